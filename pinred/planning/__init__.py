"""Motion planning: optimal gaits, and joint motions that reorient the base.

This package imports `judge` and the packages below it, because each plan is validated.
"""
