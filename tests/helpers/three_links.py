"""Three equal links in the plane in closed form: what purcell_swimmer and three_rods move like.

The middle link is the base; alpha1 and alpha2 are the angles from each link to the next.
"""

from __future__ import annotations

import numpy as np

from pinred.common.arrays import Array

LENGTH = 1.0 / 3.0
LINKS = ("rear", "middle", "front")
CENTRES = {"rear": -0.5 * LENGTH, "middle": 0.0, "front": 0.5 * LENGTH}  # in their own frames


def centre_jacobians(x: Array) -> dict[str, Array]:
    """Return the planar twist of each link's centre in its own axes, (3, 5), by (ξ, ẋ)."""
    half = 0.5 * LENGTH
    out = {"middle": np.eye(3, 5)}
    for name, side, column, sense in (("rear", -1.0, 3, -1.0), ("front", 1.0, 4, 1.0)):
        angle = sense * x[column - 3]
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, s], [-s, c]])  # into the link's axes
        J = np.zeros((3, 5))
        # The hinge at (±half, 0) of the base, then the centre at ±half along the link.
        J[:2, :3] = turn @ np.array([[1.0, 0.0, 0.0], [0.0, 1.0, side * half]])
        J[2, 2], J[2, column] = 1.0, sense
        J[1] += side * half * J[2]
        out[name] = J
    return out


def form(x: Array, tensor: Array) -> Array:
    """Return Σ JᵀDJ, (5, 5), of one planar tensor (3, 3) about each link's centre."""
    return np.asarray(sum(J.T @ tensor @ J for J in centre_jacobians(x).values()))


def local(G: Array) -> Array:
    """Return A of a symmetric form, (3, 2)."""
    return np.asarray(np.linalg.solve(G[:3, :3], G[:3, 3:]))
