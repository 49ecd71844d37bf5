"""Every word of URDF and its extensions is read, harmless, or reported as left out."""

from __future__ import annotations

import re
import warnings
from copy import deepcopy
from functools import cache
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import pytest
import urdf_word_table
from robot_texts import link, robot

import pinred
from pinred import LeftOutWarning, ModelError, PinredError
from pinred.system.find_robot_files import text_in_file
from pinred.system.read_urdf import UrdfRobot, read_urdf
from pinred.system.sdf_words import REPEATED
from pinred.system.urdf_words import (
    QUATERNION,
    UNKNOWN,
    VERSION,
    Entry,
    Fate,
    entries,
)


def bar(name: str, com: str = "0 0 0.1", turned: str = 'rpy="0.1 0.2 0.3"') -> str:
    """Return a link with mass."""
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}" {turned}/><mass value="0.5"/><inertia '
        'ixx="0.01" ixy="0.001" ixz="0.002" iyy="0.02" iyz="0.003" izz="0.025"/></inertial></link>'
    )


def on(name: str, parent: str, child: str, kind: str = "revolute", inside: str = "") -> str:
    """Return a joint with content."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside}</joint>"
    )


LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="4"/>'
AXIS = '<axis xyz="0 0.6 0.8"/>'
TREE = robot(
    *(bar(name) for name in "abcde"),
    bar("f", turned='quat_xyzw="0.5 0.5 0.5 0.5"'),
    bar("g"),
    on(
        "j1", "a", "b", inside=f'<origin xyz="1 0 0" rpy="0.1 0 0.2"/>{AXIS}{LIMIT}<dynamics '
        'damping="0.1" friction="0.2" armature="0.3" stiffness="5" spring_reference="0.7"/>',
    ),
    on(
        "j2", "b", "c", inside=f'<origin quat_xyzw="0.5 0.5 0.5 0.5"/>{AXIS}<dynamics '
        'rotor_inertia="0.4" spring_stiffness="6" spring_mount="0.8"/>',
    ),
    on("j3", "a", "d", inside=f'<mimic joint="j1" multiplier="2" offset="0.1"/>{AXIS}'),
    on("j4", "a", "e", inside=f'<drake:mimic joint="j1" multiplier="3" offset="0.2"/>{AXIS}'),
    on("j5", "b", "f", "screw", f'{AXIS}<drake:screw_thread_pitch value="0.3"/>'),
    on("j6", "c", "g", inside='<axis xyz="1 0 0"/>'),
    '<frame name="tip" link="b" xyz="0 0 1" rpy="0.1 0 0"/>',
    '<drake:frame name="top" link="b" xyz="0 0 2" rpy="0.2 0 0"/>',
    '<transmission><joint name="j6"/><actuator name="m"><drake:rotor_inertia value="0.01"/>'
    '<drake:gear_ratio value="10"/></actuator></transmission>',
    '<gazebo reference="j6"><springStiffness>7</springStiffness><springReference>0.3'
    "</springReference></gazebo>",
).replace("<robot", '<robot version="1.1"')  # fmt: skip
VALUES = TREE.replace(
    "<springStiffness>7</springStiffness>", '<springStiffness value="7"/>'
).replace("<springReference>0.3</springReference>", '<springReference value="0.3"/>')

Y, TURNED = '<axis xyz="0 1 0"/>', 'rpy="0 0.3 0"'


def four_bar(closing: str, right: float = 0.2, extra: str = "") -> str:
    """Return four bars that form a rectangle at zero, whose loop is closed by an element."""
    return robot(
        link("base"),
        *(bar(name) for name in ("left", "right", "top")),
        on("j_left", "base", "left", "continuous", Y),
        on("j_right", "base", "right", "continuous", f'<origin xyz="0.3 0 {0.2 - right}"/>{Y}'),
        on("j_top", "left", "top", "continuous", f'<origin xyz="0 0 0.2"/>{Y}'),
        extra,
        closing,
    )


def drake_loop(right: float = 0.2) -> str:
    """Return Drake's joint that closes the four-bar."""
    return (
        f'<loop_joint name="close" type="continuous">{Y}<link1 link="right" xyz="0 0 {right}" '
        f'{TURNED}/><link2 link="top" xyz="0.3 0 0" {TURNED}/></loop_joint>'
    )


def gazebo_loop(pose: str = "<pose>0.3 0 0 0 0.1 0</pose>", axis: str = "") -> str:
    """Return a joint of Gazebo that closes the four-bar."""
    axis = axis or "<axis><xyz>0 1 0</xyz></axis>"
    return (
        '<gazebo><joint name="close" type="revolute"><parent>right</parent><child>top</child>'
        f"{pose}{axis}</joint></gazebo>"
    )


GAZEBO = gazebo_loop()
BALL = (
    '<drake:ball_constraint><drake:ball_constraint_body_A name="right"/>'
    '<drake:ball_constraint_body_B name="top"/><drake:ball_constraint_p_AP value="0 0 0.2"/>'
    '<drake:ball_constraint_p_BQ value="0.3 0 0"/></drake:ball_constraint>'
)
AXIS_IN = '<axis><xyz expressed_in="left">0 1 0</xyz></axis>'
IN_MODEL = "<axis><use_parent_model_frame>1</use_parent_model_frame><xyz>0 1 0</xyz></axis>"
TILTED = "<pose>0.3 0 0 0.3 0.1 0.2</pose>"
LOOPS = (
    four_bar(drake_loop()),
    four_bar(drake_loop().replace("loop_joint", "drake:loop_joint")),
    four_bar(GAZEBO),
    four_bar(GAZEBO.replace("<parent>right</parent>", '<parent link="right"/>').replace(
        "<child>top</child>", '<child link="top"/>'
    )),
    four_bar(gazebo_loop('<pose relative_to="right">0 0 0.2 0 0 0</pose>')),
    four_bar(gazebo_loop('<pose frame="right">0 0 0.2 0 0 0</pose>')),
    four_bar(gazebo_loop(TILTED, AXIS_IN)),
    four_bar(gazebo_loop(TILTED, IN_MODEL)),
    four_bar(BALL),
)  # fmt: skip


def of_drake(text: str) -> str:
    """Return a file with Drake's name of joints."""
    text = re.sub("<joint (name=[^>]* type)", r"<drake:joint \1", text)
    return text.replace("</joint>", "</drake:joint>")


FILES = (TREE, VALUES, of_drake(TREE), *LOOPS)  # files that contain all words that are read


def read(text: str) -> UrdfRobot:
    """Read a text."""
    with text_in_file(text) as path:
        return read_urdf(path)


@cache
def contents(text: str) -> object:
    """Return all that a file states about the motion, or the error that refuses it."""
    try:
        urdf = read(text)
    except PinredError as error:
        return str(error)
    model = urdf.model
    arrays = (
        *(getattr(model, name) for name in (
            "armature", "damping", "upperDryFrictionLimit", "upperVelocityLimit",
            "upperEffortLimit", "lowerPositionLimit", "upperPositionLimit",
        )),
        *(body.toDynamicParameters() for body in model.inertias),
        *(place.homogeneous for place in model.jointPlacements),
        *(frame.placement.homogeneous for frame in model.frames),
    )  # fmt: skip
    return (
        [str(joint) for joint in model.joints], [str(name) for name in model.names],
        [(frame.name, frame.parentJoint) for frame in model.frames],
        [array.tolist() for array in arrays],
        urdf.couplings, urdf.springs, [str(loop) for loop in urdf.loops],
    )  # fmt: skip


def written(root: Element) -> str:
    """Return an XML text; prefixes stay as they are."""
    return ElementTree.tostring(root, encoding="unicode")


def parsed(text: str) -> Element:
    """Return the elements of a text, whose prefixes may be undeclared."""
    return ElementTree.fromstring(text.replace("drake:", "drake-"))


def identity(entry: Entry) -> str:
    """Return the name of a test of an entry."""
    return f"{entry.path}@{entry.attribute}"


READ = [entry for entry in entries() if entry.words.fate is Fate.READ and entry.path]
OTHERS = [entry for entry in entries() if entry.words.fate is not Fate.READ]


@pytest.mark.parametrize("text", FILES)
def test_files_of_these_tests_are_read_completely(text: str) -> None:
    """They load, and nothing but limits is left out."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pinred.ModelWarning)
        system = pinred.load(text=text)
    assert all(left.demanded for left in system.left_out)
    assert [left.what for left in system.left_out if "limits" not in left.what] == []


@pytest.mark.parametrize("entry", READ, ids=identity)
def test_word_that_is_read_changes_the_robot(entry: Entry) -> None:
    """Without the element or the attribute, a file that contains it states another robot."""
    path, attribute = entry.path.replace("drake:", "drake-"), entry.attribute
    found = False
    for text in FILES:
        root = parsed(text)
        for parent in root.iter():
            for child in [*parent]:
                if _path(root, child) != path or (attribute and attribute not in child.attrib):
                    continue
                found = True
                changed = deepcopy(root)
                parents = [*root.iter()]
                twin = [*changed.iter()][parents.index(parent)]
                if attribute:
                    del twin[list(parent).index(child)].attrib[attribute]
                else:
                    twin.remove(twin[list(parent).index(child)])
                without = written(changed).replace("drake-", "drake:")
                if contents(text) != contents(without):
                    return
    assert found, "no file of the test contains the word"
    pytest.fail("the word changes nothing")


def _path(root: Element, element: Element) -> str:
    """Return the tags from the root to an element."""
    parents = {child: parent for parent in root.iter() for child in parent}
    tags = []
    while element is not root:
        tags.append(element.tag)
        element = parents[element]
    return "/".join(reversed(tags))


def with_word(entry: Entry, value: str) -> str:
    """Return a file with a word that is not read, in an element of its own where there is none."""
    text = re.sub("<transmission>.*</transmission>", "", TREE)
    text = text.replace(' spring_stiffness="6" spring_mount="0.8"', "")
    text = text.replace("</robot>", "\n</robot>")
    tag = entry.path.partition("/")[0]
    if tag == "drake:joint":
        text = of_drake(text)
    if entry.path.startswith("gazebo/joint/"):
        text = LOOPS[2]
    root = parsed(text)
    element = root
    for tag in entry.path.replace("drake:", "drake-").replace("*", "x").split("/"):
        if tag:
            child = element.find(tag)
            element = SubElement(element, tag) if child is None else child
    if entry.attribute:
        element.set(entry.attribute.replace(":", "-").replace("*", "x"), value)
    elif entry.whole:
        SubElement(element, "junk", {"junk": value})
    else:
        element.text = value
    return re.sub("(drake|xmlns|xsi)-", r"\1:", written(root))


@pytest.mark.parametrize("entry", OTHERS, ids=identity)
@pytest.mark.sampled(3)
def test_other_words_are_reported_or_change_nothing(entry: Entry) -> None:
    """Words that are left out are listed with their line; harmless ones and neutral values not."""
    words = entry.words
    is_silent = not (entry.attribute or entry.whole or words.neutral) and bool(words.attributes)
    text = with_word(entry, "7")
    reported = list(read(text).left_out)
    if words.fate is Fate.HARMLESS or is_silent:
        assert reported == []
        return
    assert [left.what for left in reported] == [words.what]
    assert reported[0].demanded == words.quiet
    assert all("(line " in name for name in reported[0].names)
    for neutral in words.neutral:
        left_out = read(with_word(entry, neutral)).left_out
        assert not [left for left in left_out if left.what == words.what]


@pytest.mark.parametrize(
    ("plugin", "kind", "quiet"),
    [
        ('<plugin name="p" filename="libgazebo_ros_imu_sensor.so"/>', "", False),
        ('<plugin name="p" filename="libgazebo_ros_openni_kinect.so"/>', "", False),
        ('<plugin name="p" filename="/a/libgz-sim8-pose-publisher-system.so"/>', "", False),
        ('<controller:gazebo_ros_bumper name="p" plugin="libgazebo_ros_bumper.so"/>', "", False),
        ('<plugin name="p" filename="libgazebo_ros_control.so"/>', "plugins", True),
        ('<plugin name="p" filename="libgazebo_ros_force.so"/>', "plugins", True),
        ('<plugin name="p" filename="libthruster.so"/>', "plugins", False),
        ('<plugin name="p" filename="gz-sim-joint-position-controller-system"/>', "plugins", False),
        ('<plugin name="p" filename="libgz-sim-buoyancy-system.so"/>', "buoyancy", False),
        ("<plugin/>", "plugins", False),
    ],
)  # fmt: skip
def test_plugins_that_may_move_something_are_reported(plugin: str, kind: str, quiet: bool) -> None:
    """Observers are harmless; others are named with their library and line."""
    left_out = read(TREE.replace("</robot>", f"<gazebo>{plugin}</gazebo></robot>")).left_out
    assert [(left.what, left.demanded) for left in left_out] == [(kind, quiet)] * bool(kind)
    if "filename" in plugin and kind:
        library = re.search('filename="(.*?)"', plugin)
        assert library is not None
        assert f"plugin 'p' ({library[1]}) (line " in left_out[0].names[0]


def test_unknown_words_are_reported_with_owner_and_line() -> None:
    """Elements and attributes that no table contains, in any place."""
    text = TREE.replace("</robot>", '\n<wing span="2"/>\n<link name="h"><glue/></link></robot>')
    text = text.replace('<joint name="j6" type', '\n<joint strength="9" name="j6" type')
    text = text.replace("</robot>", on("j7", "a", "h", "fixed", '<axis rpy="0"/>') + "</robot>")
    (unknown,) = read(text).left_out
    assert unknown.what == UNKNOWN
    assert not unknown.demanded
    assert unknown.names == (
        "strength='9' of joint 'j6' (line 2)", "<wing> (line 3)", "<glue> of link 'h' (line 4)",
        "rpy='0' of <axis> of joint 'j7' (line 4)",
    )  # fmt: skip
    with pytest.warns(LeftOutWarning, match=r"that pinred does not know \(4\)"):
        pinred.load(text=text, lock=["j2"])


def test_repeated_elements_are_reported() -> None:
    """The first of several elements counts, as in URDF's parser."""
    text = TREE.replace(LIMIT, f'{LIMIT}<limit lower="0" upper="9"/>')
    (repeated,) = read(text).left_out
    assert (repeated.what, repeated.names) == (REPEATED, ("<limit> of joint 'j1' (line 1)",))
    assert (
        read(text).model.upperPositionLimit.tolist() == read(TREE).model.upperPositionLimit.tolist()
    )


def test_lines_count_from_the_beginning_of_the_file() -> None:
    """Blank lines and a late XML declaration before the first element count."""
    text = '\n\n<?xml\nversion="1.0"?>\n' + robot(link("a"), "\n<wing/>")
    (unknown,) = read(text).left_out
    assert unknown.names == ("<wing> (line 6)",)


def test_quaternions_need_version_one_one() -> None:
    """Without rpy they are refused; beside rpy, which old parsers read, they are reported."""
    both = TREE.replace('version="1.1"', 'version="1.0"').replace(
        'quat_xyzw="0.5', 'rpy="0 0 0" quat_xyzw="0.5'
    )
    (left,) = read(both).left_out
    assert (left.what, len(left.names)) == (QUATERNION, 2)
    for version in ("", 'version="1.0"', 'version="2.7"'):
        old = TREE.replace('version="1.1"', version)
        with pytest.raises(ModelError, match=r"'j2' \(line 1\) has quat_xyzw.*version 1.1"):
            read(old)
    with pytest.raises(ModelError, match="both rpy and quat_xyzw; keep one"):
        read(both.replace('version="1.0"', 'version="1.1"'))
    with pytest.raises(ModelError, match="quaternion of zeros"):
        read(TREE.replace("0.5 0.5 0.5 0.5", "0 0 0 0"))
    (left,) = read(robot(link("a")).replace("<robot", '<robot version="7"')).left_out
    assert left.what == VERSION


def test_table_of_the_docs_is_that_of_the_code() -> None:
    """Run tests/helpers/urdf_word_table.py after a change of the table."""
    page = urdf_word_table.DOCUMENT.read_text("utf-8")
    table = page.partition(urdf_word_table.START)[2].partition(urdf_word_table.END)[0]
    assert table.strip() == urdf_word_table.render().strip()
