"""The reduced equations against Pinocchio's forward dynamics, on random trees."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from backward_error import backward_error, kinetic_size, largest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strategies import Case, cases, make_case, seeds
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.equations import euler_poincare, hamilton_poincare, lagrange_poincare
from pinred.lie import GROUPS
from pinred.reduction.canonical_form import CanonicalForm
from pinred.reduction.potential import Potential

RELATIVE = 1e-12  # of the largest term


def aba(case: Case, tau: Array) -> Array:
    """Pinocchio's accelerations, (ξ̇, ẍ)."""
    model = case.system.model
    return np.asarray(pin.aba(model, model.createData(), case.q, case.v, tau))


def agree(a: Array, b: Array, *terms: Any) -> bool:
    """Whether a equals b to 1e-12 of the largest entry of b, or of terms that make it up."""
    return largest(a - b) <= RELATIVE * largest(b, *terms)


def momentum_rates(case: Case, a: Array) -> tuple[Array, list[Array]]:
    """Rates (n,) of H v at accelerations a, and their terms: Ḣ = C + Cᵀ by Pinocchio."""
    model = case.system.model
    data = model.createData()
    upper = pin.crba(model, data, case.q)
    C = pin.computeCoriolisMatrix(model, data, case.q, case.v)
    terms = [(np.triu(upper) + np.triu(upper, 1).T) @ a, C @ case.v, C.T @ case.v]
    return np.asarray(np.sum(terms, axis=0)), terms


def springs_of(case: Case) -> dict[str, tuple[float, float]]:
    """A spring at every other joint."""
    return dict.fromkeys(case.system.shape_names[::2], (1.5, 0.4))


@settings(max_examples=8)
@given(cases(0))
def test_lagrange_poincare_has_accelerations_of_aba(case: Case) -> None:
    """With joint torques, springs and a base wrench."""
    system, x, xdot = case.system, case.x, case.xdot
    torque, wrench = case.rng.normal(size=system.m), case.rng.normal(size=system.r)
    springs = springs_of(case)
    red = pinred.Reduction(system, springs=springs)
    tau = np.concatenate([wrench, torque])
    for name, (stiffness, rest) in springs.items():
        k = system.shape_names.index(name)
        tau[system.r + k] -= stiffness * (x[k] - rest)
    omega = red.locked_velocity(x, xdot, case.xi)
    terms = lagrange_poincare(red, x, xdot, omega, torque=torque, wrench=wrench)
    found, wanted = np.concatenate([terms.xidot, terms.xddot]), aba(case, tau)
    H = red.mass_matrix(x)
    kinetic = kinetic_size(H, case.v)
    assert backward_error(H, found, wanted, terms.shape, terms.momentum, kinetic) <= RELATIVE


@settings(max_examples=8)
@given(cases())
def test_hamilton_poincare_has_rates_of_aba(case: Case) -> None:
    """ẋ, ṗ and μ̇ follow from ABA's accelerations by p = M ẋ and μ = I ξ + I A ẋ."""
    system, x, xdot = case.system, case.x, case.xdot
    red = pinred.Reduction(system)
    torque, wrench = case.rng.normal(size=system.m), case.rng.normal(size=system.r)
    a = aba(case, np.concatenate([wrench, torque]))
    at, r = red.at(x), system.r
    p, mu = at.reduced_metric @ xdot, red.body_momentum(x, xdot, case.xi)
    terms = hamilton_poincare(red, x, p, mu, torque=torque, wrench=wrench)
    assert backward_error(at.reduced_metric, terms.xdot, xdot, p) <= RELATIVE
    bent, H = at.dM @ xdot @ xdot, red.mass_matrix(x)
    sizes = (bent, terms.shape, kinetic_size(H, case.v))
    assert agree(terms.shape.total, at.reduced_metric @ a[r:] + bent, *sizes)
    rates, parts = momentum_rates(case, a)
    assert agree(terms.momentum.total, rates[:r], *parts)
    energy = 0.5 * case.v @ H @ case.v
    assert terms.energy == pytest.approx(energy, rel=1e-12)


@settings(max_examples=8)
@given(cases(0))
def test_canonical_form_has_rates_of_aba(case: Case) -> None:
    """In (x, π, μ): velocities from momenta, and π̇ = d/dt ∂L/∂ẋ from ABA's accelerations."""
    system, r = case.system, case.system.r
    springs = springs_of(case)
    form = CanonicalForm(system, Potential(system, springs))
    H = pinred.Reduction(system).mass_matrix(case.x)
    assert backward_error(H, form.velocity(case.x, H @ case.v), case.v, H @ case.v) <= RELATIVE
    tau = np.zeros(system.n)
    for name, (stiffness, rest) in springs.items():
        k = system.shape_names.index(name)
        tau[r + k] -= stiffness * (case.x[k] - rest)
    # π = H_s v, and springs act in π̇, not in the bracket.
    expected, parts = momentum_rates(case, aba(case, tau))
    if system.m:
        assert agree(form.force(case.x, case.v), expected[r:], *parts)


@settings(max_examples=8)
@given(cases(0, 0))
def test_euler_poincare_has_accelerations_of_aba(case: Case) -> None:
    """A system without joints obeys Euler–Poincaré, with a wrench on the base."""
    wrench = case.rng.normal(size=case.system.r)
    red = pinred.Reduction(case.system)
    terms = euler_poincare(red, [], case.xi, wrench=wrench)
    I = red.locked_inertia([])
    assert backward_error(I, terms.xidot, aba(case, wrench), terms.momentum) <= RELATIVE


@pytest.mark.parametrize("group", [name for name in GROUPS if GROUPS[name].linear])
def test_equations_hold_in_falling_frame(group: str) -> None:
    """With gravity, the equations hold in the frame that falls with the translations."""
    case = make_case(group, 4, 3)
    model = case.system.model
    root = model.jointPlacements[1].rotation
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    red = pinred.Reduction(case.system)
    omega = red.locked_velocity(case.x, case.xdot, case.xi)
    terms = lagrange_poincare(red, case.x, case.xdot, omega)
    # In the base's own frame the fall is Rᵀ g, along the directions the group translates.
    data = model.createData()
    pin.forwardKinematics(model, data, case.q)
    pin.computeJointJacobians(model, data, pin.neutral(model))
    S = np.array(data.joints[1].S).reshape(6, -1)[:3, : case.system.group.linear]
    pin.forwardKinematics(model, data, case.q)
    turn = (root.T @ data.oMi[1].rotation).T  # root joint's fixed frame to body
    fall = S.T @ turn @ S @ S.T @ root.T @ model.gravity.linear
    xidot = terms.xidot.copy()
    xidot[: len(fall)] += fall
    found, wanted = np.concatenate([xidot, terms.xddot]), aba(case, np.zeros(case.system.n))
    H = red.mass_matrix(case.x)
    assert backward_error(H, found, wanted, terms.shape, terms.momentum, H @ wanted) <= RELATIVE


def test_every_term_is_printed_and_not_zero() -> None:
    """On a generic state no term vanishes, and the table names each one with its values."""
    case = make_case("SE3", 3, 11)
    red = pinred.Reduction(case.system, springs=springs_of(case))
    terms = lagrange_poincare(
        red, case.x, case.xdot, case.xi, torque=[1.0, 2.0, 3.0], wrench=np.arange(6.0)
    )
    text = str(terms)
    for name in ("metric", "centrifugal", "potential", "curvature", "coadjoint", "torque"):
        values = getattr(terms.shape, name)
        assert np.abs(values).max() > 1e-6
        assert name in text
        assert f"{values[0]:+.9e}" in text
    parts = [getattr(terms.shape, name) for name in terms.shape.__dataclass_fields__]
    np.testing.assert_allclose(np.sum(parts, axis=0), terms.shape.total, rtol=1e-15)


@pytest.mark.parametrize(
    ("words", "arguments", "options"),
    [
        ("xdot must have shape", ([0.0], [0.0, 0.0], [0.0] * 3), {}),
        ("omega must have shape", ([0.0], [0.0], [0.0] * 2), {}),
        ("omega must be finite", ([0.0], [0.0], [0.0, 0.0, np.nan]), {}),
        ("torque must have shape", ([0.0], [0.0], [0.0] * 3), {"torque": [1.0, 2.0]}),
        ("wrench must have shape", ([0.0], [0.0], [0.0] * 3), {"wrench": [1.0]}),
    ],
)
def test_invalid_states_raise_and_name_argument(
    words: str, arguments: tuple[object, ...], options: dict[str, object]
) -> None:
    """Wrong lengths and numbers that are not finite are refused by name."""
    red = pinred.Reduction(pinred.load("coupled_planar"))
    with pytest.raises(pinred.ShapeError, match=words):
        lagrange_poincare(red, *arguments, **options)  # type: ignore[arg-type]


@settings(max_examples=8)
@given(st.integers(0, 5), seeds)
@example(joints=1, seed=1_073_741_823)  # terms of size 1 that sum to 0.004
def test_equations_of_pivoted_tree_agree_with_aba(joints: int, seed: int) -> None:
    """All three equations of a pivoted tree in gravity, also with springs and forces."""
    model = random_model("SO3", joints, seed)
    rng = np.random.default_rng(seed)
    model.gravity.linear = rng.normal(size=3) * 9.0
    system = pinred.load(model)
    model = system.model
    case = Case(
        system=system,
        pose=system.group.exp(rng.uniform(-1.5, 1.5, 3)),
        x=rng.uniform(-2.0, 2.0, joints),
        xdot=rng.normal(size=joints),
        xi=rng.normal(size=3),
        rng=rng,
    )
    pose, x, xdot, xi, v = case.pose, case.x, case.xdot, case.xi, case.v
    torque, wrench = rng.normal(size=joints), rng.normal(size=3)
    red = pinred.Reduction(system, springs=springs_of(case))
    tau = np.concatenate([wrench, torque])
    tau[3::2] -= 1.5 * (x[::2] - 0.4)
    a, H, at = aba(case, tau), red.mass_matrix(x), red.at(x)
    gamma = pin.Quaternion(pose).matrix().T @ model.jointPlacements[1].rotation.T
    gamma = gamma @ model.gravity.linear / np.linalg.norm(model.gravity.linear)
    omega = red.locked_velocity(x, xdot, xi)
    terms = lagrange_poincare(red, x, xdot, omega, torque=torque, wrench=wrench, gamma=gamma)
    found = np.concatenate([terms.xidot, terms.xddot])
    kinetic = kinetic_size(H, v)
    assert backward_error(H, found, a, terms.shape, terms.momentum, kinetic) <= RELATIVE
    assert agree(found, a)  # so well are these conditioned
    p, mu = at.reduced_metric @ xdot, red.body_momentum(x, xdot, xi)
    by_momenta = hamilton_poincare(red, x, p, mu, torque=torque, wrench=wrench, pose=pose)
    bent = at.dM @ xdot @ xdot
    terms_of_rate = (bent, by_momenta.shape, kinetic)
    rate = at.reduced_metric @ a[3:] + bent
    assert not joints or agree(by_momenta.shape.total, rate, *terms_of_rate)
    rates, parts = momentum_rates(case, a)
    assert agree(by_momenta.momentum.total, rates[:3], *parts)
    energy = 0.5 * v @ H @ v + 0.75 * float(np.sum((x[::2] - 0.4) ** 2))
    energy += pin.computePotentialEnergy(model, model.createData(), case.q)
    size = 0.5 * np.abs(v) @ np.abs(H @ v) + system.mass * np.linalg.norm(model.gravity.linear)
    assert abs(by_momenta.energy - energy) <= 1e-13 * size
    if not joints:
        frozen = euler_poincare(red, [], xi, wrench=wrench, pose=pose)
        assert backward_error(H, frozen.xidot, a, frozen.momentum) <= RELATIVE


def test_equations_of_pivoted_tree_require_gravity_direction() -> None:
    """Γ or the pose is required there and refused elsewhere; other gravity breaks the symmetry."""
    heavy = random_model("SO3", 2, 3)
    heavy.gravity.linear = np.array([0.0, 0.0, -9.81])
    zero = np.zeros(3)
    red = pinred.Reduction(pinred.load(heavy))
    for missing in (
        lambda **k: euler_poincare(red, zero[:2], zero, **k),
        lambda **k: lagrange_poincare(red, zero[:2], zero[:2], zero, **k),
        lambda **k: hamilton_poincare(red, zero[:2], zero[:2], zero, **k),
    ):
        with pytest.raises(pinred.InputError, match="pass either gamma"):
            missing()
        with pytest.raises(pinred.InputError, match="pass either gamma"):
            missing(gamma=[0, 0, 1], pose=[0, 0, 0, 1])
        with pytest.raises(pinred.InputError, match="length 1, got length 2"):
            missing(gamma=[0, 0, 2])
        with pytest.raises(pinred.InputError, match="length 1, got length 1"):
            missing(gamma=[0, 0, 1 + 4e-6])
        missing(gamma=[0, 0, 1 - 4e-7])
        missing(gamma=[0, 0, 1])
    free = pinred.Reduction(pinred.load(heavy, gravity=zero))
    assert not euler_poincare(free, zero[:2], zero).xidot.any()
    with pytest.raises(pinred.InputError, match="leave gamma and pose out"):
        euler_poincare(free, zero[:2], zero, gamma=[0, 0, 1])
    tilted = pinred.load("double_spherical_pendulum", gravity=(1.0, 0.0, -9.0))
    with pytest.raises(pinred.SymmetryError):
        euler_poincare(pinred.Reduction(tilted), zero, [0.0])
