"""Simulation of scenes with two engines: compiled kernels, or Pinocchio.

A Plan is everything that follows from a scene before integration.  A flow (CompiledFlow or
PinocchioFlow) is its vector field with initial state and parameters.  A Segment is the solution
between two stops, and a Motion consists of segments with the outcome of events and controllers.
A Trajectory contains its states.  This package imports `scene`, `kernels` and packages below.
"""
