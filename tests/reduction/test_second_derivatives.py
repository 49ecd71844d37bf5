"""Second derivatives of the mass matrix, against Pinocchio and differences of what it gives."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from coupled_trees import CoupledCase, coupled_cases
from hypothesis import given, settings
from strategies import Case, cases

import pinred
from pinred.common.arrays import Array
from pinred.reduction.tree.second_derivatives import inertia_derivatives

DIFFERENCES = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))  # of order six


def pinocchio_slope(system: pinred.System, x: Array) -> Array:
    """∂H/∂x, (n, n, m), by RNEA derivatives."""
    model = system.model.copy()
    model.gravity.setZero()
    data, n, r = model.createData(), system.n, system.r
    q, out = system.q(system.group.identity(), x), np.empty((n, n, system.m))
    for k, e in enumerate(np.eye(n)):
        rates = system.joint_rates(e)
        slope = pin.computeRNEADerivatives(model, data, q, np.zeros(model.nv), rates)[0]
        out[:, k] = system.coupled_matrix(slope)[:, r:]
    return out


def check(system: pinred.System, x: Array) -> None:
    """H, c and their slopes are Pinocchio's; second ones are differences of those."""
    found = inertia_derivatives(system, x[None])
    at = pinred.Reduction(system).at(x)
    size = np.abs(at.mass_matrix).max()
    np.testing.assert_allclose(found.H[0], at.mass_matrix, atol=1e-13 * size)
    np.testing.assert_allclose(found.com[0], at.com, atol=1e-14)
    np.testing.assert_allclose(found.dH[0], pinocchio_slope(system, x), atol=1e-13 * size)
    step = 1e-3

    def com(at: Array) -> Array:
        return pinred.Reduction(system).split(at).com

    for k, e in enumerate(np.eye(system.m)):
        twice, once = np.zeros_like(found.dH[0]), np.zeros(3)
        for n, weight in DIFFERENCES:
            ahead, behind = (x + s * n * step * e for s in (1.0, -1.0))
            both = pinocchio_slope(system, ahead) - pinocchio_slope(system, behind)
            twice += weight / step * both
            once += weight / step * (com(ahead) - com(behind))
        np.testing.assert_allclose(found.d2H[0, ..., k], twice, atol=1e-10 * size)
        np.testing.assert_allclose(found.dcom[0, :, k], once, atol=1e-11)
        ahead, behind = (
            inertia_derivatives(system, (x + s * step * e)[None]).dcom[0] for s in (1.0, -1.0)
        )
        np.testing.assert_allclose(found.d2com[0, ..., k], (ahead - behind) / 2e-3, atol=1e-5)


@settings(max_examples=8)
@given(cases(1, 6))
def test_second_derivatives_of_random_trees_equal_differences(case: Case) -> None:
    """Any group, branched, every kind of joint, with armature."""
    check(case.system, case.x)


@settings(max_examples=8)
@given(coupled_cases(2, 5))
def test_second_derivatives_of_coupled_joints_equal_differences(case: CoupledCase) -> None:
    """By the independent joints alone."""
    check(case.system, case.rng.uniform(-2.0, 2.0, case.system.m))


@pytest.mark.parametrize("count", [1, 7])
def test_many_shapes_equal_single_shapes(count: int) -> None:
    """Each shape gives its values alone."""
    system = pinred.load("satellite_two_arms")
    x = np.random.default_rng(1).uniform(-2.0, 2.0, (count, system.m))
    every = inertia_derivatives(system, x)
    assert not any(values.flags.writeable for values in vars(every).values())
    for k in range(count):
        alone = inertia_derivatives(system, x[k : k + 1])
        for name in ("H", "dH", "d2H", "com", "dcom", "d2com"):
            np.testing.assert_allclose(getattr(every, name)[k], getattr(alone, name)[0], atol=1e-13)


@settings(max_examples=8)
@given(cases(1, 6))
def test_derivatives_of_some_joints_equal_all(case: Case) -> None:
    """Their rows and columns, and the base's, as without `of`."""
    system, r = case.system, case.system.r
    some = {k for k in range(system.m) if case.rng.random() < 0.4}
    whole = inertia_derivatives(system, case.x[None])
    part = inertia_derivatives(system, case.x[None], of=some)
    asked = [*range(r), *(r + k for k in sorted(some))]
    for name in ("H", "com", "dcom", "d2com"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name))
    for name in ("dH", "d2H"):
        block = np.ix_([0], asked, asked)
        np.testing.assert_array_equal(getattr(part, name)[block], getattr(whole, name)[block])
