"""Steppers for the compiled kernels, and their drivers: one run at a time, or many.

They are compiled by numba once per machine and serve every kernel, which they call by its
address.  `method` has the integrators as values, `drive` runs one, `many` runs a batch.
"""
