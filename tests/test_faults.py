"""Random invalid inputs cause no crash, hang, traceback or unsound result."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import fault_inputs
import faults
import numpy as np
import pytest
from fault_inputs import KINDS

from pinred.common.errors import InputError

_COUNT, _SEED = 40, 1


@pytest.fixture(scope="module", autouse=True)
def _prepared() -> None:
    fault_inputs.prepare()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.sampled(4)
def test_random_inputs_cause_no_fault(kind: str) -> None:
    """A short form of `python tests/helpers/faults.py --long`."""
    tally = faults.tried(kind, _COUNT, seed=_SEED)
    assert tally.faults == []
    assert tally.counts.total() == _COUNT


@pytest.mark.parametrize("kind", ["urdf", "mjcf", "scene", "recording"])
def test_unmutated_inputs_are_accepted(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without mutations the same inputs are accepted, so the mutations reach the readers."""
    monkeypatch.setattr(fault_inputs, "mutated", lambda _, text: text)
    monkeypatch.setattr(fault_inputs, "_odd", lambda _: "falling_cat")
    outcomes = []
    for number in range(8):
        rng = np.random.default_rng(number)
        outcomes.append(faults.outcome_of(KINDS[kind], rng, tmp_path)[0])
    assert "taken" in outcomes
    assert set(outcomes) <= {"taken", "refused"}


@pytest.mark.parametrize("fault", ["crash", "hang", "traceback", "silent"])
def test_each_kind_of_fault_is_counted(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A child that dies, hangs, raises another error or returns a message counts as a fault."""

    def attempt(rng: np.random.Generator, _: Path) -> str:
        if rng.random() < 0.5:
            raise InputError("a correct rejection")
        if fault == "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        elif fault == "hang":
            time.sleep(60.0)
        elif fault == "traceback":
            raise RecursionError("too deep")
        return "not finite"

    monkeypatch.setattr(faults, "_PATIENCE", 0.2 if fault == "hang" else 20.0)
    monkeypatch.setitem(KINDS, "urdf", attempt)
    tally = faults.tried("urdf", 6)
    assert tally.counts.total() == 6
    assert tally.counts[fault] >= 1
    assert {outcome for _, outcome, _ in tally.faults} == {fault}
