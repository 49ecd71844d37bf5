"""Free and planar joints inside the tree are slides with a ball or a hinge that move alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_texts import joint, link, robot, write
from trees import JOINTS, ROOTS, Rng, inertia, placement

from pinred.common.arrays import Array
from pinred.common.errors import ModelError
from pinred.system.copy_model import split_joints
from pinred.system.passive import SLIDING, Damper, Friction, passive_contents
from pinred.system.read_urdf import read_urdf

FLOATING = {"JointModelFreeFlyer": 3, "JointModelPlanar": 2}  # number of slides of each joint


def tree(seed: int, group: str = "SE3") -> pin.Model:
    """Return a branched tree with free, planar and other joints, with gravity."""
    rng, model = np.random.default_rng(seed), pin.Model()
    kinds = [lambda _: pin.JointModelFreeFlyer(), lambda _: pin.JointModelPlanar(), *JOINTS]
    for k in range(6):
        made = ROOTS[group][0](rng) if k == 0 else kinds[(0, 1, rng.integers(len(kinds)))[k % 3]]
        path = list(model.supports[k])[1:] if k else [0]
        made = made if k == 0 else made(rng)
        i = model.addJoint(path[rng.integers(len(path))], made, placement(rng), f"joint{k}")
        model.appendBodyToJoint(i, inertia(rng), pin.SE3.Identity())
    return model


def state(model: pin.Model, rng: Rng) -> tuple[Array, Array]:
    """Return a random configuration and velocity of a model."""
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-2.0, 2.0, model.nv))
    return q, rng.normal(size=model.nv)


def turns(model: pin.Model, q: Array) -> Array:
    """Return the matrix (nv, nv) from rates of free and planar joints to those of their slides."""
    data, T = model.createData(), np.eye(model.nv)
    pin.forwardKinematics(model, data, q)
    for i in range(2, model.njoints):
        parts = FLOATING.get(model.joints[i].shortname(), 0)
        turn = (model.jointPlacements[i].inverse() * data.liMi[i]).rotation
        rows = slice(model.joints[i].idx_v, model.joints[i].idx_v + parts)
        T[rows, rows] = turn[:parts, :parts]
    return T


def drift(model: pin.Model, v: Array) -> Array:
    """Return ω × v of the slides of free and planar joints, in the child's axes, (nv,)."""
    rates = np.zeros(model.nv)
    for i in range(2, model.njoints):
        k, parts = model.joints[i].idx_v, FLOATING.get(model.joints[i].shortname(), 0)
        if parts:
            omega = v[k + 3 : k + 6] if parts == 3 else np.array([0.0, 0.0, v[k + 2]])
            rates[k : k + parts] = np.cross(omega, [*v[k : k + parts], 0.0][:3])[:parts]
    return rates


@pytest.mark.parametrize("seed", range(12))
def test_split_tree_accelerates_like_the_original(seed: int) -> None:
    """ABA of both models at random states, with torques, and with armature except on slides.

    Pinocchio's armature acts on the rates of components, which is not Lagrangian for the slides of
    a free joint.  Therefore only the mass matrices are compared with their armature.
    """
    model, rng = tree(seed, sorted(ROOTS)[seed % len(ROOTS)]), np.random.default_rng(seed)
    for i in range(2, model.njoints):
        joint = model.joints[i]
        parts = FLOATING.get(joint.shortname(), 0)
        model.armature[joint.idx_v + parts : joint.idx_v + joint.nv] = rng.uniform(0.0, 0.5)
    split = split_joints(model).model
    assert not {j.shortname() for j in split.joints[2:]} & {*FLOATING}
    q, v = state(model, rng)
    tau = rng.normal(size=model.nv)
    T = turns(model, q)
    a = pin.aba(model, model.createData(), q, v, tau)
    expected = T @ (a + drift(model, v))
    # Virtual power is the same: the torque on the slides is that on the joint, turned alike.
    computed = pin.aba(split, split.createData(), q, T @ v, T @ tau)
    assert np.abs(computed - expected).max() <= 1e-12 * max(1.0, np.abs(expected).max())
    model.armature[model.joints[1].nv :] = 0.3
    split = split_joints(model).model
    H, D = (pin.crba(m, m.createData(), q, pin.Convention.WORLD) for m in (model, split))
    assert np.abs(T.T @ D @ T - H).max() <= 1e-13 * np.abs(H).max()


def test_parts_have_the_armature_and_names_of_the_joint() -> None:
    """A ball without limits keeps the three angular entries."""
    model = tree(0)
    at = model.joints[model.getJointId("joint3")].idx_v
    model.armature[at : at + 6] = [0.1, 0.1, 0.1, 0.2, 0.2, 0.2]
    model.damping[at : at + 6] = [0.3, 0.3, 0.3, 0.4, 0.5, 0.6]
    model.upperDryFrictionLimit[at + 4] = 0.7
    split = split_joints(model)
    parts = ("joint3.x", "joint3.y", "joint3.z", "joint3.ball")
    assert split.parts["joint3"] == parts
    ball = split.model.joints[split.model.getJointId("joint3.ball")]
    rates = slice(ball.idx_v, ball.idx_v + 3)
    assert ball.shortname() == "JointModelSpherical"
    assert split.model.armature[rates] == pytest.approx([0.2, 0.2, 0.2])
    assert split.model.damping[rates] == pytest.approx([0.4, 0.5, 0.6])
    assert split.model.upperDryFrictionLimit[rates] == pytest.approx([0.0, 0.7, 0.0])
    assert split.locked({"joint3": 0.0}) == dict.fromkeys(parts, 0.0)
    model.armature[at] = 0.2
    with pytest.raises(ModelError, match=r"'joint3' has armature .* equal"):
        split_joints(model)


def test_floating_joint_of_urdf_is_read(tmp_path: Path) -> None:
    """Inside the tree a floating joint is three slides and a ball."""
    text = robot(*(link(name) for name in "abc"), joint("a", "b", content="<axis xyz='1 0 0'/>"))
    path = write(tmp_path, text.replace("</robot>", joint("b", "c", "floating", "") + "</robot>"))
    split = split_joints(read_urdf(path).model)
    assert list(split.model.names)[2:] == ["b-c.x", "b-c.y", "b-c.z", "b-c.ball"]


def test_friction_and_damping_of_a_free_joint_are_reported() -> None:
    """Friction against sliding is left out; damping of the ball acts along its axes."""
    model = tree(0)
    at = model.joints[model.getJointId("joint3")].idx_v
    model.upperDryFrictionLimit[at] = model.damping[at + 3] = 0.7
    model.upperDryFrictionLimit[at + 4], model.lowerDryFrictionLimit[at + 4] = 0.4, -0.4
    split = split_joints(model)
    assert split.sliding == ("joint3",)
    contents = passive_contents(split.model, list(split.model.names)[2:], (), split.sliding)
    assert contents.passive == (Damper("joint3.ball.x", 0.7), Friction("joint3.ball.y", 0.4))
    assert [(left.what, left.names) for left in contents.left_out] == [(SLIDING, ("joint3",))]
