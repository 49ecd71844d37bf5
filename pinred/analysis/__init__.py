"""Questions about a robot beside its motions: connections, gaits, phases, inspection.

Imports `verification` and what lies below it.
"""
