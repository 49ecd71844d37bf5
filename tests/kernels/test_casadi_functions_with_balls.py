"""CasADi Functions of robots with balls, against Pinocchio."""

from __future__ import annotations

import numpy as np
import pytest
from ball_trees import ball_tree

import pinred
from pinred.reduction.canonical_form import CanonicalForm
from pinred.reduction.potential import Potential


@pytest.mark.parametrize("group", ["SE3", "SO3", "SE2"])
@pytest.mark.sampled
def test_casadi_functions_with_balls_equal_pinocchio(group: str) -> None:
    """H, I, A, M and B are functions of quaternions, with derivatives along the frame."""
    system = ball_tree(3, 4, group)
    functions, x = pinred.casadi_functions(system), system.space.random(np.random.default_rng(1), 2)
    assert functions.curvature.size_in(0) == (system.nx, 1)
    at = pinred.Reduction(system).at(x)
    for name in ("mass_matrix", "locked_inertia", "local_connection", "reduced_metric"):
        found, expected = np.array(getattr(functions, name)(x)), getattr(at, name)
        np.testing.assert_allclose(found, expected, atol=1e-13 * np.abs(expected).max())
    B = np.array(functions.curvature(x)).reshape(system.r, system.m, system.m)
    np.testing.assert_allclose(B, at.curvature, atol=1e-13 * np.abs(at.dA).max())


def test_vector_field_with_balls_has_documented_layout() -> None:
    """Hinges and slides, their momenta, momenta of balls, quaternions of balls, the base."""
    system, rng = ball_tree(3, 4, "SO3"), np.random.default_rng(2)
    functions, space = pinred.casadi_functions(system), system.space
    x, pi, mu = space.random(rng, 2.0), rng.normal(size=system.m), rng.normal(size=3)
    layout, scalar, count = functions.layout, space.scalar_v, len(space.balls)
    identity = np.array([0.0, 0.0, 0.0, 1.0])
    y = [x[space.scalar_x], pi[scalar], pi[space.ball_v], x[space.ball_x], identity]
    assert layout.balls_at == 2 * len(scalar)
    assert layout.quaternions == (layout.balls_at + 3 * count, count + 1)
    rates = np.array(functions.vector_field(np.concatenate(y), mu))[:, 0]
    form = CanonicalForm(system, Potential(system))
    v = form.velocity(x, np.concatenate([mu, pi]))
    force, xdot = form.force(x, v), space.rate_map(x) @ v[3:]
    base = np.append(0.5 * v[:3], 0.0)  # ½ q ∘ (ω, 0) at the identity
    expected = [xdot[space.scalar_x], force[scalar], force[space.ball_v], xdot[space.ball_x], base]
    np.testing.assert_allclose(rates, np.concatenate(expected), atol=1e-13 * np.abs(rates).max())
    jacobian = np.array(functions.vector_field_jacobian(np.concatenate(y), mu))
    direction, h = rng.normal(size=layout.size), 1e-3
    along = sum(
        w / h * np.array(functions.vector_field(np.concatenate(y) + k * h * direction, mu))[:, 0]
        for k, w in ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12))
    )
    np.testing.assert_allclose(jacobian @ direction, along, atol=1e-8 * np.abs(along).max())
