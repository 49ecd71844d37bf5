"""Shapes of robots that were joined or cut are those of their files, on the right links."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.system.derived_systems import join
from pinred.system.system import System
from pinred.views.playback.drawn_bodies import drawn_bodies

SHAPE = '<visual><origin xyz="0 {y} 0"/><geometry><box size=".1 .2 {z}"/></geometry></visual>'


def robot(name: str, size: float) -> System:
    """Return a robot of three links with boxes; the last link is fixed to the one before."""
    model = pinred.Model(name).body(f"{name}1", mass=1.0, inertia=1.0)
    model = model.hinge(f"{name}2", parent=f"{name}1", axis="z", at=[1, 0, 0], mass=1, inertia=1)
    model = model.fixed(f"{name}3", parent=f"{name}2", at=[0, 1, 0], mass=1.0, inertia=1.0)
    text = model.urdf()
    for k in (1, 2, 3):
        shape = SHAPE.format(y=0.1 * k, z=size * k)
        text = text.replace(f'<link name="{name}{k}">', f'<link name="{name}{k}">{shape}')
    return pinred.load(text=text, group="SE3", gravity=[0, 0, 0])


def boxes(system: System, pose: Array, x: Array) -> dict[float, Array]:
    """Return the centre of each box in the world, by its half height."""
    data = system.sorted_model.createData()
    pin.forwardKinematics(system.sorted_model, data, system.sorted_q(pose, x))
    return {
        round(solid.size[2], 6): data.oMi[solid.joint].act(solid.placement[:3])
        for solid in drawn_bodies(system).solids
        if solid.kind == "box"
    }


def test_shapes_of_joined_robots_stay_on_their_links() -> None:
    """Also behind joints that the capture has reversed, and after a release of a fixed link."""
    a, b = robot("a", 0.1), robot("b", 0.01)
    pose = np.array([0.1, 0.2, 0.3, *pin.Quaternion(pin.exp3(np.array([0.3, 0.2, 0.1]))).coeffs()])
    first = pinred.Scene(system=a, pose0=pose, x0=[0.4], xi0=np.ones(6))
    identity = b.group.identity()
    data = a.model.createData()
    pin.framesForwardKinematics(a.model, data, a.q(pose, np.array([0.4])))
    tip = data.oMf[a.model.getFrameId("a3", pin.FrameType.BODY)]
    other = b.model.createData()
    pin.framesForwardKinematics(b.model, other, b.q(identity, np.array([-0.7])))
    grip = other.oMf[b.model.getFrameId("b3", pin.FrameType.BODY)]
    there = pin.SE3ToXYZQUAT(tip * grip.inverse())
    second = pinred.Scene(system=b, pose0=there, x0=[-0.7], xi0=np.zeros(6))
    expected = boxes(a, pose, np.array([0.4])) | boxes(b, there, np.array([-0.7]))
    assert len(expected) == 6
    capture = pinred.capture(first, second, at="a3", onto="b3")
    state = capture.instant
    found = boxes(capture.system, state.pose, state.x)
    assert found.keys() == expected.keys()
    for key, centre in expected.items():
        np.testing.assert_allclose(found[key], centre, atol=1e-14)
    release = pinred.release(capture, "a3")
    parts = [
        boxes(p.system, p.instant.pose, p.instant.x) for p in (release.carrier, release.released)
    ]
    assert [len(part) for part in parts] == [2, 4]
    for key, centre in (parts[0] | parts[1]).items():
        np.testing.assert_allclose(centre, expected[key], atol=1e-14)


def test_robots_without_shapes_are_drawn_from_inertias() -> None:
    """A robot whose file has no shapes gets ellipsoids, beside the shapes of the other."""
    bare = pinred.load(pinred.Model("bare").body("bare", mass=1.0, inertia=1.0), gravity=[0, 0, 0])
    place = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    both = join(robot("a", 0.1), bare, at="a1", onto="bare", offset=place, prefix="")
    bodies = drawn_bodies(both)
    assert "bare: bodies drawn from their inertias" in bodies.note
    assert [solid.kind for solid in bodies.solids].count("box") == 3
    turned = drawn_bodies(
        join(bare, robot("a", 0.1), at="bare", onto="a2", offset=place, prefix="")
    )
    assert [solid.kind for solid in turned.solids].count("box") == 3
    assert pytest.approx(both.mass) == 4.0
