"""A symmetry that is broken by a little is broken: gravity beside an axis, a wheel out of true."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.reduction import potential
from pinred.reduction.cyclic_joints import cyclic_joints
from pinred.reduction.pointwise_reduction import PointwiseReduction as Reduction
from pinred.reduction.potential import Potential, pivot_weight


def leaning(by: float) -> pinred.System:
    """A pendulum on a mast that turns about an axis which leans by that angle [rad]."""
    model = pin.Model()
    mast = model.addJoint(
        0, pin.JointModelRZ(), pin.SE3(pin.exp3(np.array([by, 0.0, 0.0])), np.zeros(3)), "mast"
    )
    model.appendBodyToJoint(mast, pin.Inertia.FromSphere(1.0, 0.2), pin.SE3.Identity())
    arm = model.addJoint(mast, pin.JointModelRX(), pin.SE3.Identity(), "arm")
    body = pin.Inertia(1.0, np.array([0.0, 0.0, -0.5]), 0.1 * np.eye(3))
    model.appendBodyToJoint(arm, body, pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    return pinred.load(model)


@pytest.mark.parametrize("by", [1e-3, 1e-6, 1e-8])
def test_axis_tilted_from_gravity_raises(by: float) -> None:
    """However small the tilt."""
    Potential(leaning(0.0))
    said = r"breaks the SO2 symmetry of .*: rotation about its axis"
    with pytest.raises(pinred.SymmetryError, match=said):
        Potential(leaning(by))


@pytest.mark.parametrize(("part", "heavy"), [(0.9e-10, False), (2e-10, True)])
def test_pivot_beside_centre_of_mass_is_rotated_by_gravity(part: float, heavy: bool) -> None:
    """If the distance is above 1e-10 of the body's size."""
    model, radius = pin.Model(), 0.3
    pivot = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "pivot")
    body = pin.Inertia.FromSphere(2.0, radius)
    body.lever = part * np.sqrt(1.2) * radius * np.eye(3)[0]  # √1.2 r: the radius of gyration
    model.appendBodyToJoint(pivot, body, pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    assert bool(pivot_weight(pinred.load(model)).any()) is heavy


@pytest.mark.parametrize(("by", "acts"), [(0.5e-14, False), (3e-14, True)])
def test_gravity_tilted_from_slide_acts_on_shape(by: float, acts: bool) -> None:
    """If the tilt is above 1e-14, its component across the slide acts on the shape."""
    model = pin.Model()
    for i, kind in enumerate((pin.JointModelPZ(), pin.JointModelRY())):
        joint = model.addJoint(i, kind, pin.SE3.Identity(), f"joint{i}")
        body = pin.Inertia(1.0, np.array([0.0, 0.0, 0.5]), 0.1 * np.eye(3))
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    model.gravity.linear = np.array([9.81 * by, 0.0, -9.81])
    found = Potential(pinred.load(model))
    assert found.is_zero is not acts
    assert (found.direction is None) is not acts


@pytest.mark.parametrize("by", [1e-6, 1e-9])
def test_wheel_off_its_axis_is_not_cyclic(by: float) -> None:
    """By a nanometre, or with moments that differ by this fraction."""
    model = pinred.load("reaction_wheel_satellite").model
    assert cyclic_joints(Reduction(pinred.load(model.copy()))) == (1, 2, 3)
    beside = model.copy()
    beside.inertias[3].lever = beside.inertias[3].lever + by * np.array([0.0, 1.0, 0.0])
    assert cyclic_joints(Reduction(pinred.load(beside))) == (2, 3)
    uneven = model.copy()
    moments = uneven.inertias[3].inertia + by * np.diag([0.0, 0.01, -0.01])
    uneven.inertias[3] = pin.Inertia(uneven.inertias[3].mass, uneven.inertias[3].lever, moments)
    assert cyclic_joints(Reduction(pinred.load(uneven))) == (2, 3)


@pytest.mark.parametrize("far", [0.0, 1.0, 1e3])
def test_balanced_wheel_far_from_root_is_cyclic(far: float) -> None:
    """Round-off of its position is no dependence on its angle."""
    model = pinred.load("reaction_wheel_satellite").model.copy()
    place = model.jointPlacements[3]
    model.jointPlacements[3] = pin.SE3(
        pin.exp3(np.array([0.3, 0.2, 0.1])) @ place.rotation, place.translation + far
    )
    assert 1 in cyclic_joints(Reduction(pinred.load(model)))


@pytest.mark.parametrize("away", [0.0, 1e9])
def test_cyclic_joints_do_not_depend_on_root_placement(away: float) -> None:
    """Changes by a joint are measured about the root, not about the world's origin."""
    model = random_model("SO3", 2, 0)
    model.gravity.setZero()
    model.jointPlacements[1] = pin.SE3(np.eye(3), np.array([0.0, away, 0.0]))
    assert cyclic_joints(Reduction(pinred.load(model))) == ()


def slide(pushed: bool) -> tuple[int, ...]:
    """The cyclic joints of a base that slides, and a slide on it along the same axis."""
    model = pin.Model()
    for i, name in enumerate(("root", "slide")):
        at = model.addJoint(i, pin.JointModelPX(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(at, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.gravity.setZero()
    return cyclic_joints(Reduction(pinred.load(model)), pushed=pushed)


def test_slide_along_base_is_cyclic_without_push() -> None:
    """Its momentum is that in the frame of the centre of mass, which a push moves."""
    assert slide(pushed=False) == (0,)
    assert slide(pushed=True) == ()


def wheel(
    place: pin.SE3, lever: float, moments: list[float], gravity: float, height: float = 0.0
) -> tuple[int, ...]:
    """The cyclic joints of a body on a pivot, with a wheel."""
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "root")
    body = pin.Inertia(2.0, np.array([0.1, 0.0, -0.5]), np.diag([0.3, 0.4, 0.5]))
    model.appendBodyToJoint(base, body, pin.SE3.Identity())
    joint = model.addJoint(base, pin.JointModelRZ(), place, "wheel")
    disc = pin.Inertia(1.0, np.array([lever, 0.0, height]), np.diag(moments))
    model.appendBodyToJoint(joint, disc, pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    system = pinred.load(model)
    assert pivot_weight(system).any() == (gravity > 0.0)
    return cyclic_joints(Reduction(system))


@pytest.mark.parametrize("gravity", [0.0, 9.81, 1e6])
def test_wheels_on_heavy_pivot_are_cyclic_if_balanced(gravity: float) -> None:
    """Cyclic where they carry no weight round, though the mass matrix may not feel that.

    Round an axis through the pivot, moments of (a + m d², a) and a lever of d make none.
    """
    beside = pin.SE3(pin.exp3(np.array([0.4, -0.7, 0.3])), np.array([0.2, 0.1, 0.3]))
    assert wheel(beside, 0.0, [0.1, 0.1, 0.2], gravity) == (0,)
    assert wheel(beside, 0.0, [0.1, 0.1, 0.2], gravity, height=0.3) == (0,)
    assert wheel(beside, 1e-3, [0.1, 0.1, 0.2], gravity) == ()
    through = pin.SE3(beside.rotation, np.zeros(3))
    even = wheel(through, 0.1, [0.11, 0.1, 0.2], gravity)
    assert even == (() if gravity else (0,))


@pytest.mark.parametrize(("moments", "axes"), [
    ([[1.0, 3e-4, 0.0]], "x"), ([[1.0, 3e-3, 0.0]], "x, y"),
    ([[1.0, 0.0, 0.0], [0.0, 0.0, 3e-7]], "x"), ([[1.0, 0.0, 0.0], [0.0, 0.0, 3e-6]], "x, z"),
    ([[1e3, 0.0, 0.0], [0.0, 0.0, 3e-4]], "x"),
])  # fmt: skip
def test_symmetry_error_omits_axes_of_small_moments(moments: list[list[float]], axes: str) -> None:
    """Below a thousandth of the axis, or a millionth of the largest moment."""
    assert potential._axes(np.array(moments)) == axes


def test_cyclic_joints_stop_sampling_once_every_joint_has_an_effect(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Further shapes cannot change the answer, and take seconds for hundreds of joints."""
    red, at = Reduction(pinred.load("planar_chain5")), Reduction.at
    shapes: list[Array] = []

    def record_shape(reduction: Reduction, x: Array) -> Any:
        shapes.append(x)
        return at(reduction, x)

    monkeypatch.setattr(Reduction, "at", record_shape)
    assert cyclic_joints(red) == ()
    assert len(shapes) == 1
