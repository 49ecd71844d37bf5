"""Closed loops: reading, assembly, rank, kinematics and refusals."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from loop_robots import crank_angles, four_bar, gripper, random_loops, sliding_bars
from robot_texts import body, joint, link, mjcf, robot
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import pinred
from pinred.cli.command_line import main
from pinred.common.arrays import Array
from pinred.common.errors import InputError, ModelError
from pinred.system.loops import loop_assembly
from pinred.system.loops.kinematics import LoopKinematics, loop_values
from pinred.system.loops.loop import KINDS, Loop, parse_loops


@pytest.mark.parametrize("kind", ["3d", "z"])
def test_four_bar_has_rank_two_and_closes_in_closed_form(kind: str) -> None:
    """The redundant equations of a planar loop are not chosen."""
    model, _ = four_bar()
    system = pinred.load(model, loops=f"coupler_tip=rocker_tip:{kind}")
    assert system.closure is not None
    assert (system.closure.rank, system.shape_dim) == (2, 1)
    for crank in (-2.0, 0.3, 1.5):
        scene = pinred.Scene(system=system, x0={"crank": crank}, duration=1.0)
        np.testing.assert_allclose(scene.start.x, [crank, *crank_angles(crank)], atol=1e-12)


def test_units_of_loops_are_their_longest_arm() -> None:
    """Lengths count in units of the longest placement, or of one metre if all are zero."""
    lengths = {"crank": 0.3, "coupler": 0.8, "rocker": 0.7, "frame": 0.9}
    system = pinred.load(four_bar(lengths=lengths)[0], loops="coupler_tip=rocker_tip")
    assert loop_assembly.loop_length(system) == pytest.approx(0.9, rel=1e-15)
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelPlanar(), pin.SE3(np.eye(3), np.ones(3)), "root")
    model.addJoint(root, pin.JointModelRZ(), pin.SE3.Identity(), "hinge")
    without_arms: Any = SimpleNamespace(sorted_model=model, loops=())
    assert loop_assembly.loop_length(without_arms) == 1.0
    slider = pinred.load(sliding_bars()[0], loops=sliding_bars()[1])
    np.testing.assert_array_equal(loop_assembly.rate_units(slider, 0.25), [1.0, 0.25, 1.0, 1.0])
    # The six equations of the weld are three lengths and three angles.
    weights = loop_assembly.equation_weights(slider, 0.25)
    np.testing.assert_array_equal(weights, [4.0, 4.0, 4.0, 1.0, 1.0, 1.0])


@pytest.mark.parametrize("kind", KINDS)
def test_jacobian_and_its_rate_equal_differences(kind: str) -> None:
    """Central differences of order 4 confirm J and J̇ at a random state of a tree in space."""
    model = pin.buildSampleModelHumanoidRandom()
    links = [f.name for f in model.frames if f.type == pin.FrameType.BODY]
    loop = Loop(links[-3], links[5], kind)  # type: ignore[arg-type]
    kinematics, rng = LoopKinematics(model, [loop]), np.random.default_rng(0)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-0.5, 0.5, model.nv))
    v, h = rng.normal(size=model.nv), 1e-3

    def differences(function: object) -> np.ndarray:
        at = [function(pin.integrate(model, q, k * h * v)) for k in (-2, -1, 1, 2)]  # type: ignore[operator]
        return np.asarray((at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h))

    J = kinematics.jacobian(q)
    np.testing.assert_allclose(J @ v, differences(kinematics.values), atol=1e-8)
    rate = kinematics.jacobian_rate(q, v)
    np.testing.assert_allclose(rate, differences(kinematics.jacobian), atol=1e-8)
    np.testing.assert_allclose(kinematics.bias(q, v), rate @ v, rtol=1e-12)


def test_gripper_of_mjcf_has_the_gaps_that_mujoco_measures(tmp_path: Path) -> None:
    """Two connects and a coupling leave one motion; MuJoCo's residuals judge the frames."""
    path = tmp_path / "gripper.xml"
    path.write_text(gripper())
    system = pinred.load(path)
    assert system.closure is not None
    assert (system.m, system.closure.equations, system.closure.rank, system.shape_dim) == (
        5,
        6,
        4,
        1,
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    x = np.random.default_rng(0).uniform(-0.3, 0.3, system.m)
    q = system.q(system.group.identity(), x)
    names = [str(name) for name in system.model.names]
    for number in range(1, model.njnt):
        at = system.model.joints[names.index(model.joint(number).name)].idx_q
        data.qpos[model.jnt_qposadr[number]] = q[at]
    mujoco.mj_forward(model, data)
    expected = [np.linalg.norm(data.efc_pos[3 * k : 3 * k + 3]) for k in range(2)]
    found = np.linalg.norm(loop_values(system, x).reshape(2, 3), axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_weld_of_mjcf_closes_at_the_reference_configuration() -> None:
    """MuJoCo computes the relative pose of a weld in qpos0."""
    link = (
        '<body name="{0}" pos="0.1 {1} 0"><joint name="{0}" axis="0 0 1"/>'
        '<geom size="0.1" mass="1"/><body name="{0}2" pos="0.2 0.1 0"><joint name="{0}2" '
        'axis="0 0 1"/><geom size="0.1" mass="1"/>{2}</body></body>'
    )
    last = (
        '<body name="c" pos="0.3 -0.2 0"><joint name="c" axis="0 0 1"/>'
        '<geom size="0.1" mass="1"/></body>'
    )
    text = (
        '<mujoco><option><flag contact="disable"/></option>'
        '<worldbody><body name="base"><freejoint/><geom size="0.1" mass="1"/>'
        + link.format("a", 0.3, last)
        + link.format("b", -0.3, "")
        + '</body></worldbody><equality><weld name="tie" body1="c" body2="b2"/></equality></mujoco>'
    )
    system = pinred.load(mujoco.MjModel.from_xml_string(text))
    assert (system.m, system.shape_dim) == (5, 2)
    np.testing.assert_allclose(loop_values(system, np.zeros(5)), 0.0, atol=1e-15)


def test_loops_that_no_robot_can_have_are_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loops to the world, without motion, with unknown frames, and loops that do not close."""
    monkeypatch.setattr(loop_assembly, "_STARTS", 2)  # each takes hundreds of steps
    model, loops = four_bar()
    long_rocker, _ = four_bar(lengths={"crank": 0.1, "coupler": 0.2, "rocker": 0.3, "frame": 2.0})
    model.addFrame(pin.Frame("ground", 0, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    with pytest.raises(InputError, match=r"'crank_tip = ground' attaches the robot to the world"):
        pinred.load(model, loops="crank_tip=ground")
    with pytest.raises(InputError, match="'none' closes nothing: 'crank' and 'crank_tip' do not"):
        pinred.load(model, loops=[{"frame_a": "crank", "frame_b": "crank_tip", "name": "none"}])
    with pytest.raises(InputError, match="no link or frame 'rocket_tip'"):
        pinred.load(model, loops="coupler_tip=rocket_tip")
    with pytest.raises(ModelError, match=r"do not close: loop 'tips' has a gap of 1.4 m"):
        pinred.load(long_rocker, loops=loops)
    with pytest.raises(InputError, match="kind: expected one of 3d, 6d, x, y, z, got '5d'"):
        Loop("a", "b", "5d")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="expected FRAME=FRAME"):
        parse_loops("coupler_tip")
    with pytest.raises(InputError, match="two loops have the name 'tips'"):
        parse_loops([*loops, *loops])


@pytest.mark.by_hand
def test_loops_that_fix_all_joints_are_refused() -> None:
    """A four-bar whose tips may not turn against each other has no shapes."""
    with pytest.raises(ModelError, match=r"do not close|nothing can move"):
        pinred.load(four_bar()[0], loops="coupler_tip=rocker_tip:6d")


# Redundant equations of one planar loop are found by default.
@pytest.mark.by_hand
def test_redundant_equations_over_several_loops_are_found() -> None:
    """A second loop beside the first adds no independent equations."""
    model, loops = four_bar()
    twice = [*loops, Loop("rocker_tip", "coupler_tip", "z", "again")]
    system = pinred.load(model, loops=twice)
    assert system.closure is not None
    assert (system.closure.equations, system.closure.rank) == (8, 2)
    model, loops = random_loops(4, ("3d", "6d"), 5)
    assert pinred.load(model, loops=loops).shape_dim == 20 - 9


def test_scene_files_and_commands_accept_loops(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """[[load.loops]] and --loops act like load(loops=…)."""
    robot = tmp_path / "robot.urdf"
    robot.write_text(URDF)
    scene = tmp_path / "scene.toml"
    scene.write_text(
        "robot = 'robot.urdf'\n[run]\nduration = 0.2\n[start]\nseed = 1\n[load]\n"
        "group = 'SE3'\n[[load.loops]]\nframe_a = 'end'\nframe_b = 'rocker'\nkind = 'y'\n"
    )
    assert pinred.load_scene(scene).system.loops == (Loop("end", "rocker", "y"),)
    options = ["--group", "SE3", "--loops", "end=rocker:y", "--duration", "0.2"]
    assert main(["compare", str(robot), *options, "--seed", "1"]) == 0
    assert "gap of loops" in capsys.readouterr().out


def _link(name: str, parent: str = "", x: float = 0.0) -> str:
    body = (
        f'<link name="{name}"><inertial><origin xyz="0.2 0 0"/><mass value="1"/><inertia '
        'ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    joint = (
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{name}"/>'
        f'<origin xyz="{x} 0 0"/><axis xyz="0 1 0"/></joint>'
    )
    return body + (joint if parent else "")


URDF = (
    '<robot name="five">'
    + _link("frame")
    + _link("crank", "frame")
    + _link("coupler", "crank", 0.4)
    + _link("end", "coupler", 0.9)
    + _link("rocker", "frame", 1.0)
    + "</robot>"
)


# A mechanism on a heavy base is compared with MuJoCo by default.
@pytest.mark.by_hand
def test_heavy_ground_moves_a_mechanism_as_a_fixed_one(tmp_path: Path) -> None:
    """The example of docs/robots.md against the closed form of a four-bar on a fixed ground."""
    page = (Path(__file__).parents[2] / "docs/robots.md").read_text("utf-8")
    example = page.partition("### Mechanisms on the ground")[2]
    code = example.partition("```python\n")[2].partition("```")[0]
    scope: dict[str, Any] = {"pinred": pinred}
    exec(compile(code, "robots.md", "exec"), scope)
    motion = scope["motion"]
    crank, coupler, rocker = (motion.system.shape_names.index(n) for n in scope["L"])
    start = motion.x[0]

    def bars(angle: float) -> tuple[float, float, Array]:
        """Return the angles of coupler and rocker, and their ratios to the crank's rate."""

        def gap(z: Array) -> list[float]:
            x = 0.3 * np.cos(angle) + 0.8 * np.cos(z[0]) - 0.7 - 0.6 * np.cos(z[1])
            return [x, 0.3 * np.sin(angle) + 0.8 * np.sin(z[0]) - 0.6 * np.sin(z[1])]

        b, g = fsolve(gap, [start[crank] + start[coupler], start[rocker]], xtol=1e-12)
        J = [[-0.8 * np.sin(b), 0.6 * np.sin(g)], [0.8 * np.cos(b), -0.6 * np.cos(g)]]
        right = [0.3 * np.sin(angle), -0.3 * np.cos(angle)]
        return float(b), float(g), np.linalg.solve(J, right)

    def energies(angle: float) -> tuple[float, float]:
        """Return the effective moment of inertia and the potential energy."""
        b, g, (rb, rg) = bars(angle)
        vx = -0.3 * np.sin(angle) - 0.4 * np.sin(b) * rb
        vy = 0.3 * np.cos(angle) + 0.4 * np.cos(b) * rb
        inertia = 0.3**2 / 3 + 2 * (vx**2 + vy**2) + 2 * 0.8**2 / 12 * rb**2 + 1.5 * 0.12 * rg**2
        heights = 0.15 * np.sin(angle), 0.3 * np.sin(angle) + 0.4 * np.sin(b), 0.3 * np.sin(g)
        return inertia, 9.81 * float(np.dot([1.0, 2.0, 1.5], heights))

    inertia, potential = energies(start[crank])
    energy = 0.5 * inertia * 49.0 + potential

    def rate(_: float, angle: Array) -> float:
        inertia, potential = energies(float(angle[0]))
        return float(np.sqrt(2.0 * (energy - potential) / inertia))

    exact = solve_ivp(rate, (0.0, 0.3), [start[crank]], rtol=1e-12, atol=1e-13).y[0, -1]
    assert abs(motion.x[-1, crank] - exact) < 1e-9
    for text, words in WORLD_LOOPS.items():
        path = tmp_path / "robot.xml"
        path.write_text(text, "utf-8")
        with pytest.raises(ModelError, match="Mechanisms on the ground") as caught:
            pinred.load(path)
        assert words in str(caught.value)


WORLD_LOOPS = {
    mjcf(body("<freejoint/>", "a")).replace(
        "</mujoco>", '<equality><connect body1="a" anchor="0 0 0"/></equality></mujoco>'
    ): "ties 'a' and 'world'",
    robot(
        link("a"), link("b"), joint("a", "b"),
        '<loop_joint name="l" type="ball"><link1 link="b"/><link2 link="world"/></loop_joint>',
    ): "joint 'l' (line 1) ties link 'b' to the world",
}  # fmt: skip
