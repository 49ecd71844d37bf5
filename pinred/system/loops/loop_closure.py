"""Closed shapes of a robot with loops, and the choice of independent equations.

Redundant equations are normal: a planar loop has three equations of rank two.  The rank is that of
the equations at generic closed shapes, scaled by the size of the robot, and a QR factorisation
with pivoting chooses independent equations.
"""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError, ModelError
from ...common.names import quoted
from .kinematics import JointLaw, loop_ends
from .loop import HEAVY_GROUND, Constraint, JointPolynomial, Loop
from .loop_assembly import (
    CLOSED,
    NEARBY,
    assemble,
    assemble_from_any,
    loop_length,
    rate_units,
    scaled_jacobian,
)
from .looped_system import Closure, LoopedSystem, loop_jacobian

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
    if isinstance(loop, JointPolynomial):
        return {*JointLaw(system.sorted_model, loop).joints}
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
