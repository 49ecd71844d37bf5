"""Ball joints with prescribed attitudes, against Pinocchio, closed forms and hinge triples."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree, joined_bodies

import pinred
from pinred import InputError, Parameter
from pinred.common.arrays import Array
from pinred.forces import BallSpring, Damper
from pinred.lie.rotations import quaternion_exp, rotation, unwrapped_rotation_vectors
from pinred.signals import Attitude, Fourier, Hold, Linear, Spline
from pinred.system.system import System

CENTRE = (0.1, -0.5, 0.3)
SWING = Attitude(["0.8*sin(3*t)", "0.3*t", Fourier(0.1, [0.2], [], 2.0)], CENTRE)


def evaluated(attitude: Attitude, t: float) -> tuple[Array, Array, Array]:
    """Return quaternion, rate and acceleration of the expressions at a time."""
    symbol = ca.SX.sym("t")
    written = attitude.written(symbol, None, lambda value: getattr(value, "value", value))
    q, sigma, alpha = ca.Function("f", [symbol], list(written))(t)
    return np.array(q).ravel(), np.array(sigma).ravel(), np.array(alpha).ravel()


@pytest.mark.parametrize("t", [0.0, 1e-9, 1e-4, 0.05, 0.3, 0.7, 1.1, 4.0, 30.0])
def test_attitude_has_rate_and_acceleration_of_right_jacobian(t: float) -> None:
    """σ = J(w) ẇ by Pinocchio, also at w = 0 and beyond 2π; α by differences of σ."""
    attitude = Attitude(["t", "0.5*t*t", "-2*t"], CENTRE)

    def sigma_at(t: float) -> Array:
        w, wdot = np.array([t, 0.5 * t * t, -2.0 * t]), np.array([1.0, t, -2.0])
        return np.asarray(pin.Jexp3(w) @ wdot)

    q, sigma, alpha = evaluated(attitude, t)
    R = pin.exp3(np.array(CENTRE)) @ pin.exp3(np.array([t, 0.5 * t * t, -2.0 * t]))
    scale = 1.0 + t**2
    np.testing.assert_allclose(rotation(q), R, atol=1e-15 * scale)
    np.testing.assert_allclose(rotation(attitude.value(t)), R, atol=1e-15 * scale)
    np.testing.assert_allclose(sigma, sigma_at(t), atol=1e-14 * scale**2)
    np.testing.assert_allclose(attitude.rate(t), sigma_at(t), atol=1e-14 * scale**2)
    h = 1e-3 / scale
    change = sum(
        weight * (sigma_at(t + k * h) - sigma_at(t - k * h))
        for k, weight in ((1, 0.75), (2, -0.15), (3, 1.0 / 60.0))
    )
    np.testing.assert_allclose(alpha, change / h, atol=1e-11 * scale**2)


# The compiled engine has the same torques.
@pytest.mark.by_hand("pinocchio-auto")
@pytest.mark.parametrize(
    ("engine", "method"),
    [("compiled", "auto"), ("compiled", "Gauss(0.02, 8)"), ("pinocchio", "auto")],
)
@pytest.mark.sampled(3)
def test_torques_of_prescribed_ball_follow_from_inverse_dynamics(engine: Any, method: str) -> None:
    """Pinocchio's H a + c = τ with known accelerations of the ball gives its torques."""
    system = ball_tree(5, 2)
    _, second = system.space.balls
    traj = pinred.simulate(
        system, seed=1, prescribed={second.name: SWING}, engine=engine, method=method,
        times=[0.0, 0.1, 0.3], rtol=1e-9,
    )  # fmt: skip
    driven = system.r + np.arange(second.v.start, second.v.stop)
    free = np.setdiff1d(np.arange(system.n), driven)
    for k, t in enumerate(traj.t.tolist()):
        attitude, sigma, alpha = evaluated(SWING, t)
        np.testing.assert_allclose(traj.x[k, second.x], attitude, atol=1e-15)
        np.testing.assert_allclose(traj.xdot[k, second.v], sigma, atol=1e-14)
        q, v = system.sort_q(traj.q[k]), system.sort_v(traj.v[k])
        H = pin.crba(system.sorted_model, system.sorted_data, q)
        bias = pin.nonLinearEffects(system.sorted_model, system.sorted_data, q, v)
        a = np.empty(system.n)
        a[driven] = alpha
        a[free] = np.linalg.solve(
            H[np.ix_(free, free)], -bias[free] - H[np.ix_(free, driven)] @ alpha
        )
        tau = pin.rnea(system.sorted_model, system.sorted_data, q, v, a)
        np.testing.assert_allclose(traj.driving_torques[k], tau[driven], atol=1e-11)
        np.testing.assert_allclose(tau[free], 0.0, atol=1e-12)
    balance = traj.energy_balance
    np.testing.assert_allclose(
        balance.energy - balance.energy[0], balance.work.sum(axis=1), atol=1e-8
    )


def test_compare_passes_with_prescribed_ball_and_forces() -> None:
    """ABA with the prescribed acceleration agrees, with a spring on a ball that moves freely."""
    system = ball_tree(5, 2)
    first, second = (joint.name for joint in system.space.balls)
    traj = pinred.simulate(
        system, seed=1, duration=0.1, prescribed={first: SWING}, rtol=1e-7,
        forces=[BallSpring(second, 2.0), Damper(f"{second}.x", 0.3)],
    )  # fmt: skip
    report = pinred.compare(traj)
    assert report.passed, str(report)


def triple(axes: str) -> System:
    """Return the two bodies of `joined_bodies`, joined by three hinges."""
    ball = joined_bodies().model
    model = pin.Model()
    model.gravity.setZero()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(joint, ball.inertias[1], pin.SE3.Identity())
    place = ball.jointPlacements[2]
    for k, axis in enumerate(axes):
        kind = {"X": pin.JointModelRX, "Z": pin.JointModelRZ}[axis]()
        joint = model.addJoint(joint, kind, place, f"hinge{k}")
        place = pin.SE3.Identity()
    model.appendBodyToJoint(joint, ball.inertias[2], pin.SE3.Identity())
    return System(model, "triple")


# Inverse dynamics and ABA confirm the motion of prescribed balls by default.
@pytest.mark.by_hand
def test_prescribed_ball_moves_the_base_as_hinge_triple_does() -> None:
    """exp(θ cos β, θ sin β, 0) = R_z(β) R_x(θ) R_z(−β): same base, and the same power."""
    theta, beta = "(0.8 + 0.3*sin(2*t))", "(1.5*t)"
    options: dict[str, Any] = {
        "xi0": [0.1, 0.0, 0.2, 0.3, -0.4, 0.5], "times": [0.0, 0.4, 0.9], "rtol": 1e-12,
        "atol": 1e-13,
    }  # fmt: skip
    plan = Attitude([f"{theta}*cos({beta})", f"{theta}*sin({beta})", 0.0])
    ball = pinred.simulate(joined_bodies(), prescribed={"joint": plan}, **options)
    plans = {"hinge0": beta, "hinge1": theta, "hinge2": f"-{beta}"}
    hinges = pinred.simulate(triple("ZXZ"), prescribed=plans, **options)
    np.testing.assert_allclose(ball.pose, hinges.pose, atol=1e-11)
    np.testing.assert_allclose(ball.xi, hinges.xi, atol=1e-11)
    np.testing.assert_allclose(ball.energy, hinges.energy, atol=1e-11)
    power = np.sum(ball.driving_torques * ball.xdot, axis=1)
    expected = np.sum(hinges.driving_torques * hinges.xdot, axis=1)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(power, expected, atol=1e-10)
    # The torque about the last hinge, which is the z axis of the child, is the same.
    np.testing.assert_allclose(ball.driving_torques[:, 2], hinges.driving_torques[:, 2], atol=1e-10)


def test_through_interpolates_unwrapped_attitudes() -> None:
    """Logarithms that flip their sign at half a turn are unwrapped about the centre."""
    times = np.linspace(0.0, 1.0, 41)
    q = quaternion_exp(np.outer(5.0 * times, [0.0, 0.6, 0.8]))
    attitude = Attitude.through(times, q, CENTRE, end="not-a-knot")
    t = np.linspace(0.0, 1.0, 7)
    vectors = unwrapped_rotation_vectors(attitude.value(t))
    np.testing.assert_allclose(vectors, np.outer(5.0 * t, [0.0, 0.6, 0.8]), atol=1e-4)
    np.testing.assert_allclose(attitude.rate(t)[3], [0.0, 3.0, 4.0], atol=1e-3)


@pytest.mark.parametrize("attitudes", [[0.1, 0.2, 0.3], np.zeros((3, 5)), np.zeros((0, 3))])
def test_through_refuses_attitudes_of_other_shapes(attitudes: Any) -> None:
    """One attitude, rows of five numbers, and no attitudes are no table of attitudes."""
    with pytest.raises(pinred.ShapeError, match=r"rotation vectors \(n, 3\) or quaternions"):
        Attitude.through([0.0, 1.0, 2.0], attitudes)


# Every run varies a Parameter of an attitude in test_many_derivatives.
@pytest.mark.by_hand
def test_members_and_flows_vary_parameters_of_attitudes() -> None:
    """Batches equal single runs, and derivatives by a Parameter equal differences."""
    rate = Parameter("rate", 1.3)
    system = joined_bodies()
    # A spline's values may contain Parameters.
    plan = Attitude([Spline([0.0, 0.3, 0.6], [0.0, rate, 0.4]), "0.5*t", 0.2])
    scene = pinred.Scene(
        system=system, xi0=np.full(6, 0.2), prescribed={"joint": plan}, times=[0.0, 0.6],
        rtol=1e-11, atol=1e-12,
    )  # fmt: skip
    values = np.array([1.0, 1.3])
    many = pinred.simulate_many(scene, parameters={"rate": values})
    single = [pinred.simulate(scene, parameters={"rate": value}).pose[-1] for value in values]
    np.testing.assert_allclose(many.pose[:, -1], single, atol=1e-9)
    flow = pinred.flow(scene, wrt=["rate"])
    h = 1e-4
    after, before = flow(rate=1.3 + h), flow(rate=1.3 - h)
    slopes = flow.jacobian()["rate"]
    for name in ("xdot", "xi"):
        change = (getattr(after, name) - getattr(before, name)) / (2.0 * h)
        np.testing.assert_allclose(slopes[:, flow.outputs[name]], change, atol=1e-7)


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        ("0.1*t", r"prescribed\['joint'\] is a ball joint: expected an Attitude, or three"),
        ([0.1, 0.2], r"prescribed\['joint'\] must be a Signal.* or three of these"),
        (["t", "t", "y"], r"prescribed\['joint'\]: .* y is not a name"),
        ([0.0, 0.0, 0.0, 0.0], r"prescribed\['joint'\]: centre of an Attitude: .*other than zero"),
        (
            Attitude([Linear([0, 1], [0.0, 0.3]), 0.0, 0.0]),
            r"prescribed\['joint'\] must have a continuous rate, but Linear",
        ),
        (
            Attitude([Spline([0, 0.5, 1], [0.0, 2.5, -2.5]), 0.0, 0.0]),
            r"prescribed\['joint'\]: the rotation vector jumps by 5 rad from t = 0.5 s to 1 s.* "
            r"Unwrap it, as Attitude.through",
        ),
    ],
)
def test_invalid_attitudes_are_refused(plan: Any, message: str) -> None:
    """The message names the joint and the remedy."""
    with pytest.raises(InputError, match=message):
        pinred.Scene(system=joined_bodies(), seed=0, duration=0.5, prescribed={"joint": plan})


def test_attitudes_of_hinges_and_holds_are_refused() -> None:
    """A hinge follows one signal, and a rotation vector must not jump."""
    with pytest.raises(InputError, match=r"prescribed\['hinge1'\] is no ball joint"):
        pinred.Scene(system=triple("ZXZ"), seed=0, prescribed={"hinge1": [0.0, "t", 0.0]})
    with pytest.raises(InputError, match=r"vector.y of an Attitude: a Hold jumps"):
        Attitude([0.0, Hold([0.0], [1.0]), 0.0])
    with pytest.raises(InputError, match="three signals, numbers or formulas"):
        Attitude("t")
    table = Spline([0.0, 1.0], [0.0, 3.3])
    with pytest.raises(InputError, match=r"jumps by 3.3 rad"):
        pinred.Scene(system=joined_bodies(), seed=0, prescribed={"joint": [table, "t", 0]})
