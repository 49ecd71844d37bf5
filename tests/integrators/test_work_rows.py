"""Machine code stays within its work rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.integrators.methods import (
    DOP853,
    RKMK4,
    AdaptiveGauss,
    Gauss,
    Method,
    Radau,
    Tsit5,
    Variational,
)
from pinred.integrators.stepping.step_loop import Stepper

MARK = 8.25e-77
METHODS: tuple[Method, ...] = (
    DOP853(1e-8, 1e-10),
    Tsit5(1e-6, 1e-8),
    RKMK4(0.01),
    *(Gauss(0.01, order) for order in (6, 16)),
    Gauss(0.01, 6, "Newton"),
    AdaptiveGauss(1e-8, 1e-10),
    Radau(1e-6, 1e-8),
    Variational(0.01),
)
FURTHER = [
    pytest.param(Gauss(0.01, order, *solver), marks=pytest.mark.by_hand)
    for order, *solver in ((2,), (4,), (8,), (10,), (2, "Newton"), (16, "Newton"))
]
ROBOTS = ("rigid_body", "cartpole", "coupled_planar", "elroys_beanie", "falling_cat")


@pytest.mark.slow
@pytest.mark.parametrize("method", [*METHODS, *FURTHER], ids=str)
@pytest.mark.sampled(4)
def test_steppers_write_within_work_rows(method: Method, monkeypatch: pytest.MonkeyPatch) -> None:
    """Marks after the rows survive steps, reports inside steps, and later dense output."""
    allocated: list[Array] = []
    real = Stepper.work

    def with_marks(*asked: Any, **options: Any) -> Array:
        work = real(*asked, **options)
        larger = np.full((work.shape[0] + 2, work.shape[1]), MARK)
        larger[:-2] = work
        allocated.append(larger)
        return larger[:-2]

    monkeypatch.setattr(Stepper, "work", with_marks)
    for name in ROBOTS:
        system, before = pinred.load(name), len(allocated)
        traj = pinred.simulate(
            system, seed=0, times=[0.033, 0.1, 0.3], method=method, outputs="shape"
        )
        traj = pinred.simulate(system, seed=0, times=[0.033, 0.1, 0.3], method=method)
        traj(np.linspace(0.0, 0.3, 11))
        pinred.simulate_many(system, seeds=[0, 1], times=[0.033, 0.3], method=method, threads=1)
        assert len(allocated) > before + 2
        for work in allocated[before:]:
            assert (work[-2:] == MARK).all(), name
