"""What bridges to peers share: equality of models, and velocities in fixed axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Protocol

import numpy as np
import pinocchio as pin

from ....common.arrays import Array
from ....common.errors import UnsupportedOperationError
from ....common.optional_packages import install_command
from ....reduction.pointwise_reduction import symmetric
from ....system.system import System
from ..problems import Problem
from ..solver import UNKNOWN

INSTALL = install_command("bench")
EQUAL = 1e-9  # largest relative difference that counts as equal
_STATES = 5


class Bridge(Protocol):
    """A peer's model of a system, in Pinocchio's coordinates."""

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix (n, n) with respect to Pinocchio's velocities."""

    def acceleration(self, q: Array, v: Array) -> Array:
        """Return Pinocchio's dv/dt without torques, (n,)."""


@dataclass(frozen=True)
class Equality:
    """Largest differences from Pinocchio, relative to the largest entry.

    Attributes:
        mass: Difference of the mass matrix; NaN if the peer has none.
        acceleration: Difference of dv/dt.
    """

    mass: float
    acceleration: float

    @property
    def holds(self) -> bool:
        """Whether both differences are small; a missing mass matrix is ignored."""
        worst = np.nanmax([self.mass, self.acceleration])
        return bool(np.isfinite(self.acceleration) and worst <= EQUAL)


def equality(system: System, bridge: Bridge) -> Equality:
    """Compare a peer's model of a system with Pinocchio's."""
    model, data = system.model, system.model.createData()
    rng = np.random.default_rng(0)
    mass, acceleration = [], []
    for _ in range(_STATES):
        pose = system.group.exp(rng.normal(size=system.r))
        q = system.q(pose, rng.uniform(-1.0, 1.0, system.m))
        v = rng.normal(size=system.n)
        mass.append(_relative(bridge.mass_matrix(q), symmetric(pin.crba(model, data, q))))
        expected = pin.aba(model, data, q, v, np.zeros(system.n))
        acceleration.append(_relative(bridge.acceleration(q, v), np.array(expected)))
    return Equality(float(np.max(mass)), float(np.max(acceleration)))


def no_mass_matrix(system: System) -> Array:
    """Return a matrix of NaN, for peers without a mass matrix."""
    return np.full((system.n, system.n), UNKNOWN)


def missing_unless_equal(
    package: str, label: str, bridge: Callable[[System], Bridge]
) -> Callable[[Problem], str]:
    """Return a function that says why a peer cannot run a problem; "" if it can."""

    @cache
    def why(system: System) -> str:
        try:
            differences = equality(system, bridge(system))
        except UnsupportedOperationError as error:
            return f"{label} is left out: {error}"
        if differences.holds:
            return ""
        return (
            f"{label} is not timed: its model is not Pinocchio's; mass matrix and accelerations "
            f"differ by {differences.mass:.1e} and {differences.acceleration:.1e}, relative"
        )

    def missing(problem: Problem) -> str:
        if find_spec(package) is None:
            return f"{label} is left out: {INSTALL}"
        return why(problem.system)

    return missing


def _relative(actual: Array, expected: Array) -> float:
    """Return the largest difference, relative to the largest expected entry unless that is 0."""
    return float(np.abs(actual - expected).max() / (np.abs(expected).max() or 1.0))


def root_rotation(system: System, q: Array) -> Array:
    """Return the matrix (k, k) that rotates the root's linear velocity from body to fixed axes."""
    k, pose = system.group.linear, system.configuration(q).pose
    return system.group.Ad(pose)[:k, :k]


def frame_rotation_term(system: System, v: Array) -> Array:
    """Return ω × v of the root, (k,): the acceleration due to the rotation of body axes."""
    axes, k = list(system.group.axes), system.group.linear
    twist = np.zeros(6)
    twist[axes] = v[: system.r]
    return np.asarray(np.cross(twist[3:], twist[:3])[axes[:k]])
