"""The potential on shapes: heights body by body, springs in closed form, slopes by differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from coupled_trees import make_case
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.lie import GROUPS
from pinred.reduction.potential import (
    Potential,
    acting_gravity,
    broken_by_gravity,
    falling,
    pivot_weight,
    shape_gravity,
    translations,
)
from pinred.system.joints import axes_of

SPRINGS = {0: (3.0, 0.4), 2: (5.0, -0.7)}  # of the first and the third joint


def hung(group: str, joints: int = 3) -> tuple[pinred.System, Array, Array]:
    """Return a tree in gravity that keeps its symmetry, its slides (3, k), and what acts (3,).

    All in the world's axes.
    """
    model = random_model(group, joints, 4)
    S = model.jointPlacements[1].rotation @ axes_of(model.joints[1])[:3]
    slides = S[:, np.abs(S).sum(axis=0) > 0.0]
    gravity = np.array([1.0, -2.0, 3.0])
    if group in ("SO2", "SE2", "RxSE2"):  # along the axis of the turn
        axis = model.jointPlacements[1].rotation @ axes_of(model.joints[1])[3:, -1]
        gravity = 4.0 * axis + slides @ np.arange(1.0, slides.shape[1] + 1.0)
    if group == "SO3":
        gravity = np.zeros(3)
    model.gravity.linear = gravity
    return pinred.load(model), slides, gravity - slides @ (slides.T @ gravity)


def height(system: pinred.System, acting: Array, x: Array) -> float:
    """Return −Σ m g·c of all bodies at a shape, where the base has not moved."""
    model, data = system.model, system.model.createData()
    pin.forwardKinematics(model, data, system.q(system.group.identity(), x))
    weights = [body.mass * acting for body in model.inertias[1:]]
    places = [at.act(body.lever) for at, body in zip(data.oMi, model.inertias, strict=True)][1:]
    return -float(np.sum(np.array(weights) * np.array(places)))


def sprung(x: Array) -> float:
    """Return the energy of the springs."""
    return float(sum(0.5 * k * (x[i] - rest) ** 2 for i, (k, rest) in SPRINGS.items()))


@pytest.mark.parametrize("springs", [False, True])
@pytest.mark.parametrize("group", GROUPS)
def test_potential_and_gradient_have_closed_form(group: str, springs: bool) -> None:
    """Gravity across the translations and springs: −m g·c + ½ k (x − r)², from any base."""
    system, slides, acting = hung(group)
    names = system.shape_names
    given = {names[k]: pair for k, pair in SPRINGS.items()} if springs else None
    potential = Potential(system, given)
    root = system.model.jointPlacements[1].rotation
    assert falling(system) == pytest.approx(slides.T @ system.gravity)
    assert root @ translations(system) == pytest.approx(slides)
    acts = float(np.linalg.norm(acting)) > 1e-9
    assert acts == (group not in ("SO3", "SE3", "RxSE2"))
    assert potential.is_zero is not (acts or springs)
    if acts:
        assert potential.direction == pytest.approx(root.T @ acting)
    else:
        assert potential.direction is None
    rng, data = np.random.default_rng(0), system.model.createData()
    for x in rng.uniform(-2.0, 2.0, (3, system.m)):

        def whole(at: Array) -> float:
            return height(system, acting, at) + (sprung(at) if springs else 0.0)

        q = system.q(system.group.identity(), x)
        pin.forwardKinematics(system.model, data, q)
        com = data.oMi[1].actInv(pin.centerOfMass(system.model, data, q))
        identity = system.model.jointPlacements[1].actInv(data.oMi[1])
        com = identity.act(com)  # of a base that has not moved
        assert potential.value(x) == pytest.approx(whole(x))
        assert potential.value_at(x, com) == pytest.approx(whole(x))
        assert potential.values(x[None], com[None]) == pytest.approx([whole(x)])
        h = 1e-5 * np.eye(system.m)
        slopes = [(whole(x + a) - whole(x - a)) / 2e-5 for a in h]
        assert potential.gradient(x) == pytest.approx(slopes, rel=1e-7, abs=1e-7)


def test_body_without_joints_has_zero_potential() -> None:
    """A body without joints on a slide across gravity: gravity acts, but moves no joint."""
    system, _, acting = hung("R", 0)
    potential = Potential(system)
    assert potential.is_zero
    assert potential.direction == pytest.approx(system.model.jointPlacements[1].rotation.T @ acting)
    assert potential.gradient(np.zeros(0)).shape == (0,)
    assert Potential(system, weight=False).direction is None


def pivot(
    lever: float, gravity: Array, turn: Array, at: tuple[float, ...] = (3.0, -4.0, 5.0)
) -> pinred.System:
    """Return a body of 2 kg on a pivot that is turned, and a wheel of 1 kg on it."""
    model = pin.Model()
    place = pin.SE3(pin.exp3(turn), np.array(at))
    root = model.addJoint(0, pin.JointModelSpherical(), place, "pivot")
    body = pin.Inertia(2.0, np.array([lever, 0.0, 0.0]), np.diag([0.2, 0.3, 0.4]))
    model.appendBodyToJoint(root, body, pin.SE3.Identity())
    wheel = model.addJoint(root, pin.JointModelRX(), pin.SE3.Identity(), "wheel")
    model.appendBodyToJoint(wheel, pin.Inertia.FromSphere(1.0, 0.2), pin.SE3.Identity())
    model.gravity.linear = gravity
    return pinred.load(model)


def test_pivot_weight_is_gravity_force_in_root_frame() -> None:
    """It is zero if gravity does not rotate the base."""
    gravity, turn = np.array([1.0, -2.0, 3.0]), np.array([0.3, 0.2, -0.5])
    back = pin.exp3(turn).T
    heavy, light = pivot(0.3, gravity, turn), pivot(0.0, gravity, turn, (2.0, 4.0, 2.0))
    assert gravity @ [2.0, 4.0, 2.0] == 0.0
    assert pivot_weight(heavy) == pytest.approx(3.0 * back @ gravity)
    assert acting_gravity(heavy) == pytest.approx(back @ gravity)
    assert "world's x, y, z axes" in broken_by_gravity(heavy)
    assert shape_gravity(heavy).is_zero
    assert pivot_weight(light).tolist() == acting_gravity(light).tolist() == [0.0] * 3
    assert broken_by_gravity(light) == ""
    assert shape_gravity(light).is_zero
    lifted = pivot(0.0, gravity, turn)  # turned by no moment, so that its height has an energy
    assert pivot_weight(lifted) == pytest.approx(3.0 * back @ gravity)
    assert broken_by_gravity(lifted) == ""
    hinge, _, acting = hung("SO2")
    assert pivot_weight(hinge).tolist() == [0.0] * 3
    root = hinge.model.jointPlacements[1].rotation
    assert acting_gravity(hinge) == pytest.approx(root.T @ acting)
    assert not shape_gravity(hinge).is_zero


@pytest.mark.parametrize(("part", "lifted"), [(0.9e-12, False), (1.1e-12, True), (-1.1e-12, True)])
def test_pivot_weight_of_raised_pivot(part: float, lifted: bool) -> None:
    """A height of 1e-12 of the distance from the world's origin, above or below it."""
    system = pivot(0.0, np.array([0.0, 0.0, -9.0]), np.zeros(3), (2.0, 0.0, 2.0 * part))
    assert pivot_weight(system).any() == lifted


@pytest.mark.parametrize(("part", "kept"), [(3e-16, False), (6e-16, True)])
def test_acting_gravity_drops_round_off(part: float, kept: bool) -> None:
    """Entries below 4e-16 of the acting gravity are zero."""
    for size in (1e-3, 1e6):
        found = acting_gravity(pivot(0.3, size * np.array([part, 0.0, -1.0]), np.zeros(3)))
        assert found.tolist() == [part * size if kept else 0.0, 0.0, -size]


@pytest.mark.parametrize(("part", "broken"), [(0.9e-10, False), (1.1e-10, True)])
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_small_gravity_moment_keeps_symmetry(part: float, broken: bool, size: float) -> None:
    """About a hinge: 1e-10 of the weight times the distance of the centre of mass, or gyration."""
    for lever, radius, along in ((1.0, 0.0, 0.0), (0.1, 1.0, 0.0), (0.1, 0.0, 1.0)):
        model, mass, away = pin.Model(), 20.0 / size, pin.SE3(np.eye(3), np.array([3e6, 0, 0]))
        root = model.addJoint(0, pin.JointModelRZ(), away, "hinge")
        moments = mass * (radius * size) ** 2 * np.eye(3)
        body = pin.Inertia(mass, size * np.array([lever, 0.0, along]), moments)
        model.appendBodyToJoint(root, body, pin.SE3.Identity())
        reach = np.hypot(lever, max(radius, along))
        # The axis leans by a small angle, so that the weight has a moment of that part about it.
        model.gravity.linear = size * np.array([0.0, part * reach / lever, -1.0])
        assert bool(broken_by_gravity(pinred.load(model))) is broken


def test_symmetry_error_names_hinge_axis() -> None:
    """By its direction in the world, with length one."""
    model, axis = pin.Model(), np.array([0.6, 0.0, 0.8])
    root = model.addJoint(
        0, pin.JointModelRevoluteUnaligned(axis), pin.SE3(np.eye(3), np.ones(3)), "hinge"
    )
    body = pin.Inertia(20.0, np.array([0.0, 0.7, 0.0]), np.eye(3))
    model.appendBodyToJoint(root, body, pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    said = broken_by_gravity(pinred.load(model))
    assert "rotation about its axis (0.6, 0, 0.8), which is not along gravity" in said


def test_invalid_springs_raise_and_name_joint() -> None:
    """Unknown or following joints, or values that are not pairs."""
    system = pinred.load("planar_chain5")
    name = system.shape_names[0]
    pairs: list[Any] = [(1.0,), (1.0, 2.0, 3.0), (np.inf, 0.0), (1.0, np.nan)]
    for pair in pairs:
        with pytest.raises(pinred.InputError, match=f"springs\\['{name}'\\] must be"):
            Potential(system, {name: pair})
    with pytest.raises(pinred.InputError, match="springs: no shape joint 'wing'; the joints are"):
        Potential(system, {name: (1.0, 0.0), "wing": (1.0, 0.0)})
    coupled = make_case("SE3", 5, 0).system
    follower = coupled.couplings[0].follower
    with pytest.raises(pinred.InputError, match=f"springs: .*{follower}.* follows"):
        Potential(coupled, {follower: (1.0, 0.0)})
