"""Integrators as values with their claims, their compiled steppers, and the drivers of runs.

Steppers are compiled by numba once per machine and serve every kernel, which they call by
its address.  `methods` has the integrators as values, `integrate` runs one, `integrate_many`
a batch.  Imports `common` alone.
"""
