"""Assembly of closed loops, and the choice of independent equations.

Joints move by damped Gauss–Newton steps until the loops close.

Redundant equations are normal: a planar loop has three equations of rank two.  The rank is that of
the equations at generic closed shapes, scaled by the size of the robot, and a QR factorisation
with pivoting chooses independent equations.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import InputError, ModelError
from ...common.names import quoted
from .kinematics import (
    Closure,
    LoopedSystem,
    configuration,
    law_of,
    loop_ends,
    loop_jacobian,
    loop_kinematics,
)
from .loop import HEAVY_GROUND, Constraint, Loop

CLOSED = 1e-10  # largest gap of a closed loop, relative to its length [1 | rad]
NEARBY = 0.3  # displacement to a nearby closed shape [rad, or fraction of the loop's length]
_SMALLEST = 1e-6  # smallest singular value that a step inverts, relative to the largest
_LONGEST_STEP = 0.5  # longest step of the assembly [rad, or fraction of the loop's length]
_MOST_STEPS = 200  # largest number of steps of one assembly
_STARTS = 20  # number of random starts if the loops do not close from the given shapes


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
    units = rate_units(system, length) * (1.0 if free is None else free)
    gap = loop_gaps(system, x, length)
    size = np.linalg.norm(gap)
    for _ in range(_MOST_STEPS):
        residual, jacobian = _linearised(system, x, length)
        step = np.linalg.lstsq(jacobian * units, -residual, rcond=_SMALLEST)[0]
        step *= min(1.0, _LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
        factor = 1.0
        while factor > 1e-6:
            trial = system.space.integrate(x, factor * units * step)
            trial_gap = loop_gaps(system, trial, length)
            trial_size = np.linalg.norm(trial_gap)
            if trial_size < size:
                break
            factor *= 0.5
        else:
            break
        x, gap, size = trial, trial_gap, trial_size
    return x, gap


def describe_gap(system: LoopedSystem, gaps: Array, length: float) -> str:
    """Return a sentence that names the loop with the largest gap."""
    k = int(np.argmax(gaps))
    name = quoted(system.loops[k].name)
    return f"loop {name} has a gap of {gaps[k] * length:.3g} m (angles times {length:.3g} m)"


def loop_gaps(system: LoopedSystem, x: Array, length: float) -> Array:
    """Return the gap of each loop, (loops,): norm of its distance over `length` and angle."""
    kinematics, q = loop_kinematics(system), configuration(system, x)
    placements, gaps = kinematics.placements(q), list[float]()
    values = np.empty(0)  # of constraints without frames
    if any(X is None for X in placements):
        values = np.abs(equation_weights(system, length) * kinematics.values(q))
    for loop, equations, X in zip(system.loops, kinematics.rows, placements, strict=True):
        if X is None:
            gaps.append(float(values[equations.start]))
            continue
        gaps.append(np.hypot(np.linalg.norm(X.translation) / length, loop_angle(loop, X.rotation)))
    return np.array(gaps)


def assemble_from_any(system: LoopedSystem, length: float) -> Array:
    """Assemble from known shapes, the zero shape, or random shapes, in turn.

    Known are the initial shape, the keyframes, and the closed shapes of the robots of which the
    system was made.

    Args:
        system: The system.
        length: Size of the loops [m].
    Returns:
        A closed shape, (nx,) [rad | m].
    Raises:
        ModelError: The loops do not close from any of these; the message names one and its gap.
    """
    rng, best, fewest = np.random.default_rng(0), None, np.inf
    starts = [] if system.initial is None else [system.initial.x]
    starts += [keyframe.x for keyframe in system.keyframes.values()]
    derivation = None if system.origin is None else system.origin.derivation
    if derivation is not None and derivation.closed:
        x = system.space.neutral.copy()
        for joint in system.space.joints:
            x[joint.x] = derivation.closed.get(joint.name, x[joint.x])
        starts.append(x)
    starts.append(system.space.neutral)
    units = rate_units(system, length)
    for k in range(1, _STARTS):
        displacement = NEARBY * k**0.5 * units * rng.uniform(-1.0, 1.0, system.m)
        starts.append(system.space.integrate(system.space.neutral, displacement))
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


def loop_length(system: LoopedSystem, loops: Sequence[Constraint] | None = None) -> float:
    """Return the size of the loops: the largest distance of a joint or end from its parent [m].

    Args:
        system: The system.
        loops: The loops; None for those of the system.
    """
    placements = [
        system.sorted_model.jointPlacements[i] for i in range(2, system.sorted_model.njoints)
    ]
    for loop in system.loops if loops is None else loops:
        if isinstance(loop, Loop):
            placements += [end.placement for end in loop_ends(system.sorted_model, loop)]
    return max(float(np.linalg.norm(M.translation)) for M in placements) or 1.0


def rate_units(system: LoopedSystem, length: float) -> Array:
    """Return the rate of each shape joint that counts as one, (m,): 1 rad/s, or `length` per s."""
    return np.array([length if unit == "m" else 1.0 for unit in system.units])


def scaled_jacobian(system: LoopedSystem, x: Array, length: float) -> Array:
    """Return the Jacobian at shape x (nx,) of loops of the given length without units, (c, m)."""
    J = loop_jacobian(system, x) * equation_weights(system, length)[:, None]
    return np.asarray(J * rate_units(system, length))


def equation_weights(system: LoopedSystem, length: float) -> Array:
    """Return the factor on each equation of loops of the given length that removes its unit."""
    return np.where(loop_kinematics(system).is_length, 1.0 / length, 1.0)


def loop_angle(loop: Constraint, R: Array) -> float:
    """Return the angle between the frames, or between their axes [rad]."""
    if not isinstance(loop, Loop) or loop.kind == "3d":
        return 0.0
    if loop.kind == "6d":
        return float(np.linalg.norm(pin.log3(R)))
    k = "xyz".index(loop.kind)
    across = np.linalg.norm(np.delete(R[:, k], k))
    return float(np.arctan2(across, R[k, k]))


def _linearised(system: LoopedSystem, x: Array, length: float) -> tuple[Array, Array]:
    """Return the scaled residuals (c,), and their Jacobian (c, m), for one step of the assembly.

    Rotational residuals are rotation vectors or angles.  Unlike the sines in φ, they point to the
    closed shape from any distance.
    """
    kinematics = loop_kinematics(system)
    q = configuration(system, x)
    weights = equation_weights(system, length)
    residual, J = weights * kinematics.values(q), weights[:, None] * loop_jacobian(system, x)
    for loop, equations, X in zip(
        system.loops, kinematics.rows, kinematics.placements(q), strict=True
    ):
        angle = 0.0 if X is None else loop_angle(loop, X.rotation)
        turn = slice(equations.start + 3, equations.stop)
        if not isinstance(loop, Loop) or X is None or angle < 1e-3:
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


# Smallest pivot of independent equations, relative to the largest.  Files round angles to four or
# more digits, so redundant equations have singular values of about 1e-9.
_RANK = 1e-6
_SHAPES = 3  # number of closed shapes at which the rank is determined


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
    """
    for loop in system.loops:
        if isinstance(loop, Loop):
            _check_loop(system, loop)
    length = loop_length(system)
    x = assemble_from_any(system, length)
    rows, least = _independent_rows(system, x, length)
    equations = sum(loop.equations for loop in system.loops)
    if len(rows) >= system.m:
        raise ModelError(
            f"the loops of '{system.name}' have {len(rows)} independent equations for {system.m} "
            "joint rates, so nothing can move. Remove a loop, or lock the joints (lock=)."
        )
    return Closure(x, rows, equations, length, least)


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
    J = scaled_jacobian(system, x, closure.length)[closure.rows]
    return float(np.linalg.svd(J, compute_uv=False).min() / closure.least)


def loop_rates(system: LoopedSystem) -> frozenset[int]:
    """Return the indices of the shape rates that move a loop."""
    moving: list[int] = []
    for loop in system.loops:
        for joint in moving_joints(system, loop):
            moving += range(*system.tree.joints[joint - 2].v.indices(system.tree.m))
    if system.coupled is None:
        return frozenset(moving)
    return frozenset(np.flatnonzero(system.coupled.G[moving].any(axis=0)).tolist())


def moving_joints(system: LoopedSystem, loop: Constraint) -> set[int]:
    """Return the joints in the model that move a loop."""
    if not isinstance(loop, Loop):
        return {*law_of(system.sorted_model, loop).joints}
    a, b = (_path(system, end.joint) for end in loop_ends(system.sorted_model, loop))
    return a ^ b


def _path(system: LoopedSystem, joint: int) -> set[int]:
    """Return the joints from a joint to the root."""
    path = set[int]()
    while joint:
        path.add(joint)
        joint = int(system.sorted_model.parents[joint])
    return path


def _check_loop(system: LoopedSystem, loop: Loop) -> None:
    a, b = loop_ends(system.sorted_model, loop)
    for end in (a, b):
        if end.joint == 0:
            raise InputError(
                f"loops: loop {quoted(loop.name)} attaches the robot to the world, which breaks "
                f"the symmetry. Remove it, attach it to a moving link, or {HEAVY_GROUND}."
            )
    if not _path(system, a.joint) ^ _path(system, b.joint):
        raise InputError(
            f"loops: loop {quoted(loop.name)} closes nothing: {quoted(loop.frame_a)} and "
            f"{quoted(loop.frame_b)} do not move relative to each other. Remove it."
        )


def _independent_rows(system: LoopedSystem, x: Array, length: float) -> tuple[Array, float]:
    """Return independent equations of the largest rank at closed shapes near x."""
    from scipy.linalg import qr

    rng, units = np.random.default_rng(0), rate_units(system, length)
    best: tuple[int, float, Array] = (-1, 0.0, np.empty(0, dtype=int))
    for k in range(_SHAPES + 1):
        nearby = NEARBY * units * rng.uniform(-1.0, 1.0, system.m)
        start = x if k == 0 else system.space.integrate(x, nearby)
        shape, gaps = assemble(system, start, length)
        if gaps.max() > CLOSED:
            continue
        J = scaled_jacobian(system, shape, length)
        _, R, order = qr(J.T, mode="economic", pivoting=True)
        pivots = np.abs(np.diag(R))
        rank = int((pivots > _RANK * pivots[0]).sum())
        rows = np.sort(order[:rank])
        least = float(np.linalg.svd(J[rows], compute_uv=False).min())
        if (rank, least) > best[:2]:
            best = (rank, least, rows)
    return best[2].astype(np.intp), best[1]
