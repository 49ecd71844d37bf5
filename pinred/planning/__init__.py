"""Motion planning: optimal gaits, and joint motions that reorient the base.

Imports `judge` and the packages below it, so that each plan can be validated.
"""
