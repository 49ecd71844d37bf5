"""The loop that turns the base: from an ellipse by the optimiser to the last digit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...analysis.gaits.coefficients import coefficients_of
from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import path_lift
from ...common.arrays import Array
from ...common.errors import InputError
from ..optimisation.aims import Reach
from ..optimisation.margins import margins
from ..optimisation.search import Lost, Search, fourier_path_of, within
from ..optimisation.transcription import Passage, Path, Task, fourier_path
from .first_loops import first_loop
from .newton_polish import approached, polished

_HARMONICS = 3
_ITERATIONS = 70  # more make loops hardly shorter
_EDGE = 1e-3  # of what joints may do, left to the polish of a base that tumbles
_REACHED = 1e-5  # rad; what the polish starts from, at most
_FINE = 64  # pieces of order 16 of the polish
_FINE_PASSAGE = 24  # the same of a cycle from rest to rest


def turning_loop(task: Task, start: Array, turn: Array, *, quick: bool = False) -> Gait:
    """Return a loop from a shape (m,) that does what a task says.

    turn: (turns,) rotation vector or angle [rad] by which the first loop is to turn the base, at
    zero momentum.  quick: by steps of least norm alone, which limits do not hold back.
    Raises Lost if there is none within the limits, InputError as `first_loop`.
    """
    m, aim = task.connection.m, task.aim
    if not isinstance(aim, Reach):
        raise InputError("a loop that turns the base has a target")
    gait = first_loop(task.connection, start, turn, task.limits.shape)
    if quick:
        path = fourier_path_of(task, _HARMONICS, start=start)
        y = approached(task, aim, path, path.unknowns(coefficients_of(gait, _HARMONICS)))
        gait = Search(task, path).gait(y)
    else:
        gait = _shortest(task, gait, start)
    fine = fine_path(m, start, task.passage)
    y = polished(task, aim, fine, fine.unknowns(coefficients_of(gait)))
    found = Search(task, fine).gait(y)
    if margins(task.connection, found, task.limits)["limits"] < 0.0:
        raise Lost("the polished loop goes beyond the limits")
    return found


def _shortest(task: Task, gait: Gait, start: Array) -> Gait:
    """Return the shortest loop within limits near a gait.  Raises Lost."""
    if task.passage is not None:  # room for the polish
        edge = _EDGE * task.limits.reach[:, None] * np.array([1.0, -1.0])
        task = replace(task, limits=replace(task.limits, shape=task.limits.shape + edge))
    search = Search(task, fourier_path_of(task, _HARMONICS, start=start))
    best = search.from_gait(gait, most=_ITERATIONS)
    if not _missed(search, best.z) <= _REACHED:
        raise Lost(f"the optimiser stopped short of the target ({best.status})")
    search, best = within(search, best, _HARMONICS, start)
    return search.gait(best.z)


def fine_path(m: int, start: Array, passage: Passage | None, *, finer: int = 1) -> Path:
    """Return Fourier paths from a shape (m,), fine enough for the last digit."""
    pieces = finer * (_FINE if passage is None else _FINE_PASSAGE)
    return fourier_path(
        _HARMONICS, m, pieces=pieces, checks=np.zeros(1), power=1, start=start, passage=passage
    )


def _missed(search: Search, z: Array) -> float:
    aim, path = search.task.aim, search.path
    if not isinstance(aim, Reach):
        return np.inf
    pose = path_lift(
        search.task.connection, path.basis, search.coefficients(z), search.task.drift
    ).pose
    return float(np.linalg.norm(aim.missed(pose)[0]))
