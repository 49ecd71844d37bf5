"""Tables of an accuracy benchmark over scenes: time ratios, and errors relative to tolerances."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np

from .accuracy import YARDSTICK
from .work_precision import WorkPrecision

Table: TypeAlias = tuple[str, list[tuple[str, list[str]]]]  # title, and (name, cells) of each row

ERRORS = (1e-4, 1e-6, 1e-8, 1e-10, 1e-13)
LOOSEST, TIGHTEST = 1e-4, 1e-13  # largest and smallest tolerance in the table of error / tolerance
FOLLOWING = (YARDSTICK, "pinred-dop853", "pinred-gauss")  # methods in the table of error/tolerance
_SIDE_BY_SIDE = 6  # largest number of scenes in one table


def overview(results: Sequence[WorkPrecision]) -> str:
    """Format tables of several results, with one column for each scene.

    The tables contain pinred's wall time at each error, and the ratios of other methods' times in
    the same run to it. The last table gives errors of pinred's methods relative to their
    tolerances.

    Args:
        results: Results of `bench_accuracy`.
    Returns:
        The text.
    """
    scenes = list(dict.fromkeys(result.problem for result in results))
    blocks = [scenes[k : k + _SIDE_BY_SIDE] for k in range(0, len(scenes), _SIDE_BY_SIDE)]
    return "\n\n".join(_tables(results, block) for block in blocks)


def _tables(results: Sequence[WorkPrecision], scenes: list[str]) -> str:
    names = list(dict.fromkeys(n for r in results if r.problem in scenes for n in r.about))
    runs = {name: [_run(results, scene, name) for scene in scenes] for name in names}

    def table(title: str, cell: Callable[[WorkPrecision, str], str]) -> Table:
        rows = {n: [cell(run, n) if run else "—" for run in runs[n]] for n in runs}
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
    name_width = max(map(len, names))
    columns = zip(scenes, *(cells for _, rows in tables for _, cells in rows), strict=True)
    widths = [2 + max(map(len, column)) for column in columns]
    texts = []
    for title, rows in tables:
        lines = [_row(name, cells, name_width, widths) for name, cells in [("", scenes), *rows]]
        texts += ["\n".join([title, *lines])] if rows else []
    return "\n\n".join(texts)


def _run(results: Sequence[WorkPrecision], scene: str, method: str) -> WorkPrecision | None:
    """Return the run of a scene that contains both a method and pinred, or None."""
    for result in results:
        if result.problem == scene and {method, YARDSTICK} <= set(result.about):
            return result
    return None


def _time(error: float, result: WorkPrecision, name: str) -> str:
    """Format pinred's wall time [ms], or the ratio of another method's time to that time."""
    is_pinred = name == YARDSTICK
    value = 1e3 * result.wall_at(name, error) if is_pinred else result.ratio_at(name, error)
    return "—" if np.isnan(value) else f"{value:.3g}"


def _following(result: WorkPrecision, method: str) -> str:
    """Format the range of error / tolerance over points with errors above the reference error."""
    if method not in FOLLOWING:
        return "—"
    ratios = [
        point.error / point.tolerance
        for point in result.of(method)
        if 0.99 * TIGHTEST < point.tolerance < 1.01 * LOOSEST
        and point.error > result.reference_error
    ]
    return f"{min(ratios):.2g} … {max(ratios):.2g}" if ratios else "—"


def _row(name: str, cells: list[str], name_width: int, widths: list[int]) -> str:
    padded = (f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True))
    return f"{name:<{name_width}}" + "".join(padded)
