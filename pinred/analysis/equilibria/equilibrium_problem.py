"""The problem of relative equilibria: its unknown joints and its conserved momentum.

In a relative equilibrium, the robot rotates or slides steadily with its joints at rest. It is a
critical point of the amended potential over the shape x of the active joints and, in space, over
the direction of the momentum in the body. Cyclic joints rotate steadily with prescribed
momenta. Prescribed joints are constant, or, if they are cyclic, move at constant rates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError
from ...common.names import joint_index
from ...forces.force import Force
from ...forces.force_model import ForceModel, touched_by
from ...forces.signals import Signal
from ...reduction.cyclic_joints import cyclic_of
from ...scene.scene import Scene
from ...simulation.plan import Plan, plan_of
from ...system.coordinates import PlacedJoint, ShapeSpace, shape_space
from ...system.joints import axes_of
from ...system.system import System
from .loop_surface import LoopSurface
from .points import Points

Kind: TypeAlias = Literal["axis", "free", "heavy"]
_STEADY = 1e-12  # relative change below which the rate of a prescribed joint is constant
_TIMES = (0.0, 0.37, 1.0)  # times at which prescribed joints are checked [s]


@dataclass(frozen=True, eq=False)
class Problem(FrozenArrays):
    """A system, its forces, and the unknowns of its relative equilibria.

    Attributes:
        system: The system.
        scene: Scene with the forces and prescribed joints.
        kind: "axis": the momentum has a fixed axis, or none (ℝ, SO(2), SE(2), ℝ × SE(2)). "free":
            its direction in the body is unknown (SO(3), SE(3)). "heavy": gravity rotates a pivoted
            base, and the upward vertical in the body is unknown.
        active: Indices of the rates of the unknown joints.
        cyclic: Indices of the rates of the cyclic joints.
        driven: Indices of the rates of the prescribed joints.
        cyclic_momenta: Momenta of the cyclic joints, (nc,).
        driven_x: Values of the prescribed joints, (nd,).
        driven_rate: Rates of the prescribed joints, (nd,).
    """

    system: System
    scene: Scene
    kind: Kind
    active: tuple[int, ...]
    cyclic: tuple[int, ...]
    driven: tuple[int, ...]
    cyclic_momenta: Array
    driven_x: Array
    driven_rate: Array

    @property
    def plan(self) -> Plan:
        """Plan of the scene, which all equilibria share except for the initial state."""
        return plan_of(self.scene)

    @property
    def directional(self) -> bool:
        """Whether a direction in the body is unknown."""
        return self.kind != "axis"

    @property
    def unknowns(self) -> int:
        """Number of unknowns: active rates, less equations of loops, and two for a direction."""
        constraints = 0 if self.surface is None else self.surface.rank
        return len(self.active) - constraints + 2 * self.directional

    @property
    def forces(self) -> ForceModel | None:
        """Model of the springs, other potentials and prescribed joints."""
        return self.scene.force_model

    @property
    def axis(self) -> Array:
        """Axis of rotation in the base frame, (3,); zero if there is no axis or more than one."""
        if self.system.group.turns != 1:
            return np.zeros(3)
        return axes_of(self.system.model.joints[1])[3:, -1]

    @property
    def reversible(self) -> bool:
        """Whether reversing the direction gives the same motion backwards in time."""
        moving = self.cyclic_momenta.any() or self.driven_rate.any()
        return self.kind == "free" and not moving

    @cached_property
    def space(self) -> ShapeSpace:
        """Manifold of the active joints."""
        joints = self._active_joints
        return shape_space([joint.name for joint in joints], [joint.kind for joint in joints])

    @cached_property
    def surface(self) -> LoopSurface | None:
        """Closed shapes of the active joints; None without loops."""
        if not self.system.loops:
            return None
        neutral = self.shapes(self.space.neutral[None])[0]
        active = np.array(self.active, dtype=np.intp)
        return LoopSurface(self.system, self.space, active, self.active_x, neutral)

    @cached_property
    def active_x(self) -> list[int]:
        """Indices in x of the coordinates of the active joints."""
        return [k for joint in self._active_joints for k in range(joint.x.start, joint.x.stop)]

    @property
    def _active_joints(self) -> list[PlacedJoint]:
        return [joint for joint in self.system.space.joints if joint.v.start in self.active]

    @cached_property
    def turning(self) -> frozenset[int]:
        """Hinges of which a full turn restores all body poses and forces."""
        system = self.system
        other = {*touched_by(self.forces), *system.space.ball_v.tolist()}
        angles = {k for k in self.active if system.units[k] == "rad" and k not in other}
        if system.coupled is None:
            return frozenset(angles)
        ratios = system.coupled.G
        is_whole = (ratios == np.round(ratios)).all(axis=0)
        return frozenset(k for k in angles if is_whole[k])

    def shapes(self, active: Array) -> Array:
        """Return shapes (N, nx) for active joints (N, k), with cyclic joints at zero."""
        space = self.system.space
        x = np.tile(space.neutral, (len(active), 1))
        x[:, self.active_x] = active
        x[:, space.coordinates_of_joints(self.driven)] = self.driven_x
        return x

    def points(self, x: Array, n: Array) -> Points:
        """Return points of the problem's unknowns.

        Args:
            x: Coordinates of the active joints, (N, k).
            n: Directions in the body, (N, 3) or (N, 0).
        Returns:
            The points.
        """
        return Points(x, n, self.space if self.space.balls else None, self.surface)

    def rates(self, cyclic: Array) -> Array:
        """Return shape rates (m,) for rates of the cyclic joints (nc,)."""
        xdot = np.zeros(self.system.m)
        xdot[list(self.cyclic)] = cyclic
        xdot[list(self.driven)] = self.driven_rate
        return xdot

    def at_rest(self) -> Problem:
        """Return the problem at zero momentum, where the direction of the momentum is undefined."""
        if self.kind != "free":
            return self
        return replace(self, kind="axis")


def problem_of(
    system: System,
    *,
    cyclic: Mapping[str, float] | None,
    springs: Mapping[str, tuple[float, float]] | None,
    forces: Sequence[Force] | Force,
    prescribed: Mapping[str, Signal | float | str] | None,
    passive: bool,
) -> Problem:
    """Build the problem of a system.

    Args:
        system: The system.
        cyclic: Momenta of cyclic joints by name; others are zero.
        springs: Springs, as in Scene.
        forces: Forces with a potential.
        prescribed: Constant or steadily moving joints.
        passive: Whether the springs in the robot's file act.
    Returns:
        The problem.
    Raises:
        InputError: A joint is unknown or not cyclic, a force does work, or a prescribed joint is
            not steady.
    """
    scene = Scene(
        system=system,
        x0=system.space.neutral if system.closure is None else system.closure.x,
        springs=springs or {},
        forces=forces,
        prescribed=prescribed or {},
        passive=passive,
        outputs="shape",
    )
    plan, model = plan_of(scene), scene.force_model
    if model is not None and (model.labels or model.has_wrench):
        raise InputError(
            f"forces: expected conservative forces, but {', '.join(model.labels)} does work; "
            "leave it out: `damped_growth` of an equilibrium gives the effect of dampers"
        )
    group = system.group
    heavy = bool(plan.turned)
    x, rate = _steady(system, model, scene.end)
    momenta_by_name, names = dict(cyclic or {}), system.shape_names
    momenta = np.zeros(len(plan.cyclic))
    for name, value in momenta_by_name.items():
        k = joint_index(name, names, "cyclic")
        if k not in plan.cyclic:
            valid = ", ".join(names[j] for j in plan.cyclic) or "none"
            raise InputError(
                f"cyclic: '{name}' is not cyclic, because something depends on its angle or drives "
                f"it. The cyclic joints are {valid}"
            )
        momenta[plan.cyclic.index(k)] = finite(value, f"cyclic['{name}']")
    active = [k for k in range(system.m) if k not in plan.cyclic and k not in plan.driven]
    return Problem(
        system=system,
        scene=scene,
        kind="heavy" if heavy else "free" if group.turns == 3 else "axis",
        active=tuple(active),
        cyclic=plan.cyclic,
        driven=plan.driven,
        cyclic_momenta=momenta,
        driven_x=x,
        driven_rate=rate,
    )


def _steady(system: System, model: ForceModel | None, end: float) -> tuple[Array, Array]:
    """Return values and rates (nd,) of the prescribed joints, or raise InputError."""
    if model is None or not model.joints:
        return np.zeros(0), np.zeros(0)
    plans = [model.prescribed(t, model.numbers_from(t, end)) for t in _TIMES]
    first, names = plans[0], [system.shape_names[k] for k in model.joints]
    free = cyclic_of(system, frozenset(), pushed=False) if first.xdot.any() else ()
    for k, name in enumerate(names):
        rates = np.array([plan.xdot[k] for plan in plans])
        acceleration = max(abs(plan.xddot[k]) for plan in plans)
        if max(np.ptp(rates), acceleration) > _STEADY * max(1.0, float(np.abs(rates).max())):
            raise InputError(
                f"prescribed['{name}']: expected a constant value or a constant rate in a relative "
                "equilibrium"
            )
        if rates[0] and model.joints[k] not in free:
            raise InputError(
                f"prescribed['{name}'] moves, and the inertia depends on it, so no motion is "
                "steady. Keep it constant, or prescribe cyclic joints only"
            )
    return first.x, first.xdot


def finite(value: float, what: str) -> float:
    """Convert a value to a finite float.

    Args:
        value: Value to convert.
        what: Name of the argument, for error messages.
    Returns:
        The number.
    Raises:
        InputError: The value is not a finite number.
    """
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number):
        raise InputError(f"{what} must be a finite number, got {value!r}")
    return number
