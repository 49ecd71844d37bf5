"""Actuators of MJCF files: read, driven by controls, and compared with MuJoCo."""

from __future__ import annotations

import math
import pickle
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred import signals
from pinred.common.arrays import Array
from pinred.common.errors import InputError, LeftOutWarning
from pinred.forces import Controller
from pinred.forces.force_numbers import BaseInSpace, ForceInputs
from pinred.system.system import System

mujoco = pytest.importorskip("mujoco")

BODIES = """<body name="trunk"><joint name="yaw" axis="0 0 1"/>
<geom type="box" size=".3 .2 .1" mass="5"/><body name="upper" pos=".3 0 0">
<joint name="hip" axis="0 1 0" ref="20" damping=".3"/>
<geom type="capsule" size=".05 .2" mass="2"/>
<body name="lower" pos="0 .1 .4"><joint name="slide" type="slide" axis="1 0 0"/>
<geom type="capsule" size=".04 .2" mass="1"/>
<body name="head" pos="0 0 .3"><joint name="neck" type="ball"/>
<geom type="box" size=".1 .06 .08" mass="1"/>
</body></body></body></body>"""
TWO_BODIES = """<body><joint name="yaw" axis="0 0 1"/><geom type="box" size=".3 .2 .1" mass="5"/>
<body pos=".3 0 0"><joint name="hip" axis="0 0 1"/><geom size=".1" pos=".4 0 0" mass="2"/></body>
</body>"""
KINDS = {
    "motor": '<motor name="a" joint="hip" gear="7"/>',
    "motor of a slide": '<motor name="a" joint="slide" gear="-3"/>',
    "limits of the control": '<motor name="a" joint="hip" gear="7" ctrlrange="-.2 .3"/>',
    "limits of the force": '<motor name="a" joint="hip" gear="7" forcerange="-.2 .3"/>',
    "position": '<position name="a" joint="hip" kp="20" kv=".5" gear="2"/>',
    "position with a damping ratio": '<position name="a" joint="hip" kp="20" dampratio=".7"/>',
    "position within the range": (
        '<position name="a" joint="hip" kp="20" inheritrange="1" forcerange="-3 4"/>'
    ),
    "velocity": '<velocity name="a" joint="slide" kv="3" gear=".5"/>',
    "damper": '<damper name="a" joint="hip" kv="3" ctrlrange="0 .4" gear="2"/>',
    "general": (
        '<general name="a" joint="hip" gear="-2" gaintype="affine" gainprm="1 2 3" '
        'biastype="affine" biasprm=".1 -.2 .3"/>'
    ),
    "class of defaults": '<motor name="a" class="strong" joint="hip"/>',
    "child class": '<position name="a" joint="hip" class="servo"/>',
    "motor of a ball": '<motor name="a" joint="neck" gear="1 -2 .5"/>',
    "motor of a ball in the parent": '<motor name="a" jointinparent="neck" gear="1 -2 .5"/>',
    "general of a ball": (
        '<general name="a" joint="neck" gear="1 -2 .5" gainprm="2" biastype="affine" '
        'biasprm=".1 -.7 -.3"/>'
    ),
    "general of a ball in the parent": (
        '<general name="a" jointinparent="neck" gear="1 -2 .5" gainprm="2" biastype="affine" '
        'biasprm=".1 -.7 -.3"/>'
    ),
    "joint in the parent": '<position name="a" jointinparent="hip" kp="4" gear="2"/>',
    "motor of the base": '<motor name="a" joint="yaw" gear="3"/>',
    "servo of the base": '<position name="a" joint="yaw" kp="4" kv=".3" gear="2"/>',
}
DEFAULTS = """<default><motor gear="2"/><default class="strong"><motor gear="11"
ctrlrange="-.4 .1"/><default class="servo"><position kp="9" kv=".2"
forcerange="-1 1"/></default></default></default>"""


def mjcf(actuators: str, head: str = "", bodies: str = BODIES, tail: str = "") -> str:
    """Return an MJCF text with actuators."""
    return (
        f'<mujoco model="arm"><option gravity="0 0 0"/>{head}{DEFAULTS}<worldbody>{bodies}'
        f"</worldbody><actuator>{actuators}</actuator>{tail}</mujoco>"
    )


def load(text: str, **options: Any) -> System:
    """Load a text without warnings about contact."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LeftOutWarning)
        return pinred.load(text=text, **options)


class MuJoCo:
    """The same file in MuJoCo, without contact, limits and passive forces."""

    def __init__(self, text: str) -> None:
        """Compile the file."""
        self.model: Any = mujoco.MjModel.from_xml_string(text)
        off = mujoco.mjtDisableBit
        for bit in (off.mjDSBL_CONSTRAINT, off.mjDSBL_DAMPER, off.mjDSBL_SPRING):
            self.model.opt.disableflags |= int(bit)
        self.data: Any = mujoco.MjData(self.model)

    def forward(self, qpos: Array, qvel: Array, ctrl: Array | list[float]) -> Any:
        """Return MuJoCo's data at a state."""
        self.data.qpos[:], self.data.qvel[:], self.data.ctrl[:] = qpos, qvel, ctrl
        mujoco.mj_forward(self.model, self.data)
        return self.data


def generalised_forces(system: System, controls: Any, qpos: Array, qvel: Array) -> Array:
    """Return pinred's forces on base and shape, (n,), at a state of MuJoCo of BODIES."""
    scene = pinred.Scene(system=system, controls=controls, seed=0)
    x = np.concatenate([qpos[1:3], np.roll(qpos[3:7], -1)])
    zero = np.zeros(1)
    base = BaseInSpace(qpos[:1], qvel[:1], zero, zero)
    model = scene.force_model
    assert model is not None
    at = ForceInputs(0.0, x, qvel[1:], qvel[:1], zero, model.numbers_from(0.0, 1.0), base)
    acting = model.acting(at)
    return np.concatenate([acting.wrench, acting.torque])


def random_state(rng: np.random.Generator) -> tuple[Array, Array, float]:
    """Return qpos, qvel and a control of BODIES."""
    ball = rng.normal(size=4)
    qpos = np.concatenate([rng.uniform(-2.0, 2.0, 3), ball / np.linalg.norm(ball)])
    return qpos, rng.normal(size=6), rng.uniform(-1.0, 1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_actuator_of_each_kind_matches_mujoco(kind: str) -> None:
    """Forces and accelerations agree with MuJoCo at random states and controls."""
    head = '<compiler angle="radian" autolimits="true"/>'
    bodies = BODIES.replace('ref="20"', 'ref=".35" range="-1 1.5"')
    text = mjcf(KINDS[kind], head, bodies)
    system, judge = load(text), MuJoCo(text)
    (actuator,) = system.actuators
    assert actuator.name == "a"
    assert actuator.kind in (
        kind.split()[0],
        "general",
        "motor",
        "position",
    )
    rng, largest = np.random.default_rng(3), 0.0
    for _ in range(6):
        qpos, qvel, control = random_state(rng)
        data = judge.forward(qpos, qvel, [control])
        force = generalised_forces(system, {"a": control}, qpos, qvel)
        size = np.abs(data.qfrc_actuator).max()
        assert np.abs(force - data.qfrc_actuator).max() <= 1e-12 * max(1.0, size), (qpos, control)
        largest = max(largest, size)
    assert largest > 0.1


def test_motion_matches_mujoco_accelerations() -> None:
    """A motion under all kinds of control agrees with SciPy's integral of MuJoCo's qacc."""
    from scipy.integrate import solve_ivp

    text = mjcf(
        '<motor name="yaw" joint="yaw" gear="2"/><position name="hip" joint="hip" kp="30" kv="2" '
        'forcerange="-4 4"/><velocity name="slide" joint="slide" kv="5"/>'
        '<general name="neck" jointinparent="neck" gear=".1 .2 -.1" biastype="affine" '
        'biasprm="0 -.8 -.05"/><motor name="extra" joint="slide" gear="3" ctrlrange="-.2 .2"/>',
    )
    system, judge = load(text), MuJoCo(text)
    x0 = np.array([0.3, 0.1, 0.0, 0.0, 0.0, 1.0])

    def controls_at(t: float) -> list[float]:
        return [0.3 * math.sin(3 * t), 0.8, 0.2 * math.cos(t), 0.4, 0.5 * math.sin(7 * t)]

    def rate(t: float, y: Array) -> Array:
        qpos, qvel = y[:7], y[7:]
        data = judge.forward(qpos, qvel, controls_at(t))
        w = np.concatenate([[0.0], qvel[3:]])
        turn = np.empty(4)
        mujoco.mju_mulQuat(turn, qpos[3:7], w)
        return np.concatenate([qvel[:3], 0.5 * turn, data.qacc])

    traj = pinred.simulate(
        system, x0=x0, duration=0.5, times=[0.0, 0.5], rtol=1e-12, atol=1e-13,
        controls={
            "yaw": "0.3*sin(3*t)", "hip": 0.8, "slide": lambda s: _cos(s.t),
            "neck": signals.Constant(0.4), "extra": "0.5*sin(7*t)",
        },
    )  # fmt: skip
    start = np.concatenate([[0.0], x0[:2], np.roll(x0[2:], 1), np.zeros(6)])
    options: dict[str, Any] = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12, "max_step": 0.05}
    end = solve_ivp(rate, (0.0, 0.5), start, **options).y[:, -1]
    assert abs(traj.pose[-1, 0] - end[0]) < 1e-9
    assert np.abs(traj.x[-1, :2] - end[1:3]).max() < 1e-9
    assert np.abs(traj.x[-1, 2:] - np.roll(end[3:7], -1)).max() < 1e-9
    assert np.abs(traj.xdot[-1] - end[8:]).max() < 1e-8
    assert np.abs(traj.xdot[-1]).max() > 0.05
    assert pinred.compare(traj).passed


def _cos(t: Any) -> Any:
    import casadi as ca

    return 0.2 * ca.cos(t)


def test_limits_of_a_joint_bound_the_sum_of_its_actuators() -> None:
    """The torque limits of a joint apply to the sum of both actuators."""
    bodies = BODIES.replace('name="hip"', 'name="hip" actuatorfrcrange="-1 1"')
    text = mjcf(
        '<motor name="a" joint="hip" gear="5"/><motor name="b" joint="hip" gear="3"/>', "", bodies
    )
    system, judge = load(text), MuJoCo(text)
    assert [a.torque_limits for a in system.actuators] == [(-1.0, 1.0)] * 2
    qpos, qvel, _ = random_state(np.random.default_rng(1))
    for controls in ([0.5, -0.4], [0.2, -0.4], [-0.9, 0.1]):
        force = generalised_forces(system, {"a": controls[0], "b": controls[1]}, qpos, qvel)
        expected = judge.forward(qpos, qvel, controls).qfrc_actuator
        assert np.abs(force - expected).max() < 1e-12


def test_disabled_clamps_groups_and_actuation_act_as_in_mujoco() -> None:
    """Flags of the file switch clamps, groups and all actuators off."""
    motor = '<motor name="a" joint="hip" ctrlrange="-.1 .1" group="2"/>'
    (free,) = load(mjcf(motor, '<option><flag clampctrl="disable"/></option>')).actuators
    assert free.control_limits is None
    for option in (
        '<option actuatorgroupdisable="2"/>',
        '<option><flag actuation="disable"/></option>',
    ):
        assert load(mjcf(motor, option)).actuators == ()
    (one,) = load(mjcf(motor, '<option actuatorgroupdisable="3"/>')).actuators
    assert one.control_limits == (-0.1, 0.1)


def test_limits_that_bound_gravity_compensation_are_left_out() -> None:
    """MuJoCo adds the compensation of gravity before it clamps; pinred has no such force."""
    bodies = BODIES.replace(
        'name="hip"', 'name="hip" actuatorfrcrange="-1 1" actuatorgravcomp="true"'
    )
    system = load(mjcf('<motor name="a" joint="hip"/>', "", bodies))
    assert system.actuators == ()
    (left,) = (left for left in system.left_out if left.what == "actuators")
    assert left.names == ("a (its limits also bound the gravity compensation)",)


def test_actuator_of_a_follower_acts_on_its_leader() -> None:
    """With hip = 2 slide + 0.3, a servo of the hip acts on the slide by 2 gear f."""
    equality = (
        '<equality><joint joint1="hip" joint2="slide" polycoef=".3 2 0 0 0"/></equality>'
        '<size njmax="50"/>'
    )
    bodies = BODIES.replace('ref="20"', "")
    servo = '<position name="a" joint="hip" kp="20" kv=".5" gear="3"/>'
    system = load(mjcf(servo, "", bodies, equality))
    assert system.followers == ("hip",)
    scene = pinred.Scene(system=system, seed=0, controls={"a": 0.7})
    model, zero = scene.force_model, np.zeros(1)
    assert model is not None
    x, xdot = np.array([0.2, 0.0, 0.0, 0.0, 1.0]), np.array([0.4, 0.0, 0.0, 0.0])
    at = ForceInputs(0.0, x, xdot, zero, zero, model.numbers_from(0.0, 1.0), None)
    force = 20 * (0.7 - 3 * (0.3 + 2 * 0.2)) - 0.5 * 3 * 2 * 0.4
    assert model.acting(at).torque == pytest.approx([2 * 3 * force, 0.0, 0.0, 0.0], rel=1e-14)


def test_damping_of_actuators_is_passive() -> None:
    """Actuators damp their joint by the square of the gear; MuJoCo's passive forces agree."""
    text = mjcf(
        '<motor name="a" joint="hip" gear="-3" damping=".2 .3 .1"/><motor name="b" joint="hip" '
        'damping=".5"/>'
    )
    system = load(text)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    damper = next(force for force in system.passive if getattr(force, "joint", "") == "hip")
    for v in (-0.9, 0.4, 1.7):
        data.qvel[1] = v
        mujoco.mj_forward(model, data)
        laws = (damper.coefficient, *damper.polynomial)  # type: ignore[attr-defined]
        torque = -v * sum(c * abs(v) ** k for k, c in enumerate(laws))
        assert torque == pytest.approx(data.qfrc_passive[1], rel=1e-14)


LEFT_OUT = {
    "muscle": ('<muscle name="a" joint="hip" lengthrange="0 1"/>', "muscle"),
    "intvelocity": ('<intvelocity name="a" joint="hip" actrange="-1 1" kp="2"/>', "integrator"),
    "filtered": ('<position name="a" joint="hip" kp="2" timeconst=".1"/>', "filterexact"),
    "cylinder": ('<cylinder name="a" joint="hip"/>', "activation filter"),
    "site": ('<motor name="a" site="tip"/>', "site"),
    "tendon": ('<motor name="a" tendon="line"/>', "tendon"),
    "body": ('<adhesion name="a" body="head" ctrlrange="0 1"/>', "body"),
    "slidercrank": (
        '<motor name="a" cranksite="tip" slidersite="base" cranklength=".1"/>', "slidercrank",
    ),
    "pid": ('<pid name="a" joint="hip" kp="3"/>', "pid"),
    "delay": ('<motor name="a" joint="hip" delay=".1" nsample="10"/>', "delay"),
}  # fmt: skip


@pytest.mark.parametrize("kind", LEFT_OUT)
def test_other_actuators_are_left_out_by_name(kind: str) -> None:
    """Each kind that is not linear, or not at one joint, is listed with its reason and refused."""
    text, reason = LEFT_OUT[kind]
    bodies = BODIES.replace('<joint name="neck"', '<site name="tip"/><joint name="neck"').replace(
        '<joint name="yaw"', '<site name="base" pos="0 0 .5"/><joint name="yaw"'
    )
    tendon = '<tendon><fixed name="line"><joint joint="hip" coef="1"/></fixed></tendon>'
    system = load(mjcf(text, "", bodies, tendon))
    assert system.actuators == ()
    (left,) = (left for left in system.left_out if left.what == "actuators")
    assert left.names[0].startswith("a (")
    assert reason in left.names[0]
    with pytest.raises(InputError, match=rf"actuator a \(.*{reason}.*\) is left out"):
        pinred.simulate(system, seed=0, controls={"a": 0.1})


def test_actuators_of_compound_bases_merged_and_locked_joints_are_not_driven() -> None:
    """A planar base and merged hinges are left out by name; locked joints have no actuators."""
    planar = (
        '<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>'
    )
    motors = '<motor name="a" joint="yaw"/><motor name="b" joint="hip"/>'
    bodies = BODIES.replace('<joint name="yaw"', f'{planar}<joint name="yaw"')
    system = load(mjcf(motors, "", bodies))
    assert [a.name for a in system.actuators] == ["b"]
    assert any(
        "a (several degrees of freedom of the base)" in left.names for left in system.left_out
    )
    assert load(mjcf(motors), lock=["hip"]).actuators[0].name == "a"
    hinges = "".join(
        f'<joint name="n{k}" axis="{axis}"/>' for k, axis in enumerate(("1 0 0", "0 1 0", "0 0 1"))
    )
    bodies = BODIES.replace('<joint name="neck" type="ball"/>', hinges)
    system = load(mjcf('<motor name="a" joint="n1"/>', "", bodies), balls=True)
    assert system.actuators == ()
    assert any("a (merged hinge)" in left.names for left in system.left_out)


def test_actuators_without_controls_do_not_act_and_the_run_says_so() -> None:
    """Without controls nothing acts; `left_out` names idle actuators."""
    system = load(mjcf('<position name="a" joint="hip" kp="9"/><motor joint="slide"/>'))
    assert [a.name for a in system.actuators] == ["a", "slide"]
    scene = pinred.Scene(system=system, seed=0)
    assert scene.force_model is None
    assert "2 actuators (a, slide); the run leaves them out" in scene.left_out
    scene = pinred.Scene(system=system, seed=0, controls={"a": 0.0})
    assert "1 more actuator (slide); the run leaves it out" in scene.left_out
    assert scene.force_model is not None
    scene = pinred.Scene(system=system, seed=0, controls={"a": 0.0, "slide": 0.0})
    assert "actuator" not in scene.left_out
    assert "a: position at hip, gear 2" in str(pinred.inspect(system))
    assert "2 actuators (a, slide); a run leaves them out" in str(pinred.inspect(system))


def _on_three_ways(tmp_path: Path, text: str) -> Callable[[str], Array]:
    (tmp_path / "arm.xml").write_text(text)

    def end(name: str) -> Array:
        return np.asarray(pinred.read_recording(tmp_path / name).x[-1])

    return end


def test_python_scene_file_and_command_line_agree(tmp_path: Path) -> None:
    """The same controls give the same motion in all three places."""
    from pinred.cli.command_line import main

    text = mjcf(
        '<motor name="hip motor" joint="hip" gear="3"/><position name="b" joint="slide" kp="2"/>'
    )
    end = _on_three_ways(tmp_path, text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        system = pinred.load(tmp_path / "arm.xml")
        traj = pinred.simulate(
            system, x0=[0.1, 0, 0, 0, 0, 1], duration=0.5,
            controls={"hip motor": "0.3*sin(2*t)", "b": "0.2 - xdot['hip']"},
        )  # fmt: skip
        (tmp_path / "scene.toml").write_text(
            "robot = 'arm.xml'\nparameters = { gain = 0.2 }\n[start]\nx0 = [0.1, 0, 0, 0, 0, 1]\n"
            "[run]\nduration = 0.5\n[controls]\n'hip motor' = '0.3*sin(2*t)'\n"
            "b = \"gain - xdot['hip']\"\n"
        )
        assert main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "file.npz")]) == 0
        assert main([
            "simulate", str(tmp_path / "arm.xml"), "--x0", "0.1,0,0,0,0,1", "--time", "0.5",
            "--control", "hip motor=0.3*sin(2*t)", "--control", "b=0.2 - xdot['hip']",
            "--out", str(tmp_path / "line.npz"),
        ]) == 0  # fmt: skip
    assert np.abs(traj.x[-1] - end("file.npz")).max() < 1e-12
    assert np.abs(traj.x[-1] - end("line.npz")).max() < 1e-12
    assert abs(traj.x[-1, 0] - 0.1) > 1e-3


@pytest.mark.parametrize(
    ("controls", "message"),
    [
        ({"aa": 0.1}, "no actuator 'aa'; did you mean 'a'"),
        ({"a": "sin(q)"}, r"controls\['a'\]: the expression cannot be used"),
        ({"a": "sin(1/0)"}, r"controls\['a'\]"),
        ({"a": math.nan}, r"controls\['a'\] must be finite"),
        ({"a": True}, r"controls\['a'\] must be a number"),
        ({"a": None}, r"controls\['a'\] must be a number"),
        (Controller(lambda _: [0.0], 0.1, joints=("b",)), "no actuator 'b'"),
        (Controller(lambda _: [0.0], 0.1, wrench=True), "limit or a wrench"),
        (Controller(lambda _: {"b": 1.0}, 0.1), "returned a control for 'b'.*its actuators are a"),
        (Controller(lambda _: [1.0, 2.0], 0.1), r"1 finite controls \(a\)"),
    ],
)
def test_invalid_controls_are_refused_by_name(controls: Any, message: str) -> None:
    """Messages name the actuator and the valid names."""
    system = load(mjcf('<motor name="a" joint="hip"/>'))
    with pytest.raises(InputError, match=message):
        pinred.simulate(system, seed=0, duration=0.1, controls=controls)


def test_controls_of_a_robot_without_actuators_are_refused() -> None:
    """A URDF robot has no actuators."""
    with pytest.raises(InputError, match=r"no actuator 'a'.*are none"):
        pinred.simulate(pinred.load("falling_cat"), controls={"a": 1.0})
    with pytest.raises(InputError, match="are none"):
        pinred.simulate(pinred.load("falling_cat"), controls=Controller(lambda _: [], 0.1))


def test_controller_drives_actuators_by_sampled_controls() -> None:
    """A Controller's controls are clamped, held, recorded and replayed."""
    text = mjcf(
        '<motor name="a" joint="hip" gear="3" ctrlrange="-.1 .1"/>'
        '<position name="b" joint="slide" kp="2"/>'
    )
    system = load(text)
    policy = Controller(lambda s: {"a": 5.5 - s.x["hip"]}, 0.1, name="policy")
    traj = pinred.simulate(system, x0=[0.2, 0.3, 0, 0, 0, 1], duration=0.5, controls=policy)
    assert len(traj.actions) in (5, 6)
    assert set(traj.actions[0].torque) == {"a", "b"}
    assert traj.actions[0].torque == {"a": pytest.approx(5.3), "b": 0.0}
    assert pinred.compare(traj).passed
    same = pinred.simulate(
        system, x0=[0.2, 0.3, 0, 0, 0, 1], duration=0.5, controls={"a": 0.1, "b": 0.0}
    )
    assert np.abs(traj.x[-1] - same.x[-1]).max() < 1e-9


def test_keyframes_hold_controls() -> None:
    """Controls of a keyframe drive its actuators."""
    tail = '<keyframe><key name="home" qpos="0 .1 0 1 0 0 0" ctrl=".3 -.2"/></keyframe>'
    system = load(
        mjcf(
            '<muscle joint="hip" lengthrange="0 1"/><motor name="b" joint="slide"/>', tail=tail
        ).replace('ctrl=".3 -.2"', 'ctrl=".3 -.2" act="0"')
    )
    assert system.keyframes["home"].controls == {"b": -0.2}
    scene = pinred.Scene(system=system, keyframe="home", controls=system.keyframes["home"].controls)
    assert scene.controls == {"b": -0.2}
    again = pickle.loads(pickle.dumps(scene))
    assert again.controls == scene.controls
    assert again.system.actuators == system.actuators


def test_controls_vary_in_flows_batches_and_sweeps(tmp_path: Path) -> None:
    """A Parameter as control agrees with the number, in flows, batches and sweeps."""
    text = mjcf('<motor name="a" joint="hip" gear="3" ctrlrange="-.2 .2"/>', "", TWO_BODIES)
    system = load(text)

    def end(control: float) -> Array:
        traj = pinred.simulate(system, x0=[0.2], duration=0.2, controls={"a": control})
        return np.asarray(traj.x[-1])

    u, values = pinred.Parameter("u", 0.1), np.array([0.05, 0.15, 0.4])
    options: dict[str, Any] = {"duration": 0.2, "controls": {"a": u}}
    many = pinred.simulate_many(
        system, x0=np.full((3, 1), 0.2), parameters={"u": values}, **options
    )
    for k, value in enumerate((0.05, 0.15, 0.2)):
        assert np.abs(many.x[k, -1] - end(value)).max() < 1e-9
    flow = pinred.flow(system, x0=[0.2], wrt=["u"], **options)
    slope = (end(0.1 + 1e-4) - end(0.1 - 1e-4)) / 2e-4
    assert abs(np.asarray(flow.jacobian()["u"])[0] - slope[0]) < 1e-6
    assert abs(slope[0]) > 0.1
    scene = pinred.Scene(system=system, x0=[0.2], duration=0.2, controls={"a": 0.1})
    result = pinred.sweep(scene, {"controls.a": [0.05, 0.15]}, store=tmp_path / "s.zarr")
    for k, value in enumerate((0.05, 0.15)):
        assert np.abs(result.point(k).x[-1] - end(value)).max() < 1e-9


def test_actuators_of_equal_value_share_force_models() -> None:
    """Scenes with equal controls have one force model, and different controls another one."""
    system = load(mjcf('<motor name="a" joint="hip" gear="3"/>'))
    first, second, third = (
        pinred.Scene(system=system, seed=0, controls={"a": control}) for control in (0.1, 0.1, 0.2)
    )
    assert first.force_model is second.force_model
    assert first.force_model is not third.force_model
    changed = replace(system.actuators[0], gear=(4.0,))
    assert changed != system.actuators[0]
