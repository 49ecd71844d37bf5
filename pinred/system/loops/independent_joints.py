"""Independent joints as coordinates of the closed shapes of a robot with loops.

With independent joints I and dependent joints D, closed shapes have the rates ẋ = G u̇ with

    G = [1; −J_D⁻¹ J_I],   ∂_c G = [0; −J_D⁻¹ (∂_c J) G],

where J are the independent equations of the loops, and ∂_c is the derivative along column c of G.
The chart is singular where J_D is: at the dead points of a mechanism.  Other independent joints
are regular there, unless the equations of the loops are dependent.

Where G is constant, as in a parallelogram, a coupling x_D = K x_I + b replaces the loop.  It has
the same motions, and no shape is singular: the equations of the loop become dependent where the
parallelogram is flat, those of the coupling do not.  K follows from the Jacobian at one closed
shape, at which the equations have their full rank.  It is accepted only if the loop stays closed,
up to round-off, at random values of the independent joints.  The loop has no other closed shapes
near the first one, because the coupling has as many followers as the loop has independent equations
there.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...common.errors import InputError, SingularInertiaError
from ...common.names import brief, listed, quoted
from ..coordinates import ShapeSpace, coordinate_map, shape_space
from ..coupling import Coupled, coupled
from ..joints import HINGE, SLIDE
from ..robot_file_contents import Coupling
from ..system import System
from .kinematics import LoopKinematics, loop_jacobian, loop_jacobian_rate, loop_values
from .loop import Constraint, Loop
from .loop_assembly import (
    CLOSED,
    NEARBY,
    assemble,
    loop_angle,
    rate_units,
    scaled_jacobian,
    singularity,
)

_SINGULAR = 1e-7  # smallest singular value of J_D, relative to that of J, away from dead points
_DEAD = 1e-4  # the same ratio, below which other independent joints replace those of the chart
_STEP = 0.1  # longest step along which a closed shape is followed [rad | fraction of the length]
_SHORTEST = 1e-4  # shortest such step, near dead points
_ITERATIONS = 20  # largest number of Newton steps
_CLOSED = 1e-13  # largest change of a joint in the last Newton step [rad | m]
_LONGEST = 1.0  # longest Newton step [rad | fraction of the length]
_BALL = 1e-3  # weight of a ball's rates, which are dependent if possible
_ROUND_OFF = 1e-12  # largest gap of a closed loop, relative to its length [1 | rad]
_RANK = 1e-6  # smallest singular value of independent equations, relative to the largest
_INDEPENDENT = 1e-2  # smallest part of a column that is independent of the others
_WHOLE = 1e-9  # distance to a whole number below which a ratio is rounded
_REGULAR = 1e-3  # smallest singular value of the equations at a regular shape, as a fraction
_NEARBY = 8  # number of closed shapes near the assembled one
_SAMPLES = 8  # number of random shapes at which the coupling is verified
_NEAR = 1e-6  # gap of a keyframe that closes the loops, relative to their length


@dataclass(frozen=True, eq=False)
class LoopChart:
    """Independent joints of a robot with loops.

    Attributes:
        system: The system, with loops.
        independent: Indices of the independent rates, (d,).
        dependent: Indices of the dependent rates, (k,).
    """

    system: System
    independent: NDArray[np.intp]
    dependent: NDArray[np.intp]

    @property
    def names(self) -> tuple[str, ...]:
        """Labels of the independent rates, (d,)."""
        return tuple(self.system.space.names[k] for k in self.independent)

    def space(self) -> ShapeSpace:
        """Return the space of the independent coordinates.  Raises InputError for axes of balls."""
        self._coordinates()
        units = [self.system.space.units[k] for k in self.independent]
        return shape_space(self.names, [SLIDE if unit == "m" else HINGE for unit in units])

    def regular_at(self, x: Array) -> LoopChart:
        """Return this chart, or other independent joints at a dead point of these.

        Args:
            x: Closed shape, (nx,) [rad | m].
        Returns:
            A chart that is regular at x.
        Raises:
            SingularInertiaError: The equations of the loops are dependent at x, so no chart is.
        """
        if self.regularity(x) > _DEAD:
            return self
        scaled, _ = self._scaled(x)
        singular = np.linalg.svd(scaled, compute_uv=False).min(initial=np.inf)
        if not singular > _SINGULAR * np.linalg.norm(scaled):
            loops = listed([loop.name for loop in self.system.loops], 6)
            raise SingularInertiaError(
                f"the equations of the loops {loops} of '{self.system.name}' become dependent at "
                f"x = {x}, where motions can continue in several ways. Stay away from this shape."
            )
        return LoopChart(self.system, *_pivoted(self.system, x))

    def regularity(self, x: Array) -> float:
        """Return the smallest singular value of J_D at x (nx,), relative to the size of J."""
        scaled, least = self._scaled(x)
        return least / max(float(np.linalg.norm(scaled)), 1e-300)

    def near(self, x: Array, u: Array) -> Array:
        """Return the closed shape near a shape x (nx,), with independent coordinates u (d,).

        Raises:
            SingularInertiaError: The loops do not close there.
        """
        at = self._coordinates()
        x = x.copy()
        x[at] = u
        closed = self._follow(x, np.zeros(len(at)))
        closed[at] = u
        return closed

    def tangent(self, x: Array) -> Array:
        """Return G at a closed shape x (nx,), (m, d).

        Raises:
            SingularInertiaError: The independent joints do not determine the others there.
        """
        G = np.zeros((self.system.m, len(self.independent)))
        G[self.independent] = np.eye(len(self.independent))
        G[self.dependent] = -self._solve(x, self._jacobian(x)[:, self.independent])
        return G

    def tangent_rate(self, x: Array, xdot: Array, G: Array) -> Array:
        """Return the time derivative of G, (m, d), at rates ẋ = G u̇ (m,)."""
        closure = self.system.closure
        assert closure is not None
        rate = np.zeros_like(G)
        change = loop_jacobian_rate(self.system, x, xdot)[closure.rows]
        rate[self.dependent] = -self._solve(x, change @ G)
        return rate

    def shapes(self, u: Array) -> Array:
        """Return the closed shapes, (N, nx), with independent coordinates u (N, d).

        They are followed from the closed shape that was assembled, so they depend continuously on
        u.

        Raises:
            SingularInertiaError: The loops do not close there.
        """
        at, closure = self._coordinates(), self.system.closure
        assert closure is not None
        unit = rate_units(self.system, closure.length)[self.independent]
        x, shapes = closure.x, np.empty((len(u), self.system.space.nx))
        for k, target in enumerate(u):
            step = _STEP
            while (span := target - x[at]).any():
                share = min(1.0, step / float(np.abs(span / unit).max()))
                goal = target if share == 1.0 else x[at] + share * span
                try:
                    x = self._follow(x, goal - x[at])
                except SingularInertiaError:
                    # Near a dead point, the other joints move faster than the independent ones.
                    if (step := 0.25 * step) < _SHORTEST:
                        raise
                    continue
                x[at] = goal
                step = min(_STEP, 2.0 * step)
            shapes[k] = x
        return shapes

    def _follow(self, x: Array, step: Array) -> Array:
        """Return the closed shape at a displacement of the independent joints from x (nx,)."""
        space, closure = self.system.space, self.system.closure
        assert closure is not None
        change = np.zeros(self.system.m)
        change[self.independent] = step
        J = self._jacobian(x)
        residual = loop_values(self.system, x)[closure.rows] + J[:, self.independent] @ step
        last = np.inf
        side = np.linalg.slogdet(J[:, self.dependent])[0]
        for _ in range(_ITERATIONS):
            try:
                change[self.dependent] = -np.linalg.solve(J[:, self.dependent], residual)
            except np.linalg.LinAlgError:
                break
            x, size = space.integrate(x, change), float(np.abs(change).max())
            if not size <= _LONGEST * closure.length and not size <= _LONGEST:
                break
            if size <= _CLOSED or (size < 1e-10 and size >= last):
                # A change of sign reveals that the step has passed a singular shape.
                if np.linalg.slogdet(J[:, self.dependent])[0] != side:
                    break
                return np.asarray(x)
            J, residual = self._jacobian(x), loop_values(self.system, x)[closure.rows]
            change[self.independent], last = 0.0, size
        raise SingularInertiaError(self._singular(x))

    def _jacobian(self, x: Array) -> Array:
        assert self.system.closure is not None
        return np.asarray(loop_jacobian(self.system, x)[self.system.closure.rows])

    def _solve(self, x: Array, right: Array) -> Array:
        """Return J_D⁻¹ times a vector or matrix.  Raises SingularInertiaError at dead points."""
        scaled, least = self._scaled(x)
        if not least > _SINGULAR * np.linalg.norm(scaled):
            raise SingularInertiaError(self._singular(x))
        return np.asarray(np.linalg.solve(self._jacobian(x)[:, self.dependent], right))

    def _scaled(self, x: Array) -> tuple[Array, float]:
        """Return J without units, (k, m), and the smallest singular value of its J_D."""
        closure = self.system.closure
        assert closure is not None
        scaled = scaled_jacobian(self.system, x, closure.length)[closure.rows]
        singular = np.linalg.svd(scaled[:, self.dependent], compute_uv=False)
        return scaled, float(singular.min(initial=np.inf))

    def _singular(self, x: Array) -> str:
        loops = listed([loop.name for loop in self.system.loops], 6)
        return (
            f"the loops {loops} of '{self.system.name}' do not determine the other joints from "
            f"{listed(self.names)} near x = {x}. Choose other independent joints (independent=), "
            "or stay away from this shape."
        )

    def _coordinates(self) -> list[int]:
        """Return the indices of the independent coordinates in x.  Raises InputError for balls."""
        balls = {*self.system.space.ball_v.tolist()} & {*self.independent.tolist()}
        if balls:
            name = self.system.space.names[min(balls)]
            raise InputError(
                f"independent: {quoted(name)} is an axis of a ball joint, which has no coordinate "
                "of its own. Replace the ball by three hinges, or lock it."
            )
        return self.system.space.coordinates_of(self.independent.tolist())


def loop_chart(system: System, independent: Sequence[str] | None = None) -> LoopChart:
    """Choose the independent joints of a robot with loops.

    Args:
        system: The system, with loops.
        independent: Names of the independent joints, as many as `shape_dim`, in the order of the
            coordinates u.  None: a pivoted QR factorisation at the
            assembled shape chooses the dependent joints.
    Returns:
        The chart.
    Raises:
        InputError: A joint is unknown, or the number of joints is wrong.
        SingularInertiaError: The joints do not determine the others at the assembled shape, or the
            equations of the loops are dependent there.
    """
    closure, names = system.closure, system.space.names
    assert closure is not None
    if independent is None:
        chosen, dependent = _pivoted(system, closure.x)
    else:
        for name in independent:
            if name not in names:
                raise InputError(
                    f"independent: no joint {brief(name)}. The joints are {listed(names, 60)}."
                )
        chosen = np.array([names.index(name) for name in independent], dtype=np.intp)
        if len(chosen) != system.shape_dim or len({*independent}) != len(chosen):
            raise InputError(
                f"independent: expected {system.shape_dim} joints, each once, got "
                f"{listed(independent, 60)}. The joints are {listed(names, 60)}."
            )
        dependent = np.setdiff1d(np.arange(system.m), chosen)
    chart = LoopChart(system, chosen.astype(np.intp), dependent.astype(np.intp))
    chart.regular_at(closure.x)
    chart.tangent(closure.x)
    return chart


def _pivoted(system: System, x: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return independent (d,) and dependent (k,) rates by a pivoted QR factorisation at x."""
    from scipy.linalg import qr

    closure = system.closure
    assert closure is not None
    J = scaled_jacobian(system, x, closure.length)[closure.rows]
    J /= np.maximum(np.linalg.norm(J, axis=1, keepdims=True), 1e-300)
    weight = np.ones(system.m)
    weight[system.space.ball_v] = 1.0 / _BALL
    _, _, order = qr(J * weight, mode="economic", pivoting=True)
    dependent = np.sort(order[: closure.rank]).astype(np.intp)
    return np.setdiff1d(np.arange(system.m), dependent).astype(np.intp), dependent


def with_constant_loops(system: System, driven: Collection[str] = ()) -> System:
    """Replace loops whose closed shapes are linear in independent joints by couplings.

    Args:
        system: The system, with loops.
        driven: Names of joints with motors, which lead if possible.
    Returns:
        The system with couplings; `system` itself if it has no such loop.
    """
    search = _Search(system, driven)
    couplings, kept, constant = [*system.couplings], [], []
    for loop in system.loops:
        new_couplings = search.couplings_of(loop, couplings)
        if new_couplings is None:
            kept.append(loop)
        else:
            couplings += new_couplings
            constant.append(loop)
    if not constant:
        return system
    contents = replace(
        system.contents,
        couplings=tuple(couplings),
        loops=tuple(kept),
        coupled_loops=(*system.contents.coupled_loops, *constant),
    )
    at = _at_leaders(system, couplings)
    contents = replace(
        contents,
        keyframes={
            name: replace(frame, x=frame.x[at[0]], xdot=frame.xdot[at[1]])
            for name, frame in contents.keyframes.items()
        },
    )
    start = system.initial
    if start is not None:
        start = replace(start, x=start.x[at[0]], xdot=start.xdot[at[1]])
    return System(system.model, system.name, start, system.origin, contents)


def _at_leaders(system: System, couplings: Sequence[Coupling]) -> tuple[list[int], list[int]]:
    """Return indices of the coordinates and rates of the joints that follow no other."""
    followers = {coupling.follower for coupling in couplings}
    joints = [joint for joint in system.space.joints if joint.name not in followers]
    numbers = range(system.nx)
    return (
        [k for joint in joints for k in numbers[joint.x]],
        [k for joint in joints for k in numbers[joint.v]],
    )


class _Search:
    """The search for couplings that are equivalent to loops of a system."""

    def __init__(self, system: System, driven: Collection[str]) -> None:
        assert system.closure is not None
        self._system, self._length = system, system.closure.length
        self._map = coordinate_map(system.sorted_model, system.group, system.tree)
        self._first = system.joint_values(system.closure.x)
        self._is_regular = singularity(system, system.closure.x) > _REGULAR
        units = [self._length if unit == "m" else 1.0 for unit in system.tree.units]
        self._units = np.array(units)
        model, depths = system.model, [0] * system.model.njoints
        for i in range(1, model.njoints):
            depths[i] = depths[int(model.parents[i])] + 1
        self._depths = dict(zip(map(str, model.names), depths, strict=True))
        self._depths |= dict.fromkeys(driven, 0)

    @cached_property
    def _starts(self) -> list[Array]:
        """The assembled shape and closed shapes near it, as coordinates of all joints."""
        system, length, rng = self._system, self._length, np.random.default_rng(0)
        assert system.closure is not None
        shapes = [system.closure.x]
        for _ in range(_NEARBY):
            change = NEARBY * rate_units(system, length) * rng.uniform(-1.0, 1.0, system.m)
            start = system.space.integrate(system.closure.x, change)
            shape, gaps = assemble(system, start, length)
            if gaps.max() <= CLOSED:
                shapes.append(shape)
        return [system.joint_values(x) for x in shapes]

    def couplings_of(
        self, loop: Constraint, couplings: Sequence[Coupling]
    ) -> list[Coupling] | None:
        """Return couplings with the closed shapes of a loop; None if there are none.

        Args:
            loop: The loop.
            couplings: Couplings of the robot, and of loops before this one.
        """
        if isinstance(loop, Loop) and not loop.coupled:
            return None
        law = coupled(self._system.tree, couplings, self._system.root_name)
        kinematics = LoopKinematics(self._system.sorted_model, [loop])
        for joints in [self._first] if self._is_stated(kinematics) else self._starts:
            candidates = self._candidates(kinematics, law, joints)
            if candidates is None or not self._verified(
                kinematics, [*couplings, *candidates], joints
            ):
                continue
            if self._has_keyframes(kinematics, [*couplings, *candidates]):
                return candidates
        return None

    def _is_stated(self, kinematics: LoopKinematics) -> bool:
        """Return whether a shape of the file closes a loop, and is on one branch only.

        Otherwise the branch of the assembled shape is arbitrary.
        """
        system, first = self._system, self._first
        shapes = [system.space.neutral, *(frame.x for frame in system.keyframes.values())]
        shapes += [] if system.initial is None else [system.initial.x]
        rank = self._rank(kinematics, first)
        return self._is_regular and any(
            self._gap(kinematics, joints) < _NEAR and self._rank(kinematics, joints) == rank
            for joints in map(system.joint_values, shapes)
        )

    def _rank(self, kinematics: LoopKinematics, joints: Array) -> int:
        """Return the rank of the equations of a loop."""
        J = kinematics.jacobian(self._q(joints))[:, self._system.r :] * self._units
        J /= np.where(kinematics.is_length, self._length, 1.0)[:, None]
        return int(np.linalg.matrix_rank(J, tol=_REGULAR * float(np.linalg.norm(J))))

    def _candidates(
        self, kinematics: LoopKinematics, law: Coupled | None, joints: Array
    ) -> list[Coupling] | None:
        """Return the couplings that agree with a loop at a closed shape, to first order."""
        space = self._system.tree if law is None else law.space
        leads = np.arange(space.m) if law is None else law.leads
        units = self._units[leads]
        J = kinematics.jacobian(self._q(joints))[:, self._system.r :]
        J = (J if law is None else J @ law.G) * units
        J = J / np.where(kinematics.is_length, self._length, 1.0)[:, None]
        size = np.linalg.norm(J, ord=2)
        if size <= _ROUND_OFF:
            return []  # other loops already close this one
        moving = np.flatnonzero(np.linalg.norm(J, axis=0) > _ROUND_OFF * size)
        if {*moving.tolist()} & {*space.ball_v.tolist()}:
            return None
        # Driven joints lead, then those near the root.
        outward = sorted(moving.tolist(), key=lambda k: (self._depths[space.names[k]], k))
        dependent = sorted(_last_independent(J, outward))
        if len(dependent) != np.linalg.matrix_rank(J, tol=_RANK * size):
            return None
        independent = [k for k in moving.tolist() if k not in dependent]
        ratios = -np.linalg.lstsq(J[:, dependent], J[:, independent], rcond=None)[0]
        ratios *= units[dependent][:, None] / units[independent]
        integers = np.round(ratios)
        ratios = np.where(np.abs(ratios - integers) < _WHOLE, integers, ratios)
        values = _scalars(self._system.tree, joints)
        candidates = []
        for k, row in zip(dependent, ratios, strict=True):
            leaders = {space.names[j]: float(c) for j, c in zip(independent, row, strict=True) if c}
            if not leaders:
                return None
            name = space.names[k]
            offset = values[name] - sum(c * values[n] for n, c in leaders.items())
            candidates.append(Coupling(name, leaders, offset if abs(offset) > _ROUND_OFF else 0.0))
        return candidates

    def _verified(
        self, kinematics: LoopKinematics, couplings: Sequence[Coupling], start: Array
    ) -> bool:
        """Return whether a loop stays closed at random values of the independent joints."""
        law = coupled(self._system.tree, couplings, self._system.root_name)
        rng = np.random.default_rng(0)
        for _ in range(_SAMPLES):
            if law is None:  # the loop is closed at all shapes
                change = rng.uniform(-np.pi, np.pi, len(self._units)) * self._units
                joints = self._system.tree.integrate(start, change)
            else:
                change = rng.uniform(-np.pi, np.pi, law.space.m) * self._units[law.leads]
                joints = law.values(law.space.integrate(start[law.leads_x], change))
            if self._gap(kinematics, joints) > _ROUND_OFF:
                return False
        return True

    def _has_keyframes(self, kinematics: LoopKinematics, couplings: Sequence[Coupling]) -> bool:
        """Return whether each initial state that closes a loop also obeys the couplings.

        A quadrangle with equal opposite sides is a parallelogram, or has two crossed sides.
        """
        law, system = coupled(self._system.tree, couplings, self._system.root_name), self._system
        states = [frame.x for frame in system.keyframes.values()]
        states += [] if system.initial is None else [system.initial.x]
        for x in states:
            joints = system.joint_values(x)
            if law is None or self._gap(kinematics, joints) > _NEAR:
                continue
            difference = law.values(joints[law.leads_x]) - joints
            # Whole turns of a hinge are no difference.
            if np.abs(np.sin(0.5 * difference)).max() > _NEAR:
                return False
        return True

    def _gap(self, kinematics: LoopKinematics, joints: Array) -> float:
        """Return the gap of a loop, relative to its length [1 | rad]."""
        q = self._q(joints)
        units = np.where(kinematics.is_length, self._length, 1.0)
        gap = float(np.abs(kinematics.values(q) / units).max())
        (loop,), (place,) = kinematics.loops, kinematics.placements(q)
        # The sines of a frame that is turned by half a turn vanish, too.
        return gap if place is None else max(gap, _large(loop_angle(loop, place.rotation)))

    def _q(self, joints: Array) -> Array:
        pose = self._system.group.identity()
        return np.asarray(self._map.to_q(np.concatenate([pose, joints])))


def _large(angle: float) -> float:
    return angle if angle > 1e-3 else 0.0


def _last_independent(J: Array, columns: Sequence[int]) -> list[int]:
    """Return the last of the given columns of J that are linearly independent."""
    chosen: list[int] = []
    basis = np.zeros((len(J), 0))
    for k in reversed(columns):
        residual = J[:, k] - basis @ (basis.T @ J[:, k])
        residual -= basis @ (basis.T @ residual)
        size = np.linalg.norm(residual)
        if size > _INDEPENDENT * np.linalg.norm(J[:, k]):
            chosen.insert(0, k)
            basis = np.column_stack([basis, residual / size])
    return chosen


def _scalars(tree: ShapeSpace, joints: Array) -> dict[str, float]:
    """Return the values of hinges and slides by name."""
    return {
        joint.name: float(joints[joint.x][0]) for joint in tree.joints if not joint.kind.is_ball
    }
