"""The benchmark of closed loops: MuJoCo's gap decreases with the step, pinred's with rtol."""

from __future__ import annotations

import pytest

import pinred
from pinred.laboratory.bench import bench_loops, soft_loops


def test_gaps_of_soft_loops_decrease_with_the_square_of_the_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """MuJoCo at its defaults, and with the stiffest loops for two steps."""
    settings = (("Euler", 2e-3, False), ("RK4", 4e-3, True), ("RK4", 2e-3, True))
    monkeypatch.setattr(soft_loops, "ROBOTS", ("four_bar",))
    monkeypatch.setattr(soft_loops, "SETTINGS", settings)
    (result,) = bench_loops(progress=False)
    rough, fine, default, coarse, short = result.rows
    assert (result.robot, result.duration) == ("four_bar", 0.5)
    assert pinred.load("four_bar").shape_dim == 1
    assert fine.gap < 1e-10 < rough.gap < 1e-6
    assert default.gap > 1e-4
    assert coarse.gap / short.gap == pytest.approx(4.0, rel=0.1)
    assert coarse.error / short.error == pytest.approx(4.0, rel=0.2)
    assert "MuJoCo RK4, step 0.002 s, solref 0.004, solimp 0.9999" in str(result)
