"""Robots described as lists of bodies, against models built by hand and files of both formats."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred import InputError, Model, System
from pinred.common.arrays import Array

INERTIA = np.array([[0.5, 0.02, -0.01], [0.02, 0.4, 0.03], [-0.01, 0.03, 0.3]])
AT, COM, TURN = [0.3, -0.2, 0.1], [0.1, 0.05, -0.2], [0.4, -0.3, 0.7]
AXIS = np.array([1.0, 2.0, -2.0]) / 3.0


def described(*, ball: bool = True) -> Model:
    """Return a robot with joints of all types."""
    model = (
        Model("sampler")
        .body("hub", mass=3.0, inertia=INERTIA, com=COM)
        .hinge("arm", parent="hub", axis=3.0 * AXIS, at=AT, attitude=TURN, mass=1.1,
               inertia=[0.1, 0.2, 0.15], com=COM)
        .slide("piston", parent="arm", axis="-y", at=AT, attitude=TURN, mass=0.7, inertia=0.05,
               limits=(-0.4, 0.6))
        .fixed("lamp", parent="piston", at=AT, attitude=TURN, mass=0.2, inertia=0.01, com=COM)
    )  # fmt: skip
    if not ball:
        return model
    return model.ball(
        "head", parent="hub", at=AT, attitude=TURN, mass=0.9, inertia=INERTIA / 3.0, com=COM
    )


def built() -> pin.Model:
    """Return the same robot as a pin.Model."""
    model = pin.Model()
    place = pin.SE3(pin.exp3(np.array(TURN)), np.array(AT))
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    arm = model.addJoint(root, pin.JointModelRevoluteUnaligned(AXIS), place, "arm")
    piston = model.addJoint(
        arm, pin.JointModelPrismaticUnaligned(np.array([0.0, -1.0, 0.0])), place, "piston"
    )
    head = model.addJoint(root, pin.JointModelSpherical(), place, "head")
    com, origin = np.array(COM), np.zeros(3)
    model.appendBodyToJoint(root, pin.Inertia(3.0, com, INERTIA), pin.SE3.Identity())
    arm_inertia = pin.Inertia(1.1, com, np.diag([0.1, 0.2, 0.15]))
    model.appendBodyToJoint(arm, arm_inertia, pin.SE3.Identity())
    model.appendBodyToJoint(piston, pin.Inertia(0.7, origin, 0.05 * np.eye(3)), pin.SE3.Identity())
    model.appendBodyToJoint(piston, pin.Inertia(0.2, com, 0.01 * np.eye(3)), place)
    model.appendBodyToJoint(head, pin.Inertia(0.9, com, INERTIA / 3.0), pin.SE3.Identity())
    return model


def accelerations(system: System, shape: dict[str, Any], rates: dict[str, float]) -> Array:
    """Return ABA's accelerations at a state given by joint names."""
    state = pinred.Scene(
        system=system, x0=shape, xdot0=rates, xi0=[0.1, -0.2, 0.3, 0.4, 0.5, -0.6], duration=1.0
    ).start
    q, v = system.q(state.pose, state.x), system.v(state.xi, state.xdot)
    a = pin.aba(system.model, system.model.createData(), q, v, np.zeros(system.model.nv))
    by_name = dict(zip(system.shape_names, np.array(a)[system.r :], strict=True))
    return np.append(a[: system.r], [by_name[name] for name in sorted(by_name)])


def test_fixed_body_without_mass_is_a_frame(tmp_path: Path) -> None:
    """It changes no number, in both formats, and may carry bodies."""
    arm = described(ball=False)
    tip = arm.fixed("tip", parent="arm", at=AT, attitude=TURN)
    tool = tip.fixed("tool", parent="tip", mass=0.5)
    bare = arm.fixed("tool", parent="arm", at=AT, attitude=TURN, mass=0.5)
    shape, rates = {"arm": 0.4, "piston": -0.2}, {"arm": 0.5, "piston": -0.4}
    expected = accelerations(pinred.load(bare), shape, rates)
    assert pinred.load(tip).mass == pinred.load(arm).mass
    for suffix in (".urdf", ".xml"):
        if suffix == ".xml":
            pytest.importorskip("mujoco")
        with warnings.catch_warnings(action="ignore", category=pinred.LeftOutWarning):
            robot = pinred.load(tool.save(tmp_path / f"tool{suffix}"))
        found = accelerations(robot, shape, rates)
        np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())
        assert robot.model.existFrame("tip")


@pytest.mark.filterwarnings("ignore:sampler. in the file, but not simulated. joint limits")
@pytest.mark.parametrize("source", ["load", "urdf", "mjcf"])
def test_described_robot_equals_model_built_by_hand(source: str, tmp_path: Path) -> None:
    """Bodies, placements, axes and fixed bodies agree to round-off, from text and from files."""
    model = described()
    if source == "mjcf":
        pytest.importorskip("mujoco")
        robot = pinred.load(model.save(tmp_path / "sampler.xml"))
    elif source == "urdf":
        robot = pinred.load(model.save(tmp_path / "sampler.urdf"), balls=model.balls)
    else:
        robot = pinred.load(model)
    assert robot.name == "sampler"
    assert [joint.name for joint in robot.space.balls] == ["head"]
    shape = {"arm": 0.4, "piston": -0.2, "head": [0.3, -0.5, 0.2]}
    names = ("arm", "piston", "head.x", "head.y", "head.z")
    rates = dict(zip(names, (0.5, -0.4, 0.3, 0.2, -0.7), strict=True))
    found = accelerations(robot, shape, rates)
    expected = accelerations(pinred.load(built()), shape, rates)
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_described_robot_runs_and_reloads_from_its_text() -> None:
    """The robot keeps its text, so that copies of the system have the same bits."""
    robot = pinred.load(described(ball=False), lock=["piston"])
    traj = pinred.simulate(robot, seed=0, duration=0.3)
    assert pinred.compare(traj).passed
    np.testing.assert_array_equal(pinred.simulate(robot, seed=0, duration=0.3).x, traj.x)
    planar = Model().body("a", mass=3.0, inertia=0.5)
    planar = planar.hinge("b", parent="a", axis="z", at=[0.5, 0, 0], mass=1.0, inertia=0.25)
    two = pinred.load(planar, group="SE2")
    red = pinred.Reduction(two)
    np.testing.assert_allclose(
        red.local_connection([0.7])[:, 0], [0.0, -1 / 30, 4 / 15], atol=1e-14
    )


def test_slide_without_limits_has_none() -> None:
    """A slide without limits is loaded without a warning; URDF writes the largest numbers."""
    hub = Model().body("hub", mass=1.0, inertia=1.0)
    rail = hub.slide("rail", parent="hub", axis="x", mass=1.0, inertia=1.0)
    assert 'lower="-1.7976931348623157e+308"' in rail.urdf()
    assert pinred.load(rail).shape_names == ("rail",)


def test_models_are_values() -> None:
    """A call returns a new model and leaves the first one as it is."""
    base = Model().body("hub", mass=1.0, inertia=1.0)
    twins = [base.hinge(n, parent="hub", axis="x", mass=1.0, inertia=1.0) for n in "ab"]
    assert [len(model.bodies) for model in (base, *twins)] == [1, 2, 2]
    with pytest.raises(ValueError, match="read-only"):
        base.bodies[0].inertia[0, 0] = 2.0


HUB = Model().body("hub", mass=1.0, inertia=1.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Model().urdf(), "has no bodies; begin with body"),
        (lambda: HUB.body("b", mass=1.0), "the base is 'hub' already"),
        (lambda: HUB.ball("b", parent="hob", mass=1.0), "no body 'hob'.*did you mean 'hub'"),
        (lambda: Model().ball("b", parent="a", mass=1.0), "none, so begin with body"),
        (lambda: HUB.fixed("hub", parent="hub", mass=1.0), "'hub'.*cannot be used"),
        (lambda: HUB.fixed("world", parent="hub", mass=1.0), "reserved"),
        (lambda: HUB.ball("b", parent="hub", mass=0.0), "mass of ball 'b'"),
        (lambda: HUB.fixed("b", parent="hub", inertia=0.1), "neither inertia nor com"),
        (lambda: HUB.fixed("b", parent="hub", com=[0.1, 0, 0]), "neither inertia nor com"),
        (lambda: HUB.fixed("b", parent="hub", mass=-1.0), "mass of fixed 'b'"),
        (lambda: HUB.ball("b", parent="hub", mass=float("nan")), "mass of ball 'b'"),
        (lambda: HUB.ball("b", parent="hub", mass=1.0, inertia=[1.0, 2.0]), "got shape"),
        (lambda: HUB.ball("b", parent="hub", mass=1.0, inertia=np.nan), "finite and symmetric"),
        (lambda: HUB.ball("b", parent="hub", mass=1.0, inertia=np.triu(np.ones((3, 3)))), "symm"),
        (lambda: HUB.ball("b", parent="hub", mass=1.0, at=[0.0, np.inf, 0.0]), "at of ball 'b'"),
        (lambda: HUB.hinge("b", parent="hub", axis="w", mass=1.0), "x, y, z, -x"),
        (lambda: HUB.hinge("b", parent="hub", axis="", mass=1.0), "x, y, z, -x"),
        (lambda: HUB.hinge("b", parent="hub", axis=[0, 0, 0], mass=1.0), "must not be zero"),
        (lambda: HUB.hinge("b", parent="hub", axis="x", mass=1.0, limits=(1, 0)), "increase"),
        (lambda: HUB.save("robot.txt"), "urdf"),
    ],
)
def test_invalid_descriptions_are_refused(make: Callable[[], Any], message: str) -> None:
    """The message names the body, and what is expected."""
    with pytest.raises(InputError, match=message):
        make()
