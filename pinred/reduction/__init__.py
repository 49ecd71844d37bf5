"""Reduction by symmetry: the mass matrix is split into base, coupling and shape blocks.

Computes locked inertia, connection, curvature, reduced metric and potential, the terms of the
reduced equations, and the base variables to integrate.  Imports `system` and packages below it.
"""
