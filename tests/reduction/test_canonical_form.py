"""Velocities of prescribed joints, and the slope of the centre of mass, against Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from strategies import Case, cases

from pinred.reduction.canonical_form import CanonicalForm
from pinred.reduction.potential import Potential


@settings(max_examples=8)
@given(cases(1, 6))
def test_driven_velocity_keeps_momenta_of_free_joints(case: Case) -> None:
    """Momenta by RNEA give the velocity back; those of driven joints are not needed."""
    system, model = case.system, case.system.model
    form = CanonicalForm(system, Potential(system))
    at_rest = np.zeros(model.nv)
    still = model.copy()
    still.gravity.setZero()
    momentum = pin.rnea(still, still.createData(), case.q, at_rest, case.v)
    driven = np.flatnonzero(case.rng.integers(0, 2, system.m)).tolist()
    for given_to in ([], [0], driven, list(range(system.m))):
        lost = momentum.copy()
        lost[system.r :][given_to] = np.nan
        found = form.driven_velocity(case.x, lost, given_to, case.xdot[given_to])
        assert found == pytest.approx(case.v, rel=1e-6, abs=1e-6)
    assert form.velocity(case.x, momentum) == pytest.approx(case.v, rel=1e-6, abs=1e-6)


@settings(max_examples=8)
@given(cases(1, 6))
def test_com_slope_equals_differences(case: Case) -> None:
    """By central differences of Pinocchio's centre of mass, in the root body's frame."""
    system, model = case.system, case.system.model
    form, data = CanonicalForm(system, Potential(system)), model.createData()

    def com(x: np.ndarray) -> np.ndarray:
        q = system.q(case.pose, x)
        world = pin.centerOfMass(model, data, q)
        return np.asarray(data.oMi[1].actInv(world))

    h = 1e-5
    slope = np.column_stack(
        [(com(case.x + h * e) - com(case.x - h * e)) / (2.0 * h) for e in np.eye(system.m)]
    )
    assert form.com_slope(case.x) == pytest.approx(slope, abs=1e-8)
    form.mass_matrix(case.x)
    assert form.com() == pytest.approx(com(case.x), abs=1e-12)
