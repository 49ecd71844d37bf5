"""Assembly of closed loops: joints move by damped Gauss–Newton steps until the loops close."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import ModelError
from ...common.names import quoted
from .kinematics import loop_ends
from .loop import Constraint, Loop
from .looped_system import (
    LoopedSystem,
    configuration,
    loop_jacobian,
    loop_kinematics,
)

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
    for _ in range(_MOST_STEPS):
        residual, jacobian = _linearised(system, x, length)
        step = np.linalg.lstsq(jacobian * units, -residual, rcond=_SMALLEST)[0]
        step *= min(1.0, _LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
        factor, best = 1.0, gap
        while factor > 1e-6:
            moved = system.space.integrate(x, factor * units * step)
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


def loop_gaps(system: LoopedSystem, x: Array, length: float) -> Array:
    """Return the gap of each loop, (loops,): norm of its distance over `length` and angle."""
    kinematics, q = loop_kinematics(system), configuration(system, x)
    values, gaps = np.abs(equation_weights(system, length) * kinematics.values(q)), []
    for loop, rows, X in zip(system.loops, kinematics.rows, kinematics.placements(q), strict=True):
        if X is None:
            gaps.append(float(values[rows.start]))
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
    for loop, rows, X in zip(system.loops, kinematics.rows, kinematics.placements(q), strict=True):
        angle = 0.0 if X is None else loop_angle(loop, X.rotation)
        turn = slice(rows.start + 3, rows.stop)
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
