"""Joints that follow others: GᵀHG in every route, against CRBA and ABA with multipliers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from coupled_trees import CoupledCase, coupled_cases, coupling_map, make_case
from hypothesis import given, settings

import pinred
from pinred.common.arrays import Array
from pinred.reduction.canonical_form import CanonicalForm
from pinred.reduction.potential import shape_gravity
from pinred.reduction.tree.all_joints import joint_values
from pinred.reduction.tree.articulated_sweep import sweep
from pinred.reduction.tree.body_frames import bodies_of
from pinred.reduction.tree.momenta import momenta
from pinred.system.robot_file_contents import Contents, Coupling


@settings(max_examples=4)
@given(coupled_cases())
def test_coupled_mass_matrix_and_derivatives(case: CoupledCase) -> None:
    """At one shape by Pinocchio, and at many by compiled code: GᵀHG and its derivative."""
    system, red = case.system, pinred.Reduction(case.system)
    x = case.rng.uniform(-2.0, 2.0, system.m)
    at, H = red.at(x), case.mass_matrix(x)
    size = np.abs(H).max()
    np.testing.assert_allclose(at.mass_matrix, H, rtol=0, atol=1e-13 * size)
    field = red.grid(x[None])
    np.testing.assert_allclose(field.mass_matrix[0], H, rtol=0, atol=1e-13 * size)
    B = np.abs(at.curvature).max(initial=1.0)
    np.testing.assert_allclose(field.curvature[0], at.curvature, rtol=0, atol=1e-10 * B)
    r, step = system.r, 1e-5
    for k in range(system.m):
        e = np.eye(system.m)[k] * step
        slope = (case.mass_matrix(x + e) - case.mass_matrix(x - e))[:r, :r] / (2.0 * step)
        np.testing.assert_allclose(at.dI[:, :, k], slope, rtol=0, atol=1e-8 * size)


@pytest.mark.slow
@settings(max_examples=8)
@given(coupled_cases())
def test_sweep_of_coupled_joints_solves_velocities_and_forces(case: CoupledCase) -> None:
    """H v = (μ, π) for any momentum, and π̇ against the derivative of the Lagrangian by y."""
    system, r, m = case.system, case.system.r, case.system.m
    y, v = case.rng.uniform(-2.0, 2.0, m), case.rng.normal(size=system.n)
    H = case.mass_matrix(y)
    p = H @ v
    found, force = swept(system, y, p)
    condition = np.linalg.cond(H) * np.finfo(float).eps * 20
    np.testing.assert_allclose(found, v, rtol=0, atol=max(1e-12, condition) * np.abs(v).max())
    # ½ vᵀ ∂H v by Pinocchio's Coriolis matrix, of all joints, and then to y by the chain rule.
    model, full = system.model, case.whole @ v
    q = system.q(system.group.identity(), y)
    C = pin.computeCoriolisMatrix(model, model.createData(), q, full)
    expected = case.G.T @ (full @ C)[r:]
    size = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(force, expected, rtol=0, atol=max(1e-12, condition) * size)
    form = CanonicalForm(system, shape_gravity(system))
    np.testing.assert_allclose(form.velocity(y, p), found, rtol=0, atol=1e-10 + condition)
    np.testing.assert_allclose(form.force(y, v), expected, rtol=0, atol=1e-12 * size)


def swept(system: pinred.System, y: Array, p: Array) -> tuple[Array, Array]:
    """Velocity (n,) and π̇ (m,) by the sweep, from a shape and momenta."""
    r, m, group = system.r, system.m, system.group
    x, pi, mu = (
        [ca.SX.sym(f"{s}{k}") for k in range(n)] for s, n in zip("xpm", (m, m, r), strict=True)
    )
    joints = joint_values(system, x)
    found = sweep(bodies_of(system), joints, pi, mu, group.axes, 0.0, {}, None, system.coupled)
    xi = [[*found.root_linear, *found.root_angular][axis] for axis in group.axes]
    function = ca.Function(
        "f",
        [ca.vertcat(*x), ca.vertcat(*pi), ca.vertcat(*mu)],
        [ca.vertcat(*xi, *found.xdot), ca.vertcat(*found.pidot)],
    )
    v, force = (np.array(out).ravel() for out in function(y, p[r:], p[:r]))
    return v, force


@pytest.mark.slow
@settings(max_examples=8)
@given(coupled_cases())
def test_sweep_with_prescribed_rate_computes_its_momentum(case: CoupledCase) -> None:
    """The momentum of a prescribed coordinate sums over all its joints."""
    driven = [k for k in range(case.system.m) if case.rng.random() < 0.5]
    check_prescribed(case, driven)


@pytest.mark.parametrize("seed", range(6))
def test_sweep_with_one_of_two_leaders_prescribed(seed: int) -> None:
    """A joint with armature follows a prescribed and a free leader."""
    case = make_case("SE3", 5, seed)
    joints = [str(name) for name in case.system.model.names[2:]]
    case.system.model.armature = np.append(np.zeros(6), 0.3 + 0.1 * np.arange(5.0))
    free = joints[:4]
    ratios = {free[0]: 0.7, free[2]: -1.3}
    contents = Contents(couplings=(Coupling(joints[4], ratios, 0.2),))
    system = pinred.System(case.system.model, "two leaders", contents=contents)
    check_prescribed(CoupledCase(system, *coupling_map(system), case.rng), [0])


def check_prescribed(case: CoupledCase, driven: list[int]) -> None:
    """Compare rates and momenta of the sweep with H v if some rates are prescribed."""
    system, r, m = case.system, case.system.r, case.system.m
    y, v = case.rng.uniform(-2.0, 2.0, m), case.rng.normal(size=system.n)
    p = case.mass_matrix(y) @ v
    symbols = ca.SX.sym("s", m)
    found = sweep(
        bodies_of(system), joint_values(system, ca.vertsplit(symbols)), p[r:].tolist(),
        p[:r].tolist(), system.group.axes, 0.0, {k: float(v[r + k]) for k in driven}, None,
        system.coupled,
    )  # fmt: skip
    function = ca.Function("f", [symbols], [ca.vertcat(*found.xdot), ca.vertcat(*found.pi)])
    rates, pi = (np.array(out).ravel() for out in function(y))
    size = np.linalg.cond(case.mass_matrix(y)) * 1e-14 + 1e-12
    np.testing.assert_allclose(rates, v[r:], rtol=0, atol=size * np.abs(v).max())
    np.testing.assert_allclose(pi, p[r:], rtol=0, atol=size * np.abs(p).max())


@settings(max_examples=8)
@given(coupled_cases())
def test_casadi_functions_of_coupled_joints(case: CoupledCase) -> None:
    """H v of CasADi's Functions, as users call them."""
    system = case.system
    y, v = case.rng.uniform(-2.0, 2.0, system.m), case.rng.normal(size=system.n)
    x, w = ca.SX.sym("x", system.m), ca.SX.sym("v", system.n)
    p = np.array(ca.Function("f", [x, w], [momenta(system, x, w)])(y, v)).ravel()
    expected = case.mass_matrix(y) @ v
    np.testing.assert_allclose(p, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_cases_have_crossing_groups() -> None:
    """The cases above have groups that cross on one chain, with free joints between them."""
    crossing = 0
    for seed in range(40):
        case = make_case("SE3", 8, seed)
        coupled = case.system.coupled
        assert coupled is not None
        sizes = np.count_nonzero(coupled.G, axis=0)
        crossing += int((sizes > 1).sum() > 1)
    assert crossing > 10


def test_sweep_without_shares_of_open_groups_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without its share of the open groups, the rate of an ordinary joint is wrong."""
    from pinred.reduction.tree.coupled_groups import Groups

    monkeypatch.setattr(Groups, "momentum", lambda *_, **__: 0.0)
    off = 0.0
    for seed in range(5):
        case = make_case("SE3", 6, seed)
        y, v = case.rng.uniform(-2.0, 2.0, case.system.m), case.rng.normal(size=case.system.n)
        _, force = swept(case.system, y, case.mass_matrix(y) @ v)
        form = CanonicalForm(case.system, shape_gravity(case.system))
        off = max(off, float(np.abs(force - form.force(y, v)).max()))
    assert off > 1e-3
