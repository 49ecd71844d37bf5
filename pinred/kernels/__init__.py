"""Machine code for one robot and structure: expressions, compilation, validation, cache.

A kernel depends on a Structure instead of a Scene.  This package imports `integrators`, `forces`
and the packages below them.
"""
