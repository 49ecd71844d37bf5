"""Questions about a robot beside its motions: connections, gaits, phases, inspection.

Imports `simulation` and what lies below it.
"""
