"""Validation of a trajectory against Pinocchio's ABA on the full state (the judge).

Imports `simulation` and the packages below it. The equations that it compares with are ABA's, so
a fault of the reduction cannot hide on both sides.
"""
