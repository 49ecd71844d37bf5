"""The snakeboard against Lagrange and d'Alembert in world coordinates, with multipliers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from assertions import close
from lifts import random_gait
from scipy.integrate import solve_ivp

import pinred
from pinred.analysis.connections import mixed_connection
from pinred.common.arrays import Array
from pinred.kernels.kernel import evaluate

HALF = 0.5  # distance between board centre and axles [m]
MASS, BOARD, ROTOR, AXLE = 8.0, 0.92, 0.1, 0.01
# World coordinates (X, Y, θ), then the joints in the robot's order: front, rear, rotor.
INERTIA = np.diag([MASS, MASS, BOARD, AXLE, AXLE, ROTOR])
INERTIA[2, 3:] = INERTIA[3:, 2] = [AXLE, AXLE, ROTOR]
TIMES = np.linspace(0.0, 2.0, 5)
X0, RATE0, P0 = np.array([0.4, -0.3, 0.1]), np.array([0.2, 0.3, 1.0]), np.array([0.7])


def board() -> pinred.MixedConnection:
    """The snakeboard on its wheels."""
    wheels = [pinred.Wheel("rear_axle"), pinred.Wheel("front_axle")]
    return pinred.mixed_connection(pinred.load("snakeboard"), wheels)


def rows(q: Array, v: Array) -> tuple[Array, Array]:
    """W, and Ẇ v: neither axle slips sideways."""
    W, drift = np.zeros((2, 6)), np.zeros(2)
    for k, (joint, side) in enumerate(((4, -1.0), (3, 1.0))):
        heading, rate = q[2] + q[joint], v[2] + v[joint]
        W[k, :3] = [-np.sin(heading), np.cos(heading), side * HALF * np.cos(q[joint])]
        displacement = [-np.cos(heading) * rate, -np.sin(heading) * rate]
        displacement.append(-side * HALF * np.sin(q[joint]) * v[joint])
        drift[k] = np.dot(displacement, v[:3])
    return W, drift


def dalembert(
    xi0: Array, torque: Callable[[float], Array], prescribed: pinred.Gait | None = None
) -> Array:
    """Q and v at TIMES, (T, 12): H v̇ = τ + Wᵀλ, W v̇ = −Ẇ v."""

    def rate(t: float, y: Array) -> Array:
        q, v = y[:6], y[6:]
        W, drift = rows(q, v)
        if prescribed is not None:
            h = 1e-4  # step of the second differences
            ahead = [prescribed.at(t + k * h)[1] for k in (-3, -2, -1, 1, 2, 3)]
            weights = np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / (60.0 * h)
            W = np.vstack([W, np.eye(6)[3:]])
            drift = np.concatenate([drift, -(weights @ np.array(ahead))])
        k = len(W)
        whole = np.block([[INERTIA, -W.T], [W, np.zeros((k, k))]])
        right = np.concatenate([np.zeros(3), torque(t), -drift])
        return np.concatenate([v, np.linalg.solve(whole, right)[:6]])

    x, xdot = (X0, RATE0) if prescribed is None else prescribed.at(0.0)
    start = np.concatenate([np.zeros(3), x, xi0, xdot])
    solution = solve_ivp(rate, (0.0, TIMES[-1]), start, "DOP853", TIMES, rtol=1e-13, atol=1e-14)
    return np.asarray(solution.y.T)


def test_mixed_motion_without_torques_conserves_energy() -> None:
    """To 1e-11, with the energy conserved."""
    A = board()
    motion = pinred.simulate_mixed(A, X0, RATE0, P0, times=TIMES)
    expected = dalembert(A.velocity(X0, RATE0, P0), lambda _: np.zeros(3))
    close(motion.pose, expected[:, :3], 1e-11)
    close(motion.x, expected[:, 3:6], 1e-11)
    close(motion.xdot, expected[:, 9:], 1e-11)
    assert np.ptp(motion.energy) < 1e-11 * motion.energy[0]
    v = expected[-1, 6:]
    assert motion.energy[-1] == pytest.approx(0.5 * v @ INERTIA @ v, rel=1e-11)
    assert np.ptp(motion.p) > 1e-3  # p is not conserved


def test_mixed_motion_with_torques_gains_their_work() -> None:
    """To 1e-8: the energy gained is the work of the torques."""

    def torque(t: float) -> Array:
        return np.array([0.02 * np.cos(3.0 * t), -0.01 * np.sin(2.0 * t), 0.3 * np.sin(4.0 * t)])

    A = board()
    motion = pinred.simulate_mixed(A, X0, RATE0, P0, times=TIMES, torques=torque)
    expected = dalembert(A.velocity(X0, RATE0, P0), torque)
    close(motion.pose, expected[:, :3], 1e-8)
    close(motion.x, expected[:, 3:6], 1e-8)
    assert np.ptp(motion.energy) > 1e-2


def test_mixed_motion_along_gait_builds_up_momentum() -> None:
    """Prescribed joints, from rest: the snakeboard starts to move."""
    gait = pinred.Gait.fourier([0.0, 0.0, 0.0], [[0.5, -0.5, 0.0]], [[0.0, 0.0, 0.9]], period=2.0)
    A = board()
    motion = pinred.follow_mixed(A, gait, times=TIMES)
    x, xdot = gait.at(0.0)
    expected = dalembert(A.velocity(x, xdot, [0.0]), lambda _: np.zeros(3), gait)
    close(motion.pose, expected[:, :3], 1e-10)
    assert np.abs(motion.p).max() > 1e-3


def test_mixed_momentum_of_twist() -> None:
    """The momentum of an admissible twist gives that twist back; a twist that slips raises."""
    A = board()
    xi = A.velocity(X0, RATE0, P0)
    close(A.momentum(X0, RATE0, xi), P0, 1e-12)
    with pytest.raises(pinred.InputError, match="the wheels slip"):
        A.momentum(X0, RATE0, np.add(xi, [0.0, 0.1, 0.0]))


def test_chaplygin_sleigh_equals_dalembert() -> None:
    """One wheel and two momenta, against d'Alembert's principle with one constraint."""
    system = pinred.load("snakeboard", lock={"front": 0.0, "rear": 0.0})
    A = pinred.mixed_connection(system, [pinred.Wheel("rear_axle")])
    assert A.size == 2
    x0, rate0, p0 = np.array([0.2]), np.array([0.8]), np.array([0.9, -0.4])
    motion = pinred.simulate_mixed(A, x0, rate0, p0, times=TIMES)
    H = np.diag([MASS, MASS, BOARD, ROTOR])
    H[2, 3] = H[3, 2] = ROTOR

    def rate(_: float, y: Array) -> Array:
        q, v = y[:4], y[4:]
        c, s = np.cos(q[2]), np.sin(q[2])
        W = np.array([[-s, c, -HALF, 0.0]])
        drift = (-c * v[0] - s * v[1]) * v[2]
        whole = np.block([[H, -W.T], [W, np.zeros((1, 1))]])
        return np.concatenate([v, np.linalg.solve(whole, np.append(np.zeros(4), -drift))[:4]])

    start = np.concatenate([np.zeros(3), x0, A.velocity(x0, rate0, p0), rate0])
    solution = solve_ivp(rate, (0.0, 2.0), start, "DOP853", TIMES, rtol=1e-13, atol=1e-14)
    close(motion.pose, solution.y.T[:, :3], 1e-11)
    close(motion.x[:, 0], solution.y[3], 1e-11)
    assert np.ptp(motion.energy) < 1e-11


def test_invalid_mixed_connections_raise() -> None:
    """Too many wheels, and wheels that become dependent during the motion."""
    system = pinred.load("snakeboard")
    with pytest.raises(pinred.InputError, match="takes 1 to 2 wheels, got 0"):
        pinred.mixed_connection(system, [])
    A = board()
    quarter = 0.5 * np.pi
    with pytest.raises(
        pinred.SingularInertiaError, match="do not determine the motion of the body"
    ):
        pinred.simulate_mixed(A, [quarter, quarter, 0.0], RATE0, P0, times=TIMES)
    near = [quarter - 0.3, quarter - 0.3, 0.0]
    with pytest.raises(pinred.SingularInertiaError, match="the joints pass the shape"):
        pinred.simulate_mixed(A, near, [0.5, 0.5, 0.0], [0.0], times=TIMES)
    across = pinred.Gait.fourier(
        [quarter, quarter, 0.0], [[0.3, 0.3, 0.0]], [[0.0, 0.0, 0.5]], period=2.0
    )
    with pytest.raises(pinred.SingularInertiaError, match="the joints pass the shape"):
        pinred.follow_mixed(A, across, times=TIMES)
    with pytest.raises(pinred.InputError, match="times"):
        pinred.follow_mixed(A, random_gait(np.random.default_rng(0), 3), times=[1.0, 0.0])


# For each comparison: its tolerance, and the largest magnitude of the summed terms relative to the
# largest value, at most three times that of the snakeboard.
LIMITS = {
    "the twist": (1e-10, 9.0),
    "the rate of p": (1e-7, 8e4),
    "the acceleration": (1e-7, 1.6e4),
    "the energy": (1e-10, 6.5),
}


def test_bounds_of_mixed_equations_are_relative_to_values(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tolerances are those documented, and terms are of the size of values."""
    seen = []

    def record(
        _: str, what: str, found: Array, expected: Array, terms: Array, tolerance: float
    ) -> None:
        most, limit = LIMITS[what]
        size = np.abs(expected).max()
        assert tolerance <= most
        assert np.max(terms) <= limit * size, what
        assert np.abs(found - expected).max() <= 1e-3 * tolerance * size
        seen.append(what)

    monkeypatch.setattr(mixed_connection, "require_agreement", record)
    A = board()
    _ = A.equations, A.driven
    assert seen == [*LIMITS] * 2 + [*LIMITS][:2] * 2


@pytest.mark.parametrize(
    ("first", "last", "fault", "what"),
    [
        (1, 4, 3e-10, "the twist"),
        (4, 5, 3e-7, "the rate of p"),
        (5, 8, 3e-7, "the acceleration"),
        (8, 9, 3e-10, "the energy"),
    ],
)
@pytest.mark.sampled
def test_faults_of_mixed_equations_are_found(
    first: int, last: int, fault: float, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An output with an error of three times the tolerance is refused."""

    def faulty(*arguments: Any) -> Array:
        values = evaluate(*arguments)
        values[:, first:last] *= 1.0 + fault
        return values

    monkeypatch.setattr(mixed_connection, "evaluate", faulty)
    A = board()
    for name in ("equations", "driven")[: 2 if last < 6 else 1]:
        with pytest.raises(pinred.KernelMismatch, match=f"disagrees with Pinocchio: {what} is"):
            getattr(A, name)
