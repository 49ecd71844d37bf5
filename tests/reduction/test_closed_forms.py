"""The textbook examples in closed form; docs/errata.md says which misprints they decide."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import ArrayLike
from textbook import DELTA, I1, I2, J1, J2, M1, M2, D, M

import pinred
from pinred.common.arrays import Array
from pinred.equations import euler_poincare, hamilton_poincare, lagrange_poincare

rng = np.random.default_rng(5)
SHAPES = [np.zeros(1), np.array([0.7]), np.array([-2.5])]


def bar(values: ArrayLike, expected: ArrayLike) -> None:
    """Assert equality to 1e-13."""
    np.testing.assert_allclose(np.asarray(values), np.asarray(expected), rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("x", SHAPES)
def test_elroys_beanie_has_closed_form(x: Array) -> None:
    """I = I1 + I2, A = I2/I, M = I1 I2/I, no curvature, and θ̈2 = −V′ (I1 + I2)/(I1 I2)."""
    k, rest = 3.0, 0.2
    system = pinred.load("elroys_beanie")
    red = pinred.Reduction(system, springs={system.shape_names[0]: (k, rest)})
    at = red.at(x)
    bar(at.locked_inertia, [[I1 + I2]])
    bar(at.local_connection, [[I2 / (I1 + I2)]])
    bar(at.reduced_metric, [[I1 * I2 / (I1 + I2)]])
    bar(at.curvature, np.zeros((1, 1, 1)))
    force = k * (x - rest)
    bar(red.potential(x), 0.5 * k * (x[0] - rest) ** 2)
    bar(red.amended_potential(x, [0.3]), 0.5 * k * (x[0] - rest) ** 2 + 0.5 * 0.09 / (I1 + I2))
    xdot, omega = np.array([0.4]), np.array([-0.9])
    terms = lagrange_poincare(red, x, xdot, omega)
    bar(terms.xddot, -force * (I1 + I2) / (I1 * I2))
    bar(terms.momentum.total, [0.0])  # Ω̇ = 0 where Ω = θ̇1 + A θ̇2
    p, mu = at.reduced_metric @ xdot, at.locked_inertia @ omega
    h = 0.5 * p[0] ** 2 / (I1 * I2 / (I1 + I2)) + red.potential(x) + 0.5 * mu[0] ** 2 / (I1 + I2)
    bar(hamilton_poincare(red, x, p, mu).energy, h)


@pytest.mark.parametrize("x", SHAPES)
def test_coupled_planar_bodies_do_not_depend_on_shape(x: Array) -> None:
    """The second body is pinned at its centre of mass: no term depends on the shape."""
    red = pinred.Reduction(pinred.load("coupled_planar"))
    at = red.at(x)
    locked = [[M, 0, 0], [0, M, M2 * D], [0, M2 * D, J1 + J2 + M2 * D**2]]
    bar(at.locked_inertia, locked)
    bar(at.local_connection[:, 0], [0.0, -J2 * M2 * D / DELTA, J2 * M / DELTA])
    bar(at.reduced_metric, [[(J1 * J2 * M + J2 * M1 * M2 * D**2) / DELTA]])
    for derivative in (at.dI, at.dA, at.dM, at.curvature):
        bar(derivative, np.zeros(derivative.shape))
    mu = np.array([0.5, -1.0, 2.0])
    bar(at.amended_potential(mu), 0.5 * mu @ np.linalg.solve(np.array(locked), mu))


def test_euler_poincare_on_se2_has_closed_form() -> None:
    """ξ̇1 = ξ2ξ3 + (m2 d/m) ξ3², ξ̇2 = −ξ1ξ3, ξ̇3 = 0 with the locked inertia above."""
    red = pinred.Reduction(pinred.load("coupled_planar"))
    for xi in rng.normal(size=(5, 3)):
        found = euler_poincare(red, [0.3], xi).xidot
        bar(found, [xi[1] * xi[2] + M2 * D / M * xi[2] ** 2, -xi[0] * xi[2], 0.0])


def test_bracket_of_se2_equals_matrix_commutator() -> None:
    """[e1, e3] = −e2, [e2, e3] = e1, [e1, e2] = 0, by the matrices of se(2)."""
    e1, e2, e3 = np.eye(3)
    bracket = pinred.lie.SE2.bracket
    bar(bracket(e1, e3), -e2)
    bar(bracket(e2, e3), e1)
    bar(bracket(e1, e2), np.zeros(3))


def test_eulers_equations_of_rigid_body() -> None:
    """I1 ξ̇1 = (I2 − I3) ξ2 ξ3 and cyclic."""
    red = pinred.Reduction(pinred.load("rigid_body"))
    moments = np.diag(red.locked_inertia([]))
    bar(red.locked_inertia([]), np.diag(moments))
    assert len(set(moments)) == 3
    a, b, c = moments
    for xi in rng.normal(size=(5, 3)):
        u, v, w = xi
        expected = [(b - c) * v * w / a, (c - a) * w * u / b, (a - b) * u * v / c]
        bar(euler_poincare(red, [], xi).xidot, expected)


def test_shape_equation_needs_every_sign_and_factor() -> None:
    """Each quadratic term carries ½, the potential −, the coadjoint −; dropping one shows.

    The terms, rebuilt from central differences of the energy of a robot on which all of
    them act, decide the factors and signs that the notes misprint.
    """
    system = pinred.load("falling_cat")
    red = pinred.Reduction(system, springs={system.shape_names[0]: (2.0, 0.5)})
    x, xdot, omega = rng.normal(size=system.m), rng.normal(size=system.m), rng.normal(size=6)
    terms = lagrange_poincare(red, x, xdot, omega).shape
    step, mu = 1e-4, red.locked_inertia(x) @ omega
    for k, e in enumerate(np.eye(system.m)):

        def slope(f: object, e: Array = e) -> float:
            assert callable(f)
            steps = ((1, 2 / 3), (2, -1 / 12))
            return float(
                sum(w * (f(x + n * step * e) - f(x - n * step * e)) for n, w in steps) / step
            )

        metric = slope(lambda s: 0.5 * xdot @ red.reduced_metric(s) @ xdot)
        inertia = slope(lambda s: 0.5 * omega @ red.locked_inertia(s) @ omega)
        assert terms.metric[k] == pytest.approx(metric, abs=1e-9)
        assert terms.centrifugal[k] == pytest.approx(inertia, abs=1e-9)
        assert terms.potential[k] == pytest.approx(-slope(red.potential), abs=1e-9)
        twisted = system.group.bracket(omega, red.local_connection(x)[:, k])
        assert terms.coadjoint[k] == pytest.approx(-mu @ twisted, abs=1e-12)
        assert min(abs(metric), abs(inertia), abs(float(mu @ twisted))) > 1e-6


def test_sign_of_curvature_and_factor_of_momentum_equation() -> None:
    """By ABA on the falling cat: ⟨μ, B_αβ⟩ ẋ^β with +, and (ẋ⌟dI) Ω with 1, not ½."""
    system = pinred.load("falling_cat")
    red, model = pinred.Reduction(system), system.model
    x, xdot, xi = rng.normal(size=system.m), rng.normal(size=system.m), rng.normal(size=6)
    at = red.at(x)
    omega = red.locked_velocity(x, xdot, xi)
    q, v = system.q(system.group.identity(), x), system.v(xi, xdot)
    a = pin.aba(model, model.createData(), q, v, np.zeros(system.n))
    terms = lagrange_poincare(red, x, xdot, omega).shape
    left = at.reduced_metric @ a[6:] + at.dM @ xdot @ xdot
    size = np.abs(left).max()
    assert np.abs(left - terms.total).max() < 1e-12 * size
    assert np.abs(left - (terms.total - 2.0 * terms.curvature)).max() > 1e-2 * size
    interior = np.einsum("iba,i,b->a", at.curvature, at.locked_inertia @ omega, xdot)
    bar(terms.curvature, -interior)  # −⟨μ, B(ẋ, ·)⟩
    omegadot = a[:6] + at.local_connection @ a[6:] + at.dA @ xdot @ xdot
    coadjoint = system.group.coadjoint(xi, at.locked_inertia @ omega)
    left, dragged = at.locked_inertia @ omegadot, at.dI @ xdot @ omega
    size = np.abs(left).max()
    assert np.abs(left - (coadjoint - dragged)).max() < 1e-12 * size
    assert np.abs(left - (coadjoint - 0.5 * dragged)).max() > 1e-3 * size


def test_horizontal_vector_of_coupled_bodies_has_no_momentum() -> None:
    """(0, I2 m2 d/Δ, −I2 m/Δ, 1) has no momentum by Pinocchio; 𝒜 at a rotated pose."""
    system = pinred.load("coupled_planar")
    red, model = pinred.Reduction(system), system.model
    lift = red.horizontal_lift([0.4], [1.0])
    bar(lift.xi, [0.0, J2 * M2 * D / DELTA, -J2 * M / DELTA])
    bar(DELTA, 3.75)
    pose = np.array([0.3, -0.8, 1.1])
    q = system.q(pose, [0.4])
    data = model.createData()
    momentum = pin.computeCentroidalMomentum(model, data, q, system.v(lift.xi, lift.xdot))
    bar(momentum.vector, np.zeros(6))
    # Ad_g (v, ω) = (R v + ω (y, −x), ω).
    c, s = np.cos(pose[2]), np.sin(pose[2])
    a, w = -J2 * M2 * D / DELTA, J2 * M / DELTA
    form = red.connection_form(pose, [0.4])
    bar(form[:, 3], [-s * a + pose[1] * w, c * a - pose[0] * w, w])
    v = np.array([0.4, -0.2, 0.7, 1.3])
    h = pin.computeCentroidalMomentum(model, data, q, v)
    about_origin = np.cross(data.com[0], h.linear) + h.angular
    J = red.locked_inertia_in_space(pose, [0.4]) @ form @ v
    bar(J, [h.linear[0], h.linear[1], about_origin[2]])


def test_momentum_equation_of_beanie_by_aba() -> None:
    """With a stretched spring θ̈1 = −A θ̈2 is not zero; Ω̇ is."""
    system = pinred.load("elroys_beanie")
    model, torque = system.model, np.array([0.0, -3.0 * 0.7])
    a = pin.aba(model, model.createData(), system.q([0.2], [0.9]), np.array([0.5, -0.4]), torque)
    A = I2 / (I1 + I2)
    bar(a[1], torque[1] * (I1 + I2) / (I1 * I2))
    bar(a[0], -A * a[1])
    assert abs(a[0]) > 0.5
    bar(a[0] + A * a[1], 0.0)


def test_locked_inertia_of_stretched_chain() -> None:
    """Six unit links in a row: 6 · 0.1 about their middles and Σ (k − 2.5)² between them, 18.1."""
    red = pinred.Reduction(pinred.load("planar_chain5"))
    at = red.at(np.zeros(5))
    bar(at.com[:2], [3.0, 0.0])
    bar(at.locked_inertia[2, 2] - 6.0 * 3.0**2, 18.1)


def test_cartpole_has_closed_form() -> None:
    """A = −m l cos(x)/3, M = I_pole − (m l cos x)²/3, V = −m g l cos(x), with m l = 0.5."""
    red = pinred.Reduction(pinred.load("cartpole"))
    for x in (0.0, 0.7, 2.5):
        bar(red.local_connection([x]), [[-np.cos(x) / 6]])
        bar(red.reduced_metric([x]), [[0.34 - np.cos(x) ** 2 / 12]])
        bar(red.potential([x]), -9.81 * 0.5 * np.cos(x))
        bar(red.potential_gradient([x]), [9.81 * 0.5 * np.sin(x)])


def random_motion(system: pinred.System, seed: int) -> tuple[Array, Array, Array, Array]:
    """Return shape, shape rate, twist, and the accelerations by ABA without torques."""
    draws, model = np.random.default_rng(seed), system.model
    x, xdot, xi = (
        draws.normal(size=system.m),
        draws.normal(size=system.m),
        draws.normal(size=system.r),
    )
    q, v = system.q(system.group.identity(), x), system.v(xi, xdot)
    a = pin.aba(model, model.createData(), q, v, np.zeros(system.n))
    return x, xdot, xi, np.asarray(a)


def test_momentum_equation_of_coupled_bodies_by_aba() -> None:
    """Example 3.8: the terms with θ̇2 have the printed signs, the quadratic ones do not."""
    system = pinred.load("coupled_planar")
    _, (w,), xi, a = random_motion(system, 8)
    A = np.array([0.0, -J2 * M2 * D / DELTA, J2 * M / DELTA])
    u1, u2, u3 = xi + A * w
    omegadot = a[:3] + A * a[3]
    quadratic = np.array([u2 * u3 + M2 * D / M * u3**2, -u1 * u3, 0.0])
    driven = w * np.array(
        [-J2 * M / DELTA * u2 - J2 * M2 * D / DELTA * u3, J2 * M / DELTA * u1, 0.0]
    )
    bar(omegadot, quadratic + driven)
    for wrong in (-quadratic + driven, quadratic - driven):
        assert np.abs(omegadot - wrong)[:2].min() > 1e-2


def test_coadjoint_term_of_both_forms_by_aba() -> None:
    """−⟨μ, [Ω, A_α]⟩ is −⟨ad*_Ω μ, A_α⟩ on the right of both forms: ṗ and d/dt (M ẋ) by ABA."""
    system = pinred.load("falling_cat")
    red = pinred.Reduction(system)
    x, xdot, xi, a = random_motion(system, 9)
    at = red.at(x)
    omega = red.locked_velocity(x, xdot, xi)
    p, mu = at.reduced_metric @ xdot, at.locked_inertia @ omega
    pdot = at.reduced_metric @ a[6:] + at.dM @ xdot @ xdot
    size = np.abs(pdot).max()
    for terms in (
        hamilton_poincare(red, x, p, mu).shape, lagrange_poincare(red, x, xdot, omega).shape
    ):  # fmt: skip
        bar(terms.coadjoint, -at.local_connection.T @ system.group.coadjoint(omega, mu))
        assert np.abs(pdot - terms.total).max() < 1e-12 * size
        assert np.abs(pdot - (terms.total - 2.0 * terms.coadjoint)).max() > 1e-2 * size


@pytest.mark.parametrize("name", ["elroys_beanie", "coupled_planar", "falling_cat"])
def test_locked_inertia_is_top_left_of_mass_matrix(name: str) -> None:
    """Example 2.7: I is top left and I A top right, by the kinetic energy of each motion."""
    system = pinred.load(name)
    red, model, r = pinred.Reduction(system), system.model, system.r
    x, xdot, xi, _ = random_motion(system, 10)
    H, q = red.mass_matrix(x), system.q(system.group.identity(), x)

    def energy(twist: Array, rate: Array) -> float:
        v = system.v(twist, rate)
        return float(pin.computeKineticEnergy(model, model.createData(), q, v))

    both, locked, inner = energy(xi, xdot), energy(xi, 0.0 * xdot), energy(0.0 * xi, xdot)
    assert 0.5 * xi @ H[:r, :r] @ xi == pytest.approx(locked, rel=1e-12)
    assert xi @ H[:r, r:] @ xdot == pytest.approx(both - locked - inner, rel=1e-10, abs=1e-12)
    bar(H[:r, :r], red.locked_inertia(x))
    bar(H[:r, r:], red.locked_inertia(x) @ red.local_connection(x))


def test_basis_of_se2_has_zero_corner() -> None:
    """e1, e2, e3 are derivatives of poses: their corner is 0, unlike that of a pose."""
    group, step = pinred.lie.SE2, 1e-4
    expected = np.zeros((3, 3, 3))
    expected[0, 0, 2] = expected[1, 1, 2] = expected[2, 1, 0] = 1.0
    expected[2, 0, 1] = -1.0
    for e, matrix in zip(np.eye(3), expected, strict=True):
        difference = group.matrix(group.exp(step * e)) - group.matrix(group.exp(-step * e))
        np.testing.assert_allclose(difference / (2.0 * step), matrix, rtol=0.0, atol=1e-8)
        assert group.matrix(group.exp(step * e))[2, 2] == 1.0


def test_locked_inertia_in_space_of_coupled_bodies() -> None:
    """𝕀33 = I1 + I2 + m2 d² + m (x² + y²) + 2 m2 d (x cos θ + y sin θ), by the energy of a turn."""
    system = pinred.load("coupled_planar")
    model, (px, py, turn) = system.model, (0.3, -0.8, 1.1)
    found = pinred.Reduction(system).locked_inertia_in_space([px, py, turn], [0.4])[2, 2]
    along = px * np.cos(turn) + py * np.sin(turn)
    bar(found, J1 + J2 + M2 * D**2 + M * (px**2 + py**2) + 2.0 * M2 * D * along)
    # A turn about the origin of space at 1 rad/s has twice the energy 𝕀33/2.
    c, s = np.cos(turn), np.sin(turn)
    v = system.v([c * -py + s * px, -s * -py + c * px, 1.0], [0.0])
    q = system.q([px, py, turn], [0.4])
    bar(2.0 * pin.computeKineticEnergy(model, model.createData(), q, v), found)


def test_quotient_of_beanie_is_by_the_group() -> None:
    """Q/SO(2) is the shape: energies at all angles of SO(2) agree, and 2π is the same point."""
    system = pinred.load("elroys_beanie")
    model, v = system.model, np.array([0.4, -0.9])
    energies = [
        pin.computeKineticEnergy(model, model.createData(), system.q([angle], [0.3]), v)
        for angle in (0.0, 1.0, 2.0 * np.pi)
    ]
    bar(energies, [energies[0]] * 3)
    bar(system.group.matrix(np.array([2.0 * np.pi])), system.group.matrix(np.zeros(1)))
