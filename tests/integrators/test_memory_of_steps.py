"""Methods with equal steps refuse step counts whose ends exceed the memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pinred
from pinred.integrators import integrate
from pinred.integrators.methods import RKMK4, Gauss, Method, Variational


@pytest.mark.parametrize("method", [RKMK4, Gauss, Variational])
def test_steps_beyond_memory_are_refused_before_the_first(method: type[Method]) -> None:
    """1e11 steps pass the limit of the counter, but no machine holds their ends."""
    options: dict[str, Any] = {"step": 1e-11}
    with pytest.raises(pinred.InputError, match=r"step: expected step ends that fit into"):
        integrate.Integration(method(**options), 8, 2, 1.0, np.array([1.0]), tangent=lambda: 8)


def test_limit_is_the_size_of_the_step_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight bytes per number: 1000 steps of 7 numbers take 56 kB."""
    monkeypatch.setattr(integrate, "memory", lambda: 56_000)
    integrate.refuse_beyond_memory(1000.0, 7)
    with pytest.raises(pinred.InputError, match=r"got 1e\+03 steps with"):
        integrate.refuse_beyond_memory(1001.0, 7)


def test_memory_is_that_of_a_computer() -> None:
    """Between 100 MB and 100 TB."""
    assert 1e8 < integrate.memory() < 1e14
