"""The judge: compare a trajectory with Pinocchio's ABA on the full state.

Imports `simulation` and the packages below it. The equations on the other side are ABA's own, so
that a fault of the reduction cannot hide on both sides.
"""
