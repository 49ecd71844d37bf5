"""Assembly of closed loops, and the choice of independent equations.

Redundant equations are normal: a planar loop has three equations of rank two.  The rank is that of
the equations at generic closed shapes, scaled by the size of the robot, and a QR factorisation
with pivoting chooses independent equations.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
import pinocchio as pin
from scipy.linalg import qr

from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError, ModelError, UnsupportedOperationError
from ...common.names import listed, quoted
from ...lie.group import Group
from ..coordinates import InitialState
from ..coupling import Coupled
from ..robot_file_contents import Keyframe
from ..shape_space import ShapeSpace
from .kinematics import LoopKinematics, loop_ends
from .loop import Loop

T = TypeVar("T")

CLOSED = 1e-10  # largest gap of a closed loop, relative to its length [1 | rad]
_RANK = 1e-9  # smallest pivot of independent equations, relative to the largest
_LONGEST_STEP = 0.5  # longest step of the assembly [rad, or fraction of the loop's length]
_MOST_STEPS = 200  # largest number of steps of one assembly
_STARTS = 20  # number of random starts if the loops do not close from the given shapes
_NEARBY = 0.3  # displacement to a nearby closed shape [rad, or fraction of the loop's length]
_SHAPES = 3  # number of closed shapes at which the rank is determined


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
    def model(self) -> pin.Model: ...  # noqa: D102

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def loops(self) -> tuple[Loop, ...]: ...  # noqa: D102

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

    def model_q(self, pose: Array, x: Array) -> Array: ...  # noqa: D102


def loop_kinematics(system: LoopedSystem) -> LoopKinematics:
    """Return the loop constraints of a system, one object per thread."""
    return system.workspace(LoopKinematics, lambda: LoopKinematics(system.model, system.loops))


def loop_values(system: LoopedSystem, x: Array) -> Array:
    """Return φ(x), (c,) [m | 1], at shape x (nx,)."""
    return loop_kinematics(system).values(_configuration(system, x))


def loop_jacobian(system: LoopedSystem, x: Array) -> Array:
    """Return the Jacobian of the loops along the shape rates, (c, m)."""
    J = loop_kinematics(system).jacobian(_configuration(system, x))
    return system.on_shape(J)[:, system.r :]


def loop_jacobian_rate(system: LoopedSystem, x: Array, xdot: Array) -> Array:
    """Return the time derivative of the Jacobian at shape rate ẋ (m,), (c, m)."""
    v = system.joint_rates(np.concatenate([np.zeros(system.r), xdot]))
    rate = loop_kinematics(system).jacobian_rate(_configuration(system, x), v)
    return system.on_shape(rate)[:, system.r :]


def close_loops(system: LoopedSystem) -> Closure:
    """Assemble the loops of a system, and choose independent equations.

    The assembly starts at the initial shape, the keyframes and the zero shape, in this order, and
    then at random shapes.

    Args:
        system: The system, with loops.
    Returns:
        A closed shape, and independent equations.
    Raises:
        InputError: A frame is unknown, belongs to the world, or a loop closes nothing.
        ModelError: A loop does not close; the message names the loop and its gap.
        UnsupportedOperationError: The robot has balls.
    """
    if system.space.balls:
        raise UnsupportedOperationError(
            f"closed loops: ball joints are not supported in robots with loops, and "
            f"'{system.name}' has some. Replace each by three hinges, or remove the loops."
        )
    for loop in system.loops:
        _check_loop(system, loop)
    length = _length(system)
    x = _assemble_from_any(system, length)
    rows, least = _independent_rows(system, x, length)
    equations = sum(loop.equations for loop in system.loops)
    if len(rows) >= system.m:
        raise ModelError(
            f"the loops of '{system.name}' have {len(rows)} independent equations for {system.m} "
            "joint rates, so nothing can move. Remove a loop, or lock the joints (lock=)."
        )
    return Closure(x, rows, equations, length, least)


def assemble(
    system: LoopedSystem, x: Array, length: float, free: Array | None = None
) -> tuple[Array, Array]:
    """Move joints until the loops close, with damped Gauss–Newton steps of least size.

    Args:
        system: The system.
        x: Initial shape, (nx,) [rad | m].
        length: Size of the loops [m].
        free: Whether each joint may move, (m,); None if all may.
    Returns:
        The shape, (nx,), and the remaining gap of each loop, (loops,), relative to `length`.
    """
    units = _units(system, length) * (1.0 if free is None else free)
    gap = loop_gaps(system, x, length)
    for _ in range(_MOST_STEPS):
        residual, jacobian = _linearised(system, x, length)
        step = np.linalg.lstsq(jacobian * units, -residual, rcond=_RANK)[0]
        step *= min(1.0, _LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
        factor, best = 1.0, gap
        while factor > 1e-6:
            moved = x + factor * units * step
            best = loop_gaps(system, moved, length)
            if np.linalg.norm(best) < np.linalg.norm(gap):
                break
            factor *= 0.5
        else:
            break
        x, gap = moved, best
    return x, gap


def describe_gap(system: LoopedSystem, gaps: Array, length: float) -> str:
    """Return a sentence that names the loop with the largest gap."""
    k = int(np.argmax(gaps))
    name = quoted(system.loops[k].name)
    return f"loop {name} has a gap of {gaps[k] * length:.3g} m (angles times {length:.3g} m)"


def project_rates(
    system: LoopedSystem, x: Array, xdot: Array, metric: Array, free: Array | None = None
) -> Array | None:
    """Return the rates nearest to given rates that keep the loops closed.

    Args:
        system: The system.
        x: Closed shape, (nx,) [rad | m].
        xdot: Rates, (m,).
        metric: Kinetic metric in which distances are measured, (m, m).
        free: Whether each rate may change, (m,); None if all may.
    Returns:
        The rates, (m,); None if the free rates cannot keep the loops closed.
    """
    assert system.closure is not None
    J, rates = loop_jacobian(system, x)[system.closure.rows], xdot.copy()
    moves = np.ones(len(xdot), dtype=bool) if free is None else free
    if free is not None and np.linalg.matrix_rank(J[:, moves], tol=1e-9) < len(J):
        return None
    response = np.linalg.solve(metric[np.ix_(moves, moves)], J[:, moves].T)
    rates[moves] -= response @ np.linalg.solve(J[:, moves] @ response, J @ xdot)
    return rates


def singularity(system: LoopedSystem, x: Array) -> float:
    """Return the smallest singular value of the scaled independent equations at shape x (nx,).

    The value is relative to generic shapes; it is zero where equations become dependent.
    """
    closure = system.closure
    assert closure is not None
    J = _scaled_jacobian(system, x, closure.length)[closure.rows]
    return float(np.linalg.svd(J, compute_uv=False).min() / closure.least)


def loop_rates(system: LoopedSystem) -> frozenset[int]:
    """Return the indices of the shape rates that move a loop."""
    moving: list[int] = []
    for loop in system.loops:
        a, b = (_path(system, end.joint) for end in loop_ends(system.model, loop))
        for joint in a ^ b:
            moving += range(*system.tree.joints[joint - 2].v.indices(system.tree.m))
    if system.coupled is None:
        return frozenset(moving)
    return frozenset(np.flatnonzero(system.coupled.G[moving].any(axis=0)).tolist())


def _path(system: LoopedSystem, joint: int) -> set[int]:
    """Return the joints from a joint to the root."""
    path = set[int]()
    while joint:
        path.add(joint)
        joint = int(system.model.parents[joint])
    return path


def _check_loop(system: LoopedSystem, loop: Loop) -> None:
    a, b = loop_ends(system.model, loop)
    for end in (a, b):
        if end.joint == 0:
            raise InputError(
                f"loops: loop {quoted(loop.name)} attaches the robot to the world, which breaks "
                "the symmetry. Remove it, or attach it to a moving link."
            )
    if not _path(system, a.joint) ^ _path(system, b.joint):
        raise InputError(
            f"loops: loop {quoted(loop.name)} closes nothing: {quoted(loop.frame_a)} and "
            f"{quoted(loop.frame_b)} do not move relative to each other. Remove it."
        )


def _configuration(system: LoopedSystem, x: Array) -> Array:
    return system.model_q(system.group.identity(), x)


def _length(system: LoopedSystem) -> float:
    """Return the size of the loops: the largest distance of a joint or end from its parent [m]."""
    placements = [system.model.jointPlacements[i] for i in range(2, system.model.njoints)]
    for loop in system.loops:
        placements += [end.placement for end in loop_ends(system.model, loop)]
    return max(float(np.linalg.norm(M.translation)) for M in placements) or 1.0


def _units(system: LoopedSystem, length: float) -> Array:
    return np.array([length if unit == "m" else 1.0 for unit in system.units])


def _weights(system: LoopedSystem, length: float) -> Array:
    return np.where(loop_kinematics(system).is_length, 1.0 / length, 1.0)


def _scaled_jacobian(system: LoopedSystem, x: Array, length: float) -> Array:
    J = loop_jacobian(system, x) * _weights(system, length)[:, None]
    return np.asarray(J * _units(system, length))


def loop_gaps(system: LoopedSystem, x: Array, length: float) -> Array:
    """Return the gap of each loop, (loops,): norm of its distance over `length` and angle."""
    gaps = []
    places = loop_kinematics(system).placements(_configuration(system, x))
    for loop, X in zip(system.loops, places, strict=True):
        gaps.append(np.hypot(np.linalg.norm(X.translation) / length, _angle(loop, X.rotation)))
    return np.array(gaps)


def _angle(loop: Loop, R: Array) -> float:
    """Return the angle between the frames, or between their axes [rad]."""
    if loop.kind == "3d":
        return 0.0
    if loop.kind == "6d":
        return float(np.linalg.norm(pin.log3(R)))
    k = "xyz".index(loop.kind)
    across = np.linalg.norm(np.delete(R[:, k], k))
    return float(np.arctan2(across, R[k, k]))


def _linearised(system: LoopedSystem, x: Array, length: float) -> tuple[Array, Array]:
    """Return the scaled residuals (c,), and their Jacobian (c, m), for one step of the assembly.

    Rotations use the rotation vector or the angle, which point to the closed shape from any
    distance, unlike the sines of φ.
    """
    kinematics = loop_kinematics(system)
    q = _configuration(system, x)
    weights = _weights(system, length)
    residual, J = weights * kinematics.values(q), weights[:, None] * loop_jacobian(system, x)
    for loop, rows, X in zip(system.loops, kinematics.rows, kinematics.placements(q), strict=True):
        angle = _angle(loop, X.rotation)
        turn = slice(rows.start + 3, rows.stop)
        if loop.kind == "3d" or angle < 1e-3:
            continue
        if loop.kind == "6d":
            R = X.rotation
            sines = 0.5 * (np.trace(R) * np.eye(3) - R.T)
            J[turn] = pin.Jlog3(R) @ np.linalg.pinv(sines) @ J[turn]
            residual[turn] = pin.log3(R)
        elif angle > 0.5 * np.pi:  # beyond a right angle the sine decreases again
            across = max(float(np.linalg.norm(residual[turn])), 1e-3)
            residual[turn] *= 1.0 / across
    return residual, J


def _assemble_from_any(system: LoopedSystem, length: float) -> Array:
    rng, best, fewest = np.random.default_rng(0), None, np.inf
    starts = [] if system.initial is None else [system.initial.x]
    starts += [keyframe.x for keyframe in system.keyframes.values()]
    starts.append(system.space.neutral)
    units = _units(system, length)
    starts += [_NEARBY * k**0.5 * units * rng.uniform(-1, 1, system.m) for k in range(1, _STARTS)]
    for start in starts:
        x, gaps = assemble(system, start, length)
        if gaps.max() <= CLOSED:
            return x
        if gaps.max() < fewest:
            best, fewest = gaps, float(gaps.max())
    assert best is not None
    raise ModelError(
        f"the loops of '{system.name}' do not close: {describe_gap(system, best, length)} at the "
        "nearest shape that was found. Check the two frames and their placements."
    )


def _independent_rows(system: LoopedSystem, x: Array, length: float) -> tuple[Array, float]:
    """Return independent equations of the largest rank at closed shapes near x."""
    rng, units = np.random.default_rng(0), _units(system, length)
    best: tuple[int, float, Array] = (-1, 0.0, np.empty(0, dtype=int))
    for k in range(_SHAPES + 1):
        start = x if k == 0 else x + _NEARBY * units * rng.uniform(-1.0, 1.0, system.m)
        shape, gaps = assemble(system, start, length)
        if gaps.max() > CLOSED:
            continue
        J = _scaled_jacobian(system, shape, length)
        _, R, order = qr(J.T, mode="economic", pivoting=True)
        pivots = np.abs(np.diag(R))
        rank = int((pivots > _RANK * pivots[0]).sum())
        rows = np.sort(order[:rank])
        least = float(np.linalg.svd(J[rows], compute_uv=False).min())
        if (rank, least) > best[:2]:
            best = (rank, least, rows)
    return best[2].astype(np.intp), best[1]


def describe_loops(system: LoopedSystem) -> str:
    """Return loops, equations, rank and dimension of the shape in words; empty without loops."""
    closure = system.closure
    if closure is None:
        return ""
    return (
        f"{listed([str(loop) for loop in system.loops])}; {closure.equations} equations of rank "
        f"{closure.rank}, shape of dimension {system.shape_dim}"
    )
