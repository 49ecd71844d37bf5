"""The reduced equations of trees with balls, against Pinocchio's forward dynamics."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from backward_error import backward_error, kinetic_size, largest
from ball_trees import ball_tree, joined_bodies

import pinred
from pinred.common.arrays import Array
from pinred.equations import hamilton_poincare, lagrange_poincare
from pinred.system.system import System

GROUPS = ("SE3", "SO3", "SE2")


def accelerations(system: System, q: Array, v: Array, tau: Array) -> Array:
    """Return Pinocchio's accelerations, (n,)."""
    return np.asarray(pin.aba(system.sorted_model, system.sorted_model.createData(), q, v, tau))


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.sampled(3)
def test_lagrange_poincare_of_balls_has_accelerations_of_aba(group: str, seed: int) -> None:
    """With torques, springs and a base wrench, to 1e-13 of the terms."""
    system, rng = ball_tree(seed, 5, group), np.random.default_rng(seed)
    space, r, m = system.space, system.r, system.m
    x, v = space.random(rng, 2.0), rng.normal(size=system.n)
    torque, wrench = rng.normal(size=m), rng.normal(size=r)
    hinges = zip(space.scalar_v.tolist(), space.scalar_x.tolist(), strict=True)
    springs = {system.shape_names[k]: (1.5, 0.4) for k in space.scalar_v}
    tau = np.concatenate([wrench, torque])
    for k, i in hinges:
        tau[r + k] -= 1.5 * (x[i] - 0.4)
    red = pinred.Reduction(system, springs=springs)
    terms = lagrange_poincare(
        red, x, v[r:], red.locked_velocity(x, v[r:], v[:r]), torque=torque, wrench=wrench
    )
    q = system.sorted_q(system.group.exp(rng.normal(size=r)), x)
    found, expected = np.concatenate([terms.xidot, terms.xddot]), accelerations(system, q, v, tau)
    H = red.mass_matrix(x)
    sizes = (terms.shape, terms.momentum, kinetic_size(H, v))
    assert backward_error(H, found, expected, *sizes) <= 1e-13
    assert largest(terms.shape.frame) > 1e-3  # the term is tested


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("seed", range(4))
def test_hamilton_poincare_of_balls_has_rates_of_aba(group: str, seed: int) -> None:
    """The rates follow from ABA's accelerations, p = M σ and μ = I (ξ + A σ), Ḣ = C + Cᵀ."""
    system, rng = ball_tree(seed, 5, group), np.random.default_rng(seed)
    r, x, v = system.r, system.space.random(rng, 2.0), rng.normal(size=system.n)
    torque, wrench = rng.normal(size=system.m), rng.normal(size=r)
    red = pinred.Reduction(system)
    at, mu = red.at(x), red.body_momentum(x, v[r:], v[:r])
    p = at.reduced_metric @ v[r:]
    terms = hamilton_poincare(red, x, p, mu, torque=torque, wrench=wrench)
    q = system.sorted_q(system.group.identity(), x)
    a = accelerations(system, q, v, np.concatenate([wrench, torque]))
    size = kinetic_size(at.mass_matrix, v)
    bent = at.dM @ v[r:] @ v[r:]
    assert backward_error(at.reduced_metric, terms.xdot, v[r:], p) <= 1e-13
    expected = at.reduced_metric @ a[r:] + bent
    assert largest(terms.shape.total - expected) <= 1e-13 * largest(terms.shape, bent, size)
    C = np.array(
        pin.computeCoriolisMatrix(system.sorted_model, system.sorted_model.createData(), q, v)
    )
    expected = (at.mass_matrix @ a + (C + C.T) @ v)[:r]
    assert largest(terms.momentum.total - expected) <= 1e-13 * largest(terms.momentum, size)
    np.testing.assert_allclose(terms.energy, 0.5 * v @ at.mass_matrix @ v, rtol=1e-13)


def test_weight_on_pivoted_tree_with_balls_gives_accelerations_of_aba() -> None:
    """Gravity that rotates a pivoted base enters by F·e_αc − ⟨c × F, A_α⟩."""
    model = ball_tree(5, 4, "SO3").model.copy()
    model.gravity.linear = np.array([1.0, -2.0, -9.0])
    system, rng = System(model), np.random.default_rng(3)
    x, v = system.space.random(rng, 2.0), rng.normal(size=system.n)
    pose, red = system.group.exp(rng.normal(size=3)), pinred.Reduction(system)
    terms = lagrange_poincare(red, x, v[3:], red.locked_velocity(x, v[3:], v[:3]), pose=pose)
    found = np.concatenate([terms.xidot, terms.xddot])
    expected = accelerations(system, system.sorted_q(pose, x), v, np.zeros(system.n))
    H = red.mass_matrix(x)
    sizes = (terms.shape, terms.momentum, kinetic_size(H, v))
    assert backward_error(H, found, expected, *sizes) <= 1e-13


def test_frame_term_of_ball_is_cross_product() -> None:
    """The term is p × σ for one ball, and zero without balls."""
    system, rng = joined_bodies(), np.random.default_rng(0)
    x, v = system.space.random(rng, 2.0), rng.normal(size=9)
    red = pinred.Reduction(system)
    terms = lagrange_poincare(red, x, v[6:], v[:6])
    expected = np.cross(red.reduced_metric(x) @ v[6:], v[6:])
    np.testing.assert_allclose(terms.shape.frame, expected, rtol=1e-13, atol=1e-15)
