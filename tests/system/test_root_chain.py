"""Consecutive joints at the root become one joint with the same motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_texts import joint, link, robot, write
from trees import inertia

import pinred
from pinred.common.arrays import Array
from pinred.lie import GROUPS


def at(place: str, kind: str, axis: str, ends: str = "w-c") -> str:
    """Return a joint between two links at "xyz / rpy", about or along an axis."""
    xyz, rpy = place.split("/")
    parent, child = ends.split("-")
    text = joint(parent, child, kind, f'<axis xyz="{axis}"/>')
    return text.replace('xyz="0 0.2 0.3" rpy="0.1 0.2 0.3"', f'xyz="{xyz}" rpy="{rpy}"')


HERE, THERE = "0 0 0/0 0 0", "1 -2 0.5/0.3 -0.8 1.1"
X, Y, Z = "1 0 0", "0 1 0", "0 0 1"
ON_ITS_SIDE = "0.3 0 0.2/0 -1.5707963267948966 0"  # The x axis of the link is the normal.
CHAINS = {
    "climb, plane": ("RxSE2", [at(THERE, "prismatic", Z), at(HERE, "planar", Z, "c-d")]),
    "climb, turned plane": (
        "RxSE2",
        [at(THERE, "prismatic", X), at("1 2 3/0 1.5707963267948966 0", "planar", Z, "c-d")],
    ),
    "plane, climb": ("RxSE2", [at(THERE, "planar", Z), at(HERE, "prismatic", Z, "c-d")]),
    "plane, climb beside it": (
        "RxSE2", [at(THERE, "planar", Z), at("0.2 0.1 0.3/0 0 0.7", "prismatic", Z, "c-d")],
    ),
    "plane, climb on its side": (
        "RxSE2", [at(THERE, "planar", Z), at(ON_ITS_SIDE, "prismatic", X, "c-d")],
    ),
    "plane, descent": ("RxSE2", [at(THERE, "planar", Z), at(HERE, "prismatic", "0 0 -1", "c-d")]),
    "two slides, a hinge": (
        "SE2",
        [
            at(THERE, "prismatic", Y),
            at(HERE, "prismatic", X, "c-e"),
            at(HERE, "continuous", Z, "e-d"),
        ],
    ),
    "a gimbal": (
        "SO3",
        [at(THERE, "revolute", Z), at(HERE, "revolute", Y, "c-e"), at(HERE, "revolute", X, "e-d")],
    ),
}  # fmt: skip


def text_of(joints: list[str]) -> str:
    """Return a robot whose link d is at the end of a chain and carries an arm."""
    between = [link(name, 0) for name in "we"[: len(joints) - 1]] + [link("c", 0)]
    arm = joint("d", "a", content='<axis xyz="1 1 0"/>')
    return robot(*between, link("d"), link("a"), *joints, arm)


@pytest.mark.parametrize("row", CHAINS.values(), ids=CHAINS.keys())
def test_chain_has_motion_and_energy_of_its_joints(
    tmp_path: Path, row: tuple[str, list[str]]
) -> None:
    """The group's joint moves the links to where Pinocchio's separate joints move them."""
    group, joints = row
    path = write(tmp_path, text_of(joints))
    raw, system = pin.buildModelFromUrdf(str(path)), pinred.load(path)
    assert (system.group.name, system.shape_names) == (group, ("d-a",))
    assert system.root_name == "+".join(list(raw.names)[1 : 1 + len(joints)])
    model, rng = system.model, np.random.default_rng(0)
    data, reached = raw.createData(), model.createData()
    last = model.frames[model.getFrameId("d")].placement
    for _ in range(5):
        q = pin.integrate(raw, pin.neutral(raw), rng.uniform(-1.0, 1.0, raw.nv))
        v = rng.normal(size=raw.nv)
        pin.forwardKinematics(raw, data, q, v)
        pin.updateFramePlacements(raw, data)
        place = data.oMf[raw.getFrameId("d")]
        relative = model.jointPlacements[1].actInv(place) * last.inverse()
        pose = system.group.pose(_matrix(system.group.name, relative.homogeneous))
        twist = last.act(pin.getFrameVelocity(raw, data, raw.getFrameId("d"), pin.LOCAL)).vector
        xi = twist[list(system.group.axes)]
        assert (
            np.abs(np.delete(twist, system.group.axes)).max() < 1e-14
        )  # No other component moves.
        own = system.q(pose, [np.arctan2(*q[[-1, -2]]) if raw.joints[-1].nq == 2 else q[-1]])
        pin.framesForwardKinematics(model, reached, own)
        for name in "wda":
            true = data.oMf[raw.getFrameId(name)]
            assert reached.oMf[model.getFrameId(name)].isApprox(true, 1e-12), name
        energy = pin.computeKineticEnergy(model, reached, own, system.v(xi, v[-1:]))
        assert energy == pytest.approx(pin.computeKineticEnergy(raw, data, q, v), rel=1e-12)


def _matrix(group: str, placement: Array) -> Array:
    """Return a homogeneous matrix as the group stores it."""
    keep = {"SE2": [0, 1, 3], "SO3": [0, 1, 2]}.get(group, [0, 1, 2, 3])
    return placement[np.ix_(keep, keep)]


CLIMBING = [at(THERE, "prismatic", Z), at(HERE, "planar", Z, "c-d")]


def test_simulated_chain_matches_aba(tmp_path: Path) -> None:
    """Gravity has a random direction."""
    path = write(tmp_path, text_of(CLIMBING))
    system = pinred.load(path, gravity=(1.0, -2.0, -9.0))
    report = pinred.compare(pinred.simulate(system, seed=1, duration=1.0))
    assert report.passed, str(report)


def test_partly_locked_chain_is_smaller_group(tmp_path: Path) -> None:
    """The remaining joints of the chain form a smaller group."""
    path = write(tmp_path, text_of(CLIMBING))
    for locked, group in (("w-c", "SE2"), ("c-d", "R")):
        system = pinred.load(path, lock=[locked])
        assert (system.group.name, system.shape_names) == (group, ("d-a",))
    with pytest.raises(pinred.ModelError, match=r"w-c\+c-d.*group RxSE2.*lock 'w-c' or 'c-d'"):
        pinred.load(path, group="SE2")
    assert pinred.load(path, group="RxSE2").r == 4


def test_dependent_or_tilted_joints_are_no_chain(tmp_path: Path) -> None:
    """A slide in the plane moves no mass by itself; one slightly off the normal is a joint."""
    joints = [at(THERE, "planar", Z), at(HERE, "prismatic", X, "c-d")]
    with pytest.raises(pinred.ModelError, match=r"link 'c' .* has no mass.*at no shape"):
        pinred.load(write(tmp_path, text_of(joints)))
    joints[1] = at(HERE, "prismatic", "5e-9 0 1", "c-d")
    system = pinred.load(write(tmp_path, text_of(joints)))
    assert (system.group.name, system.m) == ("SE2", 2)
    report = pinred.compare(pinred.simulate(system, seed=1, duration=0.5))
    assert report.passed, str(report)
    branched = text_of(CLIMBING).replace("</robot>", "") + link("z") + joint("c", "z") + "</robot>"
    system = pinred.load(write(tmp_path, branched))
    assert system.group.name == "R"
    assert system.shape_names[:3] == ("c-d.x", "c-d.y", "c-d.turn")


def test_universal_joint_and_hinge_are_a_gimbal() -> None:
    """They consist of three perpendicular hinges."""
    model = pin.Model()
    i = model.addJoint(0, pin.JointModelUniversal(*np.eye(3)[:2]), pin.SE3.Identity(), "cross")
    i = model.addJoint(i, pin.JointModelRZ(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(i, inertia(np.random.default_rng(0)), pin.SE3.Identity())
    system = pinred.load(model)
    assert (system.group.name, system.root_name) == ("SO3", "cross.1+cross.2+hinge")


def test_armature_in_chain_is_refused(tmp_path: Path) -> None:
    """A root with several axes cannot have armature."""
    raw = pin.buildModelFromUrdf(str(write(tmp_path, text_of(CLIMBING))))
    raw.armature = np.array([0.5, 0.0, 0.0, 0.0, 0.1])
    with pytest.raises(pinred.ModelError, match=r"w-c\+c-d.*armature \[0.5"):
        pinred.load(raw)
    raw.armature = np.array([0.0, 0.0, 0.0, 0.0, 0.1])
    assert pinred.load(raw).model.armature == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.1])


def test_composite_root_joint() -> None:
    """A composite joint is a root unless it has inner placements."""
    whole = pin.JointModelComposite()
    whole.addJoint(pin.JointModelPZ())
    whole.addJoint(pin.JointModelPlanar())
    moved = pin.JointModelComposite()
    moved.addJoint(pin.JointModelPZ())
    moved.addJoint(pin.JointModelPlanar(), pin.SE3(np.eye(3), np.array([0.0, 0.1, 0.0])))
    models = []
    for kind in (whole, moved):
        model = pin.Model()
        i = model.addJoint(0, kind, pin.SE3.Identity(), "root")
        model.appendBodyToJoint(i, inertia(np.random.default_rng(0)), pin.SE3.Identity())
        models.append(model)
    assert pinred.load(models[0]).group is GROUPS["RxSE2"]
    with pytest.raises(pinred.ModelError, match="'root' is of kind Composite; a root moves in R, "):
        pinred.System(models[1])
