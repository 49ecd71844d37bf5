"""Numerical integrators: options and properties, compiled steppers, and functions that run them.

numba compiles each stepper once per machine. A stepper calls kernels by their address, so it
serves every kernel. `methods` defines the integrators, `integrate` runs one, and
`integrate_many` runs a batch. This package imports only `common`.
"""
