"""Initial states: as they are given, one or many, and one made complete."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..common.arrays import Array, freeze
from ..common.errors import InputError
from ..reduction.at_a_shape import PointwiseReduction
from ..system.system import System


@dataclass(frozen=True)
class GivenStates:
    """Initial states as they are given, (N, …): with body twists xi or body momenta mu, (N, r).

    pose: (N, size).  x, xdot: (N, m).  The other of xi and mu is None.
    """

    pose: Array
    x: Array
    xdot: Array
    xi: Array | None
    mu: Array | None

    @property
    def motion(self) -> Array:
        """The one of xi and mu that is given."""
        motion = self.xi if self.mu is None else self.mu
        assert motion is not None
        return motion

    def __getitem__(self, which: object) -> GivenStates:
        rows: dict[str, Any] = {
            name: None if part is None else part[which] for name, part in vars(self).items()
        }
        return GivenStates(**rows)


@dataclass(frozen=True)
class Start:
    """One initial state, complete; arrays are read-only.

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


def start_of(system: System, given: GivenStates) -> Start:
    """Return the first of initial states, complete by Pinocchio's mass matrix.

    Raises SingularInertiaError where that is singular, InputError where a momentum or twist
    overflows.
    """
    r, one = system.r, given[0]
    at = system.workspace(PointwiseReduction, lambda: PointwiseReduction(system)).split(one.x)
    H = at.mass_matrix
    xi, mu = one.xi, one.mu
    with np.errstate(over="ignore", invalid="ignore"):  # checked below
        if xi is None and mu is not None:
            xi = np.asarray(np.linalg.solve(H[:r, :r], mu - H[:r, r:] @ one.xdot))
        if mu is None and xi is not None:
            mu = H[:r] @ np.concatenate([xi, one.xdot])
    finite_start(xi, mu)
    return Start(one.pose, one.x, one.xdot, np.asarray(xi), np.asarray(mu), H, at.com)


def finite_start(*arrays: Array | None) -> None:
    """Raise InputError unless all that follows from an initial state is finite."""
    if not all(array is not None and np.isfinite(array).all() for array in arrays):
        raise InputError("the initial momentum or twist overflows: rates or momentum too large")
