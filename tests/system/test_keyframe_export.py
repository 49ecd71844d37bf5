"""Keyframes of MuJoCo that pinred writes, read by MuJoCo and by pinred."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import pinred
from pinred.common.errors import InputError

BODY = '<inertial pos=".1 .02 0" mass="2" diaginertia=".2 .3 .4"/>'
ROOTS = {
    "free": "<freejoint/>",
    "ball": '<joint type="ball"/>',
    "hinge": '<joint name="turn" axis="0 0 1" ref=".3"/>',
    "planar": '<joint name="a" type="slide" axis="1 0 0"/><joint name="b" type="slide" '
    'axis="0 1 0" ref=".5"/><joint name="c" axis="0 0 1" pos=".1 0 0"/>',
    "slides and ball": '<joint name="a" type="slide" axis="1 0 0"/><joint name="b" type="slide" '
    'axis="0 1 0"/><joint name="c" type="slide" axis="0 0 1"/><joint type="ball"/>',
    "six": '<joint name="a" type="slide" axis="1 0 0"/><joint name="b" type="slide" '
    'axis="0 1 0"/><joint name="c" type="slide" axis="0 0 1"/><joint name="d" axis="1 0 0"/>'
    '<joint name="e" axis="0 1 0"/><joint name="f" axis="0 0 1"/>',
}
FILE = """
<mujoco model="arm"><option gravity="0 0 0"/>{include}<worldbody><body name="base" pos="0 .2 1">
  {root}{body}
  <body pos=".3 0 0"><joint name="elbow" axis="0 1 1" ref=".2"/>{body}
    <body pos=".3 0 0"><joint name="grip" axis="0 1 0"/>{body}</body>
    <body pos=".1 0 .3"><joint name="wrist" type="ball"/>{body}</body>
    <body pos=".1 .3 .3"><joint name="frozen" axis="1 0 0"/>{body}</body></body>
</body></worldbody>
<equality><joint joint1="grip" joint2="elbow" polycoef=".1 -.5 0 0 0"/></equality></mujoco>
"""


def text_of(root: str, include: str = "") -> str:
    """Return the file of an arm."""
    return FILE.format(root=ROOTS[root], body=BODY, include=include)


@pytest.mark.parametrize("root", ROOTS)
@pytest.mark.sampled
def test_keyframes_place_the_bodies_of_mujoco(root: str, tmp_path: Path) -> None:
    """MuJoCo's centre of mass and momentum, and pinred's own reading, equal the motion."""
    path = tmp_path / "arm.xml"
    path.write_text(text_of(root), encoding="utf-8")
    load: dict[str, Any] = {"lock": {"frozen": 0.4}}
    system = pinred.load(path, **load)
    start: dict[str, Any] = {
        "xi0": np.linspace(0.3, -0.2, system.r),
        "xdot0": np.linspace(0.4, 0.1, system.m),
    }
    traj = pinred.simulate(system, times=[0.0, 0.5, 1.5], **start)
    traj.save(tmp_path / "keys.xml")
    both = tmp_path / "both.xml"
    both.write_text(text_of(root, '<include file="keys.xml"/>'), encoding="utf-8")
    model = mujoco.MjModel.from_xml_path(str(both))
    data = mujoco.MjData(model)
    for k in range(3):
        mujoco.mj_resetDataKeyframe(model, data, k)
        mujoco.mj_forward(model, data)
        assert data.time == traj.t[k]
        mujoco.mj_subtreeVel(model, data)
        kinetic = data.qvel @ full_mass_matrix(model, data) @ data.qvel / 2.0
        assert kinetic == pytest.approx(traj.energy[k], rel=1e-12)
        assert np.abs(data.qpos[model.jnt_qposadr[joint_id(model, "frozen")]] - 0.4) < 1e-15
    again = pinred.load(both, **load)
    for k, t in enumerate(("t=0", "t=0.5", "t=1.5")):
        key = again.keyframes[t]
        assert float(again.group.error(key.pose, traj.pose[k]).rotation) < 1e-11
        np.testing.assert_allclose(key.x, traj.x[k], rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(key.xi, traj.xi[k], rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(key.xdot, traj.xdot[k], rtol=0.0, atol=1e-12)


def joint_id(model: Any, name: str) -> int:
    """Return the id of a joint."""
    return int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name))


def full_mass_matrix(model: Any, data: Any) -> Any:
    """Return MuJoCo's mass matrix, (nv, nv)."""
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    return matrix


def test_keyframes_of_other_robots_are_refused(tmp_path: Path) -> None:
    """A URDF has no order of MuJoCo's coordinates."""
    traj = pinred.simulate(pinred.load("falling_cat"), seed=0, times=[0.1])
    with pytest.raises(InputError, match="from an MJCF file"):
        traj.save(tmp_path / "keys.xml")
    assert not list(tmp_path.iterdir())
