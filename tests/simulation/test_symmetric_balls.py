"""Balls with symmetric bodies: constant momenta that are not integrated, against other routes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ball_trees import joined_bodies, random_body
from gyrostat import Gyrostat

import pinred
from pinred.forces import BallSpring, Torque, Wrench
from pinred.judge.audit import audit_trajectory, axial_momentum_drifts
from pinred.lie.rotations import quaternion_exp, rotation
from pinred.simulation import plan as plans
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.plan import plan_of
from pinred.system.system import System

MOMENTS = np.array([[0.4, 0.5, 0.7], [0.2, 0.2, 0.2]])
ROTOR = np.array([[0.1, 0.2, -0.3], [0.0, 0.0, 0.0]])
START: dict[str, Any] = {
    "x0": {"joint": (0.5, 0.2, 0.1)},
    "xdot0": {"joint": (1.0, -0.5, 0.7)},
    "xi0": np.array([0.0, 0.0, 0.0, 0.3, 0.8, -0.2]),
}


def top(tilt: np.ndarray | None = None) -> System:
    """Return two free bodies, the second a body of revolution about z, tilted in its axes."""
    model = joined_bodies(MOMENTS + np.array([[0.0], [1.0]]) * [0, 0, 0.1], ROTOR).model.copy()
    body = model.inertias[2]
    body.lever = np.array([0.0, 0.0, 0.3])
    turn = pin.SE3(np.eye(3) if tilt is None else pin.exp3(tilt), np.zeros(3))
    model.inertias[2] = turn.act(body)
    return System(model, name="top")


def flow(system: System, **options: Any) -> CompiledFlow:
    """Return the compiled flow of a scene."""
    scene = pinred.Scene(system=system, **{**START, "duration": 1.0, **options})
    return CompiledFlow.of_plan(plan_of(scene))


@pytest.fixture
def without_symmetry(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Return a function after whose call no ball of a new system counts as symmetric."""
    return lambda: monkeypatch.setattr(plans, "symmetric_balls_of", lambda *_: ())


@pytest.mark.by_hand("0.0")
@pytest.mark.parametrize("armature", [0.0, 0.05])
def test_gyrostat_equals_taylor_series_of_30_digits(armature: float) -> None:
    """Attitudes and rates after 3 s to 1e-12, with either kind of method."""
    gyrostat = Gyrostat(armature=armature)
    omega, sigma = np.array([1.0, 2.0, -0.5]), np.array([0.5, -1.5, 2.0])
    q = quaternion_exp(np.array([0.4, 0.3, -0.2]))
    expected = gyrostat.integrate(omega, q, sigma, 3.0, 40)
    system = System(gyrostat.model(), name="gyrostat")
    for method in ("DOP853", "AdaptiveGauss"):
        traj = pinred.simulate(
            system, x0=q, xdot0=rotation(q).T @ sigma, xi0=np.append(np.zeros(3), omega),
            times=[3.0], rtol=1e-13, atol=1e-14, method=method,
        )  # fmt: skip
        for found, exact in (
            (rotation(traj.x[-1]), rotation(expected["rotor"])),
            (rotation(traj.pose[-1, 3:]), rotation(expected["attitude"])),
            (traj.xi[-1, 3:], expected["omega"]),
            (rotation(traj.x[-1]) @ traj.xdot[-1], expected["rates"]),
        ):
            assert np.abs(found - exact).max() <= 1e-12


def test_rotor_integrates_four_variables_instead_of_seven(
    without_symmetry: Callable[[], None],
) -> None:
    """Its momentum is a parameter, and the kernel takes three fifths of the operations."""
    system = joined_bodies(MOMENTS, ROTOR)
    kernel = flow(system).kernel
    assert kernel.layout.size == 4 + 4  # quaternions of the base and of the rotor
    assert kernel.layout.constant_pi == [0, 1, 2]
    without_symmetry()
    ordinary = flow(joined_bodies(MOMENTS, ROTOR)).kernel
    assert ordinary.layout.size == 4 + 7
    assert kernel.instructions < 0.65 * ordinary.instructions


def test_body_of_revolution_integrates_two_momenta() -> None:
    """The momentum about the axis is a parameter; about a tilted axis it is constant."""
    assert flow(top()).kernel.layout.constant_pi == [2]
    assert flow(top()).kernel.layout.size == 4 + 6
    tilted = top(np.array([0.3, 0.4, 0.1]))
    (ball,) = pinred.inspect(tilted).symmetric_balls
    assert ball.axis is not None
    np.testing.assert_allclose(ball.axis, pin.exp3(np.array([0.3, 0.4, 0.1]))[:, 2], atol=1e-12)
    y0 = flow(tilted).y0
    assert len(y0) == 4 + 7
    body = tilted.model.inertias[2]
    traj = pinred.simulate(tilted, **START, duration=2.0, rtol=1e-12)
    turns = np.swapaxes(rotation(traj.x), 1, 2)
    omega = np.einsum("tij,tj->ti", turns, traj.xi[:, 3:]) + traj.xdot
    moments = omega @ (body.inertia @ ball.axis)
    assert np.abs(moments - moments[0]).max() <= 1e-12 * np.abs(moments[0])


@pytest.mark.parametrize("make", [lambda: joined_bodies(MOMENTS, ROTOR), top])
@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
@pytest.mark.sampled
def test_compare_passes_with_symmetric_balls(make: Any, engine: Any) -> None:
    """The judge integrates all coordinates with ABA."""
    traj = pinred.simulate(make(), **START, duration=1.0, rtol=1e-10, engine=engine)
    report = pinred.compare(traj)
    assert report.passed, str(report)


def satellite(gravity: float = 0.0, group: Any = None) -> System:
    """Return a body that carries a hinged arm with a rotor, two rotors in lanes, and a top."""
    rng, model = np.random.default_rng(3), pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    root = model.addJoint(0, group or pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, *random_body(rng))
    arm = model.addJoint(root, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.3, 0, 0])), "arm")
    model.appendBodyToJoint(arm, *random_body(rng))
    sphere = pin.Inertia(0.5, np.zeros(3), 0.02 * np.eye(3))
    disc = pin.Inertia(0.3, np.array([0.0, 0.1, 0.0]), np.diag([0.01, 0.03, 0.01]))
    for name, parent, body, turn in (
        ("tip", arm, sphere, [0.2, -0.3, 0.4]), ("left", root, sphere, [0.0, 0.0, 0.0]),
        ("right", root, sphere, [0.0, 0.0, 0.0]), ("top", arm, disc, [0.5, 0.1, 0.2]),
    ):  # fmt: skip
        place = pin.SE3(pin.exp3(np.array(turn)), 0.4 * rng.normal(size=3))
        ball = model.addJoint(parent, pin.JointModelSpherical(), place, name)
        model.appendBodyToJoint(ball, body, pin.SE3.Identity())
    rotors = np.zeros(model.nv)
    rotors[model.joints[model.getJointId("tip")].idx_v :][:3] = 0.01
    model.armature = rotors
    return System(model, name="satellite")


# The other case has the same robot, with forces.
@pytest.mark.by_hand("free")
@pytest.mark.parametrize("case", ["free", "pivot in gravity", "wrench and torque"])
@pytest.mark.sampled
def test_motion_equals_that_of_ordinary_balls(
    case: str, without_symmetry: Callable[[], None]
) -> None:
    """The same robot with and without the skipped terms; two of its rotors share lanes."""
    options: dict[str, Any] = {"seed": 2, "times": [0.5], "rtol": 1e-12, "atol": 1e-13}
    pivot = (9.81, pin.JointModelSpherical()) if case == "pivot in gravity" else ()
    if case == "wrench and torque":
        options["forces"] = [Wrench([0.1, -0.2, 0.3, 0.4, 0.1, -0.1]), Torque({"arm": 0.3})]
    traj = pinred.simulate(satellite(*pivot), **options)
    layout = traj.plan.layout(zero_momentum=False)
    assert len(layout.constant_pi) == 3 * 3 + 1
    without_symmetry()
    ordinary = pinred.simulate(satellite(*pivot), **options)
    assert not ordinary.plan.layout(zero_momentum=False).constant_pi
    for found, expected in ((traj.q, ordinary.q), (traj.v, ordinary.v)):
        np.testing.assert_allclose(found, expected, atol=1e-11)


# Every run has the motions of both, and a Taylor series.
@pytest.mark.by_hand
def test_derivatives_equal_those_of_ordinary_balls(without_symmetry: Callable[[], None]) -> None:
    """By the initial shape and rates of a rotor with armature, also in SIMD lanes."""
    model = Gyrostat(armature=0.05).model()
    start = {"x0": {"rotor": (0.5, 0.2, 0.1)}, "xdot0": (1.0, -0.5, 0.7)}
    options: dict[str, Any] = {**start, "times": [0.5], "rtol": 1e-12, "atol": 1e-13}
    twists = np.random.default_rng(0).normal(size=(4, 6))
    choice: Any = {"wrt": ["x0", "xdot0", "xi0"], "of": ["x", "xdot"]}
    results = []
    for ordinary in (False, True):
        if ordinary:
            without_symmetry()
        system = System(model, name="gyrostat")
        slopes = pinred.flow(system, **options, xi0=twists[0], **choice).jacobian()
        many = pinred.simulate_many(system, **options, xi0=twists)
        results.append([*slopes.values(), many.x, many.xdot])
    for found, expected in zip(*results, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-11)


def test_linearised_flow_keeps_constant_momenta(without_symmetry: Callable[[], None]) -> None:
    """Its matrix is that of the ordinary ball at constant momentum, without its rows π."""
    system = joined_bodies(MOMENTS, ROTOR)
    found = pinred.linearise(pinred.simulate(system, **START, duration=0.1))
    assert not any(name.startswith("π") for name in found.names)
    without_symmetry()
    ordinary = joined_bodies(MOMENTS, ROTOR)
    whole = pinred.linearise(pinred.simulate(ordinary, **START, duration=0.1))
    kept = [k for k, name in enumerate(whole.names) if not name.startswith("π")]
    np.testing.assert_allclose(found.matrix, whole.matrix[np.ix_(kept, kept)], atol=1e-12)


def test_forces_and_asymmetries_make_ordinary_balls() -> None:
    """A spring, a torque, a centre of mass a nanometre away, moments that differ by 1e-9."""
    system = joined_bodies(MOMENTS, ROTOR)
    for force in (BallSpring("joint", 1.0), Torque({"joint.x": 0.1})):
        assert plan_of(pinred.Scene(system=system, **START, forces=force)).symmetric_balls == ()
    other = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for moments, offset in (
        (MOMENTS, ROTOR + 1e-9 * other),
        (MOMENTS + 1e-9 * other, ROTOR),
    ):  # fmt: skip
        (ball,) = pinred.inspect(joined_bodies(moments, offset)).symmetric_balls
        assert ball.axis is not None  # still a body of revolution
    drive = pinred.Scene(system=top(), **START, forces=Torque({"joint.x": 0.1}))
    assert len(plan_of(drive).symmetric_balls) == 1  # it has no moment about z
    assert not pinred.inspect(joined_bodies()).symmetric_balls


def test_explain_and_inspect_report_symmetric_balls(capsys: pytest.CaptureFixture[str]) -> None:
    """What is skipped, and what is constant but integrated by methods with lifted balls."""
    system = joined_bodies(MOMENTS, ROTOR)
    pinred.simulate(system, **START, duration=0.1, explain=True)
    text = capsys.readouterr().out
    assert "skipped: spherical rotor joint: its momentum in its own axes" in text
    assert "integrated: 20 → 8 numbers" in text
    pinred.simulate(system, **START, duration=0.1, method="Gauss(0.05, 4)", explain=True)
    assert "constant: spherical rotor joint: its momentum" in capsys.readouterr().out
    assert "spherical rotor joint: its momentum in its own axes is constant" in str(
        pinred.inspect(system)
    )
    assert "body of revolution on joint: its momentum about (0, 0, 1) is constant" in str(
        pinred.inspect(top())
    )


@pytest.mark.parametrize("make", [lambda: joined_bodies(MOMENTS, ROTOR), top])
def test_audit_finds_changes_of_constant_momenta(make: Any) -> None:
    """A rotation rate that grows by 1e-6 about the axis of symmetry after half of the motion."""
    traj = pinred.simulate(make(), **START, duration=1.0, rtol=1e-12, atol=1e-13)
    balls, states = traj.plan.symmetric_balls, traj.states
    drifts = axial_momentum_drifts(traj.system, balls, states)
    assert len(drifts) == (3 if balls[0].axis is None else 1)
    assert np.abs(drifts).max() <= 1e-13
    v = states.v.copy()
    v[len(v) // 2 :, -1] += 1e-6
    drifts = axial_momentum_drifts(traj.system, balls, replace(states, v=v))
    assert np.abs(drifts).max() >= 1e-7
    assert audit_trajectory(traj, states).momenta.shape[1] == 6 + len(drifts)
