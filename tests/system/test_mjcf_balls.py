"""Ball joints of MJCF inside the tree, and hinges of MJCF that are merged into balls."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import InputError, ModelError
from pinred.forces.force_model import ForceModel
from pinred.forces.force_numbers import ForceInputs
from pinred.lie.groups import SE3
from pinred.system.merge_hinges import LIMITS
from pinred.system.mjcf.read import MujocoRobot, read_mujoco
from pinred.system.passive import MERGED, BallSpring, Damper, Friction, Spring

MASS = '<geom type="box" size=".1 .2 .05" pos=".1 .02 .2"/>'
# The joint names and classes of dm_control's CMU humanoid, and a pelvis on a slide.
HUMANOID = f"""
<mujoco><default><joint limited="true" stiffness="10" armature=".01" damping="5"/></default>
<worldbody><body name="root" pos="0 0 1" euler="90 0 0"><freejoint/>{MASS}
  <body name="lfemur" pos=".1 0 -.1" euler="10 20 0">
    <joint name="lfemurrz" axis="0 0 1" pos="0 .05 0" range="-60 70"/>
    <joint name="lfemurry" axis="0 1 0" pos="0 .05 0" range="-70 70" ref="15"/>
    <joint name="lfemurrx" axis="-1 0 0" pos="0 .05 0" range="-160 20" springref="20"/>{MASS}
    <body name="ltibia" pos="0 0 -.4"><joint name="ltibiarx" axis="1 0 0" range="1 170"/>{MASS}
    </body></body>
  <body name="head" pos="0 0 .5">
    <joint name="headrz" axis="0 0 1" range="-30 30"/>
    <joint name="headry" axis="0 1 0" range="-30 30"/>
    <joint name="headrx" axis="1 0 0" range="-20 45"/>{MASS}
  </body></body></worldbody>
<keyframe><key name="pike" qpos=".1 .2 .3 .5 .5 -.5 .5 .4 .3 -.8 .6 .2 -.3 .1"
  qvel="1 2 3 -1 -2 .5 .3 .6 -.4 .7 -.2 .5 .3"/></keyframe></mujoco>
"""
DIVER = f"""
<mujoco><worldbody><body name="torso"><freejoint/>{MASS}
  <body name="arm" pos=".1 .2 .3" euler="10 20 30"><joint name="lift"/>{MASS}
    <body name="hand" pos="0 0 .4" quat="1 2 3 4">
      <joint name="wrist" type="ball" pos="0 .05 0" limited="true" range="0 40"/>{MASS}
  </body></body>
  <body name="head" pos="0 0 .5"><joint name="neck" type="ball" stiffness="3 1" damping=".7 .2"
    frictionloss=".4" armature=".2"/>{MASS}</body></body></worldbody>
<actuator><motor joint="neck" gear="1 0 0"/></actuator>
<keyframe><key name="tuck" qpos=".1 .2 .3 .5 .5 -.5 .5 .7 2 4 -2 6 0 0 0 0"
  qvel="1 2 3 -1 -2 .5 .3 .6 -.4 .7 -.2 .5 .3"/></keyframe></mujoco>
"""


def read(folder: Path, text: str, **options: Any) -> MujocoRobot:
    """Read the robot in a text."""
    path = folder / "robot.xml"
    path.write_text(text, encoding="utf-8")
    return read_mujoco(path, **{"root": None, "lock": {}, "gravity": None, **options})


def link_motions(model: pin.Model, q: Array, v: Array, names: list[str]) -> Array:
    """Return places and twists in the world's axes of link frames, (links, 18)."""
    data = model.createData()
    pin.forwardKinematics(model, data, q, v)
    pin.updateFramePlacements(model, data)
    rows = []
    for name in names:
        k = model.getFrameId(name, pin.FrameType.BODY)
        twist = pin.getFrameVelocity(model, data, k, pin.LOCAL_WORLD_ALIGNED)
        place = data.oMf[k]
        rows.append(np.concatenate([place.rotation.ravel(), place.translation, twist.vector]))
    return np.array(rows)


def mujoco_motions(text: str, names: list[str]) -> Array:
    """Return the same from MuJoCo, at the first keyframe."""
    model: Any = mujoco.MjModel.from_xml_string(text)
    data: Any = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    rows = []
    for name in names:
        body = model.body(name).id
        twist = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
        rows.append(np.concatenate([data.xmat[body], data.xpos[body], twist[3:], twist[:3]]))
    return np.array(rows)


@pytest.mark.parametrize(
    ("text", "balls", "links", "sizes"),
    [
        (DIVER, False, ["torso", "arm", "hand", "head"], (9, 7)),
        (HUMANOID, True, ["root", "lfemur", "ltibia", "head"], (9, 7)),
        (HUMANOID, ("head",), ["root", "lfemur", "ltibia", "head"], (8, 7)),
        (HUMANOID, False, ["root", "lfemur", "ltibia", "head"], (7, 7)),
    ],
)
def test_keyframe_places_and_moves_links_as_in_mujoco(
    tmp_path: Path,
    text: str,
    balls: bool | tuple[str, ...],
    links: list[str],
    sizes: tuple[int, int],
) -> None:
    """Quaternions (x, y, z, w), also from three angles, and angular velocities in the child."""
    robot = read(tmp_path, text, balls=balls)
    keyframes = robot.contents(SE3).keyframes
    (frame,) = keyframes.values()
    assert (len(frame.x), len(frame.xdot)) == sizes
    q, v = np.concatenate([frame.pose, frame.x]), np.concatenate([frame.xi, frame.xdot])
    computed = link_motions(robot.model, q, v, links)
    expected = mujoco_motions(text, links)
    assert np.abs(computed - expected).max() <= 1e-13 * np.abs(expected).max()


def test_ball_has_armature_and_no_limits(tmp_path: Path) -> None:
    """MuJoCo limits the angle of a ball's rotation, which is not a limit of a coordinate."""
    model = read(tmp_path, DIVER).model
    neck, wrist = (model.joints[model.getJointId(name)] for name in ("neck", "wrist"))
    assert neck.shortname() == wrist.shortname() == "JointModelSpherical"
    assert model.armature[neck.idx_v : neck.idx_v + 3].tolist() == [0.2, 0.2, 0.2]
    assert np.isinf(model.upperPositionLimit[wrist.idx_q : wrist.idx_q + 4]).all()


def test_forces_on_balls_are_read(tmp_path: Path) -> None:
    """Limits are left out by name."""
    contents = read(tmp_path, DIVER).contents(SE3)
    left_out = {left.what: left.names for left in contents.left_out}
    assert left_out["joint limits"] == ("wrist",)
    spring, *others = contents.passive
    assert isinstance(spring, BallSpring)
    assert (spring.joint, spring.stiffness, spring.polynomial) == ("neck", 3.0, (1.0,))
    assert others == [
        force
        for axis in "xyz"
        for force in (
            Damper(f"neck.{axis}", 0.7, polynomial=(0.2,)), Friction(f"neck.{axis}", 0.4),
        )
    ]  # fmt: skip


@pytest.mark.filterwarnings("ignore:.*not simulated")
@pytest.mark.parametrize("seed", range(4))
def test_springs_and_dampers_of_balls_equal_mujoco(tmp_path: Path, seed: int) -> None:
    """With higher powers of the angle and of the rates, at random states."""
    path = tmp_path / "robot.xml"
    path.write_text(DIVER, encoding="utf-8")
    system, rng = pinred.load(path), np.random.default_rng(seed)
    model: Any = mujoco.MjModel.from_xml_string(DIVER)
    data: Any = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = rng.normal(size=model.nq), rng.normal(size=model.nv)
    mujoco.mj_normalizeQuat(model, data.qpos)
    mujoco.mj_forward(model, data)
    x = np.concatenate([data.qpos[7:8], np.roll(data.qpos[8:12], -1), np.roll(data.qpos[12:], -1)])
    forces = tuple(force for force in system.passive if not isinstance(force, Friction))
    acting, zero = ForceModel(system, forces, {}), np.zeros(system.r)
    inputs = ForceInputs(0.0, x, np.array(data.qvel[6:]), zero, zero, acting.numbers)
    expected = (data.qfrc_spring + data.qfrc_damper)[6:]
    difference = acting.acting(inputs).torque - expected
    assert np.abs(difference).max() <= 1e-12 * np.abs(expected).max()


def test_locked_ball_is_fixed_at_the_identity(tmp_path: Path) -> None:
    """A number other than zero is not an attitude."""
    robot = read(tmp_path, DIVER, lock={"neck": 0.0})
    assert list(robot.model.names)[2:] == ["lift", "wrist"]
    with pytest.raises(InputError, match=r"'neck' is a ball: expected 0, a rotation vector"):
        read(tmp_path, DIVER, lock={"neck": 0.3})


def test_merged_hinges_leave_forces_out_and_warn(tmp_path: Path) -> None:
    """Springs, limits and armature of merged hinges have no exact counterpart."""
    contents = read(tmp_path, HUMANOID, balls=True).contents(SE3)
    left_out = {left.what: left.names for left in contents.left_out}
    assert left_out[MERGED] == ("lfemur (spring 10, damper 5)", "head (spring 10, damper 5)")
    assert left_out["joint limits"][:3] == ("lfemurrz", "lfemurry", "lfemurrx")
    assert LIMITS not in left_out
    assert contents.passive == (Spring("ltibiarx", 10.0), Damper("ltibiarx", 5.0))
    (warning,) = contents.warnings
    assert "armature of merged hinges acts about all axes of the balls lfemur, head" in warning
    hinges = read(tmp_path, HUMANOID).contents(SE3)
    assert not hinges.warnings
    assert len([force for force in hinges.passive if isinstance(force, Spring)]) == 7


def test_locked_hinges_stay_hinges(tmp_path: Path) -> None:
    """The ball can be locked by its name, also if it was to be merged; its hinges by theirs."""
    names = list(read(tmp_path, HUMANOID, balls=True, lock={"head": 0.0}).model.names)[2:]
    assert names == ["lfemur", "ltibiarx"]
    names = list(read(tmp_path, HUMANOID, balls=("head",), lock={"head": 0.0}).model.names)[2:]
    assert names == ["lfemurrz", "lfemurry", "lfemurrx", "ltibiarx"]
    robot = read(tmp_path, HUMANOID, balls=True, lock={"headrx": 0.3})
    assert list(robot.model.names)[2:] == ["lfemur", "ltibiarx", "headrz", "headry"]
    locked = robot.contents(SE3).locked
    assert locked is not None
    assert locked.names == ("headrx",)
    assert locked.raw.existJointName("lfemur")
    with pytest.raises(ModelError, match="headrx must stay"):
        read(tmp_path, HUMANOID, balls=("head",), lock={"headrx": 0.3})
    with pytest.raises(InputError, match=r"'head' is a ball: .*lock its hinges: headrz, headry"):
        read(tmp_path, HUMANOID, balls=True, lock={"head": 0.3})


def test_coupled_hinges_stay_hinges(tmp_path: Path) -> None:
    """A leader of a follower has its own angle."""
    equality = '<equality><joint joint1="ltibiarx" joint2="lfemurrx"/></equality></mujoco>'
    text = HUMANOID.replace("</mujoco>", equality)
    robot = read(tmp_path, text, balls=True)
    assert robot.model.existJointName("head")
    assert robot.model.existJointName("lfemurrx")
    with pytest.raises(ModelError, match="lfemurrx must stay, locked or coupled"):
        read(tmp_path, text, balls=("lfemur",))
