"""SDF files that include others, with several models, followers and closed loops."""

from __future__ import annotations

import warnings
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
import pytest
from test_sdf import LINKS, axis, joint, link, sdf, write

import pinred
from pinred.common.errors import ChoiceError
from pinred.system import independent_reader
from pinred.system.find_robot_files import line_of, read_xml
from pinred.system.independent_reader import ROUNDED, mass_difference
from pinred.system.loops.loop import parse_loops
from pinred.system.passive import Damper, Friction, Spring
from pinred.system.read_sdf import read_sdf

pytestmark = pytest.mark.skipif(find_spec("pydrake") is None, reason="drake is not installed")

DYNAMICS = "<dynamics><damping>0.3</damping><friction>0.4</friction></dynamics>"
FOLLOWER = (
    '<mimic joint="one"><multiplier>2</multiplier><offset>0.5</offset><reference>0.1</reference>'
    "</mimic>"
)
ARM = (
    link("base", "0 0 0 0 0 0"),
    link("arm", "0.2 0 0 0 0.3 0"),
    link("tip", "0.5 0.1 0 0.2 0 0"),
    joint("one", "revolute", "base", "arm", axis("0 0 1", DYNAMICS)),
    joint("two", "revolute", "arm", "tip", axis("0 1 0", FOLLOWER)),
)


def model(name: str, *parts: str) -> str:
    """Return a model."""
    return f'<model name="{name}">{"".join(parts)}</model>'


def world(*parts: str, version: str = "1.11") -> str:
    """Return a file with a world."""
    return f'<sdf version="{version}"><world name="w">{"".join(parts)}</world></sdf>'


def put(path: Path, text: str) -> Path:
    """Write a file in a folder that may not exist yet; return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")
    return path


def include(uri: str, *parts: str, merge: bool = False) -> str:
    """Return an <include>."""
    attribute = ' merge="true"' if merge else ""
    return f"<include{attribute}><uri>{uri}</uri>{''.join(parts)}</include>"


@pytest.mark.parametrize("merge", [False, True])
@pytest.mark.sampled
def test_included_model_keeps_friction_and_followers(tmp_path: Path, merge: bool) -> None:
    """The words of an included file count as those of the first one."""
    put(tmp_path / "arm.sdf", sdf(*ARM))
    pose = "<name>n</name><pose>1 0 0 0 0 1</pose>"
    path = put(tmp_path / "main.sdf", sdf(include("arm.sdf", pose, merge=merge)))
    system = pinred.load(path)
    assert system.followers == ("two",)
    assert str(system.couplings[0]) == "two = 2·one + 0.3"
    assert set(system.passive) == {Damper("one", 0.3), Friction("one", 0.4)}
    assert mass_difference(path, read_sdf(path)) < 1e-13


@pytest.mark.parametrize("merge", [False, True])
def test_poses_of_included_models_are_those_of_drake(tmp_path: Path, merge: bool) -> None:
    """With a placement frame, a pose relative to a frame, and a joint to a nested frame."""
    frame = '<frame name="hand"><pose relative_to="tip">0.1 0.2 0 0 0 0.4</pose></frame>'
    put(tmp_path / "arm.sdf", sdf(*ARM, frame))
    scope = "" if merge else "n::"
    path = put(
        tmp_path / "main.sdf",
        sdf(
            link("cart", "1 2 3 0.1 0.2 0.3"),
            '<frame name="mount" attached_to="cart"><pose>0 0 1 0 0.5 0</pose></frame>',
            include(
                "arm.sdf", "<name>n</name><placement_frame>hand</placement_frame>",
                '<pose relative_to="mount">0.2 0 0 0.3 0 0</pose>', merge=merge,
            ),
            joint("glue", "fixed", "cart", f"{scope}base"),
        ),
    )  # fmt: skip
    robot = read_sdf(path)
    assert mass_difference(path, robot) < 1e-13
    # By hand: cart → mount → hand, and back from the hand to the base of the arm.
    poses = {
        "cart": "1 2 3 0.1 0.2 0.3", "mount": "0 0 1 0 0.5 0", "at": "0.2 0 0 0.3 0 0",
        "tip": "0.5 0.1 0 0.2 0 0", "hand": "0.1 0.2 0 0 0 0.4",
    }  # fmt: skip
    numbers = {name: np.array([*map(float, text.split())]) for name, text in poses.items()}
    M = {name: pin.SE3(pin.rpy.rpyToMatrix(v[3:]), v[:3]) for name, v in numbers.items()}
    expected = M["mount"] * M["at"] * (M["tip"] * M["hand"]).inverse()
    placed = robot.model.frames[robot.model.getFrameId("base")].placement
    assert np.abs((placed.inverse() * expected).homogeneous - np.eye(4)).max() < 1e-14


def test_undeclared_prefix_and_late_declaration_load(tmp_path: Path) -> None:
    """Both are errors for strict parsers of XML."""
    body = LINKS[0].replace("</link>", "<drake:visual/></link>")
    text = "<!-- a -- b -->\n<?xml version='1.0'?>\n" + sdf(body, LINKS[1], ARM[3])
    system = pinred.load(write(tmp_path, text.replace("base", "a").replace("arm", "b")))
    assert system.shape_names == ("one",)


@pytest.mark.parametrize("way", ["folder", "GZ_SIM_RESOURCE_PATH", "GAZEBO_MODEL_PATH", "above"])
def test_model_uri_is_searched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str) -> None:
    """In the folders of the call, in those of Gazebo's variables, and above the file."""
    models = tmp_path / "store" / "models"
    put(models / "my_arm" / "new.sdf", sdf(*ARM))
    put(models / "my_arm" / "old.sdf", sdf(*LINKS[:1]))
    put(
        models / "my_arm" / "model.config",
        '<model><name>a</name><sdf version="1.5">old.sdf</sdf><sdf version="1.9">new.sdf</sdf>'
        '<sdf version="9.0">none.sdf</sdf></model>',
    )
    folder = models / "other" if way == "above" else tmp_path / "elsewhere"
    path = put(folder / "main.sdf", world(include("model://my_arm")))
    if way == "folder":
        system = pinred.load(path, meshes=models)
    else:
        if way != "above":
            monkeypatch.setenv(way, f"/nowhere:{models}")
        system = pinred.load(path)
    assert system.shape_names == ("one",)


UNFOUND = {
    "model://nobody": "line 2: <include> of 'model://nobody': not found in .*; pass the folder",
    "https://fuel.gazebosim.org/1.0/a/models/Arm": "pinred downloads nothing. Download the model",
    "ftp://arm": "unknown scheme 'ftp'; use model://, package:// or file://",
    "main.sdf": "line 2: .*the file includes itself; remove the <include>",
    "robot.urdf": "only SDF files can be included; convert it to SDF",
    "empty": "has no model.config that names its SDF file",
}


@pytest.mark.parametrize("uri", UNFOUND)
def test_include_that_is_not_found_is_refused(tmp_path: Path, uri: str) -> None:
    """With its line and a remedy; nothing is downloaded."""
    put(tmp_path / "robot.urdf", "<robot/>")
    (tmp_path / "empty").mkdir()
    path = put(tmp_path / "main.sdf", sdf(*LINKS[:1], "\n", include(uri)))
    with pytest.raises(pinred.PinredError, match=UNFOUND[uri]):
        pinred.load(path)


def test_too_many_included_files_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A chain, and a number of elements that grows with each file."""
    for k in range(30):
        nested = include(f"{k + 1}.sdf")
        put(tmp_path / f"{k}.sdf", sdf(link("a"), nested))
    put(tmp_path / "30.sdf", sdf(link("a")))
    with pytest.raises(pinred.LoadError, match="more than 20 files include each other"):
        read_sdf(tmp_path / "0.sdf")
    for k in range(26, 30):
        twice = [include(f"{k + 1}.sdf", f"<name>{name}</name>") for name in "xy"]
        put(tmp_path / f"{k}.sdf", sdf(link("a"), *twice))
    # 16 files of 12 elements, and 15 of 18.
    monkeypatch.setattr("pinred.system.sdf_document._MOST_ELEMENTS", 461)
    with pytest.raises(pinred.LoadError, match="more than 461 elements in all files"):
        read_sdf(tmp_path / "26.sdf")
    monkeypatch.setattr("pinred.system.sdf_document._MOST_ELEMENTS", 462)
    with pytest.raises(ChoiceError):
        read_sdf(tmp_path / "26.sdf")


GROUND = model("ground", "<static>true</static>", link("floor"))
SUN = include("model://sun")


def test_static_models_beside_a_robot_do_not_matter(tmp_path: Path) -> None:
    """Also if their joints could move, and if Gazebo's sun is not installed."""
    door = model(
        "door", "<static>true</static>", link("frame"), link("leaf"),
        joint("one", "revolute", "frame", "leaf", axis("0 0 1", DYNAMICS)),
    )  # fmt: skip
    path = put(tmp_path / "main.sdf", world(GROUND, SUN, door, model("robot", *ARM)))
    with pytest.warns(pinred.LeftOutWarning, match="scenery that was not found"):
        system = pinred.load(path)
    assert system.shape_names == ("one",)
    assert set(system.passive) == {Damper("one", 0.3), Friction("one", 0.4)}
    assert [left.names for left in system.left_out] == [("model://sun (line 1)",)]


@pytest.mark.parametrize("root", ["robot", "base", "robot::base"])
def test_root_chooses_one_of_several_robots(tmp_path: Path, root: str) -> None:
    """By its model or its base link; models that are not found then do not matter."""
    others = (model("box", link("crate")), include("model://nobody"))
    path = put(tmp_path / "main.sdf", world(GROUND, model("robot", *ARM), *others))
    with pytest.warns(pinred.LeftOutWarning, match="models that were not found"):
        system = pinred.load(path, root=root)
    assert system.shape_names == ("one",)
    assert ("other bodies", ("box::crate",)) in [(o.what, o.names) for o in system.left_out]
    assert system.origin is not None
    assert system.origin.root == root


def test_choice_of_robots_is_listed(tmp_path: Path) -> None:
    """The robot with most joints first."""
    path = put(tmp_path / "main.sdf", world(model("box", link("crate")), model("robot", *ARM)))
    with pytest.raises(ChoiceError, match="several robots") as caught:
        pinred.load(path)
    assert (caught.value.option, caught.value.choices) == ("root", ("robot", "box"))
    with pytest.raises(pinred.InputError, match="base link 'robt'; did you mean 'robot'"):
        pinred.load(path, root="robt")


def test_root_is_refused_for_urdf() -> None:
    """As before."""
    with pytest.raises(pinred.InputError, match="applies to MJCF and SDF only"):
        pinred.load("falling_cat", root="body")


def test_equal_names_in_nested_models_are_scoped(tmp_path: Path) -> None:
    """Names that are unique stay short."""
    put(tmp_path / "arm.sdf", sdf(*ARM))
    parts = [include("arm.sdf", f"<name>{name}</name><pose>0 0 1 0 0 0</pose>") for name in "LR"]
    glue = [joint(f"glue{name}", "fixed", "trunk", f"{name}::base") for name in "LR"]
    path = put(tmp_path / "main.sdf", sdf(link("trunk"), *parts, *glue))
    system = pinred.load(path)
    assert system.shape_names == ("L::one", "R::one")
    assert system.followers == ("L::two", "R::two")
    assert {Friction("L::one", 0.4), Friction("R::one", 0.4)} < set(system.passive)
    assert mass_difference(path, read_sdf(path)) < 1e-13
    (loop,) = parse_loops("L::tip=R::tip:x")
    assert loop == pinred.Loop("L::tip", "R::tip", "x")


def test_axes_of_all_joints_have_their_numbers(tmp_path: Path) -> None:
    """Of both axes of a universal joint, of a screw and of a ball."""
    first = (
        "<dynamics><damping>.1</damping><friction>.2</friction><spring_stiffness>3"
        "</spring_stiffness><spring_reference>.4</spring_reference></dynamics>"
        "<limit><lower>-1</lower><upper>2</upper><effort>5</effort><velocity>-1</velocity></limit>"
    )
    second = first.replace(".1", ".5").replace(".2", ".6").replace(">3<", ">7<").replace("-1", "-3")
    path = write(
        tmp_path,
        sdf(
            *LINKS[:4],
            joint(
                "cross", "universal", "a", "b",
                axis("1 0 0", first) + axis("0 1 0", second, "axis2"),
            ),
            joint("thread", "screw", "b", "c", axis("0 0 1", first)),
            joint("neck", "ball", "c", "d", axis("0 0 1", DYNAMICS)),
        ),
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        system = pinred.load(path)
    assert set(system.passive) == {
        Damper("cross.1", 0.1), Friction("cross.1", 0.2), Spring("cross.1", 3.0, 0.4),
        Damper("cross.2", 0.5), Friction("cross.2", 0.6), Spring("cross.2", 7.0, 0.4),
        Damper("thread", 0.1), Friction("thread", 0.2), Spring("thread", 3.0, 0.4),
        *(Damper(f"neck.{axis}", 0.3) for axis in "xyz"),
        *(Friction(f"neck.{axis}", 0.4) for axis in "xyz"),
    }  # fmt: skip
    raw = read_sdf(path).model
    assert raw.lowerPositionLimit[:3].tolist() == [-1.0, -3.0, -1.0]
    assert raw.upperEffortLimit[:3].tolist() == [5.0] * 3
    assert raw.upperVelocityLimit[:3].tolist() == [np.inf] * 3


def test_follower_of_a_second_axis_and_of_drake(tmp_path: Path) -> None:
    """<mimic> of SDF 1.11 names an axis, and <drake:mimic> has attributes."""
    path = write(
        tmp_path,
        sdf(
            *LINKS[:4],
            joint("cross", "universal", "a", "b", axis("1 0 0") + axis("0 1 0", "", "axis2")),
            joint("two", "prismatic", "b", "c", axis(
                "1 0 0", '<mimic joint="cross" axis="axis2"><multiplier>3</multiplier></mimic>'
            )),
            joint("three", "revolute", "c", "d", axis("1 0 0")
                  + '<drake:mimic joint="two" multiplier="-2" offset="0.1"/>'),
        ).replace('"1.9"', '"1.11"'),
    )  # fmt: skip
    system = pinred.load(path)
    assert [*map(str, system.couplings)] == ["two = 3·cross.2", "three = -2·two + 0.1"]
    assert system.shape_names == ("cross.1", "cross.2")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (world("<gravity>1 2 -3</gravity>", model("m", *ARM)), (1.0, 2.0, -3.0)),
        (world("<physics><gravity>0 0 -1</gravity></physics>", model("m", *ARM)), (0, 0, -1)),
        (world(model("m", *ARM)), (0.0, 0.0, -9.8)),
        (sdf(*ARM), (0.0, 0.0, -9.81)),
        (sdf(*(part.replace("</link>", "<gravity>0</gravity></link>") for part in ARM)), (0, 0, 0)),
    ],
)  # fmt: skip
def test_gravity_is_that_of_the_world(
    tmp_path: Path, text: str, expected: tuple[float, float, float]
) -> None:
    """A world without gravity has the 9.8 m/s² of the format; there is no warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        system = pinred.load(write(tmp_path, text))
    assert system.gravity.tolist() == [*expected]


def test_gravity_of_some_links_is_left_out(tmp_path: Path) -> None:
    """As the uneven compensation of MJCF."""
    text = sdf(ARM[0].replace("</link>", "<gravity>false</gravity></link>"), *ARM[1:])
    with pytest.warns(pinred.LeftOutWarning, match=r"compensated gravity \(1\)"):
        pinred.load(write(tmp_path, text))


BAR = (
    "<inertial><mass>1</mass><inertia><ixx>.1</ixx><iyy>.1</iyy><izz>.1</izz></inertia></inertial>"
)


def four_bar(kind: str, *extra: str) -> str:
    """Return a four-bar whose last joint has a kind; its joints are off all frames of links."""
    z = axis("0 0.6 0.8")
    bars = [
        f'<link name="{name}"><pose>{pose}</pose>{BAR}</link>'
        for name, pose in (
            ("base", "0 0 0 0 0 0"), ("crank", "0 0 0 0.3 0 0"), ("coupler", "1 1 0 0 0.2 0"),
            ("rocker", "3 0 0 0 0 0.5"),
        )
    ]  # fmt: skip
    at = '<pose relative_to="__model__">{}</pose>'
    return sdf(
        *bars,
        joint("one", "revolute", "base", "crank", z).replace(PLACE, at.format("0 0 0 0 0 0")),
        joint("three", "revolute", "base", "rocker", z).replace(PLACE, at.format("3 0 0 0 0 0")),
        joint("two", "revolute", "crank", "coupler", z).replace(PLACE, at.format("0.5 1 0 0 0 0")),
        joint("last", kind, "rocker", "coupler", "" if kind == "ball" else z).replace(
            PLACE, at.format("3.5 2 0 0 0 0")
        ),
        *extra,
    )


PLACE = "<pose>0.05 0 0.1 0 0.3 0</pose>"


# The other cases are a ball and a fixed joint; loop kinds of axes are tested with other files.
@pytest.mark.by_hand("revolute-z-1")
@pytest.mark.parametrize(
    ("kind", "loop", "free"), [("revolute", "z", 1), ("ball", "3d", 1), ("fixed", "6d", 0)]
)
def test_link_with_two_parents_closes_a_loop(
    tmp_path: Path, kind: str, loop: str, free: int
) -> None:
    """Drake's own frames of the joint coincide after a motion, and `compare` passes."""
    path = write(tmp_path, four_bar(kind))
    robot = read_sdf(path)
    assert [(one.name, one.kind) for one in robot.loops] == [("last", loop)]
    assert mass_difference(path, robot) < 1e-13
    if not free:
        with pytest.raises(pinred.ModelError, match="so nothing can move"):
            pinred.load(path)
        return
    system = pinred.load(path)
    assert system.shape_dim == free
    traj = pinred.simulate(system, xdot0={"one": 1.0}, duration=0.4)
    assert pinred.compare(traj).passed
    assert np.abs(traj.x[-1]).max() > 0.1
    gap, turn = drake_gap(path, dict(zip(system.shape_names, traj.x[-1], strict=True)))
    assert gap < 1e-9
    assert kind == "ball" or turn < 1e-9


def drake_gap(path: Path, angles: dict[str, float]) -> tuple[float, float]:
    """Return the distance of the frames of joint `last`, and the angle of their axes, in Drake."""
    plant: Any = import_module("pydrake.multibody.plant").MultibodyPlant(0.0)
    import_module("pydrake.multibody.parsing").Parser(plant).AddModels(str(path))
    last = plant.GetJointByName("last")
    frames = last.frame_on_parent(), last.frame_on_child()
    for index in plant.GetJointActuatorIndices():
        if plant.get_joint_actuator(index).joint().index() == last.index():
            plant.RemoveJointActuator(plant.get_joint_actuator(index))
    plant.RemoveJoint(last)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    for name, angle in angles.items():
        plant.GetJointByName(name).set_angle(context, angle)
    X = plant.CalcRelativeTransform(context, *frames)
    normal = np.array([0.0, 0.6, 0.8])
    return (
        float(np.linalg.norm(X.translation())),
        float(np.linalg.norm(X.rotation().matrix() @ normal - normal)),
    )


def test_points_that_coincide_close_a_loop(tmp_path: Path) -> None:
    """<drake:ball_constraint> is a loop of three equations."""
    constraint = (
        "<drake:ball_constraint><drake:ball_constraint_body_A>a</drake:ball_constraint_body_A>"
        "<drake:ball_constraint_p_AP>0 0 1</drake:ball_constraint_p_AP>"
        "<drake:ball_constraint_body_B>c</drake:ball_constraint_body_B>"
        "<drake:ball_constraint_p_BQ>0 1 0</drake:ball_constraint_p_BQ></drake:ball_constraint>"
    )
    chain = [
        joint(f"j{first}", "ball", first, second) for first, second in (("a", "b"), ("b", "c"))
    ]
    text = sdf(*LINKS[:3], *chain, constraint)
    robot = read_sdf(write(tmp_path, text))
    (loop,) = robot.loops
    assert loop.kind == "3d"
    for frame, point in ((loop.frame_a, (0, 0, 1)), (loop.frame_b, (0, 1, 0))):
        at = robot.model.frames[robot.model.getFrameId(frame)]
        body = robot.model.frames[robot.model.getFrameId("a" if point[2] else "c")]
        assert at.parentJoint == body.parentJoint
        placed = (body.placement.inverse() * at.placement).translation
        assert np.abs(placed - point).max() < 1e-15
    with pytest.raises(pinred.LoadError, match="line 1: <drake:ball_constraint> names no link 'x'"):
        read_sdf(write(tmp_path, text.replace("_body_B>c<", "_body_B>x<")))


def test_link_with_two_parents_is_cut_in_any_order(tmp_path: Path) -> None:
    """The joints of the base stay, although they are the last ones."""
    head, *joints = four_bar("revolute").removesuffix("</model></sdf>").split("<joint")
    text = "<joint".join([head, *joints[2:], *joints[:2]]) + "</model></sdf>"
    robot = read_sdf(write(tmp_path, text))
    assert [loop.name for loop in robot.loops] == ["last"]
    assert {str(name) for name in robot.model.names} == {"universe", "one", "two", "three"}


def test_axis_beside_z_is_not_rounded(tmp_path: Path) -> None:
    """An axis that differs from z by 1e-7 rad."""
    path = write(tmp_path, sdf(*LINKS[:2], joint("one", "revolute", "a", "b", axis("1e-7 0 1"))))
    assert mass_difference(path, read_sdf(path)) < 1e-13


def test_drake_rounds_axes_up_to_the_stated_deviation(tmp_path: Path) -> None:
    """The reason why a difference below it is no fault."""
    differences = []
    for tilt in (0.6 * ROUNDED, 1.1 * ROUNDED):
        text = sdf(*LINKS[:2], joint("one", "revolute", "a", "b", axis(f"{tilt!r} 0 1")))
        path = write(tmp_path, text)
        differences.append(mass_difference(path, read_sdf(path)))
    assert 1e-11 < differences[0] < ROUNDED
    assert differences[1] < 1e-13


def test_welded_base_beside_a_spring_is_compared(tmp_path: Path) -> None:
    """Drake removes no joints from plants with springs."""
    spring = "<dynamics><spring_stiffness>3</spring_stiffness></dynamics>"
    hinge = joint("one", "revolute", "a", "b", axis("0 1 0", spring))
    path = write(tmp_path, sdf(*LINKS[:2], joint("bolt", "fixed", "world", "a"), hinge))
    robot = read_sdf(path)
    assert mass_difference(path, robot) < 1e-13
    robot.model.inertias[1].mass *= 1.1
    assert mass_difference(path, robot) > 1e-3


def test_link_and_joint_of_one_name_load_in_old_files(tmp_path: Path) -> None:
    """Before SDF 1.7 both had names of their own."""
    text = sdf(*LINKS[:2], joint("b", "revolute", "a", "b", axis("1 0 0", DYNAMICS)))
    system = pinred.load(write(tmp_path, text.replace("1.9", "1.6")))
    assert system.shape_names == ("b",)
    assert Friction("b", 0.4) in system.passive
    with pytest.raises(pinred.LoadError, match=r"Non-unique name\[b\]"):
        pinred.load(write(tmp_path, text))


def test_joint_that_closes_a_loop_reports_its_forces(tmp_path: Path) -> None:
    """The joint without forces is cut, if there is one."""
    path = write(tmp_path, four_bar("revolute"))
    text = path.read_text("utf-8")
    damped = text.replace("</xyz></axis>", f"</xyz>{DYNAMICS}</axis>")
    with pytest.warns(pinred.LeftOutWarning, match="friction of joints that close loops"):
        system = pinred.load(write(tmp_path, damped))
    assert [loop.name for loop in system.loops] == ["last"]
    head, mark, tail = damped.rpartition(DYNAMICS)
    first = write(tmp_path, head.replace(DYNAMICS, "", 3) + mark + tail)
    assert [loop.name for loop in read_sdf(first).loops] == ["two"]


def test_joints_against_the_direction_of_the_tree(tmp_path: Path) -> None:
    """A link with two parents that closes no loop: one of its joints is reversed."""
    path = write(
        tmp_path,
        sdf(
            *LINKS[:6],
            joint("one", "revolute", "a", "c", axis("0.6 0.8 0")),
            joint("two", "prismatic", "b", "c", axis("0 0.6 0.8")),
            joint("three", "screw", "d", "c", axis("0 0 1")),
            joint("four", "fixed", "f", "d"),
            joint("five", "continuous", "f", "e", axis("0 0 1")),
        ),
    )
    robot = read_sdf(path)
    assert robot.loops == ()
    assert robot.base == "a"
    assert robot.model.nv == 4
    assert mass_difference(path, robot) < 1e-13
    crossed = path.read_text("utf-8").replace(
        'name="two" type="prismatic"', 'name="two" type="universal"'
    )
    crossed = crossed.replace("0.8</xyz></axis>", "0.8</xyz></axis><axis2><xyz>1 0 0</xyz></axis2>")
    with pytest.raises(pinred.ModelError, match="'two' is attached against the direction"):
        read_sdf(write(tmp_path, crossed))


def test_reversed_ball_is_the_ball_of_the_tree(tmp_path: Path) -> None:
    """Its coordinates are those of the joint with exchanged parent and child."""
    pivot = joint("pivot", "revolute", "world", "a", axis("0 1 0"))
    texts = [
        sdf(*LINKS[:2], pivot, joint("neck", "ball", *ends)).replace(PLACE, at)
        for ends, at in ((("a", "b"), AT), (("b", "a"), AT))
    ]
    plain, turned = (read_sdf(write(tmp_path, text)).model for text in texts)
    quaternion, rates = pin.exp3_quat(np.array([0.4, -0.7, 0.2])), np.array([0.7, 0.1, -0.3, 0.5])
    energies = [
        pin.computeKineticEnergy(m, m.createData(), np.array([0.3, *quaternion]), rates)
        for m in (plain, turned)
    ]
    assert energies[0] == pytest.approx(energies[1], rel=1e-13)


AT = '<pose relative_to="__model__">0.4 0.1 0.2 0.1 0.3 0</pose>'


def test_planar_joint_of_drake(tmp_path: Path) -> None:
    """With its damping; its coordinates are two slides and a hinge."""
    text = sdf(
        *LINKS[:3],
        joint("one", "revolute", "a", "b", axis("0 1 0")),
        '<drake:joint name="table" type="planar"><drake:parent>b</drake:parent><drake:child>c'
        "</drake:child><drake:damping>.1 .1 .2</drake:damping></drake:joint>",
    )
    path = write(tmp_path, text)
    system = pinred.load(path)
    assert system.shape_names == ("one", "table.x", "table.y", "table.turn")
    assert Damper("table.turn", 0.2) in system.passive
    assert mass_difference(path, read_sdf(path)) < 1e-13


@pytest.mark.parametrize(
    ("pitch", "metres"),
    [
        ("<screw_thread_pitch>.7</screw_thread_pitch>", 0.7),
        ("<thread_pitch>4</thread_pitch>", -2.0 * np.pi / 4.0),
        ("", 1.0),
    ],
)
@pytest.mark.sampled
def test_pitch_of_a_screw(tmp_path: Path, pitch: str, metres: float) -> None:
    """In metres per revolution, or before SDF 1.10 in left-handed radians per metre."""
    path = write(tmp_path, sdf(*LINKS[:2], joint("one", "screw", "a", "b", axis("0 0 1") + pitch)))
    robot = read_sdf(path)
    assert mass_difference(path, robot) < 1e-13
    (coupling,) = pinred.load(path).couplings
    assert coupling.ratios["one"] == pytest.approx(metres / (2.0 * np.pi), rel=1e-15)


def test_inertia_from_shapes_is_that_of_drake(tmp_path: Path) -> None:
    """SDF 1.11 computes it from the shapes and their densities."""
    auto = (
        '<link name="c"><pose>0.1 0.2 0 0 0 0.3</pose><inertial auto="true"><density>500</density>'
        '</inertial><collision name="box"><pose>0 0 0.1 0.2 0 0</pose><geometry><box><size>1 2 3'
        '</size></box></geometry></collision><collision name="ball"><density>80</density><geometry>'
        "<sphere><radius>0.4</radius></sphere></geometry></collision></link>"
    )
    path = write(
        tmp_path,
        sdf(LINKS[0], auto, joint("one", "revolute", "a", "c", axis("0 1 0"))).replace(
            "1.9", "1.11"
        ),
    )
    robot = read_sdf(path)
    mass = 500.0 * 6.0 + 80.0 * 4.0 / 3.0 * np.pi * 0.4**3
    assert robot.model.inertias[1].mass == pytest.approx(mass, rel=1e-12)
    assert mass_difference(path, robot) < 1e-13


def test_file_that_drake_cannot_read_untouched_has_no_second_reading(tmp_path: Path) -> None:
    """The words that pinred drops are errors for Drake."""
    text = sdf(LINKS[0], "<plugin/>")
    path = write(tmp_path, text)
    robot = read_sdf(path)
    with pytest.raises(pinred.LoadError, match="Drake: "):
        mass_difference(path, robot)


def test_lines_count_from_the_start_of_the_file(tmp_path: Path) -> None:
    """Also behind what the reader removes before it parses the text."""
    path = tmp_path / "lines.sdf"
    path.write_text("<!-- a\n--- b -->\n\n<?xml\nversion='1.0'?>\n\n<sdf>\n<x/>\n</sdf>", "utf-8")
    root = read_xml(path)
    assert [line_of(element) for element in root.iter()] == [7, 8]
    assert line_of(Element("new")) == 0


def test_strict_compares_an_sdf_file_with_drake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drake reads the untouched file; a difference above its rounding of axes is refused."""
    path = tmp_path / "arm.sdf"
    path.write_text(
        '<sdf version="1.9"><model name="arm"><link name="base"/><link name="l">'
        '<pose>0.3 0 0 0 0 0</pose></link><joint name="j" type="revolute"><parent>base</parent>'
        "<child>l</child><axis><xyz>0 1 0</xyz></axis></joint></model></sdf>"
    )
    assert pinred.load(path, strict=True).shape_names == ("j",)
    reading = independent_reader.second_reading(path)
    assert reading == independent_reader.SecondReading("Drake")
    monkeypatch.setattr(independent_reader, "mass_difference", lambda *_: 1e-7)
    with pytest.raises(pinred.ModelError, match=r"Drake reads the file differently: its mass"):
        pinred.load(path, strict=True)


FUEL = "https://fuel.gazebosim.org/1.0/Own Er/models/My%20Arm"


@pytest.mark.parametrize("way", ["folder", "downloads", "version"])
def test_downloaded_models_of_gazebo_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    """In a folder of the call, or where Gazebo keeps its downloads, in the newest version."""
    path = put(tmp_path / "main.sdf", world(include(f"{FUEL}/2" if way == "version" else FUEL)))
    if way == "folder":
        put(tmp_path / "store" / "My Arm" / "model.sdf", sdf(*ARM))
        assert pinred.load(path, meshes=tmp_path / "store").shape_names == ("one",)
        return
    monkeypatch.setenv("GZ_FUEL_CACHE_PATH", str(tmp_path / "cache"))
    store = tmp_path / "cache" / "fuel.gazebosim.org" / "own er" / "models" / "my arm"
    put(store / "2" / "model.sdf", sdf(*ARM).replace('"one"', '"old"'))
    put(store / "10" / "model.sdf", sdf(*ARM))
    assert pinred.load(path).shape_names == (("old",) if way == "version" else ("one",))


ZERO = ARM[3].replace("0 0 1", "0 0 0")
SPHERE = '<frame name="f" attached_to="g"/>\n<frame name="g" attached_to="f"/>'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (sdf(ARM[0], ARM[1], f"\n{ZERO}"), "line 2: the axis is zero; state a direction"),
        (sdf(*ARM).replace("1.9", "2.0"), "line 1: pinred reads SDF up to version 1.12, not 2.0"),
        (world(model("a", *ARM), "\n", model("a", *ARM)), "line 2: a second model is called 'a'"),
        (
            world(include("arm.sdf"), "\n", include("arm.sdf")),
            "main.sdf, line 2: a second model is called 'm'; give the <include> another <name>",
        ),
        (sdf("\n", link("world")), "line 2: the name 'world' belongs to the ground; rename the li"),
        (sdf(*ARM, "\n<include/>"), "line 2: <include> has no <uri>; add it"),
        (world() + "\n", "contains no model"),
        (
            sdf(*ARM, '\n<drake:joint name="p" type="planar"><drake:parent/></drake:joint>'),
            "line 2: joint 'p' has no <drake:child>; add it",
        ),
        (
            sdf(ARM[0], ARM[1], "\n", ARM[3].replace(">arm<", ">leg<")),
            "line 2: Child frame with name[leg] specified by joint with name[one] not found in "
            "model with name[m]; name a link, joint, frame or model that exists",
        ),
        (sdf(ARM[0], "\n", ARM[0]), "line 2: Non-unique name[base] detected 2 times"),
        (sdf(ARM[0], "\n", SPHERE), "line 2: FrameAttachedToGraph cycle detected"),
        (sdf(ARM[0], SPHERE), "attach one of the frames to a link"),
        (
            sdf(*ARM).replace('<model name="m"', '\n<model name="m" placement_frame="nobody"'),
            "line 2: PoseRelativeToGraph unable to find unique frame with name [nobody] in graph; "
            "name a link, joint, frame or model that exists",
        ),
        (
            sdf("\n", link("__leg__"), *ARM),
            "line 2: The supplied link name [__leg__] is reserved; re",
        ),
        (sdf("\n", "<link/>", *ARM), "element[link] is not specified in SDF; correct this element"),
        (sdf(*ARM, "\n<drake:ball_constraint/>"), "line 2: add <drake:ball_constraint_body_A> and"),
        (
            sdf(ARM[0], "\n", ARM[1].replace("0.2 0 0", "0.2")),
            "line 2: Error reading element <pose",
        ),
        (
            '<sdf version="1.9"><world name="a"/>\n<world name="b"/></sdf>',
            "line 2: pinred reads one world of a file; remove the others",
        ),
        (sdf(include("model://broken")), "names the file 'none.sdf', which does not exist"),
    ],
)
def test_message_names_element_line_and_remedy(text: str, words: str, tmp_path: Path) -> None:
    """Also where Drake's message states no line."""
    put(tmp_path / "arm.sdf", sdf(*ARM))
    put(tmp_path / "broken" / "model.config", '<model><sdf version="1.9">none.sdf</sdf></model>')
    with pytest.raises(pinred.PinredError) as caught:
        pinred.load(put(tmp_path / "main.sdf", text))
    assert words in str(caught.value)
    assert "//" not in str(caught.value).replace("model://", "")


def test_repeated_elements_are_reported(tmp_path: Path) -> None:
    """Of a second mass, pose or axis the first one is read, as Drake does."""
    twice = ARM[1].replace("<pose>", "<pose>0.2 0 0 0 0.3 0</pose>\n<pose>9", 1)
    twice = twice.replace("</mass>", "</mass><mass>9</mass>")
    path = put(tmp_path / "main.sdf", sdf(ARM[0], twice, *ARM[2:]))
    with pytest.warns(pinred.LeftOutWarning, match="repeated elements"):
        (left,) = pinred.load(path).left_out
    assert left.names == ("arm: <pose> (line 2)", "arm: <mass> (line 2)")
    assert mass_difference(path, read_sdf(path)) < 1e-13
    assert not pinred.load(put(tmp_path / "all.sdf", sdf(*ARM))).left_out


@pytest.mark.parametrize(("old", "new"), [("<ixx>", "<ixx>9"), ("<mass>", "<mass>-"), ("", "")])
def test_inertias_of_static_models_do_not_matter(old: str, new: str, tmp_path: Path) -> None:
    """Moments that no body has, and negative masses; Drake refuses both."""
    ground = GROUND.replace(old, new) if old else GROUND
    path = put(tmp_path / "main.sdf", world(ground, model("robot", *ARM)))
    system = pinred.load(path)
    alone = pinred.load(put(tmp_path / "arm.sdf", sdf(*ARM)))
    assert system.left_out == ()
    np.testing.assert_array_equal(
        pinred.Reduction(system).mass_matrix([0.3]), pinred.Reduction(alone).mass_matrix([0.3])
    )
