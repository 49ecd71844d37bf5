"""The problem of relative equilibria: its unknown joints and its conserved momentum.

In a relative equilibrium, the robot rotates or slides steadily with its joints at rest. It is a
critical point of the amended potential over the shape x of the active joints and, in space, over
the direction of the momentum in the body. Cyclic joints rotate steadily with prescribed
momenta. Prescribed joints are constant, or, if they are cyclic, move at constant rates.

With loops, shapes are restricted to the closed shapes. At a closed shape, N is an orthonormal basis
of the displacements that keep the loops closed, J N = 0.  A step moves along N and then to the
nearest closed shape.  With the multipliers λ of the loops, which make ∂U − Jᵀλ as small as
possible, the derivatives of U along the surface are

    gradient Nᵀ ∂U,   Hessian Nᵀ (∂∂U − Σ λ_i ∂∂φ_i) N.

At an equilibrium ∂U = Jᵀλ, so λ are the generalised forces of the loops.
Source: P.-A. Absil, R. Mahony, R. Sepulchre, "Optimization algorithms on matrix manifolds", 2008.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError
from ...common.names import joint_index
from ...forces.force import Force
from ...forces.force_model import ForceModel, touched_by
from ...forces.signals import Signal
from ...lie.rotations import rotation
from ...reduction.cyclic_joints import cyclic_of
from ...reduction.tree.body_frames import bodies_of
from ...reduction.tree.loop_constraints import constraint_values
from ...scene.scene import Scene
from ...simulation.plan import Plan, plan_of
from ...system.coordinates import PlacedJoint, ShapeSpace, shape_space
from ...system.joints import axes_of
from ...system.loops.kinematics import loop_kinematics
from ...system.loops.loop_assembly import CLOSED, loop_gaps, rate_units
from ...system.system import System

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


Which: TypeAlias = slice | list[int] | NDArray[Any]


@dataclass(frozen=True)
class Points:
    """Values of the unknowns at N points.

    Attributes:
        x: Coordinates of the active joints, (N, k).
        n: Directions in the body, (N, 3), or (N, 0) if none is unknown.
        space: Manifold of the active joints; None if they are hinges and slides.
        surface: Closed shapes of loops; None without loops.
    """

    x: Array
    n: Array
    space: ShapeSpace | None = None
    surface: LoopSurface | None = None

    def __len__(self) -> int:
        return len(self.x)

    def __getitem__(self, key: Which) -> Points:
        return self.at(self.x[key], self.n[key])

    @property
    def dimension(self) -> int:
        """Dimension of the manifold of the active joints."""
        return self.x.shape[1] if self.space is None else self.space.m

    def at(self, x: Array, n: Array) -> Points:
        """Return points of the same manifold."""
        return replace(self, x=x, n=n)

    def shape_difference(self, other: Points) -> Array:
        """Return the displacements, (N, ma), from these shapes to those of other points."""
        if self.space is None:
            return np.asarray(other.x - self.x)
        return self.space.difference(self.x, other.x)

    def shape_displaced(self, displacement: Array) -> Array:
        """Return the coordinates, (N, k), after displacements (N, ma)."""
        if self.space is None:
            return np.asarray(self.x + displacement)
        return self.space.integrate(self.x, displacement)

    @property
    def from_rest(self) -> Array:
        """Values of hinges and slides, and rotation vectors of balls, (N, ma)."""
        if self.space is None:
            return self.x
        return self.space.difference(self.space.neutral, self.x)

    def difference(self, other: Points) -> Array:
        """Return the differences of other points from these, (N, ma + 3) or (N, ma)."""
        return np.concatenate([self.shape_difference(other), other.n - self.n], axis=1)

    def moved(self, step: Array) -> Points:
        """Return the points after a step.

        Args:
            step: Displacements along the frame of the shape, or along the closed shapes of loops,
                and on the tangent plane of the sphere, (N, unknowns).
        Returns:
            The new points, with unit directions.
        """
        ma = self.dimension if self.surface is None else self.dimension - self.surface.rank
        if self.surface is None:
            x = self.shape_displaced(step[:, :ma])
        else:
            x = self.surface.moved(self.x, step[:, :ma])
        if not self.n.shape[1]:
            return self.at(x, self.n)
        n = self.n + (tangents(self.n) @ step[:, ma:, None])[..., 0]
        return self.at(x, n / np.linalg.norm(n, axis=1, keepdims=True))


def tangents(n: Array) -> Array:
    """Return orthonormal bases (N, 3, 2) of the tangent planes at unit vectors (N, 3)."""
    least = np.eye(3)[np.argmin(np.abs(n), axis=1)]
    a = np.cross(n, least)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    return np.stack([a, np.cross(n, a)], axis=-1)


def joined(parts: Sequence[Points]) -> Points:
    """Concatenate points.

    Args:
        parts: At least one set of points.
    Returns:
        All points, in order.
    """
    x, n = (np.concatenate([getattr(p, name) for p in parts]) for name in ("x", "n"))
    return parts[0].at(x, n)


def embedded(points: Points, angles: NDArray[np.bool_]) -> Array:
    """Return coordinates that are equal for equal points: angles as cosine and sine.

    Attitudes of balls are rotation matrices.

    Args:
        points: Points, (N,).
        angles: Which coordinates of active joints are periodic angles, (k,).
    Returns:
        (N, l).
    """
    x, lines, rotations = points.x[:, angles], ~angles, []
    if points.space is not None:
        lines[points.space.ball_x] = False
        rotations = [rotation(points.x[:, joint.x]) for joint in points.space.balls]
    flat = [matrix.reshape(len(points), 9) for matrix in rotations]
    return np.concatenate([np.cos(x), np.sin(x), points.x[:, lines], points.n, *flat], axis=1)


def displaced_shape(space: ShapeSpace, x: ca.SX, w: ca.SX) -> ca.SX:
    """Return x exp(w), (nx,), up to terms of second order in w.

    Args:
        space: Manifold of the shapes.
        x: Shape, (nx,).
        w: Displacement along the frame, (m,).
    """
    shape = ca.SX(space.nx, 1)
    for joint in space.joints:
        q, v = x[joint.x.start : joint.x.stop], w[joint.v.start : joint.v.stop]
        if joint.kind.is_ball:
            real = 1.0 - ca.sumsqr(v) / 8.0
            vector = real * q[:3] + 0.5 * (q[3] * v + ca.cross(q[:3], v))
            shape[joint.x] = ca.vertcat(vector, real * q[3] - 0.5 * ca.dot(q[:3], v))
        else:
            shape[joint.x] = q + v
    return shape


_STEPS = 30  # largest number of Gauss–Newton steps to a closed shape
_LONGEST = 0.5  # longest step [rad, or fraction of the loops' length]
_CLOSED = 1e-13  # last step of a closed shape [rad, or fraction of the loops' length]
_SHORTER = (1.0, 0.25, 0.0625)  # fractions of a step that are tried until the loops close
_SAME_GAP = 100.0  # largest gap, relative to that of an assembled loop
_SINGULAR = 1e-6  # least singular value of the equations, relative to that of generic shapes


@dataclass(frozen=True, eq=False)
class LoopSurface:
    """The closed shapes of the active joints of a problem.

    Attributes:
        system: The system, with loops.
        space: Manifold of the active joints.
        active: Indices of the rates of the active joints, (a,).
        active_x: Indices in x of their coordinates.
        rest: Shape that states the other joints, (nx,).
    """

    system: System
    space: ShapeSpace
    active: NDArray[np.intp]
    active_x: Sequence[int]
    rest: Array

    @property
    def rank(self) -> int:
        """Number of independent equations."""
        assert self.system.closure is not None
        return self.system.closure.rank

    def tangents(self, x: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the bases N of closed displacements.

        Args:
            x: Coordinates of the active joints, (N, k).
        Returns:
            N, (N, a, d), and whether the equations are independent, (N,).
        """
        assert self.system.closure is not None
        J = self._evaluated(x)[1]
        _, singular, right = np.linalg.svd(J * self._units)
        regular = singular[:, -1] > _SINGULAR * self.system.closure.least
        bases = np.linalg.qr(self._units[:, None] * np.swapaxes(right[:, self.rank :], 1, 2))[0]
        return bases, regular

    def curvature(self, x: Array, gradient: Array) -> Array:
        """Return Σ λ_i ∂∂φ_i, (N, a, a), with the multipliers of a gradient (N, a)."""
        if not len(x):
            return np.empty((0, self.space.m, self.space.m))
        J = self._evaluated(x)[1]
        multipliers = np.linalg.pinv(np.swapaxes(J, 1, 2)) @ gradient[..., None]
        second = self._functions[1](self._shapes(x).T, multipliers[..., 0].T)
        return np.array(second).T.reshape(len(x), self.space.m, self.space.m)

    def moved(self, x: Array, step: Array) -> Array:
        """Return closed shapes after steps.

        Args:
            x: Closed shapes, coordinates of the active joints (N, k).
            step: Steps along the bases N, (N, d).
        Returns:
            Coordinates, (N, k); x where the loops do not close after the step.
        """
        direction = (self.tangents(x)[0] @ step[..., None])[..., 0]
        result, waiting = x.copy(), np.arange(len(x))
        for fraction in _SHORTER:
            if not len(waiting):
                break
            start = self.space.integrate(x[waiting], fraction * direction[waiting])
            closed, is_closed = self.closed(start)
            result[waiting[is_closed]] = closed[is_closed]
            waiting = waiting[~is_closed]
        return result

    def closed(self, x: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the closed shapes near given shapes, by Gauss–Newton steps of least size.

        Args:
            x: Coordinates of the active joints, (N, k).
        Returns:
            Coordinates, (N, k), and whether the loops close there, (N,).
        """
        x, is_closed = x.copy(), np.zeros(len(x), dtype=bool)
        running = np.flatnonzero(np.isfinite(x).all(axis=1))
        for _ in range(_STEPS):
            if not len(running):
                break
            phi, J = self._evaluated(x[running])
            inverse = np.linalg.pinv(J * self._units, rcond=1e-9)
            step = -(inverse @ phi[..., None])[..., 0]
            size = np.abs(step).max(axis=1)
            step *= (np.minimum(1.0, _LONGEST / np.maximum(size, 1e-300)))[:, None] * self._units
            x[running] = self.space.integrate(x[running], step)
            done = size <= _CLOSED
            is_closed[running[done]] = True
            running = running[~done]
        # The equations of rotations also hold for frames that are half a turn apart.
        is_closed[is_closed] = self.is_closed(x[is_closed])
        return x, is_closed

    def is_closed(self, x: Array) -> NDArray[np.bool_]:
        """Return whether all loops are closed at shapes (N, k), (N,)."""
        assert self.system.closure is not None
        length = self.system.closure.length
        gaps = [loop_gaps(self.system, shape, length).max() for shape in self._shapes(x)]
        return np.array(gaps, dtype=float) <= _SAME_GAP * CLOSED

    def random(self, x: Array, rng: np.random.Generator) -> Array:
        """Return closed shapes near given shapes, (N, k); random copies replace failures."""
        closed, is_closed = self.closed(x)
        assert self.system.closure is not None
        chosen = closed[is_closed]
        if not len(chosen):
            chosen = self.system.closure.x[None, self.active_x]
        closed[~is_closed] = chosen[rng.integers(len(chosen), size=int((~is_closed).sum()))]
        return closed

    @property
    def _units(self) -> Array:
        """Rates that count as one, (a,)."""
        assert self.system.closure is not None
        return rate_units(self.system, self.system.closure.length)[self.active]

    def _shapes(self, x: Array) -> Array:
        shapes = np.tile(self.rest, (len(x), 1))
        shapes[:, self.active_x] = x
        return shapes

    def _evaluated(self, x: Array) -> tuple[Array, Array]:
        """Return φ, (N, c), and J along the active rates, (N, c, a)."""
        count = len(x)
        if not count:
            return np.empty((0, self.rank)), np.empty((0, self.rank, self.space.m))
        phi, J = (np.array(value) for value in self._functions[0](self._shapes(x).T))
        return phi.T, np.swapaxes(J.T.reshape(count, self.space.m, self.rank), 1, 2)

    @cached_property
    def _functions(self) -> tuple[ca.Function, ca.Function]:
        """CasADi functions of φ and J, and of Σ λ_i ∂∂φ_i, along displacements w at w = 0."""
        system = self.system
        x, w = ca.SX.sym("x", system.nx), ca.SX.sym("w", system.m)
        multipliers = ca.SX.sym("multipliers", self.rank)
        entries = ca.vertsplit(displaced_shape(system.space, x, w))
        assert system.closure is not None
        is_length = loop_kinematics(system).is_length[system.closure.rows]
        weights = np.where(is_length, 1.0 / system.closure.length, 1.0)
        values = constraint_values(system, bodies_of(system), entries)
        phi = ca.vertcat(*(c * value for c, value in zip(weights.tolist(), values, strict=True)))
        J = ca.jacobian(phi, w)[:, self.active.tolist()]
        H = ca.hessian(ca.dot(phi, multipliers), w)[0]
        H = H[self.active.tolist(), self.active.tolist()]
        at_zero = [ca.substitute(term, w, ca.SX.zeros(system.m)) for term in (phi, J, H)]
        phi, J, H = (ca.densify(term) for term in at_zero)
        options = {"cse": True}
        first = ca.Function("first", [x], [phi, ca.vec(J)], options)
        return first, ca.Function("second", [x, multipliers], [ca.vec(H)], options)
