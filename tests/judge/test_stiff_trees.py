"""Verdicts on random stiff trees are never wrong, and faults planted in them are found."""

from __future__ import annotations

import pytest
from stiff_study import AGREES, scipy_difference, study
from stiff_trees import stiff_tree

import pinred


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "seed", [pytest.param(k, marks=() if k < 4 else pytest.mark.by_hand) for k in range(300)]
)
def test_verdict_on_stiff_tree_and_on_planted_fault(seed: int) -> None:
    """No FAILED without a fault that SciPy's Radau confirms; FAILED for the fault."""
    about, outcome, report, kind, fault = study(seed)
    assert "contradicted" not in outcome, f"{about}: {report}"
    assert fault.verdict == "FAILED", f"{about}, {kind}: {fault}"


@pytest.mark.filterwarnings("ignore")
def test_scipy_confirms_motion_of_stiff_tree() -> None:
    """The independent integration that judges verdicts agrees with a passing motion."""
    traj = pinred.simulate(stiff_tree(0).scene)
    assert pinred.compare(traj).passed
    assert scipy_difference(traj) < AGREES
