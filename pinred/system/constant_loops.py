"""Loops whose closed shapes are linear in independent joints, as couplings: x_D = K x_I + b.

In a parallelogram, the rates of the dependent joints are constant multiples of the rates of the
independent ones.  A coupling then has the same motions, and no shape is singular: the equations of
the loop become dependent where the parallelogram is flat, those of the coupling do not.

K follows from the Jacobian at one closed shape, at which the equations have their full rank.  It is
accepted only if the loop stays closed, up to round-off, at random values of the independent joints.
The loop has no other closed shapes near the first one, because the coupling has as many followers
as the loop has independent equations there.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from ..common.arrays import Array
from .coordinates import ShapeSpace, coordinate_map
from .coupling import Coupled, coupled
from .loops.kinematics import LoopKinematics
from .loops.loop import Constraint, Loop
from .loops.loop_assembly import CLOSED, NEARBY, assemble, loop_angle, rate_units, singularity
from .robot_file_contents import Coupling
from .system import System

_ROUND_OFF = 1e-12  # largest gap of a closed loop, relative to its length [1 | rad]
_RANK = 1e-6  # smallest singular value of independent equations, relative to the largest
_INDEPENDENT = 1e-2  # smallest part of a column that is independent of the others
_WHOLE = 1e-9  # distance to a whole number below which a ratio is rounded
_SINGULAR = 1e-3  # smallest singular value of the equations at a regular shape, as a fraction
_NEARBY = 8  # number of closed shapes near the assembled one
_SAMPLES = 8  # number of random shapes at which the coupling is verified
_NEAR = 1e-6  # gap of a keyframe that closes the loops, relative to their length


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
        self._is_regular = singularity(system, system.closure.x) > _SINGULAR
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
        return int(np.linalg.matrix_rank(J, tol=_SINGULAR * float(np.linalg.norm(J))))

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
