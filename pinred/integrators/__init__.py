"""Numerical integrators: options and properties, compiled steppers, and functions that run them.

A stepper calls kernels by their address, so its machine code serves every kernel. The package
ships its bitcode, which numba has compiled. `methods` defines the integrators, `integrate` runs
one, and `integrate_many` runs a batch. This package imports only `common`.
"""
