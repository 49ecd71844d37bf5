"""Changes of section of trees with balls, with Θ = h⁻¹ ∂h along the frame of the shape."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from backward_error import backward_error, kinetic_size
from ball_trees import ball_tree, joined_bodies

import pinred
from pinred import InputError
from pinred.common.arrays import Array
from pinred.equations import lagrange_poincare
from pinred.lie.rotations import hat
from pinred.reduction.pointwise_reduction import Section
from pinred.system.system import System


def wavy(system: System, seed: int) -> Section:
    """Return h = exp(ζ₁ φ₁) exp(ζ₂ φ₂) with Θ and ∂Θ in closed form.

    φ is a function of the rotation matrix R of the first ball, φ = tr(W R), and of the other
    hinges and slides, sin(w·x).  Along axis α of the ball, e_αR = R ê_α.
    """
    G, space, rng = system.group, system.space, np.random.default_rng(seed)
    zetas = rng.normal(size=(2, G.dim))
    W, w = rng.normal(size=(2, 3, 3)), rng.normal(size=(2, len(space.scalar_x)))
    ball, axes = space.balls[0], hat(np.eye(3))

    def h(x: Array) -> tuple[Array, Array, Array]:
        R, phase = pin.Quaternion(x[ball.x]).toRotationMatrix(), w @ x[space.scalar_x]
        phi = np.einsum("kij,ji->k", W, R) + np.sin(phase)
        slope, second = np.zeros((2, system.m)), np.zeros((2, system.m, system.m))
        slope[:, ball.v] = np.einsum("kij,jl,ali->ka", W, R, axes)
        slope[:, space.scalar_v] = np.cos(phase)[:, None] * w
        # second[k, a, c] = e_c e_a φ_k, and e_c R = R ê_c is applied to the inner R.
        second[:, ball.v, ball.v] = np.einsum("kij,jl,clm,ami->kac", W, R, axes, axes)
        at = np.ix_(np.arange(2), space.scalar_v, space.scalar_v)
        second[at] = -np.sin(phase)[:, None, None] * w[:, :, None] * w[:, None, :]
        outer, inner = (G.exp(zeta * f) for zeta, f in zip(zetas, phi, strict=True))
        turned = G.Ad(G.inverse(inner)) @ zetas[0]
        theta = np.outer(turned, slope[0]) + np.outer(zetas[1], slope[1])
        moving = -np.einsum("i,a,c->iac", G.bracket(zetas[1], turned), slope[0], slope[1])
        moving += np.einsum("i,ac->iac", turned, second[0])
        return G.compose(outer, inner), theta, moving + np.einsum("i,ac->iac", zetas[1], second[1])

    return h


@pytest.mark.parametrize("group", ["SE3", "SO3", "SE2"])
@pytest.mark.sampled
def test_change_section_with_balls_equals_transformed_mass_matrix(group: str) -> None:
    """A′, I′, M′ from Pinocchio's H, and B′ from differences of A′ along the frame."""
    system, rng = ball_tree(2, 4, group), np.random.default_rng(0)
    G, r, m, space = system.group, system.r, system.m, system.space
    red, h, x = pinred.Reduction(system), wavy(system, 1), space.random(rng, 1.5)
    moved = red.change_section(h)
    pose, theta, _ = h(x)
    T = np.eye(system.n)
    T[:r, :r], T[:r, r:] = G.Ad(pose), -G.Ad(pose) @ theta
    H = T.T @ red.mass_matrix(x) @ T
    A = np.asarray(np.linalg.solve(H[:r, :r], H[:r, r:]), dtype=float)
    at, size = moved.at(x), np.abs(H).max()
    np.testing.assert_allclose(at.mass_matrix, H, atol=1e-13 * size)
    np.testing.assert_allclose(at.local_connection, A, atol=1e-12 * np.abs(A).max())
    np.testing.assert_allclose(at.reduced_metric, red.reduced_metric(x), atol=1e-13 * size)
    step, dA, dI, dcom = 1e-3, np.zeros((r, m, m)), np.zeros((r, r, m)), np.zeros((3, m))
    for k, unit in enumerate(np.eye(m)):
        for n, weight in ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60)):
            ahead, behind = (moved.split(space.integrate(x, s * n * step * unit)) for s in (1, -1))
            dA[:, :, k] += weight / step * (ahead.local_connection - behind.local_connection)
            dI[:, :, k] += weight / step * (ahead.locked_inertia - behind.locked_inertia)
            dcom[:, k] += weight / step * (ahead.com - behind.com)
    np.testing.assert_allclose(at.dA, dA, atol=1e-9 * np.abs(dA).max())
    np.testing.assert_allclose(at.dI, dI, atol=1e-9 * np.abs(dI).max())
    np.testing.assert_allclose(moved.com_slope(x), dcom, atol=1e-9 * max(1.0, np.abs(dcom).max()))
    B = np.swapaxes(dA, 1, 2) - dA - np.einsum("aij,jb->iab", G.ad(A.T), A)
    B -= np.einsum("ig,gab->iab", A, space.structure)
    np.testing.assert_allclose(at.curvature, B, atol=1e-9 * np.abs(dA).max())
    np.testing.assert_allclose(moved.curvature(x), at.curvature, atol=1e-13 * np.abs(dA).max())


@pytest.mark.parametrize("group", ["SE3", "SO3", "SE2"])
@pytest.mark.sampled
def test_lagrange_poincare_with_balls_is_independent_of_section(group: str) -> None:
    """ABA's shape accelerations in another section."""
    system, rng = ball_tree(6, 4, group), np.random.default_rng(4)
    r, x, v = system.r, system.space.random(rng, 1.5), rng.normal(size=system.n)
    red = pinred.Reduction(system)
    h = wavy(system, 2)
    moved = red.change_section(h)
    q = system.sorted_q(system.group.identity(), x)
    a = np.array(
        pin.aba(system.sorted_model, system.sorted_model.createData(), q, v, np.zeros(system.n))
    )
    pose, theta, _ = h(x)
    xi = system.group.Ad(system.group.inverse(pose)) @ v[:r] + theta @ v[r:]
    at = moved.at(x)
    terms = lagrange_poincare(moved, x, v[r:], at.locked_velocity(v[r:], xi))
    size = kinetic_size(at.mass_matrix, np.concatenate([xi, v[r:]]))
    assert backward_error(at.reduced_metric, terms.xddot, a[r:], terms.shape, size) <= 1e-12


def relative_attitude(x: Array) -> tuple[Array, Array]:
    """Return h = (0, q), the frame that rotates with the ball, with Θ = (0; 1)."""
    theta = np.vstack([np.zeros((3, 3)), np.eye(3)])
    return np.concatenate([np.zeros(3), x]), theta


def test_frame_on_second_body_has_its_connection() -> None:
    """A base frame with the attitude of the second body: Θ is constant, and B′ = Ad_{h⁻¹} B."""
    system = joined_bodies()
    red, x = pinred.Reduction(system), system.space.random(np.random.default_rng(0), 2.0)
    moved, R = red.change_section(relative_attitude), pin.Quaternion(x).toRotationMatrix()
    A = red.local_connection(x)
    expected = np.vstack([R.T @ A[:3], R.T @ A[3:] - np.eye(3)])
    np.testing.assert_allclose(moved.local_connection(x), expected, atol=1e-15)


def test_wrong_derivative_along_ball_is_refused() -> None:
    """The message names the axis of the ball."""

    def spatial(x: Array) -> tuple[Array, Array]:
        h, theta = relative_attitude(x)
        theta[3:] = pin.Quaternion(x).toRotationMatrix()  # the twists in the parent's frame
        return h, theta

    with pytest.raises(InputError, match=r"Θ = h⁻¹ ∂h .*'joint.x'"):
        pinred.Reduction(joined_bodies()).change_section(spatial)


def test_section_that_depends_on_sign_of_quaternion_is_refused() -> None:
    """A translation by the quaternion's real part is not a function of the attitude."""
    system = joined_bodies()

    def h(x: Array) -> tuple[Array, Array]:
        theta = np.zeros((6, 3))
        theta[0] = system.space.rate_map(x)[3]
        return np.array([x[3], 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), theta

    with pytest.raises(InputError, match="sign of the quaternion of ball joint 'joint'"):
        pinred.Reduction(system).change_section(h)
