"""The split of the mass matrix along the symmetry, and what follows from it.

Locked inertia, connection, curvature, reduced metric, potential; the reduced equations, term
by term; what of the base has to be integrated.  Imports `system` and what lies below it.
"""
