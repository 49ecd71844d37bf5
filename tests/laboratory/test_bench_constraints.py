"""Soft stops and loops: errors of other tools decrease with the step, pinred's with rtol."""

from __future__ import annotations

import pytest
import soft_constraints

import pinred


def test_errors_of_soft_constraints_decrease_with_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo at its defaults, stiff, and with high damping; Drake with two steps."""
    pytest.importorskip("mujoco")
    pytest.importorskip("pydrake")
    settings = (("Euler", 2e-3, 0.0), ("RK4", 1e-3, 1.0), ("RK4", 1e-3, 30.0), ("RK4", 1e-4, 30.0))
    monkeypatch.setattr(soft_constraints, "STOP_SETTINGS", settings)
    monkeypatch.setattr(soft_constraints, "DRAKE", (1e-3, 2.5e-4))
    monkeypatch.setattr(soft_constraints, "_ROUNDS", 1)
    result = soft_constraints.measure_stops()
    rough, fine, default, elastic, coarse, short, long, brief = result
    assert result.title.endswith(": 3 impacts")
    assert fine.error < 1e-9 < rough.error < 1e-5
    assert fine.times == 1.0
    assert max(fine.beyond, fine.momentum, rough.momentum) < 1e-13
    assert default.error > 0.1
    assert default.beyond > 1e-2
    assert elastic.error > 0.1
    assert 3.0 < coarse.error / short.error < 30.0
    assert 1e-5 < short.beyond < coarse.beyond
    assert 2.5 < long.error / brief.error < 6.5
    assert brief.error > 1e-3
    assert "MuJoCo RK4, step 0.0001 s, solref 0.0002 30, solimp 0.9999" in str(result)
    assert len(result) == 8


def test_scene_of_the_benchmark_passes_the_comparison() -> None:
    """The exact motion agrees with ABA and impulses from the full mass matrix."""
    assert pinred.compare(pinred.simulate(soft_constraints.stopped_scene()))


def test_gaps_of_soft_constraints_decrease_with_the_square_of_the_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """MuJoCo at its defaults, and with the stiffest loops for two steps."""
    settings = (("Euler", 2e-3, 0.0), ("RK4", 4e-3, 1.0), ("RK4", 2e-3, 1.0))
    monkeypatch.setattr(soft_constraints, "LOOPED", ("four_bar",))
    monkeypatch.setattr(soft_constraints, "LOOP_SETTINGS", settings)
    (result,) = soft_constraints.measure_loops()
    rough, fine, default, coarse, short = result
    assert result.title == "four_bar: 0.5 s"
    assert pinred.load("four_bar").shape_dim == 1
    assert fine.gap < 1e-10 < rough.gap < 1e-6
    assert default.gap > 1e-4
    assert coarse.gap / short.gap == pytest.approx(4.0, rel=0.1)
    assert coarse.error / short.error == pytest.approx(4.0, rel=0.2)
    assert "MuJoCo RK4, step 0.002 s, solref 0.004 1, solimp 0.9999" in str(result)
