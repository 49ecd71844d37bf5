"""Kernels: the reduced equations of a robot as validated, cached machine code.

A kernel depends on a Structure, which many Scenes share, and not on a Scene.  This package imports
`integrators`, `forces` and the packages below them.
"""
