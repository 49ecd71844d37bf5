"""Ball joints locked at any attitude move the other joints as the ball does at this attitude."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree
from test_merge_hinges import tree as hinged_tree

import pinred
from pinred.cli.command_options import lock_in
from pinred.common.arrays import Array
from pinred.common.errors import InputError, LoadError, PinredError
from pinred.lie.rotations import quaternion_exp
from pinred.simulation.read_recording import read_recording
from pinred.system.hinge_triples import HingeTriple, hinge_triples

pytestmark = pytest.mark.filterwarnings("ignore:.*(not simulated|singular at single shapes)")
MASS = '<geom type="box" size=".1 .2 .05" pos=".1 .02 .2" contype="0" conaffinity="0"/>'
# Two balls away from their bodies' origins, with reference angles, and joints behind each.
MJCF = f"""<mujoco><compiler angle="radian"/><worldbody><body name="torso"><freejoint/>{MASS}
  <body name="arm" pos=".1 .2 .3" euler=".1 .2 .3"><joint name="lift" ref=".4"/>
    <joint name="shoulder" type="ball" pos="0 .05 .02" ref=".3" armature=".1"/>{MASS}
    <body name="hand" pos="0 0 .4" quat="1 2 3 4">
      <joint name="wrist" type="ball" pos=".1 0 0"/>{MASS}
      <body name="finger" pos=".1 0 0"><joint name="bend" axis="0 1 1"/>{MASS}</body>
  </body></body></body></worldbody></mujoco>"""
VALUES = {
    "rotation vector": [0.1, -0.7, 0.3],
    "half turn": [0.0, np.pi, 0.0],
    "gimbal lock": [np.pi / 2, 0.0, 0.0],
    "quaternion": [1.0, -2.0, 0.5, 3.0],
}


def quaternion(value: Any) -> Array:
    """Return the unit quaternion (x, y, z, w) of a locked value."""
    numbers = np.asarray(value, dtype=float)
    return quaternion_exp(numbers) if len(numbers) == 3 else numbers / np.linalg.norm(numbers)


def totals(system: pinred.System, x: Array) -> tuple[Array, Array]:
    """Return the mass matrix of a system at the pose zero, and its centre of mass."""
    model, q = system.sorted_model, system.sorted_q(system.group.identity(), x)
    H = np.triu(pin.crba(model, data := model.createData(), q))
    com = pin.centerOfMass(model, data, q)
    return H + np.triu(H, 1).T, np.array(com)


def assert_locked(free: pinred.System, locked: pinred.System, lock: Mapping[str, Any]) -> Array:
    """Check that a locked system has the blocks of the free one at the locked attitudes.

    Return a shape of the locked system.
    """
    rng = np.random.default_rng(0)
    x = locked.space.integrate(locked.space.neutral, rng.normal(size=locked.m))
    places = {joint.name: joint for joint in locked.space.joints}
    whole, rows = free.space.neutral.copy(), [*range(free.r)]
    for joint in free.space.joints:
        if joint.name in lock:
            whole[joint.x] = quaternion(lock[joint.name])
            continue
        whole[joint.x] = x[places[joint.name].x]
        rows += range(free.r + joint.v.start, free.r + joint.v.stop)
    (H, com), (own, own_com) = totals(free, whole), totals(locked, x)
    np.testing.assert_allclose(own, H[np.ix_(rows, rows)], rtol=0, atol=1e-13 * np.abs(H).max())
    np.testing.assert_allclose(own_com, com, rtol=0, atol=1e-13 * max(np.abs(com).max(), 1.0))
    r = free.r
    inertia = pinred.Reduction(locked).locked_inertia(x)
    np.testing.assert_allclose(inertia, H[:r, :r], rtol=0, atol=1e-13 * np.abs(H).max())
    return np.asarray(x)


@pytest.mark.parametrize("case", VALUES)
@pytest.mark.parametrize(
    ("robot", "balls"), [("diver", ("hips",)), ("astronaut", ("left_hip", "right_shoulder"))]
)
@pytest.mark.sampled(3)
def test_merged_ball_is_locked_through_its_hinges(
    robot: str, balls: tuple[str, ...], case: str
) -> None:
    """With a knee and an elbow behind the ball; values of the hinges may vary."""
    lock = dict.fromkeys(balls, VALUES[case])
    locked = pinred.load(robot, lock=lock)
    assert_locked(pinred.load(robot), locked, lock)
    joints = locked.contents.locked
    assert joints is not None
    assert set(joints.names) == {f"{ball}_{axis}" for ball in balls for axis in "xyz"}


@pytest.mark.parametrize("case", VALUES)
@pytest.mark.parametrize("ball", ["j0", "j4"])
@pytest.mark.sampled
def test_ball_of_a_model_is_locked_with_its_subtree(ball: str, case: str) -> None:
    """The chain is j0 (ball), j2, j4 (ball), j5; other joints move beside it."""
    free = ball_tree(9, 6, armature=False, balls=0.4)
    lock = {ball: VALUES[case]}
    locked = pinred.load(free.sorted_model, lock=lock)
    assert_locked(free, locked, lock)
    joints = locked.contents.locked
    assert joints is not None
    for name, (place, _) in joints.placements({}).items():
        expected = locked.model.jointPlacements[locked.model.getJointId(name)]
        np.testing.assert_allclose(place.homogeneous, expected.homogeneous, rtol=0, atol=1e-14)
    with pytest.raises(InputError, match=r"does not vary: it is a ball, whose attitude cannot"):
        pinred.load(free.sorted_model, lock=lock, parameters={f"{ball}.lock": 0.1})


@pytest.mark.parametrize("names", [("shoulder",), ("wrist",), ("shoulder", "wrist")])
@pytest.mark.parametrize("case", VALUES)
@pytest.mark.sampled
def test_ball_of_mjcf_is_locked_as_in_mujoco(case: str, names: tuple[str, ...]) -> None:
    """MuJoCo has the ball at this attitude; MuJoCo ignores the reference of a ball."""
    model: Any = mujoco.MjModel.from_xml_string(MJCF)
    lock = dict.fromkeys(names, VALUES[case])
    locked = pinred.load(model, lock=lock)
    x = assert_locked(pinred.load(model), locked, lock)
    data: Any = mujoco.MjData(model)
    at = {j.name: x[j.x] for j in locked.space.joints}
    at |= {name: quaternion(value) for name, value in lock.items()}
    for name, values in at.items():
        k = int(model.joint(name).qposadr[0])
        data.qpos[k : k + len(values)] = np.roll(values, 1) if len(values) == 4 else values
    mujoco.mj_forward(model, data)
    H = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, H)
    rows = [*range(6)]
    for joint in locked.space.joints:
        first = int(model.joint(joint.name).dofadr[0])
        rows += range(first, first + joint.kind.m)
    own, com = totals(locked, x)
    np.testing.assert_allclose(own, H[np.ix_(rows, rows)], rtol=0, atol=1e-12 * np.abs(H).max())
    np.testing.assert_allclose(com, data.subtree_com[0], rtol=0, atol=1e-13)


def test_value_of_a_hinge_varies_behind_a_locked_ball() -> None:
    """Varying the value gives the robot that is loaded with it, also in MJCF."""
    model: Any = mujoco.MjModel.from_xml_string(MJCF)
    robots: list[tuple[Any, dict[str, Any], str, float]] = [
        (model, {"wrist": [0.1, 0.2, 0.3], "bend": 0.2}, "bend", -0.5),
        ("astronaut", {"left_hip": [0.1, 0.2, 0.3], "left_knee": 0.2}, "left_knee", -0.5),
    ]
    for source, lock, name, value in robots:
        varied = pinred.load(source, lock=lock, parameters={f"{name}.lock": value})
        loaded = pinred.load(source, lock={**lock, name: value})
        for ours, theirs in zip(varied.model.inertias, loaded.model.inertias, strict=True):
            np.testing.assert_allclose(ours.matrix(), theirs.matrix(), rtol=0, atol=1e-12)


def attitude_error(triple: HingeTriple, attitude: Array) -> float:
    """Return the angle between an attitude and that of the hinges' angles."""
    found = triple.attitude(triple.angles(attitude))
    return 2.0 * float(min(np.linalg.norm(found - s * attitude) for s in (-1, 1)))


@pytest.mark.parametrize("seed", range(4))
def test_angles_of_hinges_reach_every_attitude(seed: int) -> None:
    """Also near and in gimbal lock, where the first angle is zero; angles of one turn return."""
    rng = np.random.default_rng(seed)
    for triple in (t for t in hinge_triples(hinged_tree(seed)) if not t.why_not):
        first, second, third = triple.axes
        lock = float(np.arctan2(np.cross(third, first) @ second, third @ first))
        for offset in (0.0, 1e-14, 1e-12, 1e-8, 1e-4, 0.3, 1.0):
            angles = np.array([rng.uniform(-1, 1), lock + offset, rng.uniform(-1, 1)])
            assert attitude_error(triple, triple.attitude(angles)) < 3e-13
        for attitude in rng.normal(size=(10, 4)):
            assert attitude_error(triple, attitude / np.linalg.norm(attitude)) < 2e-14
        in_lock = triple.attitude(np.array([0.4, lock, -0.3]))
        assert triple.angles(in_lock)[0] == 0.0


def test_angles_of_hinges_that_are_not_exactly_at_right_angles() -> None:
    """All attitudes are reached away from gimbal lock, and to 2e-5 rad in it."""
    c = 0.9e-5
    axes = np.array([[1.0, c, 0.0], [0.0, 1.0, 0.0], [0.0, c, 1.0]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    triple = HingeTriple("ball", ("a", "b", "c"), axes, np.zeros(3))
    rng = np.random.default_rng(0)
    for angles in rng.uniform(-1.2, 1.2, (20, 3)):
        assert attitude_error(triple, triple.attitude(angles)) < 2e-14
    for x in rng.uniform(-1.0, 1.0, 5):
        in_lock = quaternion_exp(np.array([x, 0.0, 0.0]))
        half_turn = quaternion_exp(np.array([0.0, np.pi / 2, 0.0]))
        attitude = pin.Quaternion(in_lock) * pin.Quaternion(half_turn)
        assert attitude_error(triple, np.asarray(attitude.coeffs())) <= 2e-5


def test_python_command_line_and_file_lock_at_the_same_attitude(tmp_path: Path) -> None:
    """--lock J=V1,V2,V3 and lock = { J = [V1, V2, V3] } equal lock={J: [V1, V2, V3]}."""
    lock: Any = {"left_hip": [0.1, 0.0, 0.3], "left_knee": 0.2, "right_knee": 0.0}
    lock["right_hip"] = [0.0, 0.0, 2.0, 2.0]
    typed = lock_in("left_hip=.1,0,.3,left_knee=.2,right_knee,right_hip=0,0,2,2", "lock")
    assert typed == lock
    assert lock_in("", "lock") == {}
    assert lock_in("1,2", "lock") == {"1": 0.0, "2": 0.0}
    path = tmp_path / "scene.toml"
    path.write_text(
        'robot = "astronaut"\nload = { lock = { left_hip = [0.1, 0, 0.3], left_knee = 0.2,'
        " right_knee = 0, right_hip = [0, 0, 2, 2] } }\n[start]\nseed = 1\n",
        encoding="utf-8",
    )
    in_python, in_file = pinred.load("astronaut", lock=lock), pinred.load_scene(path).system
    assert in_file.model == in_python.model


def test_recording_restores_locked_attitudes(tmp_path: Path) -> None:
    """Values of hinges that varied take precedence; locks of single numbers have no sizes."""
    lock: dict[str, Any] = {"left_shoulder": [0.1, 0.2, 0.3], "hips": [0.0, 0.1, 0.2, 1.0]}
    for locked, sizes in ((lock, [3, 4, 1]), ({"hips_x": 0.3}, None)):
        system = pinred.load("diver", lock=locked, parameters={"hips_x.lock": 0.5})
        traj = pinred.simulate(system, seed=1, duration=0.01, times=[0.01], engine="pinocchio")
        path = tmp_path / "motion.npz"
        traj.save(path)
        with np.load(path) as content:
            arrays = dict(content)
        assert (arrays["lock_sizes"].tolist() if "lock_sizes" in arrays else None) == sizes
        again = read_recording(path).system
        for ours, theirs in zip(again.model.inertias, system.model.inertias, strict=True):
            np.testing.assert_allclose(ours.matrix(), theirs.matrix(), rtol=0, atol=1e-13)
    np.savez(path, **{**arrays, "lock_sizes": np.array([3])})
    with pytest.raises(LoadError, match="sizes and values of its locked joints are inconsistent"):
        _ = read_recording(path).system


@pytest.mark.parametrize(
    ("lock", "message"),
    [
        ({"left_hip": 0.3}, "'left_hip' is a ball: expected 0, a rotation .*hinges: left_hip_y"),
        ({"left_hip": [0, 0, 0, 0]}, "'left_hip': expected a quaternion other than zero"),
        ({"left_hip": [0.1, np.nan, 0]}, "'left_hip': expected a rotation vector of 3 finite"),
        ({"left_hip": [0.1, 0.2]}, "'left_hip' must be finite: a number, or for a ball"),
        ({"left_knee": [0.1, 0, 0]}, r"'left_knee' is not a ball: expected one number.*\[0.1"),
        ({"hip": [0.1, 0, 0]}, "no joint 'hip'; the joints are left_hip, left_knee"),
    ],
)
def test_wrong_value_of_a_lock_is_refused(lock: dict[str, Any], message: str) -> None:
    """The message names the joint and what is expected."""
    with pytest.raises(PinredError, match=message):
        pinred.load("astronaut", lock=lock)
