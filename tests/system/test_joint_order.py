"""Models whose joints are not in depth-first order: q and v keep the original order."""

from __future__ import annotations

from pathlib import Path

import aba
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loop_robots import FOUR_BAR, four_bar
from strategies import groups, seeds
from trees import inertia, model_in_random_order, placement, random_model, shuffled

import pinred
from pinred.common.arrays import Array
from pinred.forces import Damper, Torque
from pinred.judge.reference_solution import FullState
from pinred.lie import GROUPS
from pinred.scene.scene_options import Engine
from pinred.system.copy_model import depth_first
from pinred.system.system import in_gravity
from pinred.views.playback.colours_and_view_options import View
from pinred.views.playback.playback import playback


@given(groups, st.integers(1, 7), seeds)
def test_q_and_v_use_order_of_original_model(group: str, joints: int, seed: int) -> None:
    """The kinematics of the original model places each joint for system.q as sorted_model does."""
    model = shuffled(random_model(group, joints, seed), seed)
    system = pinred.load(model)
    rng = np.random.default_rng(seed)
    pose = system.group.exp(rng.uniform(-1.0, 1.0, system.r))
    x, xi, xdot = rng.normal(size=joints), rng.normal(size=system.r), rng.normal(size=joints)
    data, inside = model.createData(), system.sorted_model.createData()
    pin.forwardKinematics(model, data, system.q(pose, x), system.v(xi, xdot))
    q, v = system.sorted_q(pose, x), system.sorted_v(xi, xdot)
    pin.forwardKinematics(system.sorted_model, inside, q, v)
    for k, name in enumerate(model.names):
        mine = system.sorted_model.getJointId(name)
        assert data.oMi[k].isApprox(inside.oMi[mine], 1e-12)
        assert data.v[k].isApprox(inside.v[mine], 1e-12)
    at = system.configuration(system.q(pose, x))
    rate = system.velocity(system.v(xi, xdot))
    assert at.pose == pytest.approx(pose, abs=1e-14)
    assert np.cos(at.x) == pytest.approx(np.cos(x), abs=1e-14)
    assert np.array_equal(rate.xi, xi)
    assert np.array_equal(rate.xdot, xdot)


@pytest.mark.slow
def test_trajectory_uses_order_of_original_model() -> None:
    """The trajectory agrees with ABA, and the original model conserves energy along its q and v.

    Pinocchio's kinetic energy needs no depth-first order, unlike crba.
    """
    ordered = random_model("SE3", 6, seed=3)
    model = shuffled(ordered, 1)
    assert list(model.names) != list(ordered.names)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    system = pinred.load(model)
    assert system.shape_names != tuple(model.names)[2:]
    name = str(system.shape_names[0])
    for engine in ("compiled", "pinocchio"):
        traj = pinred.simulate(
            system, seed=1, duration=0.2, forces=[Damper(name, 0.1)], engine=engine
        )
        assert pinred.compare(traj).passed
        impulse = np.abs(traj.momentum_balance.impulse).max()
        assert np.abs(traj.momentum_balance.residual).max() < 1e-9 * impulse
        data, bare = model.createData(), model.copy()
        bare.armature = np.zeros(model.nv)
        for q, v, energy in zip(traj.q, traj.v, traj.energy, strict=True):
            kinetic = pin.computeKineticEnergy(bare, data, q, v) + 0.5 * model.armature @ v**2
            potential = pin.computePotentialEnergy(model, data, q)
            assert kinetic + potential == pytest.approx(energy, rel=1e-9, abs=1e-9)
    assert (
        np.abs(FullState(traj.scene).q(np.concatenate([traj.pose[0], traj.x[0]])) - traj.q[0]).max()
        > 0.01
    )


def named_places(model: pin.Model, q: Array) -> dict[str, Array]:
    """Return the placement of each joint by Pinocchio's kinematics, which takes any order."""
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return {str(name): data.oMi[i].homogeneous for i, name in enumerate(model.names)}


def assert_equal_places(system: pinred.System, q: Array, model: pin.Model, own: Array) -> None:
    """Compare places by `system.model` at q with those by the original model at `own`."""
    places, expected = named_places(system.model, q), named_places(model, own)
    assert len(q) == system.model.nq
    for name, place in expected.items():
        last = [joint for joint in places if joint == name or joint.startswith(f"{name}.")][-1:]
        for joint in last:
            np.testing.assert_allclose(places[joint], place, rtol=0.0, atol=1e-12, err_msg=joint)


def entries(model: pin.Model, name: str) -> tuple[slice, slice]:
    """Return the entries of a joint in q and in v."""
    joint = model.joints[model.getJointId(name)]
    q, v = joint.idx_q, joint.idx_v
    return slice(q, q + joint.nq), slice(v, v + joint.nv)


def copied(model: pin.Model, q: Array, other: pin.Model, q_other: Array) -> Array:
    """Return q_other with the coordinates of the joints that both models have from q."""
    result = q_other.copy()
    for name in list(other.names)[1:]:
        if model.existJointName(name):
            result[entries(other, name)[0]] = q[entries(model, name)[0]]
    return result


def random_q(model: pin.Model, seed: int) -> Array:
    """Return a random configuration."""
    rng = np.random.default_rng(seed)
    return np.asarray(pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv)))


def unsorted_model(group: str, joints: int, seed: int) -> pin.Model:
    """Return a random tree that is not in depth-first order."""
    model = shuffled(random_model(group, joints, seed), seed)
    order = depth_first(list(model.parents))
    assert order != sorted(order)
    return model


def test_model_has_order_and_indices_of_original_model() -> None:
    """Joints keep their indices, and `joints` refers to them; the sorted copy is depth-first."""
    model = unsorted_model("SE3", 7, 3)
    system = pinred.load(model)
    assert list(system.model.names) == list(model.names)
    assert system.model.idx_qs.tolist() == model.idx_qs.tolist()
    assert system.model.idx_vs.tolist() == model.idx_vs.tolist()
    assert [model.names[i] for i in system.joints] == list(system.shape_names)
    assert [system.sorted_model.names[i] for i in system.sorted_joints] == list(system.shape_names)
    order = depth_first(list(system.sorted_model.parents))
    assert order == sorted(order)
    ordered = pinred.load(random_model("SE3", 7, 3))
    assert ordered.model is ordered.sorted_model
    assert ordered.data is ordered.sorted_data
    assert system.data is not system.sorted_data


@pytest.mark.by_hand("compiled")
@pytest.mark.slow
@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
def test_motion_from_q0_with_torques_agrees_with_aba_of_original_model(engine: Engine) -> None:
    """q0, v0, q, v and torques by name agree with ABA, indexed by either model."""
    model = unsorted_model("SE3", 5, 5)
    system, rng = pinred.load(model), np.random.default_rng(0)
    q0, v0, tau = random_q(model, 1), rng.normal(size=model.nv), np.zeros(model.nv)
    torques = {name: 0.1 * k for k, name in enumerate(list(model.names)[2:], start=1)}
    for name, torque in torques.items():
        tau[model.joints[model.getJointId(name)].idx_v] = torque
    traj = pinred.simulate(
        system, q0=q0, v0=v0, times=[0.0, 0.2, 0.4], rtol=1e-11, engine=engine,
        forces=[Torque(torques)],
    )  # fmt: skip
    q, v = aba.integrate(model, q0, v0, traj.t, lambda *_: tau)
    assert aba.max_difference(model, traj.q, q) < 1e-8
    np.testing.assert_allclose(traj.v, v, rtol=0.0, atol=1e-8)
    for k, name in enumerate(system.shape_names):
        for robot in (model, system.model):
            coordinate, rate = entries(robot, name)
            own, x = traj.q[:, coordinate], traj.x[:, [k]]
            expected = np.hstack([np.cos(x), np.sin(x)]) if own.shape[1] == 2 else x
            np.testing.assert_allclose(own, expected, rtol=0.0, atol=1e-12)
            np.testing.assert_array_equal(traj.v[:, rate], traj.xdot[:, [k]])


@given(groups, st.integers(3, 8), seeds)
def test_locked_joints_leave_the_order_of_the_others(group: str, joints: int, seed: int) -> None:
    """The original model places all joints as `system.model`, without the locked joints."""
    model = shuffled(random_model(group, joints, seed), seed)
    locked = {f"joint{1 + seed % joints}": 0.3, f"joint{1 + (seed + 1) % joints}": -0.2}
    system = pinred.load(model, lock=locked)
    assert list(system.model.names) == [name for name in model.names if name not in locked]
    q = random_q(system.model, seed)
    own = copied(system.model, q, model, pin.neutral(model))
    for name, value in locked.items():
        at = entries(model, name)[0]
        own[at] = value if at.stop - at.start == 1 else (np.cos(value), np.sin(value))
    assert_equal_places(system, q, model, own)
    split = system.configuration(q)
    np.testing.assert_allclose(system.q(split.pose, split.x), q, rtol=0.0, atol=1e-12)


def test_root_joint_that_is_added_comes_first() -> None:
    """A robot that floats on a new root joint keeps the order of its joints."""
    model = unsorted_model("SO2", 6, 1)
    inertia = pin.Inertia(2.0, np.array([0.1, 0.2, -0.1]), np.diag([0.3, 0.4, 0.5]))
    model.appendBodyToJoint(0, inertia, pin.SE3.Identity())
    system = pinred.load(model, group="SE3")
    assert list(system.model.names)[2:] == list(model.names)[1:]
    q = np.append(pin.SE3ToXYZQUAT(pin.SE3.Identity()), random_q(model, 4))
    assert_equal_places(system, q, model, q[7:])


def test_joints_that_are_split_keep_their_place() -> None:
    """Parts of joints added breadth-first stand where the joint stood, in q and in space."""
    model, joints = pin.Model(), dict[str, int]()
    model.name = "split"
    composite = pin.JointModelComposite()
    composite.addJoint(pin.JointModelRX())
    composite.addJoint(pin.JointModelPY())
    rng = np.random.default_rng(0)
    for name, parent, joint in (
        ("base", None, pin.JointModelFreeFlyer()),
        ("left", "base", pin.JointModelPlanar()),
        ("right", "base", composite),
        ("ball", "left", pin.JointModelSpherical()),
        ("free", "right", pin.JointModelFreeFlyer()),
        ("screw", "left", pin.JointModelHZ(0.1)),
        ("universal", "right", pin.JointModelUniversal(*np.eye(3)[:2])),
        ("hinge", "ball", pin.JointModelRY()),
    ):
        at = placement(rng)
        joints[name] = model.addJoint(joints[parent] if parent else 0, joint, at, name)
        model.appendBodyToJoint(joints[name], inertia(rng), pin.SE3.Identity())
    system = pinred.load(model)
    assert [name.partition(".")[0] for name in system.model.names][2:] == [
        "left", "left", "left", "right", "right", "ball", "free", "free", "free", "free",
        "screw", "screw", "universal", "universal", "hinge",
    ]  # fmt: skip
    traj = pinred.simulate(system, seed=0, duration=0.2, engine="pinocchio")
    for q in traj.q:
        own = copied(system.model, q, model, pin.neutral(model))
        parts = {
            "left": ("x", "y", "turn"),
            "right": ("1", "2"),
            "free": ("x", "y", "z", "ball"),
            "universal": ("1", "2"),
        }
        for name, suffixes in parts.items():
            values = [q[entries(system.model, f"{name}.{suffix}")[0]] for suffix in suffixes]
            own[entries(model, name)[0]] = np.concatenate(values)
        assert_equal_places(system, q, model, own)


def test_mimic_joints_of_an_unsorted_model_keep_their_place() -> None:
    """Q of a system contains its followers, in the order of the original model."""
    plain = pin.Model()
    plain.name = "mimic"
    rng, ids = np.random.default_rng(1), {"world": 0}
    for name, parent, joint in (
        ("base", "world", pin.JointModelFreeFlyer()),
        ("a", "base", pin.JointModelRX()),
        ("b", "base", pin.JointModelRY()),
        ("c", "a", pin.JointModelRZ()),
        ("d", "b", pin.JointModelPX()),
        ("e", "a", pin.JointModelRY()),
    ):
        ids[name] = plain.addJoint(ids[parent], joint, placement(rng), name)
        plain.appendBodyToJoint(ids[name], inertia(rng), pin.SE3.Identity())
    model = pin.transformJointIntoMimic(plain, ids["a"], ids["e"], -2.0, 0.3)
    system = pinred.load(model)
    assert list(system.model.names) == list(plain.names)
    traj = pinred.simulate(system, seed=0, duration=0.2, engine="pinocchio")
    for q in traj.q:
        own = pin.neutral(model)
        for name in ("base", "a", "b", "c", "d"):
            own[entries(model, name)[0]] = q[entries(system.model, name)[0]]
        assert_equal_places(system, q, model, own)
        assert_equal_places(system, q, plain, q)
    q0 = traj.q[-1]
    again = pinred.simulate(system, q0=q0, v0=traj.v[-1], duration=0.1, engine="pinocchio")
    np.testing.assert_allclose(again.q[0], q0, rtol=0.0, atol=1e-12)


def test_ball_of_unsorted_hinges_takes_the_place_of_the_last_hinge() -> None:
    """Places of the merged robot agree with the original hinges."""
    model, ids = pin.Model(), {"world": 0}
    model.name = "hinges"
    rng = np.random.default_rng(2)
    for name, parent, joint in (
        ("base", "world", pin.JointModelFreeFlyer()),
        ("neckx", "base", pin.JointModelRX()),
        ("arm", "base", pin.JointModelRY()),
        ("necky", "neckx", pin.JointModelRY()),
        ("elbow", "arm", pin.JointModelRZ()),
        ("neckz", "necky", pin.JointModelRZ()),
        ("hand", "elbow", pin.JointModelPX()),
        ("jaw", "neckz", pin.JointModelRY()),
    ):
        at = pin.SE3.Identity() if name in ("necky", "neckz") else placement(rng)
        ids[name] = model.addJoint(ids[parent], joint, at, name)
        if name not in ("neckx", "necky"):
            model.appendBodyToJoint(ids[name], inertia(rng), pin.SE3.Identity())
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
    system = pinred.load(model, balls=True)
    assert list(system.model.names)[2:] == ["arm", "elbow", "neck", "hand", "jaw"]
    own = random_q(model, 3)
    angles = [own[entries(model, f"neck{axis}")[0]][0] for axis in "xyz"]
    attitude = np.eye(3)
    for axis, angle in zip(np.eye(3), angles, strict=True):
        attitude = attitude @ pin.exp3(angle * axis)
    q = copied(model, own, system.model, pin.neutral(system.model))
    q[entries(system.model, "neck")[0]] = pin.Quaternion(attitude).coeffs()
    traj = pinred.simulate(system, q0=q, duration=0.1, engine="pinocchio")
    assert_equal_places(system, traj.q[0], model, own)
    neck = named_places(system.model, traj.q[0])["neck"]
    np.testing.assert_allclose(neck, named_places(model, own)["neckz"], rtol=0.0, atol=1e-12)


def test_loops_of_an_unsorted_model_close_in_the_original_model() -> None:
    """The original model closes the loops at q; a constant loop becomes a coupling."""
    lengths = {"crank": 0.4, "coupler": 1.0, "rocker": 0.4, "frame": 1.0}
    for sizes in (FOUR_BAR, lengths):
        ordered, loops = four_bar(lengths=sizes)
        model = shuffled(ordered, 1)  # base, crank, rocker, coupler
        system = pinred.load(model, loops=loops)
        assert list(system.model.names) == list(model.names)
        traj = pinred.simulate(system, seed=0, duration=0.3, engine="pinocchio")
        data = model.createData()
        for q in traj.q:
            pin.framesForwardKinematics(model, data, q)
            a, b = (data.oMf[model.getFrameId(f"{bar}_tip")] for bar in ("coupler", "rocker"))
            np.testing.assert_allclose(a.translation, b.translation, rtol=0.0, atol=1e-7)


# The next motions of unsorted models agree with ABA by default.
@pytest.mark.by_hand
@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.by_hand) for seed in range(2, 31))]
)
def test_motion_of_tree_in_random_order_agrees_with_aba_of_original_model(seed: int) -> None:
    """Both engines agree with ABA for hinges, slides, balls and cyclic rotors in any order."""
    model = model_in_random_order(sorted(GROUPS)[seed % len(GROUPS)], seed)
    system, rng = pinred.load(model), np.random.default_rng(seed)
    assert list(system.model.names) == list(model.names)
    assert system.model.idx_qs.tolist() == model.idx_qs.tolist()
    q0, v0 = random_q(model, seed), 0.5 * rng.normal(size=model.nv)
    times = np.array([0.0, 0.1, 0.3])
    q, v = aba.integrate(model, q0, v0, times)
    engines: tuple[Engine, ...] = ("compiled", "pinocchio")
    for engine in engines:
        traj = pinred.simulate(system, q0=q0, v0=v0, times=times, rtol=1e-11, engine=engine)
        assert aba.max_difference(model, traj.q, q) < 1e-7
        np.testing.assert_allclose(traj.v, v, rtol=0.0, atol=1e-7 * max(1.0, np.abs(v).max()))
        assert pinred.compare(traj).passed


MJCF = """<mujoco><default><geom contype="0" conaffinity="0"/></default>
  <worldbody><body name="base" pos="0 0 1"><freejoint/><geom size=".1"/>
  <body name="b" pos=".3 0 0"><joint name="b" axis="0 1 0"/><geom size=".1"/>
    <body name="d" pos=".3 0 0"><joint name="d" axis="0 0 1"/><geom size=".1" pos=".1 0 0"/></body>
    <body name="a" pos="0 .3 0"><joint name="a1" axis="1 0 0"/><joint name="a0" type="slide"/>
      <geom size=".1" pos="0 .1 0"/></body></body>
  <body name="c" pos="0 -.3 0"><joint name="c" type="ball"/><geom size=".1" pos=".1 0 0"/></body>
  </body></worldbody></mujoco>"""


def test_mjcf_robot_has_order_of_mujoco_also_in_files(tmp_path: Path) -> None:
    """MuJoCo places all bodies alike at q, in a motion, its scene file and its recording."""
    (tmp_path / "robot.xml").write_text(MJCF)
    robot = mujoco.MjModel.from_xml_string(MJCF)
    data, rng = mujoco.MjData(robot), np.random.default_rng(0)
    q0 = rng.normal(size=robot.nq)
    q0[3:7] /= np.linalg.norm(q0[3:7])
    q0[-4:] /= np.linalg.norm(q0[-4:])
    (tmp_path / "scene.toml").write_text(
        f'robot = "robot.xml"\n[start]\nq0 = {q0.tolist()}\n'
        f"v0 = {rng.normal(size=robot.nv).tolist()}\n[run]\nduration = 0.2\n"
    )
    traj = pinred.simulate(pinred.load_scene(tmp_path / "scene.toml"), engine="pinocchio")
    np.testing.assert_allclose(traj.q[0], q0, rtol=0.0, atol=1e-12)
    traj.save(tmp_path / "motion.npz")
    recorded = pinred.read_recording(tmp_path / "motion.npz")
    np.testing.assert_array_equal(recorded.q, traj.q)
    for motion in (traj, recorded):
        model = motion.system.model
        assert list(model.names)[2:] == ["b", "d", "a1", "a0", "c"]
        for q in motion.q[[0, -1]]:
            data.qpos[:] = q
            data.qpos[3:7], data.qpos[-4:] = np.roll(q[3:7], 1), np.roll(q[-4:], 1)
            mujoco.mj_kinematics(robot, data)
            own = model.createData()
            pin.framesForwardKinematics(model, own, q)
            for name in ("base", "a", "b", "c", "d"):
                place = own.oMf[model.getFrameId(name, pin.FrameType.BODY)]
                body = data.body(name)
                np.testing.assert_allclose(place.translation, body.xpos, rtol=0.0, atol=1e-12)
                np.testing.assert_allclose(
                    place.rotation, body.xmat.reshape(3, 3), rtol=0.0, atol=1e-12
                )


def test_recording_and_film_of_unsorted_model_use_its_order(tmp_path: Path) -> None:
    """A film places joints by name as the original model; a recording has the same q and v."""
    model = unsorted_model("SE3", 6, 1)
    traj = pinred.simulate(pinred.load(model), seed=0, duration=0.2, engine="pinocchio")
    traj.save(tmp_path / "motion.npz")
    recorded = pinred.read_recording(tmp_path / "motion.npz")
    np.testing.assert_array_equal(recorded.q, traj.q)
    np.testing.assert_array_equal(recorded.v, traj.v)
    film = playback(traj, View(fps=10))
    for t, frame in zip(film.t, film.placements, strict=True):
        expected = named_places(model, traj(float(t)).q)
        for name, place in zip(film.system.sorted_model.names, frame, strict=True):
            shown = pin.XYZQUATToSE3(place).homogeneous
            np.testing.assert_allclose(shown, expected[str(name)], rtol=0.0, atol=1e-12)


def test_parameters_and_gravity_change_both_orders_of_the_model() -> None:
    """Both models have the numbers of an original model with these inertias and placements."""
    model = unsorted_model("SE3", 6, 1)
    name = str(model.names[4])
    changed = pinred.load(
        model,
        gravity=[0.0, 0.0, -3.0],
        parameters={f"{name}.mass": 7.0, f"{name}.translation": [1, 2, 3]},
    )
    assert changed.model is not changed.sorted_model
    varied = in_gravity(changed, np.array([1.0, 2.0, 3.0]))
    for robot in (varied.model, varied.sorted_model):
        i = robot.getJointId(name)
        assert robot.inertias[i].mass == 7.0
        assert robot.jointPlacements[i].translation.tolist() == [1.0, 2.0, 3.0]
        assert robot.gravity.linear.tolist() == [1.0, 2.0, 3.0]
        other = pinred.load(model)
        for k, body in enumerate(list(robot.names)[1:], start=1):
            if body != name:
                nominal = other.model.inertias[other.model.getJointId(body)]
                assert robot.inertias[k] == nominal
    assert changed.gravity.tolist() == [0.0, 0.0, -3.0]


def test_depth_first_order_takes_linear_time() -> None:
    """Each joint occurs once, followed by its subtree, also in long chains and large stars."""
    assert depth_first([0, 0, 1, 1, 2, 3, 2]) == [1, 2, 4, 6, 3, 5]
    assert depth_first([0, *range(100_000)]) == list(range(1, 100_001))
    assert depth_first([0] * 100_001) == list(range(1, 100_001))
