"""The carrying body of an MJCF file: group, coordinates and rotors of its joints."""

from __future__ import annotations

from itertools import product

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from mjcf_constructs import BOX, CONSTRUCTS, ROOTS, robot
from mujoco_judge import Judge, read_tree
from test_mjcf_against_mujoco import ARMS, EXACT, worst

import pinred
from pinred import ModelError, ModelWarning
from pinred.common.arrays import Array
from pinred.lie import GROUPS
from pinred.reduction.pointwise_reduction import symmetric
from pinred.system.joints import motion_group
from pinred.system.mjcf.read import keyframes_of
from pinred.system.mjcf.tree import Tree

# The group of each root, and the number of joints of the carrying body that remain as shape.
GROUP_OF = {
    "free": ("SE3", 0),
    "free, as a joint": ("SE3", 0),
    "ball": ("SO3", 0),
    "hinge": ("SO2", 0),
    "hinge with a rotor": ("SO2", 0),
    "slide": ("R", 0),
    "slide and hinge": ("R", 1),
    "ball and slide": ("SO3", 1),
    "plane": ("SE2", 0),
    "three slides and a ball": ("SE3", 0),
    "three slides and three hinges": ("SE3", 0),
}


def tree_in(text: str) -> Tree:
    """Return the robot in a text."""
    return read_tree(mujoco.MjSpec.from_string(text))


def group_of(tree: Tree) -> str:
    """Return the group of the first joint."""
    group = motion_group(tree.model.joints[1])
    assert group is not None
    return group.name


def numbers(values: Array) -> str:
    """Return the numbers as text with all digits."""
    return " ".join(map(repr, np.asarray(values).tolist()))


@pytest.mark.parametrize("root", GROUP_OF)
def test_joints_of_carrier_form_group(root: str) -> None:
    """The joints of the carrying body are one group; its remaining joints are shape."""
    tree = tree_in(robot("", root, [CONSTRUCTS["hinge"][1]]))
    group, remaining = GROUP_OF[root]
    assert group_of(tree) == group
    assert len(tree.shape) == remaining + 1


def plane(order: str, seed: int, armature: str = "") -> str:
    """Return a carrier on slides (S) and hinges (H) of a random plane, with a normal slide (C)."""
    rng = np.random.default_rng(seed)
    turn = pin.exp3(rng.uniform(-2.0, 2.0, 3))
    joints = ""
    for kind in order:
        angle, sign = rng.uniform(0, 2 * np.pi), rng.choice([-1.0, 1.0])
        along = turn @ [np.cos(angle), np.sin(angle), 0.0]
        axis = along if kind == "S" else sign * turn[:, 2]
        word = "hinge" if kind == "H" else "slide"
        joints += (
            f'<joint type="{word}" axis="{numbers(axis)}" pos="{numbers(rng.normal(size=3))}" '
            f'ref="{rng.uniform(-1, 1)!r}" {armature}/>'
        )
    said = f'pos="{numbers(rng.normal(size=3))}" quat="{numbers(rng.normal(size=4))}"'
    return f'<body name="base" {said}>{joints}{BOX}{"".join(ARMS)}</body>'


def world(inside: str, head: str = "") -> str:
    """Return a file with bodies."""
    return f"<mujoco>{head}<worldbody>{inside}</worldbody></mujoco>"


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("order", ["".join(o) for o in product("SH", repeat=3) if "H" in o])
@pytest.mark.sampled
def test_three_joints_of_plane_are_se2(order: str, seed: int) -> None:
    """This holds in any order and any plane, with points and references anywhere."""
    tree = tree_in(world(plane(order, seed)))
    assert group_of(tree) == "SE2"
    assert worst(tree, seed).worst < EXACT


@pytest.mark.parametrize("order", ["CSSH", "SCSH", "SSHC", "HSCS", "HCHS", "HHCH", "CHSH"])
def test_plane_with_normal_slide_is_r_times_se2(order: str) -> None:
    """The slide may be anywhere among the joints."""
    tree = tree_in(world(plane(order, 4)))
    assert group_of(tree) == "RxSE2"
    assert worst(tree).worst < EXACT


@pytest.mark.parametrize(
    "joints",
    [
        '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint axis="0 1 0"/>',
        '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        '<joint axis="0 1e-9 1"/>',
        '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="2 0 0"/><joint/>',
        '<joint type="slide" axis="1 0 0"/><joint/><joint/>',
        '<joint/><joint pos="1 0 0"/><joint axis="1 0 0"/>',
        "<joint/><joint/><joint/>",
        '<joint type="slide"/><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>',
        '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint/><joint/>',
    ],
)
def test_other_joint_patterns_are_no_plane(joints: str) -> None:
    """The first joint is the root, and the others are shape."""
    tree = tree_in(world(f'<body name="base">{joints}{BOX}</body>'))
    assert group_of(tree) in ("R", "SO2")
    assert len(tree.shape) == joints.count("<joint") - 1
    assert worst(tree).worst < EXACT


def test_three_hinges_drawn_in_line_are_a_plane() -> None:
    """They move in all directions of the plane away from the drawn position."""
    joints = "".join(f'<joint pos="{k} 0 0"/>' for k in range(3))
    tree = tree_in(world(f'<body name="base">{joints}{BOX}</body>'))
    assert group_of(tree) == "SE2"
    assert worst(tree).worst < EXACT


@pytest.mark.parametrize("root", [*ROOTS, "HSH", "HHH", "SSH", "SCHS"])
def test_keyframe_matches_mujoco(root: str) -> None:
    """A keyframe is the state that MuJoCo's kinematics and Jacobians give."""
    rng = np.random.default_rng(5)
    spec = mujoco.MjSpec.from_string(
        robot("", root, ARMS) if root in ROOTS else world(plane(root, 2))
    )
    model = spec.compile()
    qpos, qvel = model.qpos0 + rng.normal(size=model.nq), rng.normal(size=model.nv)
    mujoco.mj_normalizeQuat(model, qpos)
    spec.add_key(name="home", qpos=qpos, qvel=qvel, time=0.7)
    spec.add_key(qpos=qpos, qvel=qvel)
    tree = read_tree(spec)
    q, v, *_ = Judge(tree).at(qpos, qvel)
    group = GROUPS["SE3"] if tree.root is None else motion_group(tree.model.joints[1])
    assert group is not None
    frames = keyframes_of(tree, group)
    assert list(frames) == ["home", "key1"]
    assert frames["home"].time == 0.7
    key = frames["home"]
    pose = key.pose
    if tree.root is None:
        assert pose.tolist() == group.identity().tolist()
        assert not key.xi.any()
        pose = np.empty(0)
    elif group.name in ("SE2", "RxSE2"):
        pose = np.array([*pose[:-1], np.cos(pose[-1]), np.sin(pose[-1])])
    apart = pin.difference(tree.model, np.concatenate([pose, key.x]), q)
    turns = 2 * np.pi * np.round(apart / (2 * np.pi)) if group.name == "SO2" else 0.0
    assert np.abs(apart - turns).max() < 1e-12
    twist = np.empty(0) if tree.root is None else key.xi
    assert np.concatenate([twist, key.xdot]) == pytest.approx(v, abs=1e-12)


def slides(said: str) -> str:
    """Return three slides along the axes."""
    axes = "1 0 0", "0 0 1", "0 1 0"
    return "".join(f'<joint type="slide" axis="{axis}" {said}/>' for axis in axes)


# Joints of the carrying body whose rotors equal an inertia, and admissible gravity.
ROTORS = {
    "ball": ('<joint type="ball" armature=".8" pos=".1 .2 0"/>', "1 2 3"),
    "ball of a motor": ('<joint name="j" type="ball" armature=".3"/>', "1 2 3"),
    "slide, gravity across": ('<joint type="slide" axis="1 1 0" armature="2"/>', "1 -1 4"),
    "hinge": ('<joint axis="1 1 0" armature="2" pos="0 0 1"/>', "1 2 3"),
    "plane, gravity across": (
        '<joint type="slide" axis="1 0 0" armature="2"/><joint type="slide" axis="0 0 -1" '
        'armature="2"/><joint axis="0 1 0" pos=".3 0 .1" armature=".5"/>',
        "0 -9 0",
    ),
    "plane, the hinge alone": (
        '<joint type="slide" axis="1 0 0"/><joint axis="0 1 0" pos=".3 0 .1" armature=".5"/>'
        '<joint type="slide" axis="1 0 1"/>',
        "1 2 3",
    ),
    "plane that climbs, no gravity": (
        slides('armature="2"') + '<joint axis="1 0 0" pos=".3 0 .1" armature=".5"/>', "0 0 0",
    ),
    "slides and a ball, no gravity": (
        slides('armature="3"')
        + '<joint type="ball" pos=".1 0 .3" armature=".2"/>',
        "0 0 0",
    ),
    "slides and a ball, the ball alone": (
        slides("")
        + '<joint type="ball" pos=".1 0 .3" armature=".2"/>',
        "1 2 3",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ROTORS)
def test_isotropic_rotors_of_base_become_inertia(name: str) -> None:
    """Rotors that resist equally in all directions become an inertia; forces equal MuJoCo's."""
    joints, gravity = ROTORS[name]
    head = f'<option gravity="{gravity}"/>'
    if name == "ball of a motor":
        head += '<actuator><motor joint="j" armature=".1" gear="2 3 4"/></actuator>'
    tree = tree_in(world(f'<body name="base">{joints}{BOX}{"".join(ARMS)}</body>', head))
    assert tree.root is not None
    assert len(tree.root.joints) == joints.count("<joint")
    errors = worst(tree)
    assert errors.worst < EXACT, errors
    assert tree.root.rotors != pin.Inertia.Zero() or name == "hinge"


# Joints of the carrying body, gravity, and words of the refusal.
REFUSED = {
    "slide along gravity": (
        '<joint name="j" type="slide" armature="1"/>', "0 0 -1", ["'j'", "gravity"],
    ),
    "plane along gravity": (
        '<joint name="a" type="slide" axis="1 0 0" armature="1"/><joint name="b" type="slide" '
        'armature="1"/><joint axis="0 1 0"/>',
        "0 0 -1", ["joint 'a', joint 'b'", "gravity"],
    ),
    "plane, unlike": (
        '<joint name="a" type="slide" axis="1 0 0" armature="1"/><joint name="b" type="slide" '
        'armature="2"/><joint axis="0 1 0"/>',
        "0 1 0", ["joint 'a', joint 'b'", "1, 2", "the same"],
    ),
    "plane, aslant": (
        '<joint name="a" type="slide" axis="1 0 0" armature="1"/><joint name="b" type="slide" '
        'axis="1 0 1" armature="1"/><joint axis="0 1 0"/>',
        "0 1 0", ["joint 'a', joint 'b'", "right angles"],
    ),
    "plane, behind a hinge": (
        '<joint name="a" type="slide" axis="1 0 0" armature="1"/><joint axis="0 1 0"/>'
        '<joint name="b" type="slide" armature="1"/>',
        "0 1 0", ["joint 'a', joint 'b'", "hinge ahead"],
    ),
    "plane, two hinges": (
        '<joint name="a" armature="1"/><joint name="b" pos="1 0 0"/>'
        '<joint type="slide" axis="1 0 0"/>',
        "0 0 0", ["joint 'a', joint 'b'", "1, 0", "two hinges"],
    ),
    "plane that climbs": (
        slides('armature="2"') + "<joint/>", "0 0 1", ["base_slide", "2, 2, 2", "gravity"],
    ),
    "slides and a ball": (
        slides('armature="1"') .replace("1 0 0", "1 0 1") + '<joint type="ball"/>',
        "0 0 0", ["base_slide", "1, 1, 1", "right angles"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_rotors_that_break_symmetry_are_refused(name: str) -> None:
    """The message names the joints and the way out."""
    joints, gravity, words = REFUSED[name]
    text = world(f'<body name="base">{joints}{BOX}</body>', f'<option gravity="{gravity}"/>')
    with pytest.raises(ModelError) as caught:
        tree_in(text)
    said = str(caught.value)
    assert [word for word in [*words, "armature", "set it to zero"] if word not in said] == []


@pytest.mark.parametrize("gravity", ["0 0 -9", "0 0 0"])
def test_armature_of_free_joint_is_ignored_with_warning(gravity: str) -> None:
    """Inherited from a <default>: mass, forces and motion equal those of a <freejoint>."""
    head = (
        f'<default><joint armature=".1"/><geom contype="0" conaffinity="0"/></default>'
        f'<option gravity="{gravity}"/>'
    )
    arm = f'<body pos="0 .1 .2"><joint name="arm" axis="0 1 0"/>{BOX}</body>'
    text = world(f'<body><joint name="j" type="free"/>{BOX}{arm}</body>', head)
    with pytest.warns(ModelWarning, match="free joint 'j' has armature 0.1, which is ignored"):
        system = pinred.load(mujoco.MjSpec.from_string(text))
    bare = tree_in(text.replace('<joint name="j" type="free"/>', '<freejoint name="j"/>'))
    assert worst(bare).worst < EXACT
    H, expected = (
        symmetric(pin.crba(model, model.createData(), pin.neutral(model)))
        for model in (system.model, bare.model)
    )
    np.testing.assert_array_equal(H, expected)
    assert system.model.armature.tolist() == [0, 0, 0, 0, 0, 0, 0.1]
    assert system.mass == sum(bare.world.model.body_mass)


def test_gravity_argument_decides_about_rotors() -> None:
    """Gravity in the file is not used if another one is passed."""
    spec = mujoco.MjSpec.from_string(world(f'<body><joint type="slide" armature="1"/>{BOX}</body>'))
    with pytest.raises(ModelError, match="gravity"):
        pinred.load(spec)
    spec.geoms[0].contype = spec.geoms[0].conaffinity = 0
    assert pinred.load(spec, gravity=[0, 0, 0]).mass == pytest.approx(9.0)


def test_rotors_of_changed_model() -> None:
    """In a changed model, rotors of one joint can differ; rotation gives them no bias."""
    text = world(f'<body><joint name="j" type="ball" armature="1"/>{BOX}</body>')
    model = mujoco.MjSpec.from_string(text).compile()
    model.dof_armature[1] = 2.0
    with pytest.raises(ModelError, match=r"'j'.*the same in all directions"):
        read_tree(model)
