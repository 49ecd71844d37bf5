"""Implicit methods: Gauss's collocation, Radau IIA, and a discrete Lagrange–Poincaré integrator."""
