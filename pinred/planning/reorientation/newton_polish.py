"""Newton's steps of least norm: least changes of a loop, until it turns the base as it should."""

from __future__ import annotations

import numpy as np

from ...analysis.phases.path_basis import path_lift
from ...common.arrays import Array
from ..optimisation.aims import Reach
from ..optimisation.transcription import Path, Task

_STEPS = 4
_DONE = 1e-14  # rad
_TRIES = 40  # steps from afar
_NEAR = 1e-3  # rad; from where whole steps converge
_LONGEST = 0.5  # rad of the target, of one step from afar


def polished(task: Task, aim: Reach, path: Path, y: Array) -> Array:
    """Return unknowns near y that reach the aim of a task, by steps of least norm, Δy = −J⁺ r."""
    for _ in range(_STEPS):
        missed, step = _step(task, aim, path, y)
        if missed <= _DONE:
            break
        y = y + step
    return y


def approached(task: Task, aim: Reach, path: Path, y: Array) -> Array:
    """Return unknowns from which `polished` will converge, or where such steps got stuck.

    Steps are shortened until they miss less.
    """
    missed, step = _step(task, aim, path, y)
    part = min(1.0, _LONGEST / max(missed, 1e-300))
    for _ in range(_TRIES):
        if missed <= _NEAR or part < 1e-3:
            break
        tried = y + part * step
        left, following = _step(task, aim, path, tried)
        if left < missed:
            y, missed, step = tried, left, following
            part = min(1.0, 2.0 * part, _LONGEST / max(missed, 1e-300))
        else:
            part *= 0.4
    return y


def _step(task: Task, aim: Reach, path: Path, y: Array) -> tuple[float, Array]:
    """Return what is missing of the aim [rad], and Newton's step."""
    lift = path_lift(task.connection, path.basis, path.coefficients(y), task.drift)
    missed, by_twist = aim.missed(lift.pose)
    slopes = np.tensordot(by_twist, lift.twist, 1).reshape(len(missed), -1) @ path.matrix
    step = -np.linalg.lstsq(slopes, missed, rcond=1e-12)[0]
    return float(np.linalg.norm(missed)), np.asarray(step, dtype=float)
