"""Changes of section, and the global forms of connection, curvature and locked inertia."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from backward_error import backward_error, kinetic_size, largest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from strategies import Case, cases, make_case

import pinred
from pinred.common.arrays import Array
from pinred.equations import hamilton_poincare, lagrange_poincare
from pinred.reduction.pointwise_reduction import Section
from pinred.system.joints import axes_of

FIELDS = ("mass_matrix", "locked_inertia", "local_connection", "reduced_metric", "curvature", "com")


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


def norm(matrix: Array) -> float:
    """The largest singular value of a matrix, or of the largest of several in the last axes."""
    return float(np.linalg.norm(matrix, 2, axis=(0, 1)).max(initial=0.0)) if matrix.size else 0.0


def relative(a: Array, b: Array, size: float | None = None) -> float:
    """The largest difference, of a size; without one, of the largest entry or 1."""
    size = max(1.0, float(np.abs(b).max(initial=0.0))) if size is None else size
    return float(np.abs(a - b).max(initial=0.0)) / size


def solved(H: NDArray[np.longdouble], r: int) -> Array:
    """I⁻¹ H_bs of a mass matrix, refined until its residual in long numbers is nothing."""
    I, across = H[:r, :r], H[:r, r:]
    A = np.zeros(across.shape, dtype=np.longdouble)
    for _ in range(4):
        A += np.linalg.solve(I.astype(float), (across - I @ A).astype(float))
    return A.astype(float)


def pinocchios(case: Case) -> Array:
    """H by Pinocchio in the section of the file."""
    system, model = case.system, case.system.model
    q = system.q(system.group.identity(), case.x)
    H = np.triu(pin.crba(model, model.createData(), q))
    return np.asarray(H + np.triu(H, 1).T)


@settings(max_examples=8)
@given(cases(1, 6))
def test_change_section_transforms_all_terms(case: Case) -> None:
    """A′, B′, I′ to 1e-13 of their terms: by their definitions from Pinocchio's transformed H."""
    system, G, r = case.system, case.system.group, case.system.r
    h, H = wavy(case), pinocchios(case)
    red = pinred.Reduction(system)
    moved = red.change_section(h)
    pose, theta, slope = h(case.x)
    Ad, back = G.Ad(pose), G.Ad(G.inverse(pose))
    # (ξ, ẋ) = T (ξ′, ẋ): the same velocity in the two frames.
    T = np.eye(system.n, dtype=np.longdouble)
    T[:r, :r], T[:r, r:] = Ad, -Ad.astype(np.longdouble) @ theta
    exact = T.T @ H.astype(np.longdouble) @ T
    there = exact.astype(float)
    at, old = moved.at(case.x), red.at(case.x)
    A, dA = at.local_connection, at.dA
    of_A = norm(back) * norm(old.local_connection) + norm(theta)
    assert relative(at.locked_inertia, there[:r, :r], norm(Ad) ** 2 * norm(H[:r, :r])) < 1e-13
    assert relative(at.mass_matrix, there, norm(T.astype(float)) ** 2 * norm(H)) < 1e-13
    assert relative(A, solved(exact, r), of_A) < 1e-13
    assert relative(at.reduced_metric, old.reduced_metric) == 0.0
    bracket = np.einsum("aij,jb->iab", G.ad(A.T), A)
    of_B = norm(back) * (norm(old.dA) + norm(old.curvature)) + norm(slope) + of_A * of_A
    assert relative(at.curvature, np.swapaxes(dA, 1, 2) - dA - bracket, of_B) < 1e-13
    assert relative(moved.curvature(case.x), at.curvature) < 1e-14
    J = red.spatial_momentum(case.pose, red.body_momentum(case.x, case.xdot, case.xi))
    xi = back @ case.xi + theta @ case.xdot
    mu = moved.body_momentum(case.x, case.xdot, xi)
    assert relative(mu, Ad.T @ red.body_momentum(case.x, case.xdot, case.xi)) < 1e-13
    assert relative(moved.spatial_momentum(G.compose(case.pose, pose), mu), J) < 1e-12


@settings(max_examples=8)
@given(cases(1, 5))
def test_change_section_transforms_derivatives(case: Case) -> None:
    """∂(I′A′) and ∂I′ from the derivatives of Pinocchio's H and of Ad_h, exactly."""
    system, G, r = case.system, case.system.group, case.system.r
    h = wavy(case)
    pose, theta, slope = h(case.x)
    at, H = pinred.Reduction(system).change_section(h).at(case.x), pinocchios(case)
    q, zero, data = system.q(G.identity(), case.x), np.zeros(system.n), system.data
    dH = np.zeros((system.n, system.n, system.m))
    for k, e in enumerate(np.eye(system.n)):  # without gravity
        dH[:, k] = pin.computeRNEADerivatives(system.model, data, q, zero, e)[0][:, r:]
    T, dT = np.eye(system.n), np.zeros((system.n, system.n, system.m))
    Ad, ad = G.Ad(pose), G.ad(theta.T)
    T[:r, :r], T[:r, r:] = Ad, -Ad @ theta
    dT[:r, :r] = np.einsum("ij,cjk->ikc", Ad, ad)
    dT[:r, r:] = -np.einsum("ij,cjk,kb->ibc", Ad, ad, theta) - np.einsum("ij,jbc->ibc", Ad, slope)
    half = np.einsum("jik,jl,lm->imk", dT, H, T)
    there = np.einsum("ji,jkc,kl->ilc", T, dH, T) + half + np.swapaxes(half, 0, 1)
    size = norm(T) ** 2 * norm(dH) + 2.0 * norm(dT) * norm(H) * norm(T)
    assert relative(at.dI, there[:r, :r], size) < 1e-13
    across = np.einsum("ijc,jb->ibc", at.dI, at.local_connection)
    across += np.einsum("ij,jbc->ibc", at.locked_inertia, at.dA)
    size *= max(1.0, norm(at.local_connection))
    assert relative(across, there[:r, r:], size) < 1e-13


@settings(max_examples=8)
@given(cases(1, 5))
def test_com_slope_in_other_section_equals_differences(case: Case) -> None:
    """∂c′ by differences of Pinocchio's c, transformed by h."""
    system, h, root = case.system, wavy(case), case.system.model.jointPlacements[1]

    def com(x: Array) -> Array:
        q = system.q(h(x)[0], x)  # the robot moved by h stands where its own frame says
        pin.forwardKinematics(system.model, system.data, q)
        body = system.data.oMi[1].copy()
        own = system.q(system.group.identity(), x)
        place = root.actInv(pin.centerOfMass(system.model, system.data, own))
        return np.array(root.actInv(body).actInv(place))

    steps = 1e-6 * np.eye(system.m)
    slope = np.array([(com(case.x + e) - com(case.x - e)) / 2e-6 for e in steps]).T
    found = pinred.Reduction(system).change_section(h)
    assert found.at(case.x).com == pytest.approx(com(case.x), abs=1e-12)
    assert relative(found.com_slope(case.x), slope) < 1e-7


@settings(max_examples=8)
@given(cases(1, 5), st.booleans())
@example(case=make_case("R", 1, 787), heavy=False)  # all terms nearly cancel
def test_accelerations_do_not_depend_on_section(case: Case, heavy: bool) -> None:
    """Both equations in a moved frame have ABA's accelerations; gravity may rotate a pivot."""
    system, G = case.system, case.system.group
    pose0 = {}
    if heavy and G.is_pivot:
        system.model.gravity.linear = np.array([1.0, -3.0, 9.0])
        system = pinred.load(system.model)
    h = wavy(case)
    red = pinred.Reduction(system)
    moved, first = red.change_section(h), red.change_section(lambda x: h(x)[:2])
    pose, theta, _ = h(case.x)
    xi = G.Ad(G.inverse(pose)) @ case.xi + theta @ case.xdot
    if heavy and G.is_pivot:
        pose0 = {"pose": G.compose(case.pose, pose)}
    omega, at = moved.locked_velocity(case.x, case.xdot, xi), moved.at(case.x)
    terms = lagrange_poincare(moved, case.x, case.xdot, omega, **pose0)
    model = system.model
    a = pin.aba(model, model.createData(), case.q, case.v, np.zeros(system.n))[system.r :]
    kinetic = kinetic_size(at.mass_matrix, np.concatenate([xi, case.xdot]))
    assert backward_error(at.reduced_metric, terms.xddot, a, terms.shape, kinetic) < 1e-12
    p, mu = at.reduced_metric @ case.xdot, at.locked_inertia @ omega
    by_momenta = hamilton_poincare(first, case.x, p, mu, **pose0)  # needs no ∂Θ
    size = largest(terms.shape, terms.momentum, kinetic)
    assert relative(by_momenta.shape.total, terms.shape.total, size) < 1e-12
    assert relative(by_momenta.momentum.total, terms.momentum.total, size) < 1e-12


@settings(max_examples=8)
@given(cases(1, 5))
def test_grid_in_other_section_equals_at(case: Case) -> None:
    """After two changes of section, `grid` equals `at` at each shape."""
    h = wavy(case)
    red = pinred.Reduction(case.system).change_section(h).change_section(lambda x: h(x)[:2])
    shapes = case.rng.uniform(-2.0, 2.0, (2, 3, case.system.m))
    field = red.grid(shapes)
    for index in np.ndindex(2, 3):
        at = red.at(shapes[index])
        for name in FIELDS:
            assert relative(getattr(field, name)[index], getattr(at, name)) < 1e-11, name
        assert field.potential[index] == pytest.approx(at.potential, rel=1e-12, abs=1e-12)
        mu = np.arange(1.0, red.system.r + 1.0)
        assert field.amended_potential(mu)[index] == pytest.approx(at.amended_potential(mu))


def test_flat_section_of_coupled_bodies_removes_connection() -> None:
    """Remark 2.6: if no term depends on the shape, A vanishes in the section h = exp(A x)."""
    system = pinred.load("coupled_planar")
    red = pinred.Reduction(system)
    A = red.local_connection([0.0])[:, 0]

    def h(x: Array) -> tuple[Array, Array]:
        return system.group.exp(A * x[0]), A[:, None]

    flat = red.change_section(h)
    for x in (0.3, -2.0):
        assert np.abs(flat.local_connection([x])).max() < 1e-15
        assert np.abs(flat.curvature([x])).max() < 1e-15


def test_two_changes_of_section_equal_their_product() -> None:
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


def test_change_section_with_wrong_derivative_raises() -> None:
    """The spatial instead of the body derivative, a missing one, and values that are no section."""
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
    assert first.at(case.x).dI.shape == (3, 3, 2)
    with pytest.raises(pinred.InputError, match="third value"):
        _ = first.at(case.x).dA
    with pytest.raises(pinred.InputError, match="third value"):
        lagrange_poincare(first, case.x, case.xdot, case.xi)


def test_change_section_checks_derivative_to_a_millionth() -> None:
    """A constant section with a Θ of 4e-6 is refused, with 4e-7 accepted."""
    red = pinred.Reduction(make_case("SE2", 2, 1).system)
    identity = red.group.identity()
    red.change_section(lambda _: (identity, np.full((3, 2), 4e-7)))
    with pytest.raises(pinred.InputError, match="body twist of h per unit rate"):
        red.change_section(lambda _: (identity, np.full((3, 2), 4e-6)))


@settings(max_examples=8)
@given(cases(0, 5))
def test_connection_form_and_spatial_inertia(case: Case) -> None:
    """J = 𝕀 𝒜(v) by Pinocchio; 𝒜 of a rigid motion is its twist; 𝒜 is equivariant."""
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


def test_curvature_form_equals_derivative_minus_bracket() -> None:
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
