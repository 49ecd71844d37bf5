"""Generators, constrained variations and Euler–Poincaré, against differences and conserved J."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from assertions import close
from ball_trees import ball_tree
from scipy.integrate import solve_ivp

import pinred
from pinred.common.arrays import Array
from pinred.equations import (
    constrained_variation,
    euler_poincare,
    euler_poincare_of_lagrangian,
    infinitesimal_generator,
)
from pinred.lie import SE2, SE3, Group

STEP = 5e-3


def slope(f: Any) -> Array:
    """Return f′(0) by Richardson's central differences of order 6."""
    pairs = ((1, 1.5), (2, -0.3), (3, 1.0 / 30.0))
    return np.asarray(sum(w * (f(k * STEP) - f(-k * STEP)) for k, w in pairs) / (2.0 * STEP))


@pytest.mark.parametrize("name", ["falling_cat", "three_rods", "elroys_beanie"])
def test_infinitesimal_generator_is_velocity_of_moved_robot(name: str) -> None:
    """g⁻¹ d/ds (exp(sζ) g) by differences of the logarithm; joints do not move."""
    system = pinred.load(name)
    group, rng = system.group, np.random.default_rng(0)
    g, zeta = group.exp(rng.normal(size=system.r)), rng.normal(size=system.r)

    def moved(s: float) -> Array:
        turned = group.compose(group.exp(s * zeta), g)
        return group.log(group.compose(group.inverse(g), turned))

    found = infinitesimal_generator(pinred.Reduction(system), g, zeta)
    close(found.xi, slope(moved), 1e-11)
    assert not found.xdot.any()


@pytest.mark.parametrize("name", ["falling_cat", "three_rods", "satellite_two_arms"])
def test_constrained_variations_match_differences_of_motions(name: str) -> None:
    """δξ and δΩ of a family of motions g(t, s), x(t, s), whose twists are differences in t."""
    system = pinred.load(name)
    red, group, rng = pinred.Reduction(system), system.group, np.random.default_rng(1)
    a, b, c, d = rng.normal(size=(4, system.r))
    p, q, u, w = rng.normal(size=(4, system.m))

    def pose(t: float, s: float) -> Array:
        return group.compose(group.exp(t * a + s * b), group.exp(t * s * c + t * d))

    def shape(t: float, s: float) -> Array:
        return np.asarray(0.3 * p + t * q + s * u + t * s * w)

    def twist(s: float, t: float = 0.0) -> Array:
        inverse = group.inverse(pose(t, s))
        return slope(lambda h: group.log(group.compose(inverse, pose(t + h, s))))

    def variation(t: float) -> Array:
        inverse = group.inverse(pose(t, 0.0))
        return slope(lambda h: group.log(group.compose(inverse, pose(t, h))))

    def locked(s: float) -> Array:
        return np.asarray(twist(s) + red.local_connection(shape(0.0, s)) @ (q + s * w))

    found = constrained_variation(
        red, shape(0.0, 0.0), q, twist(0.0), eta=variation(0.0), etadot=slope(variation),
        dx=u, dxdot=w,
    )  # fmt: skip
    close(found.twist, slope(twist), 1e-9)
    close(found.locked, slope(locked), 1e-9)


@pytest.mark.parametrize("group", ["SE3", "SO3", "SE2"])
@pytest.mark.sampled(3)
def test_constrained_variation_with_balls_matches_differences_of_motions(group: str) -> None:
    """δΩ of a family of motions g(t, s), x(t, s) with rates and variations along the frame."""
    system = ball_tree(2, 3, group)
    red, G, space = pinred.Reduction(system), system.group, system.space
    rng = np.random.default_rng(1)
    center, (a, b, c) = space.random(rng, 1.0), rng.normal(size=(3, system.r))
    q, u, w = rng.normal(size=(3, system.m))

    def pose(t: float, s: float) -> Array:
        return G.compose(G.exp(t * a + s * b), G.exp(t * s * c))

    def shape(t: float, s: float) -> Array:
        return space.integrate(space.integrate(center, t * q + s * u), t * s * w)

    def twist(s: float) -> Array:
        inverse = G.inverse(pose(0.0, s))
        return slope(lambda h: G.log(G.compose(inverse, pose(h, s))))

    def eta(t: float) -> Array:
        inverse = G.inverse(pose(t, 0.0))
        return slope(lambda h: G.log(G.compose(inverse, pose(t, h))))

    def rate(s: float) -> Array:
        return slope(lambda h: space.difference(shape(0.0, s), shape(h, s)))

    def variation(t: float) -> Array:
        return slope(lambda h: space.difference(shape(t, 0.0), shape(t, h)))

    found = constrained_variation(
        red, center, rate(0.0), twist(0.0), eta=eta(0.0), etadot=slope(eta),
        dx=variation(0.0), dxdot=slope(variation),
    )  # fmt: skip
    expected = slope(lambda s: twist(s) + red.local_connection(shape(0.0, s)) @ rate(s))
    close(found.locked, expected, 1e-8)


def quartic(inertia: Array) -> Any:
    """Return ℓ = ½ ξᵀIξ + ¼ Σ ξ⁴ + ξ₁ ξ₂²/5."""
    return lambda xi: 0.5 * xi.T @ inertia @ xi + ca.sumsqr(xi**2) / 4.0 + xi[0] * xi[1] ** 2 / 5.0


def test_euler_poincare_of_quadratic_lagrangian_is_rigid_body() -> None:
    """With ℓ = ½ ξᵀIξ, the rates are those of the system with frozen joints."""
    for name in ("rigid_body", "coupled_planar", "falling_cat"):
        system = pinred.load(name)
        red, rng = pinred.Reduction(system), np.random.default_rng(2)
        x, xi = rng.normal(size=system.m), rng.normal(size=system.r)
        inertia = red.locked_inertia(x)

        def kinetic_energy(v: Any, inertia: Array = inertia) -> Any:
            return 0.5 * v.T @ inertia @ v

        found = euler_poincare_of_lagrangian(system.group, kinetic_energy, xi)
        expected = euler_poincare(red, x, xi)
        close(found.xidot, expected.xidot, 1e-12)
        close(found.momentum, inertia @ xi, 1e-13)
        assert found.energy == pytest.approx(0.5 * xi @ inertia @ xi, rel=1e-14)


@pytest.mark.parametrize("group", [SE2, SE3])
@pytest.mark.sampled
def test_euler_poincare_of_any_lagrangian_conserves_momentum_in_space(group: Group) -> None:
    """Along a motion of ℓ with fourth powers, J = Ad*_{g⁻¹} ∂ℓ/∂ξ and the energy are constant."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(group.dim, group.dim))
    law = quartic(root @ root.T + 3.0 * np.eye(group.dim))
    xi0, r = 0.4 * rng.normal(size=group.dim), group.dim

    def rate(_: float, y: Array) -> Array:
        motion = euler_poincare_of_lagrangian(group, law, y[:r])
        return np.concatenate([motion.xidot, group.rate(group.normalize(y[r:]), y[:r])])

    start = np.concatenate([xi0, group.identity()])
    end = solve_ivp(rate, (0.0, 0.5), start, rtol=1e-10, atol=1e-11, method="DOP853").y[:, -1]
    first, last = (euler_poincare_of_lagrangian(group, law, y[:r]) for y in (start, end))
    J = group.spatial_momentum(group.normalize(end[r:]), last.momentum)
    close(J, first.momentum, 1e-8)
    assert last.energy == pytest.approx(first.energy, rel=1e-9)
    assert np.abs(last.momentum - first.momentum).max() > 1e-2


@pytest.mark.parametrize("law", [lambda _: 1.0, lambda xi: xi, lambda xi: xi[0]])
def test_lagrangian_that_is_no_regular_scalar_is_refused(law: Any) -> None:
    """Numbers, vectors, and Lagrangians whose momentum does not determine the twist."""
    with pytest.raises(pinred.InputError, match="lagrangian: expected"):
        euler_poincare_of_lagrangian(SE2, law, [0.1, 0.2, 0.3])
