"""Methods with equal steps refuse step counts whose ends exceed the memory."""

from __future__ import annotations

import pytest

import pinred
from pinred.integrators import integrate


@pytest.mark.parametrize("method", ["RKMK4", "Gauss", "Variational"])
def test_steps_beyond_memory_are_refused_before_the_first(method: str) -> None:
    """With events, 1e11 steps pass the limit of the counter, but no machine holds their ends."""
    beanie, turn = pinred.load("elroys_beanie"), pinred.Event("x[0]", "turn")
    with pytest.raises(pinred.InputError, match=r"step: expected step ends that fit into"):
        pinred.simulate(beanie, seed=1, duration=1.0, method=f"{method}(1e-11)", events=[turn])


def test_limit_is_the_size_of_the_step_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight bytes per number: 1000 steps of 7 numbers take 56 kB."""
    monkeypatch.setattr(integrate, "memory", lambda: 56_000)
    integrate.refuse_beyond_memory(1000.0, 7)
    with pytest.raises(pinred.InputError, match=r"got 1e\+03 steps with"):
        integrate.refuse_beyond_memory(1001.0, 7)


def test_memory_is_that_of_a_computer() -> None:
    """Between 100 MB and 100 TB."""
    assert 1e8 < integrate.memory() < 1e14
