"""MJCF files: which bodies are the robot, their names, and the actions that are left out."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from mjcf_constructs import ACTING, BOX, HINGE, INERTIAL, SLIDE, SWITCHES, robot
from mujoco_judge import Judge, read_tree

import pinred
from pinred import InputError, LeftOutWarning, LoadError, MissingPackageError, ModelError
from pinred.common.errors import ChoiceError
from pinred.forces import Damper, Friction, Spring
from pinred.system.passive import BASE

# Geoms without contact, so that no action is left out of the reduction.
SILENT = '<default><geom contype="0" conaffinity="0"/></default>'
SIDE = '<body name="side" pos="5 0 0"><freejoint name="drift"/><geom size=".3"/></body>'
TABLE = f'<geom type="plane" size="9 9 1"/><body name="table" pos="0 5 0">{BOX}</body>'


def arm(name: str = "arm", joints: str = "") -> str:
    """Return a body on a hinge with the same name."""
    joints = joints or f'<joint name="{name}" axis="0 1 0" pos=".1 0 .2"/>'
    return f'<body name="{name}" pos=".1 .2 .3">{joints}{INERTIAL}</body>'


def text(world: str, head: str = "") -> str:
    """Return a file in which nothing touches."""
    return f"<mujoco>{SILENT}{head}<worldbody>{world}</worldbody></mujoco>"


def base(inside: str = "", joints: str = '<freejoint name="float"/>') -> str:
    """Return a carrying body."""
    return f'<body name="base" pos="1 2 3">{joints}{BOX}{inside}</body>'


def write(folder: Path, content: str) -> Path:
    """Write a file."""
    path = folder / "robot.xml"
    path.write_text(content, encoding="utf-8")
    return path


def loaded(content: str, **options: Any) -> pinred.System:
    """Return the system in a text without any left-out action."""
    return pinred.load(mujoco.MjSpec.from_string(content), **options)


def with_warning(content: str, **options: Any) -> tuple[pinred.System, str]:
    """Return the system in a text, and its warning of one line."""
    with pytest.warns(LeftOutWarning) as caught:
        system = loaded(content, **options)
    assert len(caught) == 1
    line = str(caught[0].message)
    assert "\n" not in line
    assert caught[0].filename == __file__
    return system, line


# ---- choice of bodies


def test_static_bodies_are_not_the_robot() -> None:
    """A floor, a table and a mocap hand are no robots."""
    hand = '<body name="hand" mocap="true"><geom size=".1"/></body>'
    system = loaded(text(f"{TABLE}{base(arm())}{hand}"))
    assert (system.root_name, system.shape_names) == ("float", ("arm",))
    assert system.mass == pytest.approx(8.0 + 1.3)


def test_root_chooses_among_several_bodies(tmp_path: Path) -> None:
    """Without root= the error lists the bodies; with it the others are reported as left out."""
    content = text(f"{TABLE}{base(arm())}{SIDE}")
    with pytest.raises(ModelError, match=r"base, side.*root="):
        loaded(content)
    system, line = with_warning(content, root="base")
    assert (system.root_name, system.shape_names) == ("float", ("arm",))
    assert "other bodies (1)" in line
    assert [(left.what, left.names) for left in system.left_out] == [("other bodies", ("side",))]
    system, _ = with_warning(content, root="side")
    assert (system.root_name, system.m) == ("drift", 0)
    with pytest.raises(InputError, match=r"no body 'arm' in the world.*base, side"):
        loaded(content, root="arm")
    path = write(tmp_path, content)
    with pytest.warns(LeftOutWarning):
        system = pinred.load(path, root="side")
    assert system.origin == pinred.system.robot_file_contents.Origin(str(path), {}, "side")


def test_root_argument_is_refused_for_urdf() -> None:
    """In a URDF one link carries all others."""
    with pytest.raises(InputError, match="root='trunk' applies to MJCF and SDF only"):
        pinred.load("falling_cat", root="trunk")


def test_single_heavy_body_without_joints_floats() -> None:
    """If nothing moves in the file, its one body with mass floats."""
    system = loaded(text(f'{base(joints="")}<body name="mark"/>'))
    assert (system.group.name, system.m, system.contents.freed) == ("SE3", 0, "base")
    with pytest.raises(ModelError, match="base, table"):
        loaded(text(base(joints="") + TABLE))
    with pytest.raises(LoadError, match="no body in the model has a joint or a mass"):
        loaded(text('<body name="mark"/>'))


def test_trees_on_one_carrier_are_one_robot() -> None:
    """All bodies on one carrier are one robot, however many trees MuJoCo counts."""
    content = text(base(arm("left") + arm("right"), joints=""))
    assert mujoco.MjModel.from_xml_string(content).ntree == 2
    system = loaded(content)
    assert (system.group.name, system.shape_names) == ("SE3", ("left", "right"))
    assert system.contents.freed == "base"


@pytest.mark.parametrize("head", ["", '<compiler fusestatic="true"/>'])
def test_fixed_heavy_carrier_floats_as_on_free_joint(head: str) -> None:
    """The mass matrix equals that of the file with a free joint, in rotated axes."""
    inner = '<body name="inner" pos="0 0 1" euler="10 20 30">' + BOX + arm("left") + "</body>"
    fixed, free = (
        loaded(text(base(inner + arm("right"), joints=joints), head))
        for joints in ("", "<freejoint/>")
    )
    assert (fixed.contents.freed, free.contents.freed) == ("base", "")
    x = np.array([0.3, -0.7])
    H = [pinred.Reduction(system).mass_matrix(x) for system in (fixed, free)]
    place = fixed.model.frames[fixed.model.getFrameId("base", pin.FrameType.BODY)].placement
    T = np.eye(8)
    T[:6, :6] = place.actionInverse  # maps twists from the root joint's frame to the body's
    assert T.T @ H[1] @ T == pytest.approx(H[0], abs=1e-12 * np.abs(H[0]).max())
    first = str(pinred.inspect(fixed)).splitlines()[0]
    assert "the file fixes 'base' to the world; here it is free" in first
    assert "fixes" not in str(pinred.inspect(free)).splitlines()[0]
    assert "here it is free" in pinred.inspect(fixed)._repr_html_()


def test_massless_anchor_makes_first_joint_root() -> None:
    """The anchor is fixed and massless, with one moving body and other massless ones."""
    anchor = f'<body name="anchor" pos="0 0 1"><body name="mark"/>{arm("first")}</body>'
    system = loaded(text(anchor))
    assert (system.group.name, system.root_name, system.contents.freed) == ("SO2", "first", "")


def test_massless_frame_with_several_bodies_is_world() -> None:
    """root= chooses one of the moving bodies on it."""
    inner = '<body name="in" pos="1 0 0">{}</body>'
    frame = f'<body name="frame" pos="0 1 0" euler="0 0 30">{inner}</body>'
    two = arm("first") + arm("second")
    with pytest.raises(ChoiceError, match="root=") as caught:
        loaded(text(frame.format(two)))
    assert (caught.value.option, caught.value.choices) == ("root", ("first", "second"))
    with pytest.warns(LeftOutWarning, match="other bodies"):
        system = loaded(text(frame.format(two)), root="second")
    assert (system.group.name, system.root_name) == ("SO2", "second")
    alone = loaded(text(frame.format(arm("second"))))
    apart = system.model.jointPlacements[1].actInv(alone.model.jointPlacements[1])
    assert apart.isIdentity(1e-14)


# ---- names


def test_nameless_elements_get_unique_names() -> None:
    """Names consist of bodies, kinds and numbers, and avoid those in the file."""
    inside = (
        f"<body>{HINGE}{SLIDE}{INERTIAL}</body>"
        f'<body name="body3"><joint name="body2_hinge"/>{INERTIAL}</body>'
        f'<body name="universe"><joint name="universe"/>{INERTIAL}</body>'
    )
    tree = read_tree(mujoco.MjSpec.from_string(text(base(inside, joints="<freejoint/>"))))
    names = ["base_free", "body2_hinge_", "body2_slide2", "body2_hinge", "universe_"]
    assert list(tree.model.names)[1:] == names
    bodies = [f.name for f in tree.model.frames if f.type == pin.FrameType.BODY]
    assert bodies == ["base", "body2", "body3", "universe_"]


def test_planar_root_is_named_after_its_joints() -> None:
    """The name avoids that of another joint."""
    joints = (
        '<joint name="a" type="slide" axis="1 0 0"/><joint name="b" type="slide"/>'
        '<joint name="c" axis="0 1 0"/>'
    )
    assert loaded(text(base(arm("d"), joints))).root_name == "a+b+c"
    system = loaded(text(base(arm("a+b+c"), joints)))
    assert (system.root_name, system.shape_names) == ("a+b+c_", ("a+b+c",))


# ---- locks


@pytest.mark.parametrize("joint", ['<joint name="arm" {}/>', '<joint name="arm" type="slide" {}/>'])
def test_locked_joint_is_at_mujoco_coordinate(joint: str) -> None:
    """The remaining mass matrix equals MuJoCo's with the joint at that value."""
    joint = joint.format('ref=".3" pos=".1 0 0" axis="1 1 0"')
    content = text(base(arm(joints=joint) + arm("other")), '<compiler angle="radian"/>')
    system = loaded(content, lock={"arm": 0.8})
    assert system.shape_names == ("other",)
    judge = Judge(read_tree(mujoco.MjSpec.from_string(content)))
    m, qpos = judge.mujoco, judge.mujoco.qpos0.copy()
    qpos[m.joint("arm").qposadr], qpos[m.joint("other").qposadr] = 0.8, 0.4
    judge.at(qpos, np.zeros(m.nv))
    M = np.zeros((m.nv, m.nv))
    mujoco.mj_fullM(m, judge.data, M)
    rows = [0, 1, 2, 3, 4, 5, int(m.joint("other").dofadr[0])]
    H = pinred.Reduction(system).mass_matrix(np.array([0.4]))
    assert pytest.approx(M[np.ix_(rows, rows)], abs=1e-12 * np.abs(M).max()) == H


def test_locking_base_joints_changes_group() -> None:
    """The remaining joints of a plane are another group; a locked free base floats."""
    joints = (
        '<joint name="a" type="slide" axis="1 0 0"/><joint name="b" type="slide"/>'
        '<joint name="c" axis="0 1 0"/>'
    )
    content = text(base(arm(), joints))
    assert loaded(content, lock=["a", "b"]).group.name == "SO2"
    assert loaded(content, lock=["b", "c"]).group.name == "R"
    system = loaded(content, lock=["a", "b", "c"])
    assert (system.group.name, system.contents.freed) == ("SE3", "base")
    floating = loaded(text(base(arm())), lock=["float"])
    assert (floating.group.name, floating.contents.freed) == ("SE3", "base")
    place = floating.model.frames[floating.model.getFrameId("base", pin.FrameType.BODY)].placement
    assert place.translation.tolist() == [1.0, 2.0, 3.0]  # the drawn position


def test_invalid_lock_is_refused() -> None:
    """Refused are unknown joints, joints of another robot, and nonzero values of ball joints."""
    content = text(base(arm()) + SIDE)
    for name in ("elbow", "drift"):
        with pytest.raises(InputError, match=f"no joint '{name}'.*float, arm"):
            loaded(content, root="base", lock=[name])
    with pytest.raises(InputError, match=r"'float'.*locked at zero"):
        loaded(content, root="base", lock={"float": 1.0})


def test_ball_inside_tree_can_be_locked() -> None:
    """It is fixed at the identity."""
    content = text(base(arm(joints='<joint name="socket" type="ball"/>')))
    assert loaded(content, lock=["socket"]).m == 0


# ---- left-out actions


@pytest.mark.parametrize("what", ACTING)
def test_left_out_actions_are_reported(what: str) -> None:
    """An action is reported by name if it acts on the robot and no flag disables it."""
    head, inside, outside, names = ACTING[what]
    carrier = arm().replace("</body>", f"{inside}</body>")
    content = text(base(carrier) + SIDE + outside, head)
    system, line = with_warning(content, root="base")
    left = {entry.what: entry.names for entry in system.left_out}
    assert left == {what: names, "other bodies": ("side",)}
    # Limits are reported after a simulation that exceeds them.
    assert (f"{what} ({len(names)})" in line) == (what != "joint limits")
    assert f"{what}: {names[0]}" in str(pinred.inspect(system))
    assert f"{what}: {names[0]}" in pinred.inspect(system)._repr_html_()
    if what in SWITCHES:
        flag = f'<option><flag {SWITCHES[what]}="disable"/></option>'
        system, _ = with_warning(content.replace("<worldbody>", f"{flag}<worldbody>"), root="base")
        assert what not in {entry.what for entry in system.left_out}


def test_disable_flags_of_constraints_and_passive_forces() -> None:
    """One flag disables all constraints; both flags of springs and dampers, all passive forces."""
    head = (
        '<option density="1">'
        '<flag constraint="disable" spring="disable" damper="disable"/></option>'
        '<default><joint range="-1 1" frictionloss="1" stiffness="1" damping="1"/></default>'
        '<equality><weld body1="arm"/></equality>'
    )
    content = text(base(arm().replace('"arm" pos', '"arm" gravcomp="1" pos')), head)
    assert loaded(content).left_out == ()


def test_left_out_kinds_are_reported_in_one_line() -> None:
    """The line has counts, and long lists are shortened."""
    head = '<default><joint stiffness="1" springyield="1" range="-1 1"/></default>'
    system, line = with_warning(text(base("".join(arm(f"j{k}") for k in range(9))), head))
    assert "plastic springs (9) (see" in line
    assert str(system.left_out[0]) == "plastic springs: j0, j1, j2, j3, j4, j5, … (9 in all)"


def test_passive_forces_become_force_objects() -> None:
    """Springs, dampers and dry friction keep their polynomials, rest positions and units."""
    joint = (
        '<joint name="arm" stiffness="2 .3 .1" damping=".5 .2 .1" frictionloss=".7" '
        'springref="30" ref="10"/>'
    )
    system = loaded(text(base(arm(joints=joint))))
    assert system.passive == (
        Spring("arm", 2.0, np.deg2rad(30.0), polynomial=(0.3, 0.1)),
        Damper("arm", 0.5, polynomial=(0.2, 0.1)),
        Friction("arm", 0.7),
    )
    assert system.left_out == ()
    for flag, gone in (("spring", Spring), ("damper", Damper), ("frictionloss", Friction)):
        head = f'<option><flag {flag}="disable"/></option>'
        left = loaded(text(base(arm(joints=joint)), head)).passive
        assert len(left) == 2
        assert not any(isinstance(force, gone) for force in left)
    assert loaded(text(base(arm(joints=joint))), lock=["arm"]).passive == ()


@pytest.mark.parametrize(
    "root",
    [
        '<joint name="b" type="ball" stiffness="4"/>',
        '<joint name="b" type="free" damping="4"/>',
        '<joint name="b" axis="0 0 1" frictionloss="4"/>',
    ],
)
def test_passive_forces_at_base_are_left_out(root: str) -> None:
    """They would change the momentum."""
    inside = arm(joints='<joint name="arm" damping="1"/>')
    system, line = with_warning(text(base(inside, joints=root)))
    assert system.passive == (Damper("arm", 1.0),)
    assert [(left.what, left.names) for left in system.left_out] == [(BASE, ("b",))]
    assert f"{BASE} (1)" in line


def test_uniform_gravity_compensation_reduces_gravity() -> None:
    """The remainder is the gravity, also if a motor at the joint compensates."""
    carrier = base(arm()).replace('name="base"', 'name="base" gravcomp=".75"')
    carrier = carrier.replace('name="arm" pos', 'name="arm" gravcomp=".75" pos')
    head = '<option gravity="0 4 -8"/>'
    assert loaded(text(carrier, head)).gravity.tolist() == [0.0, 1.0, -2.0]
    assert loaded(text(carrier, head), gravity=[0, 0, -1]).gravity.tolist() == [0.0, 0.0, -1.0]


# ---- packages, memory, threads


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder."""
    env = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(Path(pinred.__file__).parents[1]), *sys.path])
    }
    command = [sys.executable, "-c", code]
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_mujoco_is_imported_only_for_mjcf(tmp_path: Path) -> None:
    """Neither pinred nor a URDF imports it."""
    path = write(tmp_path, text(base(arm())))
    code = (
        "import sys, pinred\npinred.load('falling_cat')\nassert 'mujoco' not in sys.modules\n"
        f"pinred.load({str(path)!r})\nassert 'mujoco' in sys.modules\n"
    )
    done = run(code, tmp_path)
    assert done.returncode == 0, done.stderr


def test_missing_mujoco_names_command_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message has one line."""
    path = write(tmp_path, text(base(arm())))
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingPackageError, match=r'pip install "pinred\[mjcf\]"') as caught:
        pinred.load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_mujoco_warnings_write_no_file(tmp_path: Path) -> None:
    """Warnings are not logged to a file, and are enabled again afterwards."""
    nan = write(tmp_path, text(base(arm()).replace("1 2 3", "1 nan 3")))
    code = (
        "import mujoco, pinred\n"
        "said = []\nmujoco.set_mju_user_warning(said.append)\n"
        "kept = mujoco.get_mju_user_warning()\n"
        f"try:\n    pinred.load({str(nan)!r})\n"
        "except pinred.LoadError as error:\n    print(error)\n"
        "assert mujoco.get_mju_user_warning() is kept and said == []\n"
        "mujoco.set_mju_user_warning(None)\n"
        f"try:\n    pinred.load({str(nan)!r})\nexcept pinred.LoadError:\n    pass\n"
        "assert mujoco.get_mju_user_warning() is None\n"
    )
    done = run(code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert "contains nan" in done.stdout
    assert done.stderr == ""
    assert [entry.name for entry in tmp_path.iterdir()] == ["robot.xml"]


def test_system_name_of_file_and_model(tmp_path: Path) -> None:
    """A file gives its own name, a model the name in it."""
    content = text(base(arm())).replace("<mujoco>", '<mujoco model="walker">')
    assert pinred.load(write(tmp_path, content)).name == "robot"
    assert loaded(content).name == "walker"
    assert pinred.load(mujoco.MjModel.from_xml_string(content)).name == "walker"
    assert loaded(content).origin is None


def test_robot_without_left_out_actions_loads_silently() -> None:
    """MuJoCo's deprecation messages are not passed on."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        system = loaded(text(base(arm()), '<compiler settotalmass="5"/>'))
    assert system.mass == pytest.approx(5.0)
    assert (system.left_out, system.passive, dict(system.keyframes)) == ((), (), {})


def test_planar_motion_matches_mujoco() -> None:
    """The reduced equations and MuJoCo with small steps agree for one second."""
    spec = mujoco.MjSpec.from_string(
        robot(f'{SILENT}<option integrator="RK4" timestep="1e-4" gravity="0 0 -9.81"/>', "plane",
              [arm("a"), arm("b", '<joint name="b" axis="0 1 0" ref="20"/>')])
    )  # fmt: skip
    model = spec.compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(3)
    data.qpos[:] = model.qpos0 + rng.uniform(-1, 1, model.nq)
    data.qvel[:] = rng.normal(size=model.nv)
    spec.add_key(name="start", qpos=data.qpos, qvel=data.qvel)
    mujoco.mj_step(model, data, 10_000)
    spec.add_key(name="end", qpos=data.qpos, qvel=data.qvel)
    system = pinred.load(spec)
    traj = pinred.simulate(system, keyframe="start", duration=1.0)
    end = system.keyframes["end"]
    assert traj.x[-1] == pytest.approx(end.x, abs=1e-9)
    assert traj.pose[-1] == pytest.approx(end.pose, abs=1e-9)
    assert traj.xi[-1] == pytest.approx(end.xi, abs=1e-8)


def test_comments_with_hyphens_load(tmp_path: Path) -> None:
    """As in MuJoCo; in the file and in one that it includes."""
    (tmp_path / "inner.xml").write_text(f"<mujocoinclude><!-- a -- b -->{arm()}</mujocoinclude>")
    path = tmp_path / "arm.xml"
    path.write_text(text('<!-- -- -->\n<include file="inner.xml"/>'), encoding="utf-8")
    assert mujoco.MjModel.from_xml_path(str(path)).nv == 1
    assert pinred.load(path).root_name == "arm"
