"""Poisson brackets with balls: both forms, the Jacobi identity, Casimirs, and ḟ = {f, h}."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import casadi as ca
import numpy as np
import pytest
from ball_trees import ball_tree

import pinred
from pinred import poisson
from pinred.common.arrays import Array
from pinred.kernels.kernel import Structure
from pinred.kernels.reduced_graph import ReducedGraph
from pinred.reduction.canonical_form import CanonicalForm
from pinred.reduction.potential import Potential
from pinred.system.system import System

FORMS: tuple[Literal["connection", "canonical"], ...] = ("connection", "canonical")


def heavy(seed: int) -> System:
    """Return a random tree on a pivot in gravity."""
    model = ball_tree(seed, 2, "SO3").model.copy()
    model.gravity.linear = np.array([1.0, -2.0, -9.0])
    return System(model)


def random_state(space: poisson.PhaseSpace, seed: int) -> Array:
    """Return random values of z, with quaternions of length one."""
    system, rng = space.system, np.random.default_rng(seed)
    rest = rng.normal(size=space.z.numel() - system.nx)
    return np.concatenate([system.space.random(rng, 2.0), rest])


def at(space: poisson.PhaseSpace, value: ca.SX, z: Array) -> Array:
    """Return a matrix of expressions at z."""
    return np.array(ca.Function("value", [space.z], [value])(z))


@pytest.mark.parametrize("group", ["SE3", "SO3", "SE2", "heavy"])
@pytest.mark.sampled
def test_canonical_tensor_with_balls_maps_to_connection_tensor(group: str) -> None:
    """With σ(x, π, μ) = (x, π − Aᵀμ, μ): Tσ P Tσᵀ; the numerical tensors are the same."""
    system = heavy(3) if group == "heavy" else ball_tree(3, 3, group)
    space = poisson.phase_space(system, form="canonical")
    A = pinred.casadi_functions(system).local_connection(space.x)
    sigma = ca.vertcat(space.x, space.p - A.T @ space.mu, space.mu, space.gamma)
    slope, z = ca.jacobian(sigma, space.z), random_state(space, 1)
    pushed = at(space, slope @ space.tensor @ slope.T, z)
    mapped = at(space, sigma, z)[:, 0]
    symbolic = poisson.phase_space(system)
    size = np.abs(pushed).max()
    np.testing.assert_allclose(at(symbolic, symbolic.tensor, mapped), pushed, atol=1e-13 * size)
    red, nx, m, r = pinred.Reduction(system), system.nx, system.m, system.r
    for form, values, expected in (
        ("connection", mapped, pushed),
        ("canonical", z, at(space, space.tensor, z)),
    ):
        x, p, mu, gamma = np.split(values, [nx, nx + m, nx + m + r])
        P = poisson.tensor(red, x, p, mu, gamma if len(gamma) else None, form=form)  # type: ignore[arg-type]
        np.testing.assert_allclose(P, expected, atol=1e-13 * size)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("group", ["SE3", "SE2", "heavy"])
@pytest.mark.sampled(3)
def test_jacobi_identity_with_balls(group: str, form: Literal["connection", "canonical"]) -> None:
    """The cyclic sum of {{f, g}, k} vanishes to round-off of its largest term."""
    system = heavy(3) if group == "heavy" else ball_tree(4, 2, group)
    space = poisson.phase_space(system, form=form)
    rng, size = np.random.default_rng(4), space.z.numel()
    f, g, k = (
        ca.dot(ca.DM(rng.normal(size=size)), space.z)
        + ca.sin(ca.dot(ca.DM(rng.normal(size=size)), space.z))
        for _ in range(3)
    )
    turns = [
        poisson.bracket(poisson.bracket(a, b), c) for a, b, c in ((f, g, k), (g, k, f), (k, f, g))
    ]
    for seed in range(3):
        values = at(space, ca.vertcat(*turns), random_state(space, seed))
        assert abs(values.sum()) <= 2e-13 * max(1.0, np.abs(values).max())
        assert np.abs(values).max() > 1e-3


def test_momenta_of_ball_have_brackets_of_angular_momentum() -> None:
    """{π_1, π_2} = −π_3 in cyclic order, and {x, π} is the rate of the quaternion."""
    system = ball_tree(0, 3, "SO3")
    space = poisson.phase_space(system, form="canonical")
    ball, z = system.space.balls[-1], random_state(space, 2)
    axes = [space.p[k] for k in range(ball.v.start, ball.v.stop)]
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        bracket = poisson.bracket(axes[a], axes[b])
        assert at(space, bracket, z) == pytest.approx(float(-at(space, axes[c], z)[0, 0]))
    x = z[: system.nx]
    h, unit = 1e-5, np.eye(system.m)[ball.v.start]
    along = [system.space.integrate(x, s * h * unit) for s in (-1.0, 1.0)]
    found = at(space, ca.vertcat(*(poisson.bracket(c, axes[0]) for c in ca.vertsplit(space.x))), z)
    np.testing.assert_allclose(found[:, 0], (along[1] - along[0]) / (2.0 * h), atol=1e-10)


@pytest.mark.parametrize("group", ["SE3", "SO3", "SE2"])
@pytest.mark.sampled(3)
def test_energy_bracket_with_balls_equals_rates_of_kernel(group: str) -> None:
    """{z, h} equals Pinocchio's rates, the kernel's rates, and maps to the connection form."""
    system = ball_tree(5, 3, group)
    space, r, k = poisson.phase_space(system, form="canonical"), system.r, system.group.linear
    z = random_state(space, 3)
    z[system.nx + system.m :][:k] = 0.0  # the kernel's momentum about the centre of mass
    x, pi, mu = np.split(z, [system.nx, system.nx + system.m])
    rates = at(space, space.tensor @ ca.gradient(space.hamiltonian, space.z), z)[:, 0]
    form = CanonicalForm(system, Potential(system))
    v = form.velocity(x, np.concatenate([mu, pi]))
    force, drift = form.force(x, v), system.group.coadjoint(v[:r], mu)
    expected = np.concatenate([system.space.rate_map(x) @ v[r:], force, drift])
    np.testing.assert_allclose(rates, expected, atol=1e-13 * np.abs(expected).max())
    graph = ReducedGraph(system, Structure(zero_momentum=False, base=False))
    spin = ca.vertcat(*graph.base.b, *graph.base.spin)
    inputs = [ca.vertcat(*graph.x), ca.vertcat(*graph.pi), spin]
    kernel = ca.Function("kernel", inputs, [ca.vertcat(*graph.xdot, *graph.pidot)])
    values = np.array(kernel(x, pi, mu[k:]))[:, 0]
    np.testing.assert_allclose(
        values, np.concatenate([v[r:], force]), atol=1e-13 * max(abs(values))
    )
    connection, red = poisson.phase_space(system), pinred.Reduction(system)
    p = pi - red.local_connection(x).T @ mu
    dh = ca.gradient(connection.hamiltonian, connection.z)
    found = at(connection, connection.tensor @ dh, np.concatenate([x, p, mu]))[:, 0]
    terms = pinred.equations.hamilton_poincare(red, x, p, mu)
    expected = np.concatenate([expected[: system.nx], terms.shape.total, drift])
    np.testing.assert_allclose(found, expected, atol=1e-13 * np.abs(expected).max())


@pytest.mark.parametrize("form", FORMS)
def test_casimirs_commute_with_all_variables_of_balls(
    form: Literal["connection", "canonical"],
) -> None:
    """The Casimirs are those of the base alone, |P|² and P·L."""
    system = ball_tree(2, 3)
    space, casimirs = poisson.phase_space(system, form=form), poisson.casimirs(system)
    assert casimirs[0].name == poisson.casimirs(ball_tree(0, 1))[0].name
    z = random_state(space, 4)
    P, mu = at(space, space.tensor, z), z[system.nx + system.m :]
    assert len(casimirs) == 2
    for casimir in casimirs:
        slope = np.concatenate([np.zeros(system.nx + system.m), casimir.gradient(mu)])
        np.testing.assert_allclose(P @ slope, 0.0, atol=1e-13 * np.abs(P).max())


def test_brackets_of_observables_with_balls_equal_expressions() -> None:
    """Gradients with respect to x have an entry for each coordinate of a quaternion."""
    system = ball_tree(1, 3)
    space, red = poisson.phase_space(system), pinred.Reduction(system)
    f, g = ca.sin(ca.sum1(space.z)), ca.sumsqr(space.z[2:])
    value = ca.Function("value", [space.z], [f, g, *(ca.gradient(h, space.z) for h in (f, g))])
    pair = [
        poisson.Observable(
            red,
            lambda *z, k=k: float(value(np.concatenate(z))[k]),
            lambda *z, k=k: np.array(value(np.concatenate(z))[2 + k])[:, 0],
        )
        for k in (0, 1)
    ]
    z = random_state(space, 5)
    ends = [0, system.nx, system.nx + system.m, len(z)]
    found = poisson.bracket(*pair)(*(z[a:b] for a, b in pairwise(ends)))
    np.testing.assert_allclose(found, at(space, poisson.bracket(f, g), z)[0, 0], rtol=1e-12)
