"""Relative equilibria: steady motions of a shape that does not change, found and identified."""
