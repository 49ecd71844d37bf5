"""Moments of a body for many values of its parameters at once, as `Bodies.dynamic` for each."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..common.arrays import Array

# Eigenvalues of a pseudo-inertia below this fraction of the largest one count as round-off.
LEAST = 1e-12


def moments_of_rows(rows: Mapping[str, Array]) -> Array:
    """Compute mass, first and second moments of a body about the origin of its joint.

    Each row has the bits of `Bodies.dynamic`, whatever the other rows.

    Args:
        rows: {kind: (N, size)} for mass, com, inertia, payload.mass and payload.at.
    Returns:
        Moments, (N, 10), in the order of `Bodies.dynamic`.
    """
    total = _point_moments(rows["mass"][:, 0], rows["com"])
    total[:, 4:] += rows["inertia"]
    total += _point_moments(rows["payload.mass"][:, 0], rows["payload.at"])
    return total


def _point_moments(m: Array, c: Array) -> Array:
    """Compute the moments, (N, 10), of point masses m (N,) at c (N, 3) about the origin."""
    x, y, z = c.T
    one = np.ones(len(m))
    by_mass = [one, x, y, z, y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y]
    return np.asarray(m[:, None] * np.stack(by_mass, axis=1))


def find_unphysical(values: Mapping[str, Array], names: Mapping[str, str]) -> dict[int, str]:
    """Return {row: reason} of the rows that no physical body has.

    Args:
        values: {kind: (N, size)} of the kinds in `names`, mass (N, 1) among them.
        names: {kind: name of the parameter}, for the reasons.
    Returns:
        The reasons, in the words of `Bodies.dynamic`.
    """
    reasons: dict[int, str] = {}
    for kind, rule in (("mass", "be above zero"), ("payload.mass", "not be negative")):
        if kind in names:
            column = values[kind][:, 0]
            valid = column > 0.0 if kind == "mass" else column >= 0.0
            for k in np.flatnonzero(~valid).tolist():
                text = f"parameters: '{names[kind]}' must {rule}, got {column[k]:g}"
                reasons.setdefault(k, text)
    if "inertia" in names:
        name = names["inertia"]
        for k in np.flatnonzero(~_are_physical(values["mass"], values["inertia"])).tolist():
            reasons.setdefault(
                k,
                f"parameters: '{name}' is not physical: no positive masses have these moments "
                "(each principal moment is at most the sum of the other two)",
            )
    return reasons


def _are_physical(mass: Array, moments: Array) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return whether pseudo-inertias at the centre of mass are positive semidefinite, (N,)."""
    xx, xy, xz, yy, yz, zz = moments.T
    pseudo = np.zeros((len(moments), 4, 4))
    half = 0.5 * (xx + yy + zz)
    for i, value in enumerate((half - xx, half - yy, half - zz, mass[:, 0])):
        pseudo[:, i, i] = value
    for (i, j), value in zip(((0, 1), (0, 2), (1, 2)), (xy, xz, yz), strict=True):
        pseudo[:, i, j] = pseudo[:, j, i] = -value
    eigenvalues = np.linalg.eigvalsh(pseudo)
    return np.asarray(eigenvalues[:, 0] >= -LEAST * eigenvalues[:, -1])
