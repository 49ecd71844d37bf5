"""Verdicts on random stiff trees are never wrong, and faults planted in them are found."""

from __future__ import annotations

import pytest
from stiff_study import AGREES, planted_fault, scipy_difference, study
from stiff_trees import stiff_tree

import pinred
from pinred.judge.reference_solution import FullState
from pinred.judge.step_defects import compute_defects


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "seed", [pytest.param(k, marks=() if k < 4 else pytest.mark.by_hand) for k in range(300)]
)
def test_verdict_on_stiff_tree_and_on_planted_fault(seed: int) -> None:
    """SciPy's Radau contradicts no verdict on the motion, and the fault is FAILED."""
    about, outcome, report, kind, fault = study(seed)
    assert "contradicted" not in outcome, f"{about}: {report}"
    assert fault.verdict == "FAILED", f"{about}, {kind}: {fault}"


@pytest.mark.parametrize("seed", [4, 47])
@pytest.mark.filterwarnings("ignore")
def test_planted_jumps_exceed_tolerance(seed: int) -> None:
    """An offset of a coordinate, and a jump of a rate with a unit of 1e4 rad/s."""
    traj = pinred.simulate(stiff_tree(seed).scene)
    _, wrong = planted_fault(traj, seed)
    steps = compute_defects(wrong, FullState(wrong.scene), max_steps=100_000).steps
    assert 1e-6 < 1.01 * steps[(len(steps) + 1) // 2 - 1] < 1e-3


@pytest.mark.filterwarnings("ignore")
def test_scipy_confirms_motion_of_stiff_tree() -> None:
    """The independent integration that judges verdicts agrees with a passing motion."""
    traj = pinred.simulate(stiff_tree(0).scene)
    assert pinred.compare(traj).passed
    assert scipy_difference(traj) < AGREES
