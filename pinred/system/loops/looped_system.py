"""The members of a system with closed loops, and the constraints at one of its shapes."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
import pinocchio as pin

from ...common.arrays import Array, FrozenArrays
from ...lie.group import Group
from ..coordinates import InitialState, ShapeSpace
from ..coupling import Coupled
from ..robot_file_contents import Keyframe, Origin
from .kinematics import LoopKinematics
from .loop import Constraint

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Closure(FrozenArrays):
    """A closed shape of a robot with loops, and its independent equations.  Arrays are read-only.

    Attributes:
        x: A closed shape, (nx,) [rad | m].
        rows: Indices of independent equations, (k,).
        equations: Number of all equations.
        length: Size of the loops [m].
        least: Smallest singular value of the scaled independent equations at generic shapes.
    """

    x: Array
    rows: Array
    equations: int
    length: float
    least: float

    @property
    def rank(self) -> int:
        """Number of independent equations."""
        return len(self.rows)


class LoopedSystem(Protocol):
    """The members of System on which loops depend; System imports this module."""

    @property
    def sorted_model(self) -> pin.Model: ...  # noqa: D102

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def loops(self) -> tuple[Constraint, ...]: ...  # noqa: D102

    @property
    def closure(self) -> Closure | None: ...  # noqa: D102

    @property
    def group(self) -> Group: ...  # noqa: D102

    @property
    def space(self) -> ShapeSpace: ...  # noqa: D102

    @property
    def tree(self) -> ShapeSpace: ...  # noqa: D102

    @property
    def coupled(self) -> Coupled | None: ...  # noqa: D102

    @property
    def initial(self) -> InitialState | None: ...  # noqa: D102

    @property
    def origin(self) -> Origin | None: ...  # noqa: D102

    @property
    def keyframes(self) -> Mapping[str, Keyframe]: ...  # noqa: D102

    @property
    def r(self) -> int: ...  # noqa: D102

    @property
    def m(self) -> int: ...  # noqa: D102

    @property
    def shape_dim(self) -> int: ...  # noqa: D102

    @property
    def units(self) -> tuple[str, ...]: ...  # noqa: D102

    def workspace(self, key: Hashable, make: Callable[[], T]) -> T: ...  # noqa: D102

    def on_shape(self, forces: Array) -> Array: ...  # noqa: D102

    def joint_rates(self, v: Array) -> Array: ...  # noqa: D102

    def sorted_q(self, pose: Array, x: Array) -> Array: ...  # noqa: D102


def loop_kinematics(system: LoopedSystem) -> LoopKinematics:
    """Return the loop constraints of a system, one object per thread."""
    return system.workspace(
        LoopKinematics, lambda: LoopKinematics(system.sorted_model, system.loops)
    )


def loop_values(system: LoopedSystem, x: Array) -> Array:
    """Return φ(x), (c,) [m | 1], at shape x (nx,)."""
    return loop_kinematics(system).values(configuration(system, x))


def loop_jacobian(system: LoopedSystem, x: Array) -> Array:
    """Return the Jacobian of the loops along the shape rates, (c, m)."""
    J = loop_kinematics(system).jacobian(configuration(system, x))
    return system.on_shape(J)[:, system.r :]


def loop_jacobian_rate(system: LoopedSystem, x: Array, xdot: Array) -> Array:
    """Return the time derivative of the Jacobian at shape rate ẋ (m,), (c, m)."""
    v = system.joint_rates(np.concatenate([np.zeros(system.r), xdot]))
    rate = loop_kinematics(system).jacobian_rate(configuration(system, x), v)
    return system.on_shape(rate)[:, system.r :]


def configuration(system: LoopedSystem, x: Array) -> Array:
    """Return the configuration of the model at shape x (nx,), with the base at the identity."""
    return system.sorted_q(system.group.identity(), x)
