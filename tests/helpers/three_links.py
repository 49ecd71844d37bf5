"""Closed forms for three equal planar links: the robots purcell_swimmer and three_rods.

The middle link is the base. alpha1 and alpha2 are the angles from each link to the next.
"""

from __future__ import annotations

import numpy as np

from pinred.common.arrays import Array

LENGTH = 1.0 / 3.0
LINKS = ("rear", "middle", "front")
CENTRES = {
    "rear": -0.5 * LENGTH,
    "middle": 0.0,
    "front": 0.5 * LENGTH,
}  # x of the centre in the frame of the link [m]


def centre_jacobians(x: Array) -> dict[str, Array]:
    """Return the Jacobian of each link's centre, (3, 5): planar body twist per (ξ, ẋ)."""
    half = 0.5 * LENGTH
    jacobians = {"middle": np.eye(3, 5)}
    for name, side, column, sense in (("rear", -1.0, 3, -1.0), ("front", 1.0, 4, 1.0)):
        angle = sense * x[column - 3]
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.array([[c, s], [-s, c]])  # from base axes to link axes
        J = np.zeros((3, 5))
        # Velocity of the hinge at (±half, 0) of the base; then that of the centre, ±half further.
        J[:2, :3] = rotation @ np.array([[1.0, 0.0, 0.0], [0.0, 1.0, side * half]])
        J[2, 2], J[2, column] = 1.0, sense
        J[1] += side * half * J[2]
        jacobians[name] = J
    return jacobians


def form(x: Array, tensor: Array) -> Array:
    """Return Σ JᵀDJ, (5, 5), where D = tensor (3, 3) acts at each link's centre."""
    return np.asarray(sum(J.T @ tensor @ J for J in centre_jacobians(x).values()))


def local(G: Array) -> Array:
    """Return the connection A of a symmetric form, (3, 2)."""
    return np.asarray(np.linalg.solve(G[:3, :3], G[:3, 3:]))
