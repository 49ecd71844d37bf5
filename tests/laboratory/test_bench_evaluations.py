"""Number of evaluations for an error, compared with counts on the full state."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pinred.common.errors import InputError
from pinred.judge.reference_solution import FullMotion
from pinred.laboratory.bench.method_comparison import ERRORS, bench_evaluations
from pinred.laboratory.bench.problems import problems_named


@pytest.fixture(scope="module")
def counts() -> dict[str, tuple[float, ...]]:
    """Count evaluations on a short planar chain."""
    parts: list[float] = []
    (result,) = bench_evaluations(["planar-2"], progress=parts.append)
    assert parts == [1.0]
    counts = {row.method: tuple(vars(row)[f"{e:.0e}"] for e in ERRORS) for row in result}
    lines = str(result).splitlines()
    assert lines[0] == result.title
    head, row = lines[1].split(), lines[2].split()
    assert head == ["method", *(f"{error:.0e}" for error in ERRORS)]
    assert row == ["DOP853", *(f"{n:.0f}" for n in counts["DOP853"])]
    return counts


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), [("DOP853", "DOP853"), ("Dormand–Prince 5(4)", "RK45")])
def test_evaluations_equal_those_on_full_state(
    counts: dict[str, tuple[float, ...]], name: str, kind: str
) -> None:
    """The same method over Pinocchio's ABA needs about as many for the same error."""
    (problem,), _ = problems_named(["planar-2"])
    full, start, m, r = problem.full, problem.full_start(), problem.system.m, problem.system.r
    truth = full.run(start, problem.times, 2e-14, 1e-16)
    points = []
    for tol in 10.0 ** -np.arange(2.0, 13.1, 0.5):
        run = solve_ivp(
            full.rate, (0.0, problem.start.duration), start, kind, rtol=max(tol, 1e-13), atol=tol
        )
        end = FullMotion(x=run.y[None, -2 * m - r : -m - r, -1], q=full.q(run.y[:, -1])[None])
        points.append((problem.apart(truth, end), run.nfev))
    for error, count in zip(ERRORS, counts[name], strict=True):
        second = min(nfev for reached, nfev in points if reached <= error)
        assert 1 / 1.6 < count / second < 1.6, (error, count, second)


def test_evaluations_grow_with_order(counts: dict[str, tuple[float, ...]]) -> None:
    """Four more digits cost a method of order p about 10^(4/p) times as many."""
    for name, order in (("Dormand–Prince 5(4)", 5), ("DOP853", 8), ("DOP853, a scale a kind", 8)):
        grown = np.log10(counts[name][3] / counts[name][1])
        assert 4 / order - 0.3 < grown < 4 / order + 0.3, name
    best = min(row[3] for name, row in counts.items() if "sweeps" not in name)
    assert counts["AdaptiveGauss, sweeps"][3] < best / 2


def test_bench_evaluations_rejects_unknown_scene() -> None:
    """The message names the scene."""
    with pytest.raises(InputError, match="no_such"):
        bench_evaluations(["no_such"])
