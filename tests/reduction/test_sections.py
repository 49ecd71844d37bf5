"""Changes of section, and the global forms of connection, curvature and locked inertia."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from strategies import Case, cases, make_case

import pinred
from pinred.common.arrays import Array
from pinred.equations import lagrange_poincare
from pinred.reduction.section import Section
from pinred.system.joints import axes_of


def wavy(case: Case) -> Section:
    """H = exp(ζ₁ φ₁(x)) exp(ζ₂ φ₂(x)), φ = sin(w·x), with Θ and ∂Θ in closed form."""
    G = case.system.group
    zetas = case.rng.normal(size=(2, G.dim))
    w = case.rng.normal(size=(2, case.system.m))

    def h(x: Array) -> tuple[Array, Array, Array]:
        phi = np.sin(w @ x)
        slope = np.cos(w @ x)[:, None] * w
        second = -phi[:, None, None] * w[:, :, None] * w[:, None, :]
        outer, inner = (G.exp(zeta * f) for zeta, f in zip(zetas, phi, strict=True))
        turned = G.Ad(G.inverse(inner)) @ zetas[0]
        theta = np.outer(turned, slope[0]) + np.outer(zetas[1], slope[1])
        moving = -np.einsum("i,a,c->iac", G.bracket(zetas[1], turned), slope[0], slope[1])
        moving += np.einsum("i,ac->iac", turned, second[0])
        return G.compose(outer, inner), theta, moving + np.einsum("i,ac->iac", zetas[1], second[1])

    return h


def relative(a: Array, b: Array) -> float:
    """The largest difference, of the largest entry or 1."""
    return float(np.abs(a - b).max(initial=0.0)) / max(1.0, float(np.abs(b).max(initial=0.0)))


@settings(max_examples=30)
@given(cases(1, 5))
def test_formulas_of_a_change(case: Case) -> None:
    """A′, I′, B′ by their definitions from Pinocchio's H at the velocities of the moved frame."""
    system, G, r = case.system, case.system.group, case.system.r
    h = wavy(case)
    red = pinred.Reduction(system)
    moved = red.change_section(h)
    pose, theta, _ = h(case.x)
    # (ξ, ẋ) = T (ξ′, ẋ): the same velocity in the two frames.
    T = np.eye(system.n)
    T[:r, :r], T[:r, r:] = G.Ad(pose), -G.Ad(pose) @ theta
    model = system.model
    H = np.triu(pin.crba(model, model.createData(), system.model_q(G.identity(), case.x)))
    H = T.T @ (H + np.triu(H, 1).T) @ T
    at = moved.at(case.x)
    assert relative(at.mass_matrix, H) < 1e-13
    condition = max(1e-13, 1e-16 * np.linalg.cond(H[:r, :r]))
    assert relative(at.local_connection, np.linalg.solve(H[:r, :r], H[:r, r:])) < 10 * condition
    A = at.local_connection
    bracket = np.einsum("aij,jb->iab", G.ad(A.T), A)
    from_slopes = np.swapaxes(at.dA, 1, 2) - at.dA - bracket
    scale = max(1.0, float(np.abs(at.dA).max()), float(np.abs(bracket).max()))
    assert np.abs(at.curvature - from_slopes).max() < 1e-11 * scale
    assert relative(moved.curvature(case.x), at.curvature) < 1e-14
    J = red.spatial_momentum(case.pose, red.body_momentum(case.x, case.xdot, case.xi))
    xi = G.Ad(G.inverse(pose)) @ case.xi + theta @ case.xdot
    mu = moved.body_momentum(case.x, case.xdot, xi)
    assert relative(moved.spatial_momentum(G.compose(case.pose, pose), mu), J) < 1e-12


@settings(max_examples=30)
@given(cases(1, 5))
def test_motion_does_not_see_the_section(case: Case) -> None:
    """Lagrange–Poincaré in a moved frame gives the joints the accelerations of ABA."""
    system, G = case.system, case.system.group
    h = wavy(case)
    moved = pinred.Reduction(system).change_section(h)
    pose, theta, _ = h(case.x)
    xi = G.Ad(G.inverse(pose)) @ case.xi + theta @ case.xdot
    terms = lagrange_poincare(
        moved, case.x, case.xdot, moved.locked_velocity(case.x, case.xdot, xi)
    )
    model = system.model
    a = pin.aba(model, model.createData(), case.q, case.v, np.zeros(system.n))[system.r :]
    assert np.abs(terms.xddot - a).max() <= 1e-10 * max(1.0, np.abs(a).max())


def test_flat_coordinates_of_coupled_bodies() -> None:
    """Remark 2.6: where nothing depends on the shape, h = exp(A x) leaves no connection."""
    system = pinred.load("coupled_planar")
    red = pinred.Reduction(system)
    A = red.local_connection([0.0])[:, 0]

    def h(x: Array) -> tuple[Array, Array]:
        return system.group.exp(A * x[0]), A[:, None]

    flat = red.change_section(h)
    for x in (0.3, -2.0):
        assert np.abs(flat.local_connection([x])).max() < 1e-15
        assert np.abs(flat.curvature([x])).max() < 1e-15


def test_twice_is_the_product() -> None:
    """h₁ and then h₂ are h₁ h₂."""
    case = make_case("SE3", 3, 5)
    G, (one, two) = case.system.group, (wavy(case), wavy(case))

    def both(x: Array) -> tuple[Array, Array]:
        (g, a, _), (k, b, _) = one(x), two(x)
        return G.compose(g, k), G.Ad(G.inverse(k)) @ a + b

    red = pinred.Reduction(case.system)
    there = red.change_section(one).change_section(two).split(case.x)
    at_once = red.change_section(both).split(case.x)
    assert relative(there.mass_matrix, at_once.mass_matrix) < 1e-13
    assert relative(there.com, at_once.com) < 1e-13


def test_a_wrong_derivative_is_refused() -> None:
    """The spatial derivative for the body's, a missing one, and what is no section at all."""
    case = make_case("SE2", 2, 1)
    red, h, G = pinred.Reduction(case.system), wavy(case), case.system.group

    def spatial(x: Array) -> tuple[Array, Array]:
        pose, theta, _ = h(x)
        return pose, G.Ad(pose) @ theta

    with pytest.raises(pinred.InputError, match="body twist of h per unit rate"):
        red.change_section(spatial)
    with pytest.raises(pinred.InputError, match="body twist of h per unit rate"):
        red.change_section(lambda x: (*h(x)[:2], 1.001 * h(x)[2]))
    with pytest.raises(pinred.ShapeError, match="must be finite and have shape"):
        red.change_section(lambda x: (h(x)[0], h(x)[1][:1]))
    with pytest.raises(pinred.InputError, match="must return"):
        red.change_section(lambda x: h(x)[0])
    first = red.change_section(lambda x: h(x)[:2])
    assert first.curvature(case.x).shape == (3, 2, 2)
    with pytest.raises(pinred.InputError, match="third value"):
        first.at(case.x)
    with pytest.raises(pinred.InputError, match="grid knows no change"):
        first.grid(case.x)


@settings(max_examples=30)
@given(cases(0, 5))
def test_global_forms(case: Case) -> None:
    """J = 𝕀 𝒜(v) by Pinocchio; 𝒜 of a rigid motion is its twist; 𝒜 turns with the base."""
    system, G, r = case.system, case.system.group, case.system.r
    red, model = pinred.Reduction(system), system.model
    v = np.concatenate([case.xi, case.xdot])
    form = red.connection_form(case.pose, case.x)
    inertia = red.locked_inertia_in_space(case.pose, case.x)
    data = model.createData()
    h = pin.computeCentroidalMomentum(model, data, case.q, case.v)
    # About the origin of the root joint's fixed frame, along its axes.
    about_com = pin.SE3(np.eye(3), np.array(data.com[0])).act(h)
    in_root = model.jointPlacements[1].actInv(about_com).vector
    E = axes_of(model.joints[1])
    J = E.T @ in_root
    if not system.model.armature[:r].any():
        assert relative(inertia @ form @ v, J) < 1e-12
    rigid = np.concatenate([case.xi, np.zeros(system.m)])
    assert relative(form @ rigid, G.Ad(case.pose) @ case.xi) < 1e-13
    g = G.exp(case.rng.normal(size=r))
    turned = red.connection_form(G.compose(g, case.pose), case.x)
    assert relative(turned, G.Ad(g) @ form) < 1e-12
    parts = red.split_velocity(case.x, case.xdot, case.xi)
    up, across = (np.concatenate([p.xi, p.xdot]) for p in (parts.vertical, parts.horizontal))
    H = red.mass_matrix(case.x)
    assert relative(up + across, v) < 1e-12
    assert abs(up @ H @ across) <= 1e-11 * max(1.0, v @ H @ v)
    assert np.abs(form @ across).max(initial=0.0) <= 1e-11 * max(1.0, np.abs(v).max())


def test_curvature_form_is_d_minus_bracket() -> None:
    """d𝒜(X, Y) − [𝒜(X), 𝒜(Y)] by differences, on random horizontal and vertical fields."""
    case = make_case("SE3", 3, 8)
    system, G, r = case.system, case.system.group, case.system.r
    red = pinred.Reduction(system)
    u, w = case.rng.normal(size=(2, system.n))
    form = red.curvature_form(case.pose, case.x)

    def along(u: Array, t: float) -> tuple[Array, Array]:
        return G.compose(case.pose, G.exp(t * u[:r])), case.x + t * u[r:]

    def value(u: Array, t: float, of: Array) -> Array:
        return np.asarray(red.connection_form(*along(u, t)) @ of)

    # d𝒜(X, Y) = X 𝒜(Y) − Y 𝒜(X) − 𝒜([X, Y]) for left-invariant fields along the base.
    differences, h = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60)), 1e-3
    slope = [
        sum(k / h * (value(by, n * h, of) - value(by, -n * h, of)) for n, k in differences)
        for by, of in ((u, w), (w, u))
    ]
    both = np.zeros(system.n)
    both[:r] = G.bracket(u[:r], w[:r])
    whole = red.connection_form(case.pose, case.x)
    d = slope[0] - slope[1] - whole @ both
    expected = d - G.bracket(whole @ u, whole @ w)
    found = np.einsum("iab,a,b->i", form, u, w)
    np.testing.assert_allclose(found, expected, atol=1e-8)
    assert np.abs(found).max() > 1e-2
