"""Tables over scenes: time ratios within one run, and errors relative to tolerances."""

from __future__ import annotations

import numpy as np

from pinred.laboratory.bench import WorkPrecision
from pinred.laboratory.bench.accuracy import overview
from pinred.laboratory.bench.accuracy_record import Point


def powers(method: str, wall: float, error: float, order: float) -> list[Point]:
    """Return points with error `error` · tol and time wall · tol^(−1/order)."""
    return [
        Point(method, tol, wall=wall * tol ** (-1 / order), evaluations=1.0,
              shape=error * tol, rotation=0.1 * error * tol, position=0.0)
        for tol in 10.0 ** -np.arange(2.0, 15.0)
    ]  # fmt: skip


def result(problem: str, run: str, points: list[Point]) -> WorkPrecision:
    """Build a result of a run with a reference error of 1e-12."""
    about = dict.fromkeys((point.method for point in points), "made up")
    return WorkPrecision(problem, 1, 2.0, 1e-12, about, tuple(points), run=run)


def test_overview_uses_ratios_within_runs() -> None:
    """Rows are methods, columns scenes; times of another run are divided by its own pinred."""
    first = result("one", "a", powers("pinred", 1e-3, 3.0, 8) + powers("slow", 5e-3, 3.0, 8))
    # The same scene on a machine that is twice as slow: the ratio stays 5.
    again = result("one", "b", powers("pinred", 2e-3, 3.0, 8) + powers("later", 1.4e-2, 3.0, 8))
    other = result("two", "a", powers("pinred", 1e-3, 0.5, 4))
    text = overview([first, again, other]).splitlines()
    start = text.index("error 1e-08: pinred [ms], and how many times longer others take")
    assert text[start + 1].split() == ["method", "one", "two"]
    rows = {line.split()[0]: line.split()[1:] for line in text[start + 2 : start + 5]}
    # error 1e-8 is a tolerance of 1e-8/3, and of 2e-8
    walls = [(1e-8 / 3.0) ** (-1 / 8), (2e-8) ** (-1 / 4)]
    assert rows["pinred"] == [f"{wall:.3g}" for wall in walls]
    assert rows["slow"] == ["5", "—"]
    assert rows["later"] == ["7", "—"]
    end = text.index("error / tolerance, for tolerances of 1e-04 … 1e-13")
    # In scene one, 3e-13 is below the reference error and is excluded.
    assert text[end + 2].split() == ["pinred", "3", "…", "3", "0.5", "…", "0.5"]


def test_overview_splits_scenes_into_blocks() -> None:
    """At most six scenes are side by side, with aligned columns."""
    results = [result(f"s{k}", "a", powers("pinred", 1e-3, 1.0, 8)) for k in range(14)]
    text = overview(results)
    heads = [line.split()[1:] for line in text.splitlines() if line.startswith("method")]
    assert sorted({name for head in heads for name in head}) == sorted(f"s{k}" for k in range(14))
    assert max(map(len, heads)) == 6
    for table in text.split("\n\n"):
        _, head, *rows = table.splitlines()
        assert rows
        assert {len(row) for row in rows} == {len(head)}
