"""The reduced vector field of a robot and a kind of scene, as CasADi expressions.

What a scene does not need is not in the graph.  The reduced state is

    y = (x, π) of the joints that act, x of the cyclic joints, attitude of the base

and the parameters are the angular momentum of the base (none if it is zero), the momenta
of the cyclic joints, and stiffness and rest of the springs.  A joint is cyclic if nothing
depends on its angle and nothing acts on it: then its momentum is constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from ..lie import SE2, SE3, SO2
from ..system import System
from .algebra import Scalar, Vec, add, cross, mul, plus
from .frames import Body, bodies_of
from .lanes import Lanes
from .sweep import step_of, sweep

AXES: dict[str, list[tuple[bool, int]]] = {
    "R": [(False, 2)],
    "SO2": [(True, 2)],
    "SE2": [(False, 0), (False, 1), (True, 2)],
    "SO3": [(True, 0), (True, 1), (True, 2)],
    "SE3": [(False, 0), (False, 1), (False, 2), (True, 0), (True, 1), (True, 2)],
}


@dataclass(frozen=True)
class Structure:
    """What decides which terms a kernel has.

    zero_momentum: of the base.  cyclic: indices of the cyclic joints.  springs: indices of
    the joints that have one.
    gravity: (3,) what acts on the shape, in the root joint's fixed frame, or None.
    """

    zero_momentum: bool = True
    cyclic: tuple[int, ...] = ()
    springs: tuple[int, ...] = ()
    gravity: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Layout:
    """Where things stand in y and in the parameters.

    active, cyclic: indices of shape joints.  attitude: number of base coordinates at the
    end of y (0, 1, or 4 for a quaternion).  spin: number of momentum parameters.
    springs: indices of joints with one.
    """

    active: tuple[int, ...]
    cyclic: tuple[int, ...]
    attitude: int
    spin: int
    springs: tuple[int, ...]

    @property
    def size(self) -> int:
        """Length of y."""
        return 2 * len(self.active) + len(self.cyclic) + self.attitude

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return self.spin + len(self.cyclic) + 2 * len(self.springs)

    @property
    def quaternion(self) -> int:
        """Index of the first of four quaternion entries in y, or −1."""
        return self.size - 4 if self.attitude == 4 else -1


class ReducedGraph:
    """The expressions of one system under one structure."""

    def __init__(self, system: System, structure: Structure, lanes: Lanes | None = None) -> None:
        """Build the sweep.

        lanes: if given, limbs of one build are computed at once, and the Functions are for
        `compile_object` with the marks of `lanes` alone.
        """
        self._system, self._structure, self._lanes = system, structure, lanes
        self._bodies = bodies_of(system)
        group, m = system.group, system.m
        self.x = [ca.SX.sym(f"x{k}") for k in range(m)]
        self.pi = [ca.SX.sym(f"pi{k}") for k in range(m)]
        self.attitude = _attitude(system)
        spin = 0 if structure.zero_momentum else {"R": 0, "SO2": 1, "SE2": 1}.get(group.name, 3)
        self.spin = [ca.SX.sym(f"spin{k}") for k in range(spin)]
        self.stiffness = [ca.SX.sym(f"k{j}") for j in structure.springs]
        self.rest = [ca.SX.sym(f"rest{j}") for j in structure.springs]
        mu = _body_momentum(system, self.spin, self.attitude)
        armature = float(system.model.armature[0]) if group is SO2 else 0.0
        cyclic = structure.cyclic
        # Nothing depends on the angle of a cyclic joint, so it may as well be zero.
        angles: list[Scalar] = [0.0 if k in cyclic else self.x[k] for k in range(m)]
        found = sweep(self._bodies, angles, self.pi, mu, AXES[group.name], armature, lanes)
        self.xi: list[Scalar] = [
            (found.root_angular if angular else found.root_linear)[k]
            for angular, k in AXES[group.name]
        ]
        self.xdot: list[Scalar] = found.xdot
        self.pidot = self._with_forces(found.pidot)
        self.layout = Layout(
            active=tuple(k for k in range(m) if k not in cyclic),
            cyclic=cyclic,
            attitude=len(self.attitude),
            spin=spin,
            springs=structure.springs,
        )

    @cached_property
    def y(self) -> ca.SX:
        """The reduced state, (size,)."""
        active, cyclic = self.layout.active, self.layout.cyclic
        return _column(
            [self.x[k] for k in active],
            [self.pi[k] for k in active],
            [self.x[k] for k in cyclic],
            self.attitude,
        )

    @cached_property
    def parameters(self) -> ca.SX:
        """The parameters, (parameters,)."""
        constant = [self.pi[k] for k in self.layout.cyclic]
        return _column(self.spin, constant, self.stiffness, self.rest)

    def rate(self) -> ca.Function:
        """Return the vector field (y, parameters) → dy/dt."""
        active, cyclic = self.layout.active, self.layout.cyclic
        rate = _column(
            [self.xdot[k] for k in active],
            [self.pidot[k] for k in active],
            [self.xdot[k] for k in cyclic],
            self._attitude_rate(),
        )
        return self._function("rate", rate)

    def outputs(self) -> ca.Function:
        """Return (y, parameters) → (ξ, ẋ, c): twist relative to the centre of mass, rate, com.

        c: (3,) is the centre of mass in the frame of Pinocchio's root body.
        """
        out = _column(self.xi, self.xdot, self.com())
        return self._function("outputs", out)

    def _function(self, name: str, value: ca.SX) -> ca.Function:
        inputs = [self.y, self.parameters]
        if self._lanes is not None:
            return self._lanes.function(name, inputs, value)
        return ca.Function(name, inputs, [ca.densify(value)], {"cse": True})

    def com(self) -> Vec:
        """Return the centre of mass in the root body's own frame, from the joints' placements."""
        return centre_of_mass(self._bodies, self.x)

    def _with_forces(self, pidot: list[Scalar]) -> list[Scalar]:
        out = list(pidot)
        for n, j in enumerate(self._structure.springs):
            out[j] = out[j] - self.stiffness[n] * (self.x[j] - self.rest[n])
        if self._structure.gravity is not None:
            weight = [float(-self._system.mass * g) for g in self._structure.gravity]
            height = sum(mul(w, c) for w, c in zip(weight, self.com(), strict=True))
            if isinstance(height, ca.SX):
                slope = ca.gradient(height, ca.vertcat(*self.x))
                out = [add(out[k], mul(-1.0, slope[k])) for k in range(len(out))]
        return out

    def _attitude_rate(self) -> list[Scalar]:
        if len(self.attitude) == 1:
            return self.xi[-1:]
        if not self.attitude:
            return []
        x, y, z, w = self.attitude
        a, b, c = self.xi[-3:]
        return [
            0.5 * (w * a + y * c - z * b),
            0.5 * (w * b + z * a - x * c),
            0.5 * (w * c + x * b - y * a),
            -0.5 * (x * a + y * b + z * c),
        ]


def centre_of_mass(bodies: list[Body], x: list[Scalar]) -> Vec:
    """Return the centre of mass in Pinocchio's root body frame, (3,)."""
    mass: list[float] = [body.mass for body in bodies]
    moment: list[Vec] = [[float(c) for c in body.moment] for body in bodies]
    for i in range(len(bodies) - 1, 0, -1):
        p, step = bodies[i].parent, step_of(bodies[i], x[i - 1])
        moved = plus(moment[i], [0.0, 0.0, mul(mass[i], step.slide)])
        for turn in reversed(step.turns):
            moved = turn.vector(moved)
        moved = plus(moved, [mul(mass[i], c) for c in step.shift])
        moment[p] = plus(moment[p], moved)
        mass[p] += mass[i]
    own = bodies[0].frame.rotation
    com = [mul(1.0 / mass[0], c) for c in moment[0]]
    return [
        add(add(mul(float(own[i, 0]), com[0]), mul(float(own[i, 1]), com[1])),
            mul(float(own[i, 2]), com[2]))
        for i in range(3)
    ]  # fmt: skip


def _attitude(system: System) -> list[ca.SX]:
    count = {"R": 0, "SO2": 1, "SE2": 1}.get(system.group.name, 4)
    return [ca.SX.sym(f"a{k}") for k in range(count)]


def _body_momentum(system: System, spin: list[ca.SX], attitude: list[ca.SX]) -> list[Scalar]:
    """Return μ in the frame of the centre of mass: no linear part, the angular one turned."""
    group = system.group
    if not spin:
        return [0.0] * system.r
    if group is SO2:
        return [spin[0]]
    if group is SE2:
        return [0.0, 0.0, spin[0]]
    q: Vec = attitude[:3]
    w = attitude[3]
    scale = 2.0 / (sum(c * c for c in q) + w * w)  # a quaternion of any length
    t = cross(spin, q)
    turned = cross(t, q)
    body = [spin[k] + scale * (w * t[k] + turned[k]) for k in range(3)]
    return [0.0, 0.0, 0.0, *body] if group is SE3 else body


def _column(*parts: list[Scalar]) -> ca.SX:
    entries = [entry for part in parts for entry in part]
    return ca.vertcat(*entries) if entries else ca.SX(0, 1)
