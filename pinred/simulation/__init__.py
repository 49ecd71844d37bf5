"""A Scene becomes a Trajectory, by one of two routes: compiled, or readable by Pinocchio.

The plan of a scene, the runs, trajectories with their balances, and the files that hold
them.  Imports `scene`, `kernels` and what lies below them.
"""
