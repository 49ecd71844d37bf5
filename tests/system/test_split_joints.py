"""Joints with several degrees of freedom become hinges and slides that move alike."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import aba
import numpy as np
import pinocchio as pin
import pytest
from backward_error import backward_error, kinetic_size
from robot_texts import joint, link, robot, write
from trees import ROOTS, Rng, inertia, placement, unit

import pinred
from pinred.common.arrays import Array
from pinred.equations import lagrange_poincare
from pinred.system.copy_model import TYPES, split_joints
from pinred.system.passive import SLIDING, Damper, Friction


def composite(*joints: pin.JointModel, rng: Rng | None = None) -> pin.JointModel:
    """Return a composite joint, with random placements between its joints if `rng` is given."""
    whole = pin.JointModelComposite()
    for part in joints:
        whole.addJoint(part, pin.SE3.Identity() if rng is None else placement(rng))
    return whole


def universal(rng: Rng) -> pin.JointModel:
    """Return a universal joint with random perpendicular axes."""
    first, other = unit(rng), unit(rng)
    second = np.cross(first, other)
    return pin.JointModelUniversal(first, second / np.linalg.norm(second))


KINDS: dict[str, Callable[[Rng], pin.JointModel]] = {
    "universal": universal,
    "Euler angles": lambda _: pin.JointModelSphericalZYX(),
    "planar": lambda _: pin.JointModelPlanar(),
    "translation": lambda _: pin.JointModelTranslation(),
    "screw along x": lambda _: pin.JointModelHX(0.3),
    "screw along y": lambda _: pin.JointModelHY(-0.2),
    "screw along z": lambda _: pin.JointModelHZ(0.1),
    "screw": lambda rng: pin.JointModelHelicalUnaligned(unit(rng), -0.4),
    "cylindrical": lambda _: composite(pin.JointModelRX(), pin.JointModelPX()),
    "with placements": lambda rng: composite(
        pin.JointModelRX(), pin.JointModelRUBY(), pin.JointModelPZ(), rng=rng
    ),
    "nested": lambda rng: composite(
        pin.JointModelPlanar(), composite(pin.JointModelHZ(0.1), universal(rng)), rng=rng
    ),
}


def tree(kinds: list[str], seed: int, group: str = "SE3") -> pin.Model:
    """Return a branched tree with joints of some kinds, without gravity."""
    rng, model = np.random.default_rng(seed), pin.Model()
    model.name = f"tree-{seed}"
    model.gravity.setZero()
    for k, kind in enumerate([None, *kinds]):
        made = ROOTS[group][0](rng) if kind is None else KINDS[kind](rng)
        path = list(model.supports[k])[1:] if k else [0]
        i = model.addJoint(path[rng.integers(len(path))], made, placement(rng), f"joint{k}")
        model.appendBodyToJoint(i, inertia(rng), pin.SE3.Identity())
    return model


def raw_coordinates(system: pinred.System, pose: Array, x: Array) -> Array:
    """Return the configuration of the model that was split, (nq,)."""
    q = list(system.q(pose, x)[: system.model.joints[1].nq])
    for name, value in zip(system.shape_names, x, strict=True):
        unbounded = system.model.joints[system.model.getJointId(name)].nq == 2
        q += [np.cos(value), np.sin(value)] if unbounded else [value]
    return np.array(q)


def turned(system: pinred.System, x: Array, rates: Array, sign: float) -> Array:
    """Rotate the slides' rates of planar joints to the axes of the child (−1), or back (1)."""
    rates, names = rates.copy(), list(system.shape_names)
    for k, name in enumerate(names):
        if name.endswith(".turn"):
            c, s = np.cos(sign * x[k]), np.sin(sign * x[k])
            rates[k - 2 : k] = [[c, -s], [s, c]] @ rates[k - 2 : k]
    return rates


def raw_accelerations(raw: pin.Model, system: pinred.System, *state: Array) -> Array:
    """Return (ξ̇, ẍ) by ABA of the model that was split, at a state (pose, x, ξ, ẋ)."""
    pose, x, xi, xdot = state
    v = np.concatenate([xi, turned(system, x, xdot, -1.0)])
    a = pin.aba(raw, raw.createData(), raw_coordinates(system, pose, x), v, np.zeros(raw.nv))
    a, r = np.array(a), system.r
    # With v = Rᵀ ẋ, the accelerations are ẍ = R (v̇ + θ̇ e_z × v).
    for k, name in enumerate(system.shape_names, start=r):
        if name.endswith(".turn"):
            a[k - 2 : k] += v[k] * np.array([-v[k - 1], v[k - 2]])
    return np.concatenate([a[:r], turned(system, x, a[r:], 1.0)])


@pytest.mark.filterwarnings("ignore:.*mass matrix is singular at single shapes")
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.sampled(4)
def test_equations_of_split_tree_agree_with_aba_of_the_original(seed: int) -> None:
    """Three joints of random kinds; Pinocchio's ABA is right for all of them."""
    rng = np.random.default_rng(1000 + seed)
    kinds = [*np.array(list(KINDS))[(seed + np.arange(2)) % len(KINDS)], rng.choice([*KINDS])]
    raw = tree(kinds, seed, sorted(ROOTS)[seed % len(ROOTS)])
    system = pinred.load(raw)
    pose = system.group.exp(rng.uniform(-1.5, 1.5, system.r))
    x, xdot, xi = rng.uniform(-1, 1, system.m), rng.normal(size=system.m), rng.normal(size=system.r)
    red = pinred.Reduction(system)
    terms = lagrange_poincare(red, x, xdot, red.locked_velocity(x, xdot, xi))
    H, v = red.mass_matrix(x), np.concatenate([xi, xdot])
    expected = raw_accelerations(raw, system, pose, x, xi, xdot)
    computed = np.concatenate([terms.xidot, terms.xddot])
    size = (terms.shape, terms.momentum, kinetic_size(H, v), np.abs(H) @ np.abs(expected))
    assert backward_error(H, computed, expected, *size) <= 1e-13


def test_motion_of_split_joints_agrees_with_aba_of_the_original() -> None:
    """A planar joint, a screw and a universal joint over one second."""
    raw = tree(["planar", "screw", "universal"], 5)
    system, rng = pinred.load(raw), np.random.default_rng(5)
    x0, xdot0 = rng.uniform(-1, 1, system.m), rng.normal(size=system.m)
    traj = pinred.simulate(system, x0=x0, xdot0=xdot0, xi0=rng.normal(size=6), duration=1.0)
    assert pinred.compare(traj).passed
    v0 = np.concatenate([traj.xi[0], turned(system, x0, xdot0, -1.0)])
    q, _ = aba.integrate(raw, raw_coordinates(system, traj.pose[0], x0), v0, traj.t)
    found = [raw_coordinates(system, *row) for row in zip(traj.pose, traj.x, strict=True)]
    assert aba.max_difference(raw, np.array(found), q) < 1e-8


def test_every_type_is_split() -> None:
    """Each registered type has a joint in the tests above."""
    made = {KINDS[kind](np.random.default_rng(0)).shortname() for kind in KINDS}
    made |= {"JointModelFreeFlyer"}  # in test_free_joints.py
    assert {f"JointModel{kind}" for kind in TYPES} <= made


def test_names_limits_and_armature_are_kept() -> None:
    """Coordinates of the parts are those of the joint, in the same order."""
    raw = tree(["planar", "screw", "Euler angles"], 3)
    raw.armature = np.concatenate([np.zeros(6), [0.2, 0.2, 0.1], [0.3], [0.4, 0.5, 0.6]])
    raw.lowerPositionLimit = -np.arange(float(raw.nq))
    raw.upperPositionLimit = np.arange(float(raw.nq))
    system = pinred.load(raw)
    names = ["joint1.x", "joint1.y", "joint1.turn", "joint2"]
    assert system.shape_names == (*names, "joint3.yaw", "joint3.pitch", "joint3.roll")
    assert [str(c) for c in system.couplings] == ["joint2.slide = -0.4·joint2"]
    model = system.model
    armature = {n: model.armature[model.joints[model.getJointId(n)].idx_v] for n in model.names[2:]}
    assert [*armature.values()] == pytest.approx([0.2, 0.2, 0.1, 0.3, 0.0, 0.4, 0.5, 0.6])
    upper = {n: model.upperPositionLimit[model.joints[model.getJointId(n)].idx_q] for n in armature}
    expected = [7.0, 8.0, np.inf, 11.0, np.inf, 12.0, 13.0, 14.0]
    assert [*upper.values()] == pytest.approx(expected)
    assert model.lowerPositionLimit[model.joints[2].idx_q] == -7.0


def test_inertia_of_body_moves_with_the_last_part() -> None:
    """Frames too."""
    raw = tree(["planar"], 1)
    raw.addFrame(pin.Frame("tool", 2, 0, placement(np.random.default_rng(0)), pin.OP_FRAME))
    model = pinred.load(raw).model
    last = model.getJointId("joint1.turn")
    assert model.inertias[last].isApprox(raw.inertias[2])
    assert model.frames[model.getFrameId("tool")].parentJoint == last


def test_unequal_armature_or_damping_in_a_plane_is_refused() -> None:
    """Along axes that turn with the body, unequal values are not constant along the slides."""
    raw = tree(["planar"], 2)
    raw.armature = np.array([*np.zeros(6), 0.2, 0.3, 0.1])
    with pytest.raises(pinred.ModelError, match=r"'joint1' has armature \[0.2 0.3\].*equal"):
        pinred.load(raw)
    raw.armature = np.zeros(9)
    raw.damping = np.array([*np.zeros(6), 0.2, 0.1, 0.1])
    with pytest.raises(pinred.ModelError, match=r"'joint1' has damping \[0.2 0.1\]"):
        pinred.load(raw)


def planar_arm(tmp_path: Path, dynamics: str) -> Path:
    """Return a URDF file with a planar joint inside the tree."""
    inside = f'<axis xyz="0 0 1"/>{dynamics}'
    text = robot(*(link(name) for name in "abc"), joint("a", "b", content="<axis xyz='1 0 0'/>"))
    return write(tmp_path, text.replace("</robot>", joint("b", "c", "planar", inside) + "</robot>"))


def test_dynamics_of_planar_joint_are_read_or_reported(tmp_path: Path) -> None:
    """Damping acts along the parts. Dry friction acts along the direction of sliding."""
    with pytest.warns(pinred.LeftOutWarning, match=re.escape(SLIDING)):
        system = pinred.load(planar_arm(tmp_path, '<dynamics damping="0.5" friction="0.2"/>'))
    assert system.shape_names == ("a-b", "b-c.x", "b-c.y", "b-c.turn")
    damped = [Damper(name, 0.5) for name in system.shape_names[1:]]
    assert set(system.passive) == {*damped, Friction("b-c.turn", 0.2)}
    assert (SLIDING, ("b-c",)) in [(left.what, left.names) for left in system.left_out]


def test_locks_apply_to_a_joint_or_to_its_parts(tmp_path: Path) -> None:
    """A screw has one value; a planar joint can be locked at zero, and each part at any value."""
    path = planar_arm(tmp_path, "")
    assert pinred.load(path, lock=["b-c"]).shape_names == ("a-b",)
    assert pinred.load(path, lock={"b-c.x": 0.3}).shape_names == ("a-b", "b-c.y", "b-c.turn")
    with pytest.raises(pinred.InputError, match=r"3 degrees of freedom.*b-c.x, b-c.y, b-c.turn"):
        pinred.load(path, lock={"b-c": 0.3})
    raw, q = tree(["screw"], 4), 0.7
    motion, screw = raw.joints[2].createData(), raw.joints[2]
    screw.calc(motion, np.append(pin.neutral(raw)[:7], q))
    whole = raw.inertias[1] + raw.inertias[2].se3Action(raw.jointPlacements[2] * motion.M)
    locked = pinred.load(raw, lock={"joint1": q})
    assert locked.m == 0
    assert locked.model.inertias[1].isApprox(whole, 1e-12)


def test_balls_are_parts_of_composites_and_stay_joints() -> None:
    """A ball is not a product of hinges that is regular everywhere."""
    for kind, names in (
        (pin.JointModelSpherical(), ["neck"]),
        (composite(pin.JointModelRX(), pin.JointModelSpherical()), ["neck.1", "neck.2"]),
    ):
        model = pin.Model()
        root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
        i = model.addJoint(root, kind, pin.SE3.Identity(), "neck")
        for k in (root, i):
            model.appendBodyToJoint(k, inertia(np.random.default_rng(k)), pin.SE3.Identity())
        split = split_joints(model).model
        assert list(split.names)[2:] == names
        assert split.joints[split.njoints - 1].shortname() == "JointModelSpherical"


def test_pinocchio_derivatives_are_wrong_for_universal_joints() -> None:
    """The reason for splitting: if this test fails, Pinocchio is mended."""
    model = pin.Model()
    universal = pin.JointModelUniversal(*np.eye(3)[:2])
    i = model.addJoint(0, universal, pin.SE3.Identity(), "cross")
    body = pin.Inertia(1.0, np.array([0.1, 0.2, 0.3]), np.diag([1.0, 2.0, 2.5]))
    model.appendBodyToJoint(i, body, pin.SE3.Identity())
    model.gravity.setZero()
    data, q, v = model.createData(), np.array([0.3, 0.5]), np.array([0.4, -0.6])
    wrong = pin.computeCoriolisMatrix(model, data, q, v) @ v
    assert np.abs(wrong - pin.nonLinearEffects(model, data, q, v)).max() > 0.1
