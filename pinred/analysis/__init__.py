"""Analyses of a robot beyond single motions: connections, gaits, phases, stability, inspection.

Imports `simulation` and the packages below it.
"""
