"""Poisson brackets: both forms, the Jacobi identity, Casimirs, and ḟ = {f, h} along motions."""

from __future__ import annotations

from typing import Any, Literal

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from strategies import Case, cases, make_case, seeds
from trees import inertia, placement, random_model

import pinred
from pinred import poisson
from pinred.common.arrays import Array
from pinred.lie import GROUPS
from pinred.reduction import poisson_brackets
from pinred.reduction.poisson_brackets import momentum_tensor

NINE = np.array([3, -32, 168, -672, 0, 672, -168, 32, -3]) / 840.0  # of differences, order 8


def heavy(joints: int, seed: int) -> pinred.System:
    """A random tree on a pivot in gravity."""
    model = random_model("SO3", joints, seed)
    model.gravity.linear = np.array([1.0, -2.0, -9.0])
    return pinred.load(model)


@settings(max_examples=8)
@given(cases(0, 4))
def test_canonical_tensor_maps_to_connection_tensor(case: Case) -> None:
    """With σ(x, π, μ) = (x, π − Aᵀμ, μ): Tσ P Tσᵀ, with A and its derivatives from CasADi."""
    system = case.system
    space = poisson.phase_space(system, form="canonical")
    A = pinred.casadi_functions(system).local_connection(space.x)
    sigma = ca.vertcat(space.x, space.p - A.T @ space.mu, space.mu)
    slope = ca.jacobian(sigma, space.z)
    pushed = ca.Function("pushed", [space.z], [slope @ space.tensor @ slope.T])
    pi, mu = case.rng.normal(size=system.m), case.rng.normal(size=system.r)
    P = np.array(pushed(np.concatenate([case.x, pi, mu])))
    red = pinred.Reduction(system)
    found = poisson.tensor(red, case.x, pi, mu)
    size = max(1.0, np.abs(P).max(initial=0.0))
    assert np.abs(found - P).max(initial=0.0) <= 1e-12 * size
    np.testing.assert_array_equal(found, -found.T)
    flat = poisson.tensor(red, case.x, pi, mu, form="canonical")
    z = np.concatenate([case.x, pi, mu])
    np.testing.assert_allclose(flat, np.array(ca.Function("P", [space.z], [space.tensor])(z)))
    symbolic = poisson.phase_space(system)
    at = np.array(ca.Function("P", [symbolic.z], [symbolic.tensor])(z))
    assert np.abs(found - at).max(initial=0.0) <= 1e-12 * size


@pytest.mark.parametrize("form", ["connection", "canonical"])
@pytest.mark.parametrize("group", [*GROUPS, "heavy"])
@pytest.mark.sampled
def test_jacobi_identity(group: str, form: str) -> None:
    """The cyclic sum of {{f, g}, k} vanishes to round-off of its largest term."""
    system = heavy(2, 3) if group == "heavy" else make_case(group, 2, 3).system
    space = poisson.phase_space(system, form=form)  # type: ignore[arg-type]
    rng = np.random.default_rng(4)
    size = space.z.numel()
    assert size == 4 + system.r + 3 * (group == "heavy")
    f, g, k = (
        ca.dot(ca.DM(rng.normal(size=size)), space.z)
        + ca.sin(ca.dot(ca.DM(rng.normal(size=size)), space.z))
        for _ in range(3)
    )
    turns = [
        poisson.bracket(poisson.bracket(a, b), c) for a, b, c in ((f, g, k), (g, k, f), (k, f, g))
    ]
    value = ca.Function("turns", [space.z], turns)
    for _ in range(5):
        z = rng.normal(size=size)
        values = np.array([float(v) for v in value(z)])
        assert abs(values.sum()) <= 2e-13 * max(1.0, np.abs(values).max())
        assert np.abs(values).max() > 1e-3


def along(system: pinred.System, traj: pinred.Trajectory, t: float, step: float) -> None:
    """ḟ of random functions by nine-point differences is {f, h}, to 1e-10 of its scale."""
    space = poisson.phase_space(system)
    rng = np.random.default_rng(0)
    size = space.z.numel()
    tests = [
        ca.dot(ca.DM(rng.normal(size=size)), space.z) + 0.5 * ca.sumsqr(space.mu),
        ca.cos(ca.sum1(space.z)),
        space.hamiltonian,
    ]
    value = ca.Function("f", [space.z], [ca.vertcat(*tests)])
    rate = ca.Function(
        "rate", [space.z], [ca.vertcat(*(poisson.bracket(f, space.hamiltonian) for f in tests))]
    )
    terms = ca.Function(
        "terms",
        [space.z],
        [ca.fabs(ca.jacobian(ca.vertcat(*tests), space.z))
         @ ca.fabs(space.tensor @ ca.gradient(space.hamiltonian, space.z))],
    )  # fmt: skip
    red, G = pinred.Reduction(system), system.group
    k = G.linear
    states = traj(t + step * np.arange(-4, 5))
    down = np.zeros((9, 0))
    if space.gamma.numel():
        weight = system.model.jointPlacements[1].rotation.T @ system.gravity
        down = np.array([G.matrix(g).T @ weight / np.linalg.norm(weight) for g in states.pose])
    rows = []
    for i in range(9):
        at = red.at(states.x[i])
        mu = states.body_momentum[i].copy()
        if system.gravity.any() and k:  # in the frame that falls
            from pinred.reduction.base_parts import root_of

            fallen = states.t[i] * root_of(system).g
            mu -= at.locked_inertia[:, :k] @ G.turned_back(states.pose[i, k:], fallen)
        rows.append(np.concatenate([at.x, at.reduced_metric @ states.xdot[i], mu, down[i]]))
    values = np.array([np.array(value(z))[:, 0] for z in rows])
    found = NINE @ values / step
    expected, scale = (np.array(f(rows[4]))[:, 0] for f in (rate, terms))
    assert (np.abs(found - expected) <= 1e-10 * np.maximum(1.0, scale)).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["falling_cat", "double_spherical_pendulum", "planar_chain5", "upright_drone", "cartpole"],
)
@pytest.mark.sampled
def test_bracket_with_energy_is_rate_along_motion(name: str) -> None:
    """For random functions, on bundled robots, also in free fall."""
    system = pinred.load(name)
    traj = pinred.simulate(system, duration=2.0, rtol=1e-13, atol=1e-14)
    for t in (0.6, 1.4):
        along(system, traj, t, 4e-3)


@pytest.mark.slow
def test_bracket_with_energy_is_rate_of_heavy_top() -> None:
    """With Γ, on a pivoted tree in gravity."""
    system = heavy(1, 5)
    traj = pinred.simulate(system, seed=1, duration=1.0, rtol=1e-13, atol=1e-14)
    along(system, traj, 0.5, 1e-3)


EXPECTED = {
    "R": ["P"],
    "SO2": ["L"],
    "SE2": ["P1² + P2²"],
    "SO3": ["L1² + L2² + L3²"],
    "SE3": ["P1² + P2² + P3²", "P1 L1 + P2 L2 + P3 L3"],
    "RxSE2": ["P3", "P1² + P2²"],
}


@pytest.mark.parametrize("group", GROUPS)
def test_casimirs_of_groups_commute_with_momenta(group: str) -> None:
    """Their number follows from the rank, and their brackets with all momenta vanish."""
    system = make_case(group, 1, 0).system
    found = poisson.casimirs(system)
    assert [str(each) for each in found] == EXPECTED[group]
    rng = np.random.default_rng(0)
    mu = rng.normal(size=system.r)
    P = momentum_tensor(system.group, mu)
    assert len(found) == system.r - np.linalg.matrix_rank(P, tol=1e-12)
    for each in found:
        assert np.abs(P @ each.gradient(mu)).max() < 1e-14
        assert np.abs(each.gradient(mu)).max() > 1e-3
        with pytest.raises(pinred.InputError, match="does not depend on gamma"):
            each(mu, [0.0, 0.0, 1.0])


@pytest.mark.parametrize("group", GROUPS)
def test_casimirs_do_not_depend_on_tolerance(group: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Structure constants are whole numbers: 1e-13 and 1e-3 tell the same Casimirs from none."""
    for bound in (1e-13, 1e-3):
        monkeypatch.setattr(poisson_brackets, "_ZERO", bound)
        found = poisson_brackets.casimirs(make_case(group, 1, 0).system)
        assert [str(each) for each in found] == EXPECTED[group]


def test_casimir_formula_shows_signs_and_sizes() -> None:
    """Signs, and coefficients other than one."""
    assert poisson_brackets._formula(np.array([2.0, -1.0, 0.0, -0.5]), "abcd") == "2 a − b − 0.5 d"
    assert poisson_brackets._formula(np.array([-1.0, 1.0]), "ab") == "− a + b"


@pytest.mark.parametrize(("form", "momentum"), [("connection", "p"), ("canonical", "pi")])
def test_phase_space_symbols_are_named_by_form(
    form: Literal["connection", "canonical"], momentum: str
) -> None:
    """The momentum is p or pi."""
    system = make_case("SE3", 1, 0).system
    assert str(poisson.phase_space(system, form=form).z).startswith(f"[x, {momentum}, mu_0")


def test_casimirs_of_heavy_top_are_constant_by_aba() -> None:
    """μ·Γ and |Γ|² are constant in any motion by ABA; |μ|² is not."""
    system = heavy(2, 1)
    found = poisson.casimirs(system)
    assert [str(each) for each in found] == ["L1 Γ1 + L2 Γ2 + L3 Γ3", "Γ1² + Γ2² + Γ3²"]
    mu, gamma = np.array([0.3, -0.2, 0.5]), np.array([0.6, 0.0, 0.8])
    P = momentum_tensor(system.group, mu, gamma)
    assert np.linalg.matrix_rank(P) == 4
    for each in found:
        assert np.abs(P @ each.gradient(mu, gamma)).max() < 1e-15
    assert found[0](mu, gamma) == pytest.approx(mu @ gamma, abs=1e-15)
    with pytest.raises(pinred.InputError, match="depends on gamma"):
        found[0](mu)


@settings(max_examples=8)
@given(seeds)
def test_observables_have_bracket_of_their_expressions(seed: int) -> None:
    """Functions with gradients have the bracket of the same CasADi expressions."""
    case = make_case("SE3", 2, seed)
    system, red = case.system, pinred.Reduction(case.system)
    space = poisson.phase_space(system)
    w = case.rng.normal(size=(2, 10))
    numbers = [
        poisson.Observable(
            red,
            lambda x, p, mu, a=a: float(np.sin(a @ np.concatenate([x, p, mu]))),
            lambda x, p, mu, a=a: np.cos(a @ np.concatenate([x, p, mu])) * a,
        )
        for a in w
    ]
    f, g = (ca.sin(ca.dot(ca.DM(a), space.z)) for a in w)
    p, mu = case.rng.normal(size=2), case.rng.normal(size=6)
    expected = ca.Function("b", [space.z], [poisson.bracket(f, g)])
    z: Array = np.concatenate([case.x, p, mu])
    assert poisson.bracket(*numbers)(case.x, p, mu) == pytest.approx(float(expected(z)), abs=1e-10)


def test_bracket_of_invalid_arguments_raises() -> None:
    """Unknown symbols, two spaces, mixed types, unknown forms, missing Γ."""
    cat, top = pinred.load("falling_cat"), heavy(1, 2)
    one, two = poisson.phase_space(cat), poisson.phase_space(cat, form="canonical")
    with pytest.raises(pinred.InputError, match="not a phase-space variable"):
        poisson.bracket(ca.SX.sym("y"), one.mu[0])
    with pytest.raises(pinred.InputError, match="one phase space"):
        poisson.bracket(one.mu[0], two.mu[0])
    with pytest.raises(pinred.InputError, match="one phase space"):
        poisson.bracket(ca.SX(1.0), ca.SX(2.0))
    with pytest.raises(pinred.InputError, match="'connection' or 'canonical'"):
        poisson.phase_space(cat, form="lie")  # type: ignore[arg-type]
    red = pinred.Reduction(top)
    with pytest.raises(pinred.InputError, match="give gamma"):
        poisson.tensor(red, [0.1], [0.0], np.ones(3))
    with pytest.raises(pinred.InputError, match="leave gamma out"):
        poisson.tensor(pinred.Reduction(cat), np.zeros(3), np.zeros(3), np.ones(6), [0, 0, 1])
    some = poisson.Observable(red, lambda *_: 0.0, lambda *_: np.zeros(3))
    with pytest.raises(pinred.InputError, match="not one of each"):
        poisson.bracket(some, one.mu[0])  # type: ignore[call-overload]
    with pytest.raises(pinred.ShapeError, match="a gradient with respect to z"):
        poisson.bracket(some, some)([0.1], [0.0], np.ones(3), [0.0, 0.0, 1.0])


ROOT_PLACE = pin.SE3(pin.exp3(np.array([0.4, -0.3, 0.7])), np.array([0.5, -0.4, 0.9]))
PIVOTS = {
    "heavy": (pin.JointModelSpherical(), (1.0, -2.0, -9.0)),
    "SO2": (pin.JointModelRZ(), tuple(-9.0 * ROOT_PLACE.rotation[:, 2])),
    "R": (pin.JointModelPX(), tuple(-9.0 * ROOT_PLACE.rotation[:, 2])),
}


@pytest.mark.parametrize("form", ["connection", "canonical"])
@pytest.mark.parametrize(
    ("pivot", "joints"), [*((pivot, 1) for pivot in (*PIVOTS, "SE3")), ("heavy", 0), ("SE3", 0)]
)
def test_hamiltonian_is_total_energy_by_pinocchio(pivot: str, joints: int, form: Any) -> None:
    """Including the height of the root joint, which is away from the world's origin."""
    kind, gravity = PIVOTS.get(pivot, (pin.JointModelFreeFlyer(), (0.0, 0.0, 0.0)))
    model = pin.Model()
    model.gravity.linear = np.array(gravity)
    joint, rng = model.addJoint(0, kind, ROOT_PLACE, "root"), np.random.default_rng(5)
    model.appendBodyToJoint(joint, inertia(rng), pin.SE3.Identity())
    for _ in range(joints):
        joint = model.addJoint(joint, pin.JointModelRY(), placement(rng), "one")
        model.appendBodyToJoint(joint, inertia(rng), pin.SE3.Identity())
    system = pinred.load(model)
    pose = system.group.exp(rng.normal(size=system.r))
    if system.group.linear:
        pose[: system.group.linear] = 0.0  # the energy does not depend on it
    x, xdot, xi = (rng.normal(size=size) for size in (joints, joints, system.r))
    q, v = system.q(pose, x), system.v(xi, xdot)
    data = system.model.createData()
    H = np.triu(pin.crba(system.model, data, q))
    mu, pi = np.split((H + np.triu(H, 1).T) @ v, [system.r])
    A = pinred.Reduction(system).local_connection(x)
    z = [*x, *(pi if form == "canonical" else pi - A.T @ mu), *mu]
    space = poisson.phase_space(system, form=form)
    if pivot == "heavy":
        weight = ROOT_PLACE.rotation.T @ system.gravity
        z += (system.group.matrix(pose).T @ weight / np.linalg.norm(weight)).tolist()
    found = float(ca.Function("h", [space.z], [space.hamiltonian])(np.array(z)))
    expected = pin.computeKineticEnergy(system.model, data, q, v)
    expected += pin.computePotentialEnergy(system.model, data, q)
    assert found == pytest.approx(expected, rel=1e-12)
