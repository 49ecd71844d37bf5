"""Christoffel symbols, curvature, geodesics: of the reduced metric and of left-invariant ones."""

from __future__ import annotations

import time

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from strategies import Case, cases, make_case

import pinred
from pinred.common.arrays import Array
from pinred.reduction.tree.second_derivatives import inertia_derivatives


def at_zero_momentum(case: Case) -> tuple[Array, Array]:
    """ξ = −A ẋ and the joints' accelerations there, by Pinocchio's ABA."""
    system = case.system
    model, data = system.model, system.model.createData()
    H = np.triu(pin.crba(model, data, case.q))
    H = H + np.triu(H, 1).T
    r = system.r
    xi = -np.linalg.solve(H[:r, :r], H[:r, r:] @ case.xdot)
    v = np.concatenate([xi, case.xdot])
    return xi, np.asarray(pin.aba(model, data, case.q, v, np.zeros(system.n)))[r:]


@settings(max_examples=8)
@given(cases(1, 6))
def test_aba_at_zero_momentum_has_no_covariant_acceleration(case: Case) -> None:
    """ẍ of ABA at zero momentum has no covariant acceleration."""
    _, xddot = at_zero_momentum(case)
    red = pinred.Reduction(case.system)
    left = red.covariant_acceleration(case.x, case.xdot, xddot)
    assert np.abs(left).max() <= 1e-11 * max(1.0, np.abs(xddot).max())
    symbols = red.christoffel(case.x)
    np.testing.assert_allclose(symbols, np.swapaxes(symbols, 1, 2), atol=1e-11)


def test_simulated_motion_at_zero_momentum_is_geodesic() -> None:
    """The cat without momentum: no covariant acceleration along its motion, constant speed."""
    cat = pinred.load("falling_cat")
    traj = pinred.simulate(
        cat, x0=[0.5, 0.2, -0.3], xdot0=[0.6, -0.4, -0.1], momentum=0, duration=3.0
    )
    red = pinred.Reduction(cat)
    speed = [v @ red.reduced_metric(x) @ v for x, v in zip(traj.x, traj.xdot, strict=True)]
    np.testing.assert_allclose(speed, speed[0], rtol=1e-9)
    h = 2e-3 * np.arange(-4, 5)
    weights = np.array([3, -32, 168, -672, 0, 672, -168, 32, -3]) / 840.0 / 2e-3
    for t in (0.5, 1.7, 2.6):
        states = traj(t + h)
        xddot = weights @ states.xdot
        left = red.covariant_acceleration(states.x[4], states.xdot[4], xddot)
        assert np.abs(left).max() < 1e-8


def brioschi(system: pinred.System) -> ca.Function:
    """Gauss's curvature of a reduced metric in two joints, from its coefficients (Brioschi)."""
    x = ca.SX.sym("x", 2)
    M = pinred.casadi_functions(system).reduced_metric(x)
    E, F, G = M[0, 0], M[0, 1], M[1, 1]

    def d(f: ca.SX, *by: int) -> ca.SX:
        for k in by:
            f = ca.jacobian(f, x)[k]
        return f

    corner = -0.5 * d(E, 1, 1) + d(F, 0, 1) - 0.5 * d(G, 0, 0)
    rows = [
        ca.horzcat(corner, 0.5 * d(E, 0), d(F, 0) - 0.5 * d(E, 1)),
        ca.horzcat(d(F, 1) - 0.5 * d(G, 0), E, F),
        ca.horzcat(0.5 * d(G, 1), F, G),
    ]
    first = ca.det(ca.vertcat(*rows))
    rows = [
        ca.horzcat(0.0, 0.5 * d(E, 1), 0.5 * d(G, 0)),
        ca.horzcat(0.5 * d(E, 1), E, F),
        ca.horzcat(0.5 * d(G, 0), F, G),
    ]
    return ca.Function("K", [x], [(first - ca.det(ca.vertcat(*rows))) / (E * G - F * F) ** 2])


@pytest.mark.parametrize("group", ["R", "SO2", "SE2", "SO3", "SE3"])
@pytest.mark.sampled(3)
def test_gauss_curvature_of_two_joints_equals_brioschi(group: str) -> None:
    """Gauss's curvature by CasADi's derivatives of the metric's coefficients."""
    for seed in range(3):
        case = make_case(group, 2, seed)
        red = pinred.Reduction(case.system)
        K = float(brioschi(case.system)(case.x))
        u, v = case.rng.normal(size=(2, 2))
        assert red.sectional_curvature(case.x, u, v) == pytest.approx(K, rel=1e-9, abs=1e-11)


def above(case: Case, u: Array, v: Array) -> float:
    """R_Q(u, v, u, v) of velocities (n,) in the metric H of Q, in the frame (left-invariant, ∂)."""
    system, r, n = case.system, case.system.r, case.system.n
    d = inertia_derivatives(system, case.x[None])
    H, dH, d2H = d.H[0], np.zeros((n, n, n)), np.zeros((n, n, n, n))
    dH[..., r:], d2H[..., r:, r:] = d.dH[0], d.d2H[0]
    c = np.zeros((n, n, n))  # c[C, A, B]: [e_A, e_B] = c^C_AB e_C
    c[:r, :r, :r] = np.moveaxis(system.group.ad(np.eye(r)), 0, 1)

    def koszul(H: Array, dH: Array) -> Array:
        low = np.einsum("DC,CAB->DAB", H, c)
        out = np.einsum("BDA->DAB", dH) + np.einsum("ADB->DAB", dH) - np.einsum("ABD->DAB", dH)
        out = out + low - np.einsum("BAD->DAB", low) - np.einsum("ABD->DAB", low)
        return np.asarray(0.5 * out)

    inverse = np.linalg.inv(H)
    lowered = koszul(H, dH)
    G = np.einsum("CD,DAB->CAB", inverse, lowered)
    slope = np.stack([koszul(dH[..., k], d2H[..., k]) for k in range(n)], axis=-1)
    slope = slope - np.einsum("DEk,EAB->DABk", dH, G)
    dG = np.einsum("CD,DABk->CABk", inverse, slope)
    R = np.einsum("DBCA->DCAB", dG) - np.einsum("DACB->DCAB", dG)
    R = R + np.einsum("EBC,DAE->DCAB", G, G) - np.einsum("EAC,DBE->DCAB", G, G)
    R = R - np.einsum("EAB,DEC->DCAB", c, G)
    return float(np.einsum("XD,DCAB,X,C,A,B", H, R, u, v, u, v))


@settings(max_examples=8)
@given(cases(2, 5))
def test_oneill_formula(case: Case) -> None:
    """R_B(u, v, u, v) = R_Q of the horizontal lifts + ¾ B(u, v)ᵀ I B(u, v): M, A, B, R at once."""
    red = pinred.Reduction(case.system)
    at, R = red.at(case.x), red.riemann(case.x)
    u, v = case.rng.normal(size=(2, case.system.m))
    lifts = [red.horizontal_lift(case.x, w) for w in (u, v)]
    whole = [np.concatenate([lift.xi, lift.xdot]) for lift in lifts]
    B = np.einsum("iab,a,b->i", at.curvature, u, v)
    expected = above(case, *whole) + 0.75 * B @ at.locked_inertia @ B
    found = np.einsum("abcd,a,b,c,d", R, u, v, u, v)
    scale = np.abs(np.einsum("abcd,a,b,c,d", np.abs(R), *np.abs([u, v, u, v])))
    scale = max(scale, 0.75 * float(B @ at.locked_inertia @ B), 1e-3)
    condition = np.linalg.cond(at.mass_matrix)
    assert abs(found - expected) <= max(1e-12, 1e-15 * condition) * scale


def test_riemann_tensor_has_its_symmetries() -> None:
    """R_abcd = −R_bacd = R_cdab, and the first Bianchi identity."""
    case = make_case("SE3", 5, 4)
    R = pinred.Reduction(case.system).riemann(case.x)
    size = np.abs(R).max()
    assert size > 1e-3
    for other in (-np.swapaxes(R, 0, 1), np.transpose(R, (2, 3, 0, 1))):
        np.testing.assert_allclose(R, other, atol=1e-13 * max(1.0, size))
    around = R + np.transpose(R, (0, 2, 3, 1)) + np.transpose(R, (0, 3, 1, 2))
    np.testing.assert_allclose(around, 0.0, atol=1e-13 * max(1.0, size))


@pytest.mark.by_hand
def test_riemann_of_a_quadruped_takes_less_than_a_second() -> None:
    """Measure the time for twelve joints, including the set-up."""
    pytest.importorskip("example_robot_data")
    solo = pinred.load("solo12")
    start = time.perf_counter()
    pinred.Reduction(solo).riemann(np.full(solo.m, 0.3))
    assert time.perf_counter() - start < 1.0


@pytest.mark.parametrize("group", ["SO3", "SE2", "SE3", "RxSE2"])
def test_left_invariant_derivative_is_levi_civita(group: str) -> None:
    """Proposition 3.1: torsion-free, metric, and its geodesics are Euler–Poincaré's by ABA."""
    case = make_case(group, 0, 2)
    system, red, G = case.system, pinred.Reduction(case.system), case.system.group
    xi, eta, zeta = case.rng.normal(size=(3, system.r))
    I = red.locked_inertia([])

    def nabla(a: Array, b: Array) -> Array:
        return red.left_invariant_derivative([], a, b)

    np.testing.assert_allclose(nabla(xi, eta) - nabla(eta, xi), G.bracket(xi, eta), atol=1e-12)
    # ⟨η, ζ⟩ is constant: ⟨∇_ξ η, ζ⟩ + ⟨η, ∇_ξ ζ⟩ = 0.
    assert abs(nabla(xi, eta) @ I @ zeta + eta @ I @ nabla(xi, zeta)) < 1e-12 * np.abs(I).max()
    model = system.model
    free = pin.aba(model, model.createData(), case.q, system.v(xi, []), np.zeros(system.n))
    np.testing.assert_allclose(-nabla(xi, xi), free, atol=1e-11 * max(1.0, np.abs(free).max()))


def test_sectional_curvature_of_parallel_vectors_raises() -> None:
    """They span no plane."""
    red = pinred.Reduction(pinred.load("falling_cat"))
    with pytest.raises(pinred.InputError, match="span a plane"):
        red.sectional_curvature(np.zeros(3), [1.0, 0.0, 0.0], [-2.0, 0.0, 0.0])
    with pytest.raises(pinred.ShapeError, match="u must have shape"):
        red.sectional_curvature(np.zeros(3), [1.0], [1.0, 0.0, 0.0])
