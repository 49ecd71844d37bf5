"""Inputs at random: none of them crashes, hangs, ends in a traceback, or is taken unsoundly."""

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

_FEW, _SEED = 40, 1


@pytest.fixture(scope="module", autouse=True)
def _prepared() -> None:
    fault_inputs.prepare()


@pytest.mark.parametrize("kind", KINDS)
def test_no_faults(kind: str) -> None:
    """A short form of `python tests/helpers/faults.py --long`."""
    found = faults.tried(kind, _FEW, seed=_SEED)
    assert found.faults == []
    assert found.counts.total() == _FEW


@pytest.mark.parametrize("kind", ["urdf", "mjcf", "scene", "recording"])
def test_what_is_not_changed_is_taken(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The inputs that are changed are sound themselves, so that what is tried is what is read."""
    monkeypatch.setattr(fault_inputs, "mutated", lambda _, text: text)
    monkeypatch.setattr(fault_inputs, "_odd", lambda _: "falling_cat")
    outcomes = []
    for number in range(8):
        rng = np.random.default_rng(number)
        outcomes.append(faults.outcome_of(KINDS[kind], rng, tmp_path)[0])
    assert "taken" in outcomes
    assert set(outcomes) <= {"taken", "refused"}


@pytest.mark.parametrize("fault", ["crash", "hang", "traceback", "silent"])
def test_faults_are_seen(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A child that dies, hangs, raises something else or gives nonsense counts as a fault."""

    def attempt(rng: np.random.Generator, _: Path) -> str:
        if rng.random() < 0.5:
            raise InputError("as it should be")
        if fault == "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        elif fault == "hang":
            time.sleep(60.0)
        elif fault == "traceback":
            raise RecursionError("too deep")
        return "not finite"

    monkeypatch.setattr(faults, "_PATIENCE", 0.2 if fault == "hang" else 20.0)
    monkeypatch.setitem(KINDS, "urdf", attempt)
    found = faults.tried("urdf", 6)
    assert found.counts.total() == 6
    assert found.counts[fault] >= 1
    assert {outcome for _, outcome, _ in found.faults} == {fault}
