"""Initial states: as stated in a scene, for one run or many, and completed with momenta."""

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
    """Initial states of N runs, with either body twists or body momenta.

    Attributes:
        pose: Poses of the base, (N, size).
        x: Shapes, (N, m) [rad | m].
        xdot: Shape rates, (N, m) [rad/s | m/s].
        xi: Body twists, (N, r) [m/s; rad/s]; None if `mu` is stated.
        mu: Body momenta, (N, r) [N·s; N·m·s]; None if `xi` is stated.
    """

    pose: Array
    x: Array
    xdot: Array
    xi: Array | None
    mu: Array | None

    @property
    def motion(self) -> Array:
        """The body twists or body momenta, whichever is stated, (N, r)."""
        motion = self.xi if self.mu is None else self.mu
        assert motion is not None
        return motion

    def __getitem__(self, index: object) -> GivenStates:
        columns: dict[str, Any] = {
            name: None if column is None else column[index] for name, column in vars(self).items()
        }
        return GivenStates(**columns)


@dataclass(frozen=True)
class Start:
    """A complete initial state; arrays are read-only.

    Attributes:
        pose: Pose of the base, (size,).
        x: Shape, (m,) [rad | m].
        xdot: Shape rate, (m,) [rad/s | m/s].
        xi: Body twist, (r,) [m/s; rad/s].
        mu: Body momentum, (r,) [N·s; N·m·s].
        mass_matrix: Mass matrix H(x), (n, n), base rows first.
        com: Centre of mass in the frame of the root body at x, (3,) [m].
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
    """Complete the first of several initial states with Pinocchio's mass matrix.

    Raises SingularInertiaError if that matrix is singular, InputError if a momentum or twist
    overflows.
    """
    r, state = system.r, given[0]
    split = system.workspace(PointwiseReduction, lambda: PointwiseReduction(system)).split(state.x)
    H = split.mass_matrix
    xi, mu = state.xi, state.mu
    with np.errstate(over="ignore", invalid="ignore"):  # finite_start reports an overflow.
        if xi is None and mu is not None:
            xi = np.asarray(np.linalg.solve(H[:r, :r], mu - H[:r, r:] @ state.xdot))
        if mu is None and xi is not None:
            mu = H[:r] @ np.concatenate([xi, state.xdot])
    finite_start(xi, mu)
    return Start(state.pose, state.x, state.xdot, np.asarray(xi), np.asarray(mu), H, split.com)


def finite_start(*arrays: Array | None) -> None:
    """Raise InputError unless all arrays computed from an initial state are finite."""
    if not all(array is not None and np.isfinite(array).all() for array in arrays):
        raise InputError("the initial momentum or twist overflows: rates or momentum too large")
