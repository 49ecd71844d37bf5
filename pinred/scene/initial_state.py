"""Initial states: as given by the scene options, and completed with momenta.

This module also reports suspicious angles: too large to be accurate, or perhaps in degrees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..common.arrays import Array, FrozenArrays, is_finite
from ..common.errors import InputError
from ..common.names import quoted
from ..reduction.pointwise_reduction import PointwiseReduction
from ..system.system import System

_RESOLUTION = 1e-6  # largest spacing of floats at an accepted angle [rad]
_LARGEST_SAFE = 2.0**32  # angle at which the spacing of floats is below _RESOLUTION [rad]
_TURN = 2.0 * math.pi  # angle of a full turn [rad]


@dataclass(frozen=True)
class GivenStates:
    """Initial states of N runs, with either body twists or body momenta.

    Attributes:
        pose: Poses of the base, (N, size).
        x: Shapes, (N, nx) [rad | m | 1].
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
class Start(FrozenArrays):
    """A complete initial state; arrays are read-only.

    Attributes:
        pose: Pose of the base, (size,).
        x: Shape, (nx,) [rad | m | 1].
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


def start_of(system: System, given: GivenStates) -> Start:
    """Complete the first of several initial states with Pinocchio's mass matrix.

    Returns:
        The initial state.
    Raises:
        SingularInertiaError: The mass matrix is singular.
        InputError: A momentum or twist overflows.
    """
    r, state = system.r, given[0]
    split = system.workspace(
        PointwiseReduction, lambda: PointwiseReduction(system.open_tree())
    ).split(state.x)
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
    if not all(array is not None and is_finite(array) for array in arrays):
        raise InputError("the initial momentum or twist overflows; reduce rates or momentum")


def refuse_vague(x: Array, system: System) -> None:
    """Reject angles of a shape (nx,) at which adjacent floats differ by more than 1e-6 rad.

    Raises:
        InputError: An angle is too large.
    """
    if max(map(abs, x.tolist()), default=0.0) <= _LARGEST_SAFE:
        return
    for name, angle in _angles(x, system):
        if np.spacing(abs(angle)) > _RESOLUTION:
            raise InputError(
                f"x0: the angle of joint {quoted(name)}, {angle:g} rad, is only accurate to "
                f"{np.spacing(abs(angle)):.1g} rad, so its sine is meaningless. Reduce it to one "
                "turn."
            )


def large_angles(x: Array, system: System) -> str:
    """Return a sentence about angles of a shape (nx,) above one turn; empty without such angles."""
    large = [(name, angle) for name, angle in _angles(x, system) if abs(angle) > _TURN]
    if not large:
        return ""
    name, angle = max(large, key=lambda named: abs(named[1]))
    others = f" (and {len(large) - 1} more)" if len(large) > 1 else ""
    return (
        f"joint {quoted(name)} begins at {angle:g} rad, {abs(angle) / _TURN:.3g} turns{others}; "
        f"in degrees that would be {math.radians(angle):.4g} rad"
    )


def _angles(x: Array, system: System) -> list[tuple[str, float]]:
    """Return names and angles of the revolute joints of a shape (nx,)."""
    rows = zip(system.x_names, x.tolist(), system.space.x_units, strict=True)
    return [(name, value) for name, value, unit in rows if unit == "rad"]
