"""Hairer's codes: errors come out at once, failures in silence, and the smallest rates are none."""

from __future__ import annotations

import numpy as np
import pytest

from pinred.common.arrays import Array
from pinred.verification.hairer import Hairer

METHODS = ["dop853", "dopri5"]


@pytest.mark.parametrize("method", METHODS)
def test_an_error_comes_out(method: str) -> None:
    """Whatever it is, and nothing is asked for after it."""
    calls = []

    def rate(t: float, y: Array) -> Array:
        calls.append(t)
        if len(calls) > 30:
            raise LookupError("here")
        return -y

    with pytest.raises(LookupError, match="here"):
        Hairer(rate, method, np.ones(1), 0.0, 1e-10, 1e-12, 9.0).integrate(9.0)
    assert len(calls) == 31


@pytest.mark.parametrize("method", METHODS)
def test_what_cannot_be_followed(method: str) -> None:
    """A pole: y = 1/(1 − t) ends at 1: there is no state beyond, and no warning."""
    solver = Hairer(lambda _, y: y**2, method, np.ones(1), 0.0, 1e-8, 1e-10, 2.0)
    half = solver.integrate(0.5)
    assert half == pytest.approx(2.0, rel=1e-6)
    assert solver.integrate(2.0) is None


@pytest.mark.parametrize("begin", [0.0, 10.0])
@pytest.mark.parametrize("time", [0.03, 1.0, 100.0])
@pytest.mark.parametrize("method", METHODS)
def test_the_smallest_rates(method: str, time: float, begin: float) -> None:
    """Those that would come to less than 1e-120 by the end, or within 1 s, count as none."""
    for part, moves in ((0.3, False), (3.0, True)):
        rate, end = part * 1e-120 / max(time, 1.0), begin + time
        solver = Hairer(
            lambda _, y, r=rate: r + 0.0 * y, method, np.zeros(1), begin, 1e-8, 1e-16, end
        )
        y = solver.integrate(end)
        assert y is not None
        assert y[0] == pytest.approx(rate * time if moves else 0.0, rel=1e-9, abs=0.0)
