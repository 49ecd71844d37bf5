"""Computation of loops that rotate the base to a target.

The initial loop is an ellipse computed from the curvature.  The optimiser then finds the shortest
loop, and Newton steps of least norm reduce the target error to round-off.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import path_lift
from ...common.arrays import Array
from ...common.errors import InputError
from ..optimisation.gait_search import Search, StartFailed, finish, fourier_path_of
from ..optimisation.limits import margins
from ..optimisation.objective import TargetAim
from ..optimisation.transcription import Passage, Path, Task, fourier_path

_ROOM_USED = 0.7  # largest fraction of the joint range used by the initial ellipse
_OFFSET = 0.3  # fraction of the joint range between trial shapes of the curvature
_FIT = 1e-6  # largest relative error of the rotation that the bivector produces
_POLISH_STEPS = 4  # largest number of full Newton steps
_ROUND_OFF = 1e-14  # rotation error at which the full Newton steps stop [rad]
_DAMPED_STEPS = 40  # largest number of damped Newton steps
_CONVERGENCE = 1e-3  # rotation error below which full Newton steps converge [rad]
_LONGEST = 0.5  # largest rotation of a damped step [rad]
_HARMONICS = 3  # number of harmonics of the loops
_ITERATIONS = 70  # number of iterations of the optimiser; more iterations hardly shorten loops
_EDGE = 1e-3  # fraction of the joint ranges reserved for the final Newton steps
_REACHED = 1e-5  # largest rotation error of the optimiser's loop [rad]
_FINE = 64  # number of quadrature segments of order 16 for the final Newton steps
_FINE_PASSAGE = 24  # number of quadrature segments of order 16 for each cycle from rest to rest


def first_loop(connection: Connection, start: Array, turn: Array, limits: Array) -> Gait:
    """Return the initial ellipse, whose area bivector is the smallest that yields the rotation.

    To leading order, a small loop x₀ − c + c cos φ + s sin φ moves the base by
    exp(−Σ_{a<b} B_ab S_ab), with the bivector S = π (c sᵀ − s cᵀ) of its area and the curvature B
    at x₀.

    Args:
        connection: The connection.
        start: Initial shape, (m,).
        turn: Rotation vector or angle, (turns,) [rad].
        limits: Joint limits, (m, 2); the ellipse is shrunk to fit.
    Returns:
        The ellipse.
    Raises:
        InputError: The curvature near this shape cannot produce the rotation.
    """
    m = connection.m
    room = np.maximum(np.minimum(limits[:, 1] - start, start - limits[:, 0]), 1e-3)
    S = np.zeros((m, m))
    a, b = np.triu_indices(m, 1)
    # At singular shapes, such as rods in a line, use the curvature at neighbouring shapes.
    alternating = _OFFSET * room * np.where(np.arange(m) % 2, -1.0, 1.0)
    for near in (start, start + _OFFSET * room, start + alternating):
        B = connection.curvature(near)[connection.group.linear :, a, b]  # (turns, pairs)
        least = np.linalg.lstsq(-B, turn, rcond=1e-9)[0]
        if np.linalg.norm(B @ least + turn) <= _FIT * np.linalg.norm(turn):
            break
    else:
        raise InputError(
            "small loops from this shape cannot rotate the base as requested; give another x0"
        )
    S[a, b], S[b, a] = least, -least
    # S = Σ σ (u vᵀ − v uᵀ); its leading plane has the singular vectors u and Sᵀu / σ.
    u, sizes, _ = np.linalg.svd(S)
    c = u[:, 0]
    s = S.T @ c
    s = s / max(float(np.linalg.norm(s)), 1e-300)
    radius = np.sqrt(float(sizes[0]) / np.pi)
    reach = np.max(2.0 * np.abs(c) / room + np.abs(s) / room)
    radius = min(radius, _ROOM_USED / float(reach))
    return Gait.fourier(start - radius * c, [radius * c], [radius * s])


def polish_loop(task: Task, aim: TargetAim, path: Path, y: Array) -> Array:
    """Refine unknowns with Newton steps of least norm, Δy = −J⁺ r, for the rotation error r.

    Args:
        task: The task.
        aim: The target.
        path: The family of paths.
        y: Unknowns near a solution.
    Returns:
        The refined unknowns.
    """
    for _ in range(_POLISH_STEPS):
        error, step = _newton_step(task, aim, path, y)
        if error <= _ROUND_OFF:
            break
        y = y + step
    return y


def approach_target(task: Task, aim: TargetAim, path: Path, y: Array) -> Array:
    """Move unknowns towards the target with damped Newton steps of least norm.

    Args:
        task: The task.
        aim: The target.
        path: The family of paths.
        y: Initial unknowns.
    Returns:
        Unknowns from which `polish_loop` converges, or at which the steps stagnate.
    """
    error, step = _newton_step(task, aim, path, y)
    damping = min(1.0, _LONGEST / max(error, 1e-300))
    for _ in range(_DAMPED_STEPS):
        if error <= _CONVERGENCE or damping < 1e-3:
            break
        trial = y + damping * step
        trial_error, trial_step = _newton_step(task, aim, path, trial)
        if trial_error < error:
            y, error, step = trial, trial_error, trial_step
            damping = min(1.0, 2.0 * damping, _LONGEST / max(error, 1e-300))
        else:
            damping *= 0.4
    return y


def _newton_step(task: Task, aim: TargetAim, path: Path, y: Array) -> tuple[float, Array]:
    """Return the rotation error [rad] and the Newton step of least norm."""
    lift = path_lift(task.connection, path.basis, path.coefficients(y), task.drift)
    residual, by_twist = aim.error(lift.pose)
    jacobian = np.tensordot(by_twist, lift.twist, 1).reshape(len(residual), -1) @ path.matrix
    step = -np.linalg.lstsq(jacobian, residual, rcond=1e-12)[0]
    return float(np.linalg.norm(residual)), np.asarray(step, dtype=float)


def turning_loop(task: Task, start: Array, turn: Array, *, quick: bool = False) -> Gait:
    """Find a loop that reaches the target of a task.

    Args:
        task: The task, with a TargetAim.
        start: Initial and final shape, (m,).
        turn: Rotation of the initial loop at zero momentum, (turns,) [rad].
        quick: Whether to use only Newton steps, which ignore limits, instead of the optimiser.
    Returns:
        The loop.
    Raises:
        StartFailed: No loop within the limits was found.
        InputError: The task has no target, or no initial loop exists.
    """
    m, aim = task.connection.m, task.aim
    if not isinstance(aim, TargetAim):
        raise InputError("task: expected a TargetAim")
    gait = first_loop(task.connection, start, turn, task.limits.shape)
    if quick:
        path = fourier_path_of(task, _HARMONICS, start=start)
        y = approach_target(task, aim, path, path.unknowns(gait.series.coefficients(_HARMONICS)))
        gait = Search(task, path).gait(y)
    else:
        gait = _shortest_loop(task, aim, gait, start)
    fine = fine_path(m, start, task.passage)
    y = polish_loop(task, aim, fine, fine.unknowns(gait.series.coefficients()))
    loop = Search(task, fine).gait(y)
    if margins(task.connection, loop, task.limits)["limits"] < 0.0:
        raise StartFailed("the polished loop exceeds the limits")
    return loop


def _shortest_loop(task: Task, aim: TargetAim, gait: Gait, start: Array) -> Gait:
    """Return the shortest loop within limits near a gait.  Raises StartFailed."""
    if task.passage is not None:  # reserve range for the final Newton steps
        edge = _EDGE * task.limits.reach[:, None] * np.array([1.0, -1.0])
        task = replace(task, limits=replace(task.limits, shape=task.limits.shape + edge))
    search = Search(task, fourier_path_of(task, _HARMONICS, start=start, action=True))
    end = finish(search, gait, most=_ITERATIONS, sharp=False)
    search, best = end.search, end.best
    if not _newton_step(task, aim, search.path, best.z)[0] <= _REACHED:
        raise StartFailed(f"the optimiser did not reach the target ({best.status})")
    return search.gait(best.z)


def fine_path(m: int, start: Array, passage: Passage | None, *, finer: int = 1) -> Path:
    """Return a family of Fourier paths whose quadrature is accurate to round-off.

    Args:
        m: Number of joints.
        start: Common initial shape of all paths, (m,).
        passage: Motion from rest to rest, or None.
        finer: Factor on the number of quadrature segments.
    Returns:
        The family of paths.
    """
    pieces = finer * (_FINE if passage is None else _FINE_PASSAGE)
    return fourier_path(_HARMONICS, m, pieces=pieces, power=1, start=start, passage=passage)
