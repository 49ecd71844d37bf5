"""Linearised motions of robots with ball joints, against closed forms and flows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from ball_trees import joined_bodies

import pinred
from pinred.analysis.stability.linearised_flow import linearised_flow
from pinred.forces import BallSpring, Torque
from pinred.reduction.pointwise_reduction import mass_matrix

_STIFFNESS = 2.0  # of the spring [N m/rad]
METHODS = ["DOP853", "Gauss(0.02, 8)"]


@pytest.fixture(scope="module")
def bodies() -> pinred.System:
    """Two bodies, joined by a ball; the plane of x and z is a plane of symmetry."""
    return joined_bodies()


def spring() -> list[Any]:
    """Return a spring at the ball."""
    return [BallSpring("joint", _STIFFNESS, law="cosine")]


@pytest.mark.parametrize("method", METHODS)
def test_eigenvalues_at_rest_equal_those_of_stiffness_and_metric(
    bodies: pinred.System, method: str
) -> None:
    """Frequencies are the square roots of k/M; the angular momentum of the base is zero."""
    traj = pinred.simulate(bodies, forces=spring(), momentum=0, duration=0.1, method=method)
    linear = pinred.linearise(traj)
    H, r = mass_matrix(bodies, bodies.space.neutral), bodies.r
    M = H[r:, r:] - H[r:, :r] @ np.linalg.solve(H[:r, :r], H[:r, r:])
    squares = scipy.linalg.eigh(_STIFFNESS * np.eye(3), M, eigvals_only=True)
    expected = np.sort(np.concatenate([np.sqrt(squares), -np.sqrt(squares)]))
    np.testing.assert_allclose(np.sort(linear.eigenvalues.imag), expected, rtol=1e-12)
    assert np.abs(linear.eigenvalues.real).max() <= 1e-12
    assert linear.matrix.shape == (len(linear.names),) * 2
    assert {"joint.qx", "joint.qw"} <= set(linear.names)


def turn_of_ball(traj: Any, t: float) -> float:
    """Return the angle of a ball about its y axis at time t, from −π to π."""
    x, _, z, w = traj.at(t).x[[0, 0, 1, 3]]
    assert abs(x) <= 1e-9
    return float(2.0 * np.arctan2(z, w))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "springs",
    [0, pytest.param(1, marks=pytest.mark.by_hand)],
    ids=["rotation", "oscillation"],
)
@pytest.mark.sampled
def test_multipliers_of_planar_motion_equal_those_of_flow(
    bodies: pinred.System, method: str, springs: int
) -> None:
    """Zero momentum: the tangent of (x, ẋ) over a period, after which q may have become −q."""
    rate = 0.8 if springs else 3.0
    options: dict[str, Any] = {
        "forces": spring() if springs else [], "momentum": 0, "method": method, "rtol": 1e-12,
        "atol": 1e-13, "x0": {"joint": (0.0, 0.0, 0.0)}, "xdot0": {"joint": (0.0, rate, 0.0)},
    }  # fmt: skip
    traj = pinred.simulate(bodies, **options, duration=4.0, times=np.linspace(0.0, 4.0, 201))
    angles = 2.0 * np.unwrap(np.arctan2(traj.x[:, 1], traj.x[:, 3]), period=np.pi)
    turns = angles if springs else angles - 2.0 * np.pi
    upward = (turns[:-1] < 0.0) & (turns[1:] >= 0.0) & (traj.t[1:] > 0.5)
    k = int(np.flatnonzero(upward)[0])
    T = scipy.optimize.brentq(lambda t: traj.at(t).x[1], traj.t[k], traj.t[k + 1], xtol=1e-14)
    if not springs:
        assert traj.at(T).x[3] < -0.99
    found = pinred.floquet(traj, period=T)
    flow = pinred.flow(
        bodies, **options, duration=T, wrt=["x0", "xdot0"], of=["x", "xdot"]
    )  # fmt: skip
    jacobian = flow.jacobian()
    monodromy = np.hstack([jacobian["x0"], jacobian["xdot0"]])
    assert found.multipliers.shape == (6,)
    expected = np.poly(monodromy)
    np.testing.assert_allclose(
        np.poly(found.multipliers).real, expected, rtol=0.0, atol=1e-7 * np.abs(expected).max()
    )


def test_lyapunov_exponents_with_ball_sum_to_zero(bodies: pinred.System) -> None:
    """The flow on the leaf keeps volume: three pairs of the ball, one of the momentum."""
    traj = pinred.simulate(
        bodies, forces=spring(), x0={"joint": (0.5, 0.2, 0.1)}, xi0=[0, 0, 0, 0.3, 0.8, -0.2],
        duration=2.0, rtol=1e-10,
    )  # fmt: skip
    exponents = pinred.lyapunov(traj).exponents
    assert len(exponents) == 8
    assert abs(exponents.sum()) <= 1e-9 * np.abs(exponents).max()


@pytest.mark.parametrize("power", [1, 2])
def test_sign_of_quaternion_stays_if_a_force_depends_on_it(
    bodies: pinred.System, power: int
) -> None:
    """A torque that is odd in q has different values at q and −q, so the period is not closed."""
    force = Torque(lambda s: {"joint.y": 0.1 * s.x["joint.qw"] ** power})
    traj = pinred.simulate(bodies, forces=[force], momentum=0, duration=0.1, method="DOP853")
    flow = linearised_flow(traj)
    initial, entries = flow.y.copy(), flow.leaf.indices[flow.leaf.quaternions[0]]
    flow.y[entries] *= -1.0
    flow.align(initial)
    assert (flow.y[entries] @ initial[entries] > 0.0) == (power == 2)
