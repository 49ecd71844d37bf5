"""Validation of a trajectory against Pinocchio's ABA on the full state (the judge).

Imports `simulation` and the packages below it. The reference equations are ABA's, so a fault of the
reduction cannot affect both sides.
"""
