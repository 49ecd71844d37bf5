"""Scenes of an accuracy benchmark side by side: what others take, and what tolerances mean."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np

from .accuracy import YARDSTICK
from .work_precision import WorkPrecision

Table: TypeAlias = tuple[str, list[tuple[str, list[str]]]]  # a title, and rows with their names

ERRORS = (1e-4, 1e-6, 1e-8, 1e-10, 1e-13)
LOOSEST, TIGHTEST = 1e-4, 1e-13  # tolerances between which errors are held against them
FOLLOWING = (YARDSTICK, "pinred-dop853", "pinred-gauss")  # the methods for which that is said
_SIDE_BY_SIDE = 6  # scenes


def overview(results: Sequence[WorkPrecision]) -> str:
    """Return the tables of several results, a column a scene.

    At each error, pinred's wall time and how many times longer each other method takes, within
    the run that has both; then the errors of pinred's methods over the tolerances asked for.
    """
    scenes = list(dict.fromkeys(found.problem for found in results))
    blocks = [scenes[k : k + _SIDE_BY_SIDE] for k in range(0, len(scenes), _SIDE_BY_SIDE)]
    return "\n\n".join(_tables(results, block) for block in blocks)


def _tables(results: Sequence[WorkPrecision], scenes: list[str]) -> str:
    names = list(dict.fromkeys(n for each in results if each.problem in scenes for n in each.about))
    runs = {name: [_run(results, scene, name) for scene in scenes] for name in names}

    def table(title: str, told: Callable[[WorkPrecision, str], str]) -> Table:
        rows = {n: [told(each, n) if each else "—" for each in found] for n, found in runs.items()}
        return title, [(name, cells) for name, cells in rows.items() if set(cells) != {"—"}]

    tables = [
        table(
            f"error {error:.0e}: {YARDSTICK} [ms], and how many times longer others take",
            partial(_time, error),
        )
        for error in ERRORS
    ]
    tables.append(
        table(f"error / tolerance, for tolerances of {LOOSEST:.0e} … {TIGHTEST:.0e}", _following)
    )
    first = max(map(len, names))
    columns = zip(scenes, *(cells for _, rows in tables for _, cells in rows), strict=True)
    wide = [2 + max(map(len, column)) for column in columns]
    texts = []
    for title, rows in tables:
        lines = [_row(name, cells, first, wide) for name, cells in [("", scenes), *rows]]
        texts += ["\n".join([title, *lines])] if rows else []
    return "\n\n".join(texts)


def _run(results: Sequence[WorkPrecision], scene: str, method: str) -> WorkPrecision | None:
    """Return the run of a scene that has a method, and pinred to compare it with."""
    for found in results:
        if found.problem == scene and {method, YARDSTICK} <= set(found.about):
            return found
    return None


def _time(error: float, found: WorkPrecision, name: str) -> str:
    """Return pinred's milliseconds, or how many times longer another method takes."""
    own = name == YARDSTICK
    value = 1e3 * found.wall_at(name, error) if own else found.ratio_at(name, error)
    return "—" if np.isnan(value) else f"{value:.3g}"


def _following(found: WorkPrecision, method: str) -> str:
    """Return the least and the largest error over tolerance, of errors that are known."""
    if method not in FOLLOWING:
        return "—"
    ratios = [
        point.error / point.tolerance
        for point in found.of(method)
        if 0.99 * TIGHTEST < point.tolerance < 1.01 * LOOSEST
        and point.error > found.reference_error
    ]
    return f"{min(ratios):.2g} … {max(ratios):.2g}" if ratios else "—"


def _row(name: str, cells: list[str], first: int, wide: list[int]) -> str:
    ends = (f"{cell:>{width}}" for cell, width in zip(cells, wide, strict=True))
    return f"{name:<{first}}" + "".join(ends)
