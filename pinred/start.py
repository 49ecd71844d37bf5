"""Initial states, complete and checked: one, or many at once with the same arithmetic."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import pinocchio as pin

from .arrays import Array, freeze
from .errors import InputError
from .split import cholesky
from .system import System


@dataclass(frozen=True)
class Start:
    """Initial states, with a leading axis (N, …) over them, or one without; read-only.

    pose: (size,).  x, xdot: (m,).  xi: (r,) body twist.  mu: (r,) body momentum.
    mass_matrix: (n, n) and com: (3,), centre of mass in the root body's frame, at x.
    """

    pose: Array
    x: Array
    xdot: Array
    xi: Array
    mu: Array
    mass_matrix: Array
    com: Array

    def __post_init__(self) -> None:
        freeze(self)

    def __getitem__(self, which: object) -> Start:
        return Start(*(getattr(self, field.name)[which] for field in fields(self)))


def starts(
    system: System, pose: Array, x: Array, xdot: Array, *, xi: Array | None, mu: Array | None
) -> Start:
    """Return the states with a body twist (N, r), or else with a body momentum (N, r).

    xi, mu: exactly one of them.  pose: (N, size).  x, xdot: (N, m).
    Raises SingularInertiaError where the mass matrix is singular, InputError where a
    momentum or twist overflows.
    """
    r = system.r
    H, com = inertias(system, x)
    with np.errstate(over="ignore", invalid="ignore"):  # checked below
        if xi is None and mu is not None:
            carried = (H[:, :r, r:] @ xdot[:, :, None])[:, :, 0]
            xi = np.asarray(np.linalg.solve(H[:, :r, :r], (mu - carried)[:, :, None])[:, :, 0])
        if mu is None and xi is not None:
            mu = (H[:, :r] @ np.concatenate([xi, xdot], axis=1)[:, :, None])[:, :, 0]
    assert xi is not None
    assert mu is not None
    if not (np.isfinite(xi).all() and np.isfinite(mu).all()):
        raise InputError("the initial momentum or twist overflows: rates or momentum too large")
    return Start(pose, x, xdot, xi, mu, H, com)


def inertias(system: System, x: Array) -> tuple[Array, Array]:
    """Return mass matrices (N, n, n) and centres of mass (N, 3) at shapes (N, m)."""
    model = system.model
    data: pin.Data = system.workspace(inertias, model.createData)
    n = system.n
    upper, com = np.empty((len(x), n, n)), np.empty((len(x), 3))
    for k, q in enumerate(system.q(system.group.identity(), x)):
        upper[k] = pin.crba(model, data, q)
        com[k] = data.Ycrb[1].lever
    below = system.workspace("below", lambda: np.tri(n, dtype=bool))
    H = np.where(below, np.swapaxes(upper, 1, 2), upper)
    try:
        own = np.diagonal(np.linalg.cholesky(H), axis1=1, axis2=2) ** 2
    except np.linalg.LinAlgError:
        own = np.zeros((len(x), n))
    # The part of each diagonal entry that the coordinates before it do not explain.
    sound = own > n * np.finfo(float).eps * np.diagonal(H, axis1=1, axis2=2)
    if not sound.all():
        for k in np.flatnonzero(~sound.all(axis=1)).tolist():
            cholesky(H[k], system, x[k])  # raises for those that are singular
    return H, com
