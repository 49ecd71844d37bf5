"""Forces at ball joints: springs by four laws, PD control and limits, against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree, joined_bodies
from scipy.special import ellipk

import pinred
from pinred import InputError
from pinred.common.arrays import Array
from pinred.forces import PD, BallLimit, BallPD, BallSpring, Damper, Force, PotentialEnergy
from pinred.forces.force_model import ForceModel
from pinred.forces.force_numbers import ForceInputs
from pinred.lie.rotations import quaternion_exp, rotation
from pinred.signals import Attitude
from pinred.system.system import System

K = np.array([[3.0, 0.4, -0.2], [0.4, 2.0, 0.3], [-0.2, 0.3, 1.5]])
REST = np.array([0.3, -0.4, 0.2])


def torque_of(force: Force, x: Array, xdot: Array | None = None) -> Array:
    """Return the torques (3,) of a force on two bodies joined by the ball "joint"."""
    system = joined_bodies()
    model = ForceModel(system, [force], {})
    zero = np.zeros(6)
    rates = np.zeros(3) if xdot is None else xdot
    return model.acting(ForceInputs(0.0, x, rates, zero, zero, model.numbers)).torque


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.sampled(3)
def test_springs_exert_the_moments_of_their_laws(seed: int) -> None:
    """Closed forms in the axes of the child, at a random attitude relative to rest."""
    rng = np.random.default_rng(seed)
    R0 = rotation(quaternion_exp(REST))
    r = rng.normal(size=3)
    r *= rng.uniform(0.1, 3.0) / np.linalg.norm(r)
    theta, R = float(np.linalg.norm(r)), pin.exp3(r)
    q = pin.Quaternion(R0 @ R).coeffs() * rng.choice([-1.0, 1.0])
    GR = K @ R
    vee = np.array([GR[2, 1] - GR[1, 2], GR[0, 2] - GR[2, 0], GR[1, 0] - GR[0, 1]])
    cases: list[tuple[BallSpring, Array]] = [
        (BallSpring("joint", 2.0, REST), -2.0 * r),
        (BallSpring("joint", 2.0, REST, polynomial=(0.3, 0.1)),
         -(2.0 + 0.3 * theta + 0.1 * theta**2) * r),
        (BallSpring("joint", 2.0, REST, law="cosine"), -2.0 * np.sin(theta) * r / theta),
        (BallSpring("joint", 2.0, REST, law="vector"), -2.0 * r),
        (BallSpring("joint", K, REST, law="vector"), -np.linalg.inv(pin.Jexp3(r)).T @ K @ r),
        (BallSpring("joint", K, REST, law="trace"), -vee),
    ]  # fmt: skip
    for spring, expected in cases:
        found = torque_of(spring, q)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=2e-13, err_msg=str(spring.law))


@pytest.mark.parametrize("law", BallSpring.LAWS)
def test_springs_at_rest_exert_nothing(law: str) -> None:
    """The torque and its neighbourhood are finite where the angle is zero."""
    spring = BallSpring("joint", 2.0, law=law)
    np.testing.assert_array_equal(torque_of(spring, np.array([0.0, 0.0, 0.0, 1.0])), np.zeros(3))
    tiny = torque_of(spring, quaternion_exp(np.array([1e-9, 0.0, 0.0])))
    factor = 4.0 if law == "trace" else 2.0
    np.testing.assert_allclose(tiny, [-factor * 1e-9, 0.0, 0.0], rtol=1e-9, atol=1e-25)


def test_pd_turns_ball_towards_attitude_and_damps_it() -> None:
    """τ = −kp log(R_dᵀ R) − kd σ."""
    w, sigma = np.array([0.2, 0.5, -0.3]), np.array([1.0, -2.0, 0.5])
    Rd = pin.exp3(REST)
    found = torque_of(BallPD("joint", REST, 3.0, 0.7), quaternion_exp(w), sigma)
    expected = -3.0 * pin.log3(Rd.T @ pin.exp3(w)) - 0.7 * sigma
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_pd_follows_moving_attitude_and_its_rate() -> None:
    """τ = −kp log(E) − kd (σ − Eᵀ σ_d) with E = R_dᵀ R; σ_d from Pinocchio's right Jacobian."""
    t, w, sigma = 0.7, np.array([0.2, 0.5, -0.3]), np.array([1.0, -2.0, 0.5])
    target = Attitude(["2*t", "0.3", "-t*t"], REST)
    system = joined_bodies()
    model = ForceModel(system, [BallPD("joint", target, 3.0, 0.7)], {})
    zero = np.zeros(6)
    at = ForceInputs(t, quaternion_exp(w), sigma, zero, zero, model.numbers)
    v, vdot = np.array([2.0 * t, 0.3, -t * t]), np.array([2.0, 0.0, -2.0 * t])
    E = (pin.exp3(REST) @ pin.exp3(v)).T @ pin.exp3(w)
    expected = -3.0 * pin.log3(E) - 0.7 * (sigma - E.T @ pin.Jexp3(v) @ vdot)
    np.testing.assert_allclose(model.acting(at).torque, expected, atol=1e-14)


# test_ball_tracking.py has PD along a plan.
@pytest.mark.by_hand
def test_pd_keeps_ball_on_moving_attitude() -> None:
    """A ball that starts on the target stays near it; compare agrees."""
    target = Attitude(["0.5*sin(2*t)", "0.2*t", 0.0], REST)
    traj = pinred.simulate(
        joined_bodies(), x0={"joint": target.value(0.0)}, xdot0={"joint": target.rate(0.0)},
        times=[0.0, 0.3], forces=BallPD("joint", target, 200.0, 20.0),
    )  # fmt: skip
    assert pinred.compare(traj).passed
    reached, wanted = rotation(traj.x[-1]), rotation(target.value(0.3))
    assert np.linalg.norm(pin.log3(wanted.T @ reached)) < 0.02


def test_limit_pushes_back_only_beyond_swing_and_twist() -> None:
    """Inside both limits the torque is negligible; beyond one, it turns the ball back."""
    limit = BallLimit("joint", swing=0.8, twist=0.5, stiffness=10.0, width=0.01)
    inside = torque_of(limit, quaternion_exp(np.array([0.5, 0.2, 0.0])))
    assert np.abs(inside).max() < 1e-6
    swung = torque_of(limit, quaternion_exp(np.array([1.2, 0.0, 0.0])))
    np.testing.assert_allclose(swung, [-10.0 * np.sin(1.2), 0.0, 0.0], atol=1e-8)
    twisted = torque_of(limit, quaternion_exp(np.array([0.0, 0.0, -1.0])))
    np.testing.assert_allclose(twisted, [0.0, 0.0, 10.0 * np.sin(1.0)], atol=1e-8)
    # The slope of w log(1 + exp(y/w)) at y = 0 is one half.
    at_limit = torque_of(limit, quaternion_exp(np.array([0.8, 0.0, 0.0])))
    np.testing.assert_allclose(at_limit, [-5.0 * np.sin(0.8), 0.0, 0.0], atol=1e-8)


def test_period_of_cosine_spring_equals_elliptic_integral() -> None:
    """A rotation about a fixed axis under V = k (1 − cos θ) is a pendulum: T = 4 √(J/k) K(m)."""
    moments = np.array([[0.4, 0.4, 0.4], [0.2, 0.2, 0.2]])
    system, k, amplitude = joined_bodies(moments, np.zeros((2, 3))), 2.0, 2.5
    J = 0.4 * 0.2 / 0.6  # reduced moment of inertia of the two bodies
    period = 4.0 * np.sqrt(J / k) * float(ellipk(np.sin(0.5 * amplitude) ** 2))
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    traj = pinred.simulate(
        system, x0={"joint": amplitude * axis}, times=[0.5 * period, period],
        forces=BallSpring("joint", k, law="cosine"), rtol=1e-13, atol=1e-14,
    )  # fmt: skip
    half, full = traj.x
    np.testing.assert_allclose(half, quaternion_exp(-amplitude * axis), atol=1e-12)
    np.testing.assert_allclose(full, quaternion_exp(amplitude * axis), atol=1e-12)


def test_angle_spring_about_fixed_axis_is_harmonic() -> None:
    """V = ½ k θ² gives θ(t) = θ₀ cos ωt with ω² = k/J."""
    moments = np.array([[0.4, 0.4, 0.4], [0.2, 0.2, 0.2]])
    system, k = joined_bodies(moments, np.zeros((2, 3))), 2.0
    omega, axis = np.sqrt(k * 0.6 / (0.4 * 0.2)), np.array([0.6, 0.0, 0.8])
    traj = pinred.simulate(
        system, x0={"joint": 1.5 * axis}, duration=2.0, forces=BallSpring("joint", k),
        rtol=1e-13, atol=1e-14,
    )  # fmt: skip
    expected = quaternion_exp(1.5 * np.cos(omega * traj.t)[:, None] * axis)
    np.testing.assert_allclose(traj.x, expected, atol=2e-12)


@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
@pytest.mark.sampled
def test_compare_passes_with_forces_on_balls(engine: Any) -> None:
    """Springs, PD, limits, dampers by axis and a potential of the quaternion together."""
    system = ball_tree(5, 3)
    first, second, *_ = (joint.name for joint in system.space.balls)
    forces = [
        BallSpring(first, K, REST, law="vector"),
        BallSpring(second, 3.0, law="trace"),
        BallPD(second, (0.1, 0.2, 0.3), 1.0, 0.2),
        BallLimit(first, swing=1.0, stiffness=5.0),
        Damper(f"{first}.y", 0.3),
        PotentialEnergy(lambda x: 2.0 * x[f"{second}.qx"] ** 2),
    ]
    traj = pinred.simulate(system, seed=1, duration=0.5, forces=forces, engine=engine, rtol=1e-9)
    report = pinred.compare(traj)
    assert report.passed, str(report)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BallSpring("joint", 1.0, (0, 0, 0, 0)), "rest of a spring joint: .*other than"),
        (lambda: BallSpring("joint", 1.0, (0, 0)), "expected a rotation vector of 3"),
        (lambda: BallSpring("joint", 1.0, law="hooke"), "one of angle, cosine, vector, trace"),
        (lambda: BallSpring("joint", K), r"for the law angle"),
        (lambda: BallSpring("joint", K + np.eye(3, k=1), law="trace"), "symmetric matrix"),
        (lambda: BallSpring("joint", np.nan), "must be finite"),
        (lambda: BallSpring("joint", 1.0, law="trace", polynomial=(1.0,)), "only the law angle"),
        (lambda: BallPD("joint", (np.inf, 0, 0), 1.0, 1.0), "attitude of ball pd"),
        (lambda: BallPD("joint", (0, 0, 0), 1.0, np.nan), "kd of ball pd must be finite"),
        (lambda: BallLimit("joint"), "give swing, twist, or both"),
        (lambda: BallLimit("joint", swing=4.0), "between 0 and π, got 4.0"),
        (lambda: BallLimit("joint", swing=1.0, width=1e-4), "at least 0.003"),
        (lambda: BallLimit("joint", swing=1.0, axis="w"), "expected x, y or z"),
    ],
)
def test_invalid_forces_on_balls_are_refused(make: Any, message: str) -> None:
    """Errors name the force, the expected value and the given one."""
    with pytest.raises(InputError, match=message):
        make()


def test_forces_on_unknown_balls_and_scalar_forces_on_balls_are_refused() -> None:
    """Messages list the balls, or point to forces on the whole ball."""

    def simulate(system: System, force: Force) -> None:
        pinred.simulate(system, seed=0, duration=0.1, forces=force)

    system = joined_bodies()
    with pytest.raises(InputError, match="no ball joint 'neck'; the ball joints are joint"):
        simulate(system, BallSpring("neck", 1.0))
    with pytest.raises(InputError, match=r"'joint.x' is an axis of a ball joint"):
        simulate(system, PD({"joint.x": 0.1}, 1.0, 1.0))
    with pytest.raises(InputError, match=r"'joint.x' is an axis of a ball joint"):
        pinred.simulate(system, seed=0, duration=0.1, springs={"joint.x": (1.0, 0.0)})
    with pytest.raises(InputError, match=r"'joint.x' is an axis of a ball joint"):
        pinred.simulate(system, seed=0, duration=0.1, prescribed={"joint.x": "t"})
