"""The words of URDF and of its extensions: what pinred does with each element and attribute.

`WORDS` lists all words that are read, harmless or left out.  `left_out_words` reports those of a
file that are left out, and all words that are not in the table.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from fnmatch import fnmatchcase
from functools import cache, lru_cache
from xml.etree.ElementTree import Element

from ..common.names import is_number, plain, quoted
from .find_robot_files import place
from .robot_file_contents import LeftOut
from .sdf_words import PLUGINS, REPEATED, plugin_kind, waits_for_commands

UNKNOWN = "elements and attributes that pinred does not know"
QUATERNION = "attitudes by quat_xyzw, which need version 1.1 of URDF"
VERSION = "unknown versions of URDF"
_VERSION = re.compile(r"1\.([012])", re.ASCII)


class Fate(Enum):
    """What happens to a word of a file."""

    READ = "read"
    HARMLESS = "harmless"
    LEFT_OUT = "left out"


@dataclass(frozen=True)
class Words:
    """An element and some of its attributes.

    Attributes:
        path: Tags of the element below <robot>, with alternatives a|b, and * for other characters.
            A final ** contains all elements below.
        fate: What happens to the element and the attributes.
        what: What the words become, why they are harmless, or their kind in `System.left_out`.
        attributes: Names of attributes, separated by blanks.
        neutral: Values that have no effect, so that they are not reported.
        single: Whether an element contains at most one such element.
        quiet: Whether words that are left out cause no warning.
    """

    path: str
    fate: Fate
    what: str
    attributes: str = ""
    neutral: tuple[str, ...] = ()
    single: bool = False
    quiet: bool = False


_READ, _FINE, _OUT = Fate
_ZERO, _ONE = ("0", "false"), ("1", "true")
_SHAPE, _SHOW = "no contact is simulated", "drawn by playback"
_ODE, _MOTOR = "a setting of Gazebo's solver", "describes control, which a file does not simulate"
_PLACE = "placement"
SPRINGS = "springs, damping and friction that are not read"
LOOPS = "closed loops of kinds that are not read"
_GRAVITY = "gravity that does not act on all links"
_FORCES = "bushings, springs and tendons between links"
_MUJOCO = "inertia and forces that options of MuJoCo change"
_RATES = "acceleration, jerk and motor limits"
_NAME = "a name"
_JOINT = "joint|drake:joint"
_LOOP = "loop_joint|drake:loop_joint"
_CLOSING = "closed loop"

WORDS: tuple[Words, ...] = (
    # The robot
    Words("", _READ, "version of URDF", "version"),
    Words("", _FINE, "a System has the name of its file", "name"),
    Words("", _FINE, "a declaration of XML", "xmlns* xsi:*"),
    # Links
    Words("link", _READ, "body", "name"),
    Words("link", _FINE, "a note for other programs", "type concave drake_ignore"),
    Words("link", _FINE, _SHAPE, "self_collision_checking"),
    Words("link/inertial", _READ, "inertia"),
    Words("link/inertial/origin", _READ, _PLACE, "xyz rpy quat_xyzw", single=True),
    Words("link/inertial/mass", _READ, "mass", "value", single=True),
    Words("link/inertial/inertia", _READ, "moments", "ixx iyy izz ixy ixz iyz", single=True),
    Words("link/origin", _OUT, "placements of links", "xyz rpy", ("0",)),
    Words("link/visual|drake:visual/**", _FINE, _SHOW),
    Words("link/collision|drake:collision/**", _FINE, _SHAPE),
    Words("link/collision_checking|self_filter|surface/**", _FINE, _SHAPE),
    Words("link/self_collide", _FINE, _SHAPE),
    Words("link/sensor/**", _FINE, "measures only"),
    Words("link/gravity", _OUT, _GRAVITY, neutral=_ONE),
    Words("link/kinematic", _OUT, _GRAVITY, neutral=_ZERO),
    Words("link/contact", _FINE, _SHAPE),
    Words(
        "link/contact/lateral_friction|rolling_friction|spinning_friction|restitution|stiffness|"
        "damping|contact_cfm|contact_erp|friction_anchor", _FINE, _SHAPE, "value",
    ),
    Words("link/contact/inertia_scaling", _OUT, "scaled inertia", "value", ("1",)),
    # Joints
    Words(_JOINT, _READ, "joint", "name type"),
    Words(_JOINT, _FINE, "an option of Isaac Sim's importer", "dont_collapse"),
    Words(f"{_JOINT}/origin", _READ, _PLACE, "xyz rpy quat_xyzw", single=True),
    Words(f"{_JOINT}/parent|child", _READ, "carrier and carried body", "link", single=True),
    Words(f"{_JOINT}/axis", _READ, "axis; normal of a planar joint", "xyz", single=True),
    Words(f"{_JOINT}/limit", _READ, "limits", "lower upper velocity effort", single=True),
    Words(
        f"{_JOINT}/limit", _OUT, _RATES,
        "acceleration drake:acceleration deceleration jerk command_effort current gear_velocity",
        quiet=True,
    ),
    Words(f"{_JOINT}/mimic|drake:mimic", _READ, "follower", "joint multiplier offset", single=True),
    Words(f"{_JOINT}/dynamics", _READ, "damper and dry friction", "damping friction", single=True),
    Words(f"{_JOINT}/dynamics", _READ, "armature", "armature rotor_inertia"),
    Words(f"{_JOINT}/dynamics", _READ, "spring", "stiffness spring_stiffness"),
    Words(f"{_JOINT}/dynamics", _READ, "rest of the spring", "spring_reference spring_mount"),
    Words(f"{_JOINT}/dynamics", _OUT, SPRINGS, "D K mu_coulomb mu_viscous", ("0",)),
    Words(f"{_JOINT}/dynamics", _FINE, "scenes state the width of friction", "coulomb_window"),
    Words(f"{_JOINT}/drake:screw_thread_pitch", _READ, "pitch", "value", single=True),
    Words(
        f"{_JOINT}/safety_controller", _FINE, _MOTOR,
        "soft_lower_limit soft_upper_limit k_position k_velocity",
    ),
    Words(
        f"{_JOINT}/calibration", _FINE, "a reference of encoders",
        "rising falling reference_position",
    ),
    Words(f"{_JOINT}/drake:controller_gains", _FINE, _MOTOR, "p d"),
    Words(f"{_JOINT}/hardware|hardwareInterface|joint_properties/**", _OUT, SPRINGS),
    # Frames and loops of Drake
    Words("frame|drake:frame", _READ, "frame", "name link xyz rpy"),
    Words(_LOOP, _READ, _CLOSING, "name type"),
    Words(f"{_LOOP}/link1|link2", _READ, _CLOSING, "link xyz rpy", single=True),
    Words(f"{_LOOP}/axis", _READ, _CLOSING, "xyz", single=True),
    Words("drake:ball_constraint", _READ, _CLOSING),
    Words(
        "drake:ball_constraint/drake:ball_constraint_body_A|drake:ball_constraint_body_B",
        _READ, _CLOSING, "name", single=True,
    ),
    Words(
        "drake:ball_constraint/drake:ball_constraint_p_AP|drake:ball_constraint_p_BQ",
        _READ, _CLOSING, "value", single=True,
    ),
    Words("drake:linear_bushing_rpy|drake:linear_spring_damper/**", _OUT, _FORCES),
    Words("drake:tendon_constraint|drake:distance_constraint/**", _OUT, LOOPS),
    Words("drake:weld_constraint|drake:coupler_constraint/**", _OUT, LOOPS),
    Words("drake:collision_filter_group|collision_filter_group/**", _FINE, _SHAPE),
    # Transmissions and control
    Words("transmission", _FINE, _MOTOR, "name type"),
    Words("transmission/type", _FINE, _MOTOR),
    Words("transmission/joint", _READ, "joint of a rotor", "name"),
    Words(
        "transmission/joint/hardwareInterface|mechanicalReduction|mechanical_reduction|role|offset|"
        "deadBandLower|deadBandUpper|saturationLower|saturationUpper|"
        "ignoreTransmissionAbsoluteEncoder/**", _FINE, _MOTOR,
    ),
    Words("transmission/actuator", _READ, "rotor"),
    Words("transmission/actuator", _FINE, _NAME, "name"),
    Words("transmission/actuator/drake:rotor_inertia", _READ, "armature", "value", single=True),
    Words("transmission/actuator/drake:gear_ratio", _READ, "armature", "value", single=True),
    Words(
        "transmission/actuator/mechanicalReduction|mechanical_reduction|hardwareInterface|role|"
        "offset|motorTorqueConstant/**", _FINE, _MOTOR,
    ),
    Words(
        "transmission/mechanicalReduction|mechanical_reduction|use_simulated_gripper_joint|"
        "leftActuator|rightActuator|flexJoint|rollJoint|gap_joint|passive_joint|"
        "simulated_actuated_joint|motorTorqueConstant|compensator|plugin|param/**", _FINE, _MOTOR,
    ),
    Words("ros2_control|actuator/**", _FINE, _MOTOR),
    Words("joint_state_interface|gripper|group|end_effector|disable_collisions/**", _FINE, _MOTOR),
    # Descriptions
    Words("material/**", _FINE, _SHOW),
    Words("sensor/**", _FINE, "measures only"),
    # MuJoCo
    Words("mujoco", _FINE, "options of MuJoCo"),
    Words(
        "mujoco/compiler", _FINE, "an option for files, shapes or names",
        "angle autolimits coordinate discardvisual fitaabb fusestatic meshdir assetdir texturedir "
        "strippath usethread convexhull eulerseq exactmeshinertia alignfree inertiagrouprange "
        "conflict saveinertial",
    ),
    Words("mujoco/compiler", _OUT, _MUJOCO, "balanceinertia", _ZERO),
    Words("mujoco/compiler", _OUT, _MUJOCO, "inertiafromgeom", ("false", "auto")),
    Words("mujoco/compiler", _OUT, _MUJOCO, "boundmass boundinertia", ("0",)),
    Words("mujoco/compiler", _OUT, _MUJOCO, "settotalmass", ("-1",)),
    Words("mujoco/size|statistic|visual|asset/**", _FINE, "a setting of MuJoCo's memory or viewer"),
    Words("mujoco/option|default|actuator|equality|tendon|custom|contact/**", _OUT, _MUJOCO),
    # Gazebo
    Words("gazebo", _READ, "extension of Gazebo", "reference"),
    Words("gazebo", _FINE, _NAME, "xmlns* name"),
    Words("gazebo/joint", _READ, _CLOSING, "name type"),
    Words("gazebo/joint/parent|child", _READ, _CLOSING, "link", single=True),
    Words("gazebo/joint/pose", _READ, _CLOSING, "relative_to frame", single=True),
    Words("gazebo/joint/axis", _READ, _CLOSING, single=True),
    Words("gazebo/joint/axis/xyz", _READ, _CLOSING, "expressed_in", single=True),
    Words("gazebo/joint/axis/use_parent_model_frame", _READ, _CLOSING, single=True),
    Words("gazebo/joint/axis/limit/**", _OUT, "limits of joints that close loops", quiet=True),
    Words("gazebo/joint/axis/dynamics", _FINE, "see its elements"),
    Words("gazebo/joint/axis/dynamics/damping|friction", _OUT, SPRINGS, neutral=("0",)),
    Words("gazebo/joint/axis/dynamics/spring_stiffness", _OUT, SPRINGS, neutral=("0",)),
    Words("gazebo/joint/axis/dynamics/spring_reference", _FINE, "rest of a spring"),
    Words("gazebo/joint/physics|sensor/**", _FINE, _ODE),
    Words("gazebo/joint:*/**", _OUT, LOOPS),
    Words("gazebo/springStiffness", _READ, "spring", "value", single=True),
    Words("gazebo/springReference", _READ, "rest of the spring", "value", single=True),
    Words("gazebo/turnGravityOff", _OUT, _GRAVITY, "value", _ZERO),
    Words("gazebo/gravity", _OUT, _GRAVITY, "value", _ONE),
    Words("gazebo/kinematic", _OUT, _GRAVITY, "value", _ZERO),
    Words("gazebo/static", _OUT, "links fixed to the world", "value", _ZERO),
    Words("gazebo/enable_wind", _OUT, "wind", "value", _ZERO),
    Words("gazebo/dampingFactor", _OUT, "damping of links", "value", ("0",)),
    Words("gazebo/velocity_decay/**", _OUT, "damping of links"),
    Words("gazebo/initial_joint_position/**", _OUT, "initial joint positions"),
    Words("gazebo/plugin|controller:*/**", _OUT, PLUGINS),
    Words(
        "gazebo/mu1|mu2|fdir1|kp|kd|minDepth|maxVel|maxContacts|selfCollide|self_collide|"
        "collision|laserRetro|soft_cfm|soft_erp|min_depth|max_vel|max_contacts/**",
        _FINE, _SHAPE,
    ),
    Words("gazebo/material|visual/**", _FINE, _SHOW),
    Words("gazebo/sensor|sensor:*/**", _FINE, "measures only"),
    Words(
        "gazebo/fudgeFactor|stopCfm|stopErp|stopKp|stopKd|implicitSpringDamper|provideFeedback|"
        "provide_feedback|cfmDamping|disableFixedJointLumping|preserveFixedJoint|"
        "disable_fixed_joint_lumping|preserve_fixed_joint|initialized|canonicalBody|allow_auto_disable"
        "|joint_properties/**", _FINE, _ODE,
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Entry:
    """One element or attribute of the table.

    Attributes:
        path: Path of the element; "" for <robot>.
        attribute: Name of the attribute; "" for the element itself.
        words: The row of the table.
        whole: Whether the entry contains all elements below.
    """

    path: str
    attribute: str
    words: Words
    whole: bool = False

    @property
    def label(self) -> str:
        """The element and the attribute, such as <joint/dynamics damping>."""
        inside = " ".join(word for word in (self.path or "robot", self.attribute) if word)
        return f"<{inside}>"


@cache
def entries() -> tuple[Entry, ...]:
    """Return the entries of the table, one for each element and each attribute."""
    table: dict[tuple[str, str], Entry] = {}
    for words in WORDS:
        is_tree = words.path.endswith("/**")
        for path in _paths(words.path.removesuffix("/**")):
            # An element that the table names again for its attributes keeps its first row.
            for attribute in ("", *words.attributes.split()):
                entry = Entry(path, attribute, words, is_tree and not attribute)
                table.setdefault((path, attribute), entry)
    return tuple(table.values())


def _paths(pattern: str) -> Iterator[str]:
    """Yield the paths of a pattern with alternatives."""
    first, slash, below = pattern.partition("/")
    for tag in first.split("|"):
        for inner in _paths(below) if slash else [""]:
            yield f"{tag}/{inner}" if inner else tag


@cache
def _index() -> tuple[dict[tuple[str, str], Entry], tuple[Entry, ...]]:
    """Return the entries by path and attribute, and those with patterns."""
    exact = {(entry.path, entry.attribute): entry for entry in entries()}
    return exact, tuple(e for e in entries() if "*" in e.path or "*" in e.attribute)


@lru_cache(4096)
def _entry(path: str, attribute: str = "") -> Entry | None:
    """Return the entry of an element or attribute; None if it is not in the table."""
    exact, patterns = _index()
    match = exact.get((path, attribute))
    if match is None:
        alike = (
            entry
            for entry in patterns
            if fnmatchcase(path, entry.path)
            and path.count("/") == entry.path.count("/")
            and bool(attribute) == bool(entry.attribute)
            and fnmatchcase(attribute, entry.attribute)
        )
        match = next(alike, None)
    return match


def version_of(robot: Element) -> int:
    """Return the minor version of URDF 1.0, 1.1 or 1.2; an unknown version counts as 1.0."""
    match = _VERSION.fullmatch(robot.get("version", "1.0").strip())
    return int(match[1]) if match else 0


def left_out_words(robot: Element) -> tuple[LeftOut, ...]:
    """Return the words of a URDF file that are left out, by kind, each with its line.

    Args:
        robot: Element <robot> of the file, as it is.
    """
    names: dict[tuple[str, bool], list[str]] = {}

    def report(kind: str, name: str, *, quiet: bool = False) -> None:
        names.setdefault((kind, quiet), []).append(name)

    def visit(element: Element, path: str, owner: Element) -> None:
        owner = element if _is_named(element) else owner
        for key, value in element.attrib.items():
            kind, quiet = _kind_of_attribute(robot, element, path, key)
            if kind:
                shown = f"{key}={quoted(value)} of {_shown(element, owner)}{place(element)}"
                report(kind, shown, quiet=quiet)
        tags = set[str]()
        for child in element:
            below = f"{path}/{child.tag}" if path else child.tag
            entry = _entry(below)
            if entry is None:
                report(UNKNOWN, f"{_shown(child, owner)}{place(child)}")
                continue
            words = entry.words
            if words.single and child.tag in tags:
                report(REPEATED, f"{_shown(child, owner)}{place(child)}")
            tags.add(child.tag)
            if words.what == PLUGINS:
                library = child.get("filename", child.get("plugin", ""))
                if kind := plugin_kind(library):
                    shown = f"{_shown(child, owner)}{f' ({plain(library)})' * bool(library)}"
                    report(kind, f"{shown}{place(child)}", quiet=waits_for_commands(library))
            elif words.fate is _OUT and _is_stated(child, entry):
                report(words.what, f"{_shown(child, owner)}{place(child)}", quiet=words.quiet)
            if not entry.whole:
                visit(child, below, owner)

    visit(robot, "", robot)
    return tuple(LeftOut(kind, tuple(words), quiet) for (kind, quiet), words in names.items())


def _kind_of_attribute(robot: Element, element: Element, path: str, key: str) -> tuple[str, bool]:
    """Return the kind of an attribute that is left out, or "", and whether it is quiet."""
    entry, value = _entry(path, key), element.attrib[key]
    if entry is None:
        return UNKNOWN, False
    if key == "quat_xyzw" and not version_of(robot):
        return QUATERNION, False
    if element is robot and key == "version" and not _VERSION.fullmatch(value.strip()):
        return VERSION, False
    words = entry.words
    is_left_out = words.fate is _OUT and not _is_neutral(value, words.neutral)
    return (words.what if is_left_out else ""), words.quiet


def _is_stated(element: Element, entry: Entry) -> bool:
    """Return whether an element states more than its attributes do."""
    words, text = entry.words, (element.text or "").strip()
    if entry.whole or not (words.attributes or words.neutral):
        return True
    return bool(text) and not _is_neutral(text, words.neutral)


def _is_named(element: Element) -> bool:
    return element.tag != "robot" and ("name" in element.attrib or "reference" in element.attrib)


def _shown(element: Element, owner: Element) -> str:
    """Describe an element, and the innermost named element that contains it, for a list."""
    if _is_named(element):
        name = element.get("name", element.get("reference", ""))
        return f"{element.tag} {quoted(name)}"
    inside = f" of {_shown(owner, owner)}" if _is_named(owner) else ""
    return f"<{element.tag}>{inside}"


def _is_neutral(value: str, neutral: tuple[str, ...]) -> bool:
    """Return whether all words of a value are neutral."""
    numbers = {float(word) for word in neutral if is_number(word)}
    return bool(neutral) and all(
        word.lower() in neutral or (is_number(word) and float(word) in numbers)
        for word in value.split()
    )
