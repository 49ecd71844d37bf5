"""Compiled connections of trees with ball joints, against Pinocchio shape by shape."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree

import pinred
from pinred.common.arrays import Array

NAMES = ("mass_matrix", "locked_inertia", "local_connection", "reduced_metric", "curvature", "com")


def shapes_of(system: pinred.System, count: int, seed: int = 0) -> Array:
    """Return random shapes, (count, nx), with angles of balls up to more than π."""
    rng = np.random.default_rng(seed)
    return np.array([system.space.random(rng, 2.0) for _ in range(count)])


@pytest.mark.parametrize(
    ("seed", "group"), [pytest.param(1, "SE3", marks=pytest.mark.by_hand), (2, "SO3"), (4, "SE2")]
)
@pytest.mark.sampled
def test_grid_with_balls_equals_pinocchio(seed: int, group: str) -> None:
    """Every array of a field over (2, 3) shapes is Pinocchio's, to round-off of its terms."""
    system = ball_tree(seed, 4, group)
    red = pinred.Reduction(system)
    shapes = shapes_of(system, 6).reshape(2, 3, system.nx)
    field = red.grid(shapes)
    for index in np.ndindex(2, 3):
        at = red.at(shapes[index])
        size = float(np.linalg.cond(at.locked_inertia))
        for name in NAMES:
            computed, expected = getattr(field, name)[index], getattr(at, name)
            assert computed.shape == expected.shape
            tolerance = 2e-15 * size * max(1.0, float(np.abs(expected).max()))
            np.testing.assert_allclose(computed, expected, rtol=0.0, atol=tolerance, err_msg=name)
        assert field.potential[index] == at.potential == 0.0
    B = field.curvature
    np.testing.assert_array_equal(B, -np.swapaxes(B, -1, -2))


def test_connection_with_balls_equals_reduction() -> None:
    """A, I, M, B, both terms of B, and ξ = −A σ at one shape, and labels of both sizes."""
    system = ball_tree(3, 2)
    A, red = pinred.Connection.mechanical(system), pinred.Reduction(system)
    (x,), sigma = shapes_of(system, 1), np.random.default_rng(1).normal(size=system.m)
    assert (A.nx, A.m, A.joints) == (system.nx, system.m, system.shape_names)
    np.testing.assert_allclose(A.local(x), red.local_connection(x), atol=1e-13)
    np.testing.assert_allclose(A.locked(x), red.locked_inertia(x), atol=1e-13)
    np.testing.assert_allclose(A.metric(x), red.reduced_metric(x), atol=1e-13)
    np.testing.assert_allclose(A.curvature(x), red.curvature(x), atol=1e-12)
    np.testing.assert_allclose(A.velocity(x, sigma), -red.local_connection(x) @ sigma, atol=1e-13)
    field = A.grid(x[None])
    np.testing.assert_allclose(field.exterior - field.bracket, field.curvature, atol=1e-13)


def test_derivatives_with_balls_are_along_frame() -> None:
    """Slopes of ξ, of σᵀMσ and of I ω equal Pinocchio's derivatives along the frame."""
    system = ball_tree(3, 2)
    A, at = pinred.Connection.mechanical(system), pinred.Reduction(system).at
    (x,), (r, m) = shapes_of(system, 1), (system.r, system.m)
    rng = np.random.default_rng(1)
    sigma, omega = rng.normal(size=m), rng.normal(size=r)
    slopes, terms = A.horizontal_slopes(x[None], sigma[None])[0], at(x)
    np.testing.assert_allclose(slopes[:r, m:], -terms.local_connection, atol=1e-12)
    np.testing.assert_allclose(slopes[r, m:], 2.0 * terms.reduced_metric @ sigma, atol=1e-12)
    expected = -np.einsum("iba,b->ia", terms.dA, sigma)
    np.testing.assert_allclose(slopes[:r, :m], expected, atol=1e-11)
    locked = A.code.locked_derivatives(x[None], omega[None])[0]
    np.testing.assert_allclose(locked, np.einsum("ija,j->ia", terms.dI, omega), atol=1e-11)


def test_covariant_forces_with_balls_are_torques_at_zero_momentum() -> None:
    """The torques of a prescribed motion σ, σ̇ at zero momentum, from Pinocchio's RNEA."""
    system = ball_tree(3, 2)
    A, red = pinred.Connection.mechanical(system), pinred.Reduction(system)
    (x,), (r, m) = shapes_of(system, 1), (system.r, system.m)
    sigma, sigmadot = np.random.default_rng(2).normal(size=(2, m))
    at = red.at(x)
    xi = -at.local_connection @ sigma
    xidot = -at.local_connection @ sigmadot - np.einsum("iba,a,b->i", at.dA, sigma, sigma)
    model, data = system.sorted_model, system.sorted_model.createData()
    q = system.sorted_q(system.group.identity(), x)
    velocity, acceleration = np.concatenate([xi, sigma]), np.concatenate([xidot, sigmadot])
    tau = pin.rnea(model, data, q, system.joint_rates(velocity), system.joint_rates(acceleration))
    found, _ = A.code.covariant_forces(x[None], sigma[None], sigmadot[None], np.zeros((1, m)))
    np.testing.assert_allclose(tau[:r], 0.0, atol=1e-11)
    np.testing.assert_allclose(found[0], tau[r:], atol=1e-11)


def test_shapes_of_balls_must_have_length_one() -> None:
    """A quaternion of length 2 is refused by name; one of few decimals is normalised."""
    system = ball_tree(0, 1)
    A, red = pinred.Connection.mechanical(system), pinred.Reduction(system)
    for call in (A.local, A.grid, red.grid):
        with pytest.raises(pinred.InputError, match=r"quaternion of ball joint 'j0'.*length"):
            call([0.0, 0.0, 0.0, 2.0])
    rough = np.array([0.1826, 0.3651, 0.5477, 0.7303])
    exact = rough / np.linalg.norm(rough)
    np.testing.assert_array_equal(A.local(rough), A.local(exact))
    np.testing.assert_array_equal(A.grid(rough).local, A.local(exact))
    np.testing.assert_array_equal(red.grid(rough).com, red.grid(exact).com)
