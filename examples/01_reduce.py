"""Reduce a robot: print the blocks of its mass matrix and the terms of its equations."""

import numpy as np

import pinred

system = pinred.load("coupled_planar")
red = pinred.Reduction(system)
x = np.array([0.3])
print(system)
print("I =", red.locked_inertia(x), sep="\n")
print("A =", red.local_connection(x).T)
print("M =", red.reduced_metric(x))

# The Lagrange–Poincaré equations, term by term, at shape x, rate ẋ and body twist ξ.
xdot, xi = np.array([1.0]), np.array([0.2, -0.1, 0.5])
omega = red.locked_velocity(x, xdot, xi)
print(pinred.equations.lagrange_poincare(red, x, xdot, omega))
