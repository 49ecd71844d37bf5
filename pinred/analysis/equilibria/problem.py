"""The problem of relative equilibria: which joints may move, and what the base keeps.

A relative equilibrium turns (or slides) steadily with its joints at rest.  It is a critical point
of the amended potential over the shape x of the active joints and, in space, over the direction of
the momentum in the body.  Cyclic joints turn steadily at given momenta; prescribed ones are held,
or turn at given rates where nothing depends on their angle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from ...common.arrays import Array, freeze
from ...common.errors import InputError
from ...common.names import joint_index
from ...forces.force import Force
from ...forces.force_model import ForceModel
from ...forces.signals import Signal
from ...reduction.at_a_shape import PointwiseReduction
from ...reduction.cyclic_joints import cyclic_joints
from ...scene.scene import Scene
from ...simulation.plan import Plan, plan_of
from ...system.joints import axes_of
from ...system.system import System

Kind: TypeAlias = Literal["axis", "free", "heavy"]
_STEADY = 1e-12  # relative; rates of prescribed joints that change by less are constant
_TIMES = (0.0, 0.37, 1.0)  # s; where a plan is looked at


@dataclass(frozen=True, eq=False)
class Problem:
    """A system with what acts on it; arrays are read-only.

    kind: "axis", the momentum has one axis (ℝ, SO(2), SE(2), ℝ × SE(2), or none); "free", its
    direction in the body is an unknown (SO(3), SE(3)); "heavy", gravity turns a pivoted base, and
    the unknown is the upward vertical in the body.
    active, cyclic, driven: indices of joints that are unknown, cyclic, prescribed.  cyclic_momenta:
    (nc,).  driven_x, driven_rate: (nd,).  touched: joints whose angle something but the inertia
    depends on.
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

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def plan(self) -> Plan:
        """The plan of the scene, which all equilibria share but for their start."""
        return plan_of(self.scene)

    @property
    def directional(self) -> bool:
        """Whether a direction in the body is among the unknowns."""
        return self.kind != "axis"

    @property
    def unknowns(self) -> int:
        """Number of unknowns: of the active joints, and two of a direction."""
        return len(self.active) + 2 * self.directional

    @property
    def forces(self) -> ForceModel | None:
        """Springs and other potentials, and the prescribed joints."""
        return self.scene.force_model

    @property
    def axis(self) -> Array:
        """The axis of rotation in the root body's frame, (3,), zero if there is none or several."""
        if self.system.group.turns != 1:
            return np.zeros(3)
        return axes_of(self.system.model.joints[1])[3:, -1]

    @property
    def reversible(self) -> bool:
        """Whether the opposite direction is the same motion backwards."""
        moving = self.cyclic_momenta.any() or self.driven_rate.any()
        return self.kind == "free" and not moving

    def shapes(self, active: Array) -> Array:
        """Return shapes (N, m) of the active joints' values (N, ma); cyclic ones at zero."""
        x = np.zeros((len(active), self.system.m))
        x[:, list(self.active)] = active
        x[:, list(self.driven)] = self.driven_x
        return x

    def rates(self, cyclic: Array) -> Array:
        """Return shape rates (m,) of the cyclic joints' rates (nc,)."""
        xdot = np.zeros(self.system.m)
        xdot[list(self.cyclic)] = cyclic
        xdot[list(self.driven)] = self.driven_rate
        return xdot

    def at_rest(self) -> Problem:
        """Return the problem at zero momentum, where no direction is left in free space."""
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
    """Return the problem of a system.

    Raises InputError for joints that are not there or not cyclic, forces that do work, and plans
    that are not steady; SymmetryError if gravity breaks the symmetry.
    """
    scene = Scene(
        system=system,
        x0=np.zeros(system.m),
        springs=springs or {},
        forces=forces,
        prescribed=prescribed or {},
        passive=passive,
        outputs="shape",
    )
    plan, model = plan_of(scene), scene.force_model
    acting = plan.acting
    if model is not None and (model.labels or model.has_wrench):
        raise InputError(
            f"relative equilibria are of conservative systems, but {', '.join(model.labels)} does "
            "work; leave it out (each equilibrium tells what dampers would do to it)"
        )
    group = system.group
    heavy = bool(acting.turned)
    x, rate = _steady(system, model, scene.end)
    given, names = dict(cyclic or {}), system.shape_names
    momenta = np.zeros(len(acting.cyclic))
    for name, value in given.items():
        k = joint_index(name, names, "cyclic")
        if k not in acting.cyclic:
            known = ", ".join(names[j] for j in acting.cyclic) or "none"
            raise InputError(
                f"cyclic: '{name}' has no momentum of its own to give, as something depends on its "
                f"angle or drives it; the cyclic joints are {known}"
            )
        momenta[acting.cyclic.index(k)] = finite(value, f"cyclic['{name}']")
    moving = [k for k in range(system.m) if k not in acting.cyclic and k not in acting.driven]
    return Problem(
        system=system,
        scene=scene,
        kind="heavy" if heavy else "free" if group.turns == 3 else "axis",
        active=tuple(moving),
        cyclic=acting.cyclic,
        driven=acting.driven,
        cyclic_momenta=momenta,
        driven_x=x,
        driven_rate=rate,
    )


def _steady(system: System, model: ForceModel | None, end: float) -> tuple[Array, Array]:
    """Return places and rates (nd,) of the prescribed joints.  Raises InputError."""
    if model is None or not model.joints:
        return np.zeros(0), np.zeros(0)
    plans = [model.prescribed(t, model.numbers_from(t, end)) for t in _TIMES]
    first, names = plans[0], [system.shape_names[k] for k in model.joints]
    free = cyclic_joints(PointwiseReduction(system)) if first.xdot.any() else ()
    for k, name in enumerate(names):
        rates = np.array([plan.xdot[k] for plan in plans])
        bent = max(abs(plan.xddot[k]) for plan in plans)
        if max(np.ptp(rates), bent) > _STEADY * max(1.0, float(np.abs(rates).max())):
            raise InputError(
                f"prescribed['{name}'] must stand still or move at a constant rate in a relative "
                "equilibrium"
            )
        if rates[0] and model.joints[k] not in free:
            raise InputError(
                f"prescribed['{name}'] moves, and the inertia depends on it, so that no motion is "
                "steady; hold it, or prescribe joints of symmetric rotors alone"
            )
    return first.x, first.xdot


def finite(value: float, what: str) -> float:
    """Return a number as a finite float.  Raises InputError."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number):
        raise InputError(f"{what} must be a finite number, got {value!r}")
    return number
