"""Refusals: a robot that pinred cannot reduce raises a typed error that names the cause."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from robot_texts import FLOATING, HINGE, MASS, body, joint, link, mjcf, robot, write
from trees import random_model

import pinred
from pinred import InputError, LoadError, ModelError, ModelWarning, PinredError, ShapeError
from pinred.common.arrays import Array

FREE = "<freejoint/>"
Z = '<axis xyz="0 0 1"/>'


def inertial(mass: str = "2", ixx: str = "1", izz: str = "2.5", xyz: str = "0 0 0") -> str:
    """Return a URDF inertial element with any attributes."""
    return (
        f'<inertial><origin xyz="{xyz}"/><mass value="{mass}"/><inertia ixx="{ixx}" iyy="2" '
        f'izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def with_b(inside: str) -> str:
    """Return a floating URDF whose moving link 'bee' has an inertial element."""
    return robot(link("a"), f'<link name="bee">{inside}</link>', joint("a", "bee"))


def with_merged(inside: str) -> str:
    """Return the same with the inertial element in link 'sea', fixed to a heavier link."""
    sea = f'<link name="sea">{inside}</link>'
    return robot(link("a"), link("b", 9), sea, joint("a", "b"), joint("b", "sea", "fixed"))


def three(*joints: str) -> str:
    """Return links a, b, c on joints; one joint is a-b."""
    return robot(*(link(name) for name in "abc"), joint("a", "b"), *joints)


def chain(kind: str, inside: str = Z) -> str:
    """Return three links in a chain, the last on a joint 'b-c' of a kind."""
    return three(joint("b", "c", kind, inside))


def on_arm(joints: str, inside: str = MASS, head: str = "", more: str = "") -> str:
    """Return a free MJCF body that carries an arm on joints."""
    return mjcf(body(f'{FREE}<body name="arm" {more}>{joints}{inside}</body>'), head)


BEE, SEA = "'bee'", "'sea'"
TIED = '<equality><weld name="tie" body1="base" active="true"/></equality>'
TWO = HINGE + '<joint name="second" axis="1 0 0"/>'

# Text of the file, expected error, and words of its message.
FILES: dict[str, tuple[str, type[PinredError], list[str]]] = {
    "empty": ("", LoadError, ["arm.urdf", "is empty", "must be XML"]),
    "not XML": ("robot: r", LoadError, ["arm.urdf", "not XML"]),
    "entities": ('<!DOCTYPE r SYSTEM "r.dtd"><robot>&e;</robot>', LoadError, ["arm.urdf"]),
    "entity in a mass": (
        '<!DOCTYPE r [<!ENTITY m "2">]>' + with_merged(inertial("&m;")),
        LoadError, ["arm.urdf", "document type"],
    ),
    "another format": ("<scene/>", LoadError, ["arm.urdf", "<scene>", "URDF"]),
    "encoding unknown": ('<?xml version="1.0" encoding="u-8"?><robot/>', LoadError, ["arm.urdf"]),
    "no links": (robot(), LoadError, ["arm.urdf"]),
    "two roots": (robot(link("a"), "\n", link("b")), ModelError, ["a (line 1)", "b (line 2)"]),
    "link twice": (robot(link("a"), "\n", link("a")), ModelError, ["two links", "'a'", "line 2"]),
    "joint twice": (
        three(joint("b", "c"), "\n", joint("b", "c")),
        ModelError, ["two joints", "'b-c'", "line 2"],
    ),
    "link missing": (
        three(joint("b", "c"), "\n", joint("c", "d")),
        ModelError, ["child of", "'c-d' (line 2)", "'d'"],
    ),
    "parent missing": (
        three(joint("b", "c").replace('<parent link="b"/>', "")),
        ModelError, ["'b-c' (line 1)", "names no parent", 'add <parent link="'],
    ),
    "joint universe": (
        chain("revolute").replace('name="b-c"', 'name="universe"'),
        ModelError, ["'universe' (line 1)", "fixed world", "rename"],
    ),
    "cycle": (robot(link("a"), link("b"), joint("a", "b"), joint("b", "a")), ModelError, ["cycle"]),
    "cycle beside the root": (
        robot(*(link(n) for n in "abc"), joint("b", "c"), joint("c", "b")), ModelError, ["cycle"],
    ),
    "loop": (three(joint("a", "c"), joint("b", "c")), ModelError, ["loop 'b-c'", "close"]),
    "loop, fixed": (
        three(joint("a", "c"), joint("b", "c", "fixed")), ModelError, ["loop 'b-c'", "close"],
    ),
    "joint of unknown kind": (
        chain("spring"), ModelError, ["'b-c' (line 1)", "'spring'", "spherical"],
    ),
    "axis not finite": (chain("revolute", '<axis xyz="nan 0 1"/>'), ModelError, ["b-c", "axis"]),
    "axis zero": (chain("revolute", '<axis xyz="0 0 0"/>'), PinredError, ["b-c", "axis"]),
    "axis zero, sliding": (chain("prismatic", '<axis xyz="0 0 0"/>'), PinredError, ["b-c", "axis"]),
    "axis empty": (chain("continuous", "<axis/>"), PinredError, ["b-c", "axis"]),
    "mimic of none": (
        chain("revolute", '<mimic joint="far"/>'), ModelError, ["'far'", "b-c", "lock=['b-c']"],
    ),
    "mimic without a name": (chain("revolute", "<mimic/>"), ModelError, ["<mimic>", "b-c"]),
    "mimic of itself": (
        chain("revolute", '<mimic joint="b-c"/>'), ModelError, ["cycle", "b-c"],
    ),
    "mimic by no number": (
        chain("revolute", '<mimic joint="a-b" multiplier="two"/>'),
        ModelError, ["multiplier", "b-c", "two"],
    ),
    "no mass at all": (robot(link("world", 0)), ModelError, ["world", "no mass"]),
    "no mass, moving": (with_b(""), ModelError, [BEE, "a-bee", "no mass", "lock"]),
    "no mass at the end": (
        chain("revolute").replace(link("c"), link("c", 0)), ModelError, ["'c'", "b-c", "no mass"],
    ),
    "no mass on an axis twice": (
        three(re.sub("<origin[^>]*>", "", joint("b", "c"))).replace(
            link("b"), link("b", 0)
        ),
        ModelError, ["'b'", "a-b", "no mass", "descendant joints", "lock=['a-b']"],
    ),
    "mass and moments zero": (
        with_b(re.sub(r'(mass value|i..)="[\d.]+"', r'\1="0"', inertial())),
        ModelError, [BEE, "a-bee", "no mass", "lock=['a-bee']"],
    ),
    "no mass on a ball": (
        chain("spherical").replace(link("c"), link("c", 0)),
        ModelError, ["'c'", "b-c", "no mass", "lock=['b-c']"],
    ),
    "point mass on its axis": (
        with_b(re.sub(r'(i..)="[\d.]+"', r'\1="0"', inertial())),
        ModelError, [BEE, "a-bee", "in one point", "lock=['a-bee']"],
    ),
    "mass negative": (with_b(inertial("-2")), ModelError, [BEE, "negative mass -2"]),
    "mass negative, merged": (with_merged(inertial("-2")), ModelError, [SEA, "negative mass"]),
    "mass not finite": (with_b(inertial("nan")), ModelError, [BEE, "finite", "nan"]),
    "mass overflows": (with_merged(inertial("1e999")), ModelError, [SEA, "finite"]),
    "mass missing": (with_merged(re.sub("<mass[^>]*>", "", inertial())), PinredError, [SEA]),
    "moments missing": (
        with_merged(re.sub("<inertia ixx[^>]*>", "", inertial())), PinredError, [SEA],
    ),
    "moment missing": (with_merged(inertial().replace("ixx", "x")), PinredError, [SEA]),
    "moment not finite": (with_merged(inertial(ixx="nan")), PinredError, [SEA]),
    "rod on its axis": (
        with_b(inertial(izz="0").replace('ixx="1"', 'ixx="2"')),
        ModelError, [BEE, "a-bee", "in one line", "lock=['a-bee']"],
    ),
    "moments negative": (with_b(inertial(ixx="-1")), ModelError, [BEE, "-1", "zero or positive"]),
    "centre of mass": (with_merged(inertial(xyz="nan 0 0")), PinredError, [SEA]),
    "frame of inertia": (
        with_merged(inertial().replace('xyz="0', 'rpy="x')), PinredError, [SEA],
    ),
    "two joints on the anchor": (
        robot(link("w", 0), link("a"), link("b"), joint("w", "a"), joint("w", "b")),
        ModelError, ["'w'", "no mass"],
    ),
    "two floating bodies": (
        robot(link("w", 0), link("a"), link("b"), *(joint("w", n, "floating") for n in "ab")),
        ModelError, ["w-b", "fixed world", "w-a"],
    ),
    "MJCF no body": (mjcf(""), LoadError, ["arm.xml"]),
    "MJCF two bodies": (mjcf(body(FREE) + body(FREE, "other")), PinredError, ["other"]),
    "MJCF no mass": (on_arm(HINGE, ""), LoadError, ["'arm'", "line 1", "mass and inertia"]),
    "MJCF mass negative": (
        on_arm("", MASS.replace('"2"', '"-2"')), ModelError, ["'arm'", "negative mass"],
    ),
    "MJCF mass in a mesh": (
        on_arm(HINGE, '<geom type="mesh" mesh="m"/>'), LoadError, ["arm.xml", "mesh 'm'", "line 1"],
    ),
    "MJCF mass in a mesh by default": (
        on_arm(HINGE, "<geom/>", '<default><geom type="mesh" mesh="m"/></default>'),
        LoadError, ["arm.xml", "mesh 'm'", "line 1"],
    ),
    "MJCF mass in a plane": (
        on_arm(HINGE, '<geom type="plane" size="1 1 1"/>'), LoadError, ["arm.xml", "plane"],
    ),
    "MJCF mass negative in a geom": (
        on_arm(HINGE, '<geom size="1"/><geom size="1" mass="-1"/>'),
        LoadError, ["arm.xml", "negative in geom"],
    ),
    "MJCF geom too short": (
        on_arm(HINGE, '<geom type="capsule" size="0.1" fromto="0 0 0 1 1"/>'),
        LoadError, ["arm.xml", "'fromto'", "line 1"],
    ),
    "MJCF armature bad by default": (
        on_arm('<joint name="h"/>', head='<default><joint armature="nan"/></default>'),
        PinredError, ["contains nan"],
    ),
    "MJCF moments missing": (
        on_arm(HINGE, '<inertial pos="0 0 0" mass="1"/>'), PinredError, ["'arm'"],
    ),
    "MJCF axis zero": (on_arm('<joint name="h" axis="0 0 0"/>'), PinredError, ["'h'", "axis"]),
    "MJCF axis bad": (on_arm('<joint name="h" axis="a b c"/>'), LoadError, ["'axis'", "line 1"]),
    "MJCF position bad": (on_arm(HINGE, more='pos="1 2"'), LoadError, ["'pos'", "'body'"]),
    "MJCF class unknown": (on_arm(HINGE, more='childclass="none"'), LoadError, ["arm.xml"]),
    "MJCF armature bad": (on_arm('<joint name="h" armature="nan"/>'), PinredError, ["contains"]),
    "MJCF armature negative": (
        on_arm('<joint name="h" armature="-1"/>'), ModelError, ["armature", "-1"],
    ),
    "MJCF armature on the root": (
        mjcf(body('<joint name="j" type="slide" armature="1"/>')), ModelError, ["'j'", "armature"],
    ),
    "MJCF equality": (on_arm(HINGE, head=TIED), ModelError, ["weld", "tie", "active"]),
    "MJCF gravity bad": (
        on_arm(HINGE, head='<option gravity="0 nan 0"/>'), LoadError, ["arm.xml", "nan"],
    ),
    "MJCF include": (on_arm(HINGE, head='<include file="b.xml"/>'), PinredError, ["b.xml"]),
}  # fmt: skip


def refused(action: Callable[[], object], error: type[PinredError], words: list[str]) -> str:
    """Check that an action raises the error with words in its message; return the message."""
    with pytest.raises(error) as caught:
        action()
    message = str(caught.value)
    assert [word for word in words if word not in message] == [], message
    return message


@pytest.mark.parametrize("row", FILES.values(), ids=FILES.keys())
def test_invalid_file_is_refused(
    tmp_path: Path, row: tuple[str, type[PinredError], list[str]]
) -> None:
    """The message names the joint, the link or the file."""
    text, error, words = row
    refused(lambda: pinred.load(write(tmp_path, text)), error, words)


# Moments ixx, iyy, izz of the last link, and their excess over the triangle inequality.
UNREAL = {"much": ("1", "2", "3.3", "10 %"), "hardly": ("1", "2", "3.000003", "0.0001 %"),
          "wholly": ("0", "0", "1", "all of it")}  # fmt: skip


@pytest.mark.parametrize("row", UNREAL.values(), ids=UNREAL.keys())
@pytest.mark.sampled
def test_broken_triangle_inequality_warns(tmp_path: Path, row: tuple[str, str, str, str]) -> None:
    """The warning names link and extent; with strict=True loading is refused."""
    x, y, z, much = row
    text = with_b(inertial(ixx=x, izz=z).replace('iyy="2"', f'iyy="{y}"'))
    path = write(tmp_path, text)
    with pytest.warns(ModelWarning, match="triangle") as told:
        system = pinred.load(path)
    assert len(told) == 1
    message = str(told[0].message)
    assert BEE in message
    assert "a-bee" in message
    assert f"by {much}" in message
    assert told[0].filename == __file__
    assert system.m == 1
    refused(lambda: pinred.load(path, strict=True), ModelError, [BEE, "triangle", much])


def test_flat_body_does_not_warn(tmp_path: Path) -> None:
    """Equality in the triangle inequality, up to round-off, is valid."""
    for moments in (("1", "3"), ("0.1", "2.1"), ("0", "2")):
        path = write(tmp_path, with_b(inertial(ixx=moments[0], izz=moments[1])))
        assert pinred.load(path, strict=True).m == 1


# Text of the file, and its total mass.
WHOLE = {
    "mass, space": (with_merged(inertial("2 ")), 13.0),
    "centre of mass, tab": (with_merged(inertial(xyz="0\t0\t0")), 13.0),
    "MJCF frame": (mjcf(body(f"{FREE}<frame>{body('', 'lid')}</frame>")), 4.0),
    "MJCF replicate": (
        mjcf(body(f"{FREE}<replicate count='2'>{body('', 'lid')}</replicate>")),
        6.0,
    ),
}


@pytest.mark.parametrize("row", WHOLE.values(), ids=WHOLE.keys())
def test_no_body_or_inertia_is_dropped(tmp_path: Path, row: tuple[str, float]) -> None:
    """The total mass is that of the file, or the file is refused."""
    text, mass = row
    try:
        system = pinred.load(write(tmp_path, text))
    except PinredError:
        return
    assert system.mass == pytest.approx(mass)


TURN = 'euler="0 0 1.5707963267948966"'
QUARTER = pin.exp3(np.array([0.0, 0.0, np.pi / 2]))
# Settings of an MJCF file, and the resulting gravity and placement of a joint with TURN.
HEADS = {
    "compiler twice": ('<compiler/><compiler angle="radian"/>', -9.81, QUARTER),
    "option twice": ('<option timestep="1"/><option gravity="0 0 -1"/>', -1.0, None),
    "flag": ('<option><flag gravity="disable"/></option>', 0.0, None),
}


@pytest.mark.parametrize("row", HEADS.values(), ids=HEADS.keys())
def test_mjcf_settings_are_used_or_refused(
    tmp_path: Path, row: tuple[str, float, Array | None]
) -> None:
    """A setting that Pinocchio ignores does not silently keep its default."""
    head, gravity, turned = row
    try:
        system = pinred.load(write(tmp_path, on_arm(HINGE, head=head, more=TURN)))
    except PinredError:
        return
    assert system.gravity == pytest.approx([0.0, 0.0, gravity])
    if turned is not None:
        assert system.model.jointPlacements[2].rotation == pytest.approx(turned, abs=1e-9)


def test_other_group_than_root_is_refused(tmp_path: Path) -> None:
    """The message states the root's group and three ways out."""
    path = write(tmp_path, robot(link("w", 0), link("a"), joint("w", "a")))
    words = ["SE3", "SO2", "w-a", "lock", "mass"]
    refused(lambda: pinred.load(path, group="SE3"), ModelError, words)


def test_two_hinges_in_one_body_are_a_chain(tmp_path: Path) -> None:
    """The massless link between them is fine, since both hinges move mass at every shape."""
    system = pinred.load(write(tmp_path, on_arm(TWO)))
    assert system.shape_names == ("hinge", "second")
    report = pinred.compare(pinred.simulate(system, seed=1, duration=0.5))
    assert report.passed, str(report)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (chain("revolute", '<mimic joint="far"/>'), "b-c"),
    ],
    ids=["mimic of none"],
)
def test_advice_to_lock_works(tmp_path: Path, text: str, name: str) -> None:
    """If the refusal advises to lock a joint, the locked robot loads."""
    path = write(tmp_path, text)
    message = refused(lambda: pinred.load(path), ModelError, [name])
    if "lock" in message:
        assert name not in pinred.load(path, lock=[name]).shape_names


@pytest.mark.parametrize(
    "content",
    [b"\x7fELF\0\1\2\xff", b"\0" * 64, FLOATING.encode("utf-16"), FLOATING.encode()[:40]],
    ids=["binary", "zeros", "UTF-16", "cut"],
)
def test_binary_content_is_refused(tmp_path: Path, content: bytes) -> None:
    """Bytes that are no URDF raise LoadError with the path."""
    path = tmp_path / "robot.urdf"
    path.write_bytes(content)
    refused(lambda: pinred.load(path), LoadError, [str(path)])


def test_latin_1_encoding_is_refused(tmp_path: Path) -> None:
    """Pinocchio cannot read this encoding."""
    path = tmp_path / "robot.urdf"
    text = '<?xml version="1.0" encoding="iso-8859-1"?>' + FLOATING.replace("a-b", "épaule")
    path.write_text(text, encoding="iso-8859-1")
    refused(lambda: pinred.load(path), PinredError, ["robot.urdf"])


def test_harmless_content_is_accepted(tmp_path: Path) -> None:
    """Inactive constraints, a byte order mark, and spaces or any script in names are fine."""
    assert pinred.load(write(tmp_path, on_arm(HINGE, head=TIED.replace("true", "false")))).m == 1
    path = tmp_path / "mon robot.urdf"
    path.write_text(FLOATING.replace("a-b", "épaule 肩"), encoding="utf-8-sig")
    system = pinred.load(path)
    assert (system.name, system.shape_names) == ("mon robot", ("épaule 肩",))


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("none/none.urdf", ["none/none.urdf", "no such file"]),
        ("none.xml", ["none.xml", "no such file"]),
        (Path("/"), ["/"]),
        ("falling_dog", ["falling_dog", "falling_cat", "pinred robots"]),
        ("", ["''"]),
        ("a" * 300, ["aaa"]),
        (FLOATING, ["<robot"]),
    ],
    ids=["path", "suffix", "folder", "misspelt", "empty", "long", "text of a URDF"],
)
def test_missing_source_is_refused(source: str | Path, words: list[str]) -> None:
    """The message has the name of the source."""
    refused(lambda: pinred.load(source), LoadError, words)


ARGUMENTS: dict[str, tuple[dict[str, Any], type[PinredError], list[str]]] = {
    "group unknown": ({"group": "SE4"}, InputError, ["SE4", "SE2", "SO3"]),
    "group of another type": ({"group": 3}, InputError, ["3", "SE3"]),
    "lock unknown": ({"lock": ["elbow"]}, InputError, ["elbow", "a-b"]),
    "lock the world": ({"lock": ["universe"]}, InputError, ["universe", "a-b"]),
    "lock a link": ({"lock": ["b"]}, InputError, ["'b'", "a-b"]),
    "lock text": ({"lock": "a-b"}, InputError, ["a-b", "list"]),
    "lock nothing": ({"lock": None}, InputError, ["lock", "None"]),
    "lock a number": ({"lock": 1}, InputError, ["lock", "1"]),
    "lock at text": ({"lock": {"a-b": "up"}}, InputError, ["a-b", "up"]),
    "lock at nothing": ({"lock": {"a-b": None}}, InputError, ["a-b", "None"]),
    "lock not finite": ({"lock": {"a-b": np.nan}}, InputError, ["a-b", "finite", "nan"]),
    "gravity too short": ({"gravity": [0, -9.81]}, ShapeError, ["gravity", "(3,)", "(2,)"]),
    "gravity a number": ({"gravity": 9.81}, ShapeError, ["gravity", "(3,)", "()"]),
    "gravity not finite": ({"gravity": [0, 0, np.inf]}, ShapeError, ["gravity", "entry 2", "inf"]),
    "gravity text": ({"gravity": "down"}, ShapeError, ["gravity", "down"]),
}


@pytest.mark.parametrize("row", ARGUMENTS.values(), ids=ARGUMENTS.keys())
def test_invalid_argument_is_refused(
    tmp_path: Path, row: tuple[dict[str, Any], type[PinredError], list[str]]
) -> None:
    """The InputError states the value and the valid ones."""
    arguments, error, words = row
    path = write(tmp_path, FLOATING)
    refused(lambda: pinred.load(path, **arguments), error, words)


def grown(
    kind: pin.JointModel, parent: int = 1, mass: float = 1.0, moments: float = 1.0
) -> pin.Model:
    """Return a free tree joint0-joint1 with a further joint 'odd' on a parent."""
    return add(random_model("SE3", 1, seed=0), kind, "odd", parent, mass, moments=moments)


def add(
    model: pin.Model,
    kind: pin.JointModel,
    name: str,
    parent: int,
    mass: float = 1.0,
    *,
    z: float = 0.0,
    moments: float = 1.0,
) -> pin.Model:
    """Add a joint and its body at height z; return the model."""
    i = model.addJoint(parent, kind, pin.SE3(np.eye(3), np.array([0.0, 0.0, z])), name)
    body = pin.Inertia(mass, np.zeros(3), moments * np.eye(3))
    model.appendBodyToJoint(i, body, pin.SE3.Identity())
    return model


def changed(**attributes: Any) -> pin.Model:
    """Return a valid model with some attributes changed."""
    model = grown(pin.JointModelRX())
    for name, value in attributes.items():
        setattr(model, name, value)
    return model


RX, E = pin.JointModelRX(), np.eye(3)
MODELS: dict[str, tuple[Callable[[], pin.Model], list[str]]] = {
    "no joint, no mass": (pin.Model, ["no mass"]),
    "names twice": (lambda: add(grown(RX), RX, "odd", 3), ["'odd'", "name"]),
    "mimic that has lost its axis": (
        lambda: pin.transformJointIntoMimic(grown(RX, parent=2), 2, 3, 0.0, 0.0),
        ["mimic", "odd", "scaling 0"],
    ),
    "beside the root": (lambda: grown(RX, parent=0), ["odd", "fixed world"]),
    "axis too long": (lambda: grown(pin.JointModelRevoluteUnaligned(2 * E[0])), ["odd", "axis"]),
    "axis zero": (lambda: grown(pin.JointModelPrismaticUnaligned(0 * E[0])), ["odd", "axis"]),
    "no mass": (lambda: grown(RX, mass=0.0, moments=0.0), ["odd", "no mass"]),
    "mass negative": (lambda: grown(RX, mass=-1.0), ["odd", "negative mass"]),
    "mass not finite": (lambda: grown(RX, mass=np.nan), ["odd", "finite"]),
    "placement not finite": (lambda: add(grown(RX), RX, "far", 3, z=np.nan), ["far", "finite"]),
    "gravity": (lambda: changed(gravity=pin.Motion(np.full(6, np.inf))), ["gravity", "finite"]),
    "armature": (lambda: changed(armature=np.full(8, np.nan)), ["armature", "finite"]),
    "armature negative": (lambda: changed(armature=np.full(8, -1.0)), ["armature", "-1"]),
    "armature on the root": (lambda: changed(armature=np.ones(8)), ["joint0", "armature"]),
}  # fmt: skip


@pytest.mark.parametrize("row", MODELS.values(), ids=MODELS.keys())
def test_invalid_model_is_refused(row: tuple[Callable[[], pin.Model], list[str]]) -> None:
    """Models made in Python obey the same rules as files."""
    build, words = row
    refused(lambda: pinred.load(build()), ModelError, words)


def test_system_refuses_mimic_joints() -> None:
    """load() converts them to couplings; System does not."""
    model = pin.transformJointIntoMimic(grown(RX, parent=2), 2, 3, 1.0, 0.0)
    refused(lambda: pinred.System(model), ModelError, ["mimic", "odd", "pinred.load"])


def test_system_without_root_is_refused() -> None:
    """System adds no root; the model must have one that moves in a group."""
    refused(lambda: pinred.System(pin.Model()), ModelError, ["no joint", "group"])
    model = pin.Model()
    model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "odd")
    refused(lambda: pinred.System(model), ModelError, ["odd", "Translation", "SE3"])


def test_conversion_of_wrong_length_names_argument() -> None:
    """Each conversion names the argument whose last axis has the wrong length."""
    system = pinred.load("satellite_two_arms")
    pose, x, xi = system.group.identity(), np.zeros(system.m), np.zeros(system.r)
    refused(lambda: system.q(pose[:-1], x), ShapeError, ["pose", "(..., 7)", "(6,)"])
    refused(lambda: system.q(pose, x[1:]), ShapeError, ["x", f"(..., {system.m})"])
    refused(lambda: system.v(0.0, x), ShapeError, ["xi", "(..., 6)", "()"])
    refused(lambda: system.v(xi, np.zeros((2, system.m + 1))), ShapeError, ["xdot"])
    refused(lambda: system.configuration(pose), ShapeError, ["q", f"(..., {system.model.nq})"])
    refused(lambda: system.velocity("v"), ShapeError, ["v", "numbers"])


def test_conversion_of_mismatched_times_is_refused() -> None:
    """Pose and shape at different numbers of times cannot be combined."""
    system = pinred.load("elroys_beanie")
    refused(lambda: system.q(np.zeros((3, 1)), np.zeros((2, 1))), ShapeError, ["pose", "x"])
    refused(lambda: system.v(np.zeros((3, 1)), np.zeros((2, 1))), ShapeError, ["xi", "xdot"])


# Equality constraints, or the bodies before them, and words of the message.
EQUALITIES = {
    "named": ('<connect name="tie" body1="arm" anchor="0 0 0"/>', "", "connect 'tie' (line 3)"),
    "numbered": ('<connect body1="arm" anchor="0 0 0"/>', "", "connect 'equality 0' (line 3)"),
    "copied": (
        '<connect body1="arm" anchor="0 0 0"/>',
        '<replicate count="2"><geom size="1" contype="0" conaffinity="0"/></replicate>',
        "connect 'equality 0' ties",
    ),
    "of a tendon": (
        '<tendon name="t" tendon1="t"/></equality><tendon><spatial name="t"><site site="s"/>'
        '<site site="far"/></spatial></tendon><equality>',
        "",
        "tendon 't' (line 3) is spatial: equality tendon 't' (line 3) is not supported",
    ),
}


@pytest.mark.parametrize("name", EQUALITIES)
def test_message_about_an_equality_states_its_line(name: str, tmp_path: Path) -> None:
    """Also of one without a name, but not if copies of bodies may add constraints."""
    constraint, more, words = EQUALITIES[name]
    arms = '<site name="far"/>' + body(f'{HINGE}<site name="s"/>', "arm")
    text = mjcf(body(f"<freejoint/>{arms}") + more)
    text = text.replace("</mujoco>", f"\n<equality>\n{constraint}</equality></mujoco>")
    refused(lambda: pinred.load(write(tmp_path, text)), ModelError, [words])
