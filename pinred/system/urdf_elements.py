"""URDF elements as Pinocchio's parser needs them: checks, conversion, and what the parser drops.

Pinocchio's parser rejects files for reasons that do not change a motion, such as limits without
effort or velocity.  `reduced_text` keeps only the elements that affect the motion, so errors in
meshes, paths and materials do not matter.  `urdf_words` lists all words, so none is lost here.
"""

from __future__ import annotations

import re
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import ModelError
from ..common.names import listed, nearest, quoted
from .copy_model import NewJoint
from .find_robot_files import FileElement, place
from .passive import UNLIMITED, Spring
from .robot_file_contents import Coupling, LeftOut
from .urdf_words import SPRINGS, version_of

_DIGITS = r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"
_NUMBER = re.compile(_DIGITS, re.ASCII)
_WITH_COMMAS = re.compile(rf"\s*{_DIGITS}(\s*,\s*{_DIGITS})+\s*", re.ASCII)
_BLANKS = re.compile(r"[ \t\r\n]+")
_LISTS = ("xyz", "rpy", "size", "scale", "rgba")  # attributes that contain several numbers
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_NEEDS_LIMITS = ("revolute", "prismatic")
_SINGLE = ("revolute", "continuous", "prismatic", "screw")  # types with one degree of freedom
# Types that Pinocchio's parser does not know; it gets a free joint in their place.
_REPLACED = ("spherical", "universal", "screw")
_MANY = ("planar", "floating", *_REPLACED)  # types whose numbers `keep_numbers` reads
_TYPES = (*_SINGLE, "fixed", "planar", "floating", "spherical", "universal")
# Other names of these types, as Drake and Bullet use them.
_SAME_TYPES = {
    "ball": "spherical",
    "rpy_floating": "floating",
    "quaternion_floating": "floating",
}
_JOINT = ("origin", "parent", "child", "axis", "mimic")
WORLD = "world"  # Drake's name of the ground, which needs no <link>
_SAME = 1e-6  # relative difference of numbers that count as equal, because files round them


def replace_commas(robot: Element) -> str:
    """Replace commas between the numbers of lists by blanks, in place.

    A list that mixes commas and blanks stays as it is, because its commas may be decimal ones.

    Returns:
        A warning, or "" if there are no such lists.
    """
    lists = [
        (element.attrib, key)
        for element in robot.iter()
        for key in _LISTS
        if _WITH_COMMAS.fullmatch(element.get(key, ""))
    ]
    if not lists:
        return ""
    attributes, key = lists[0]
    first = f"{key}={quoted(attributes[key])}"
    for attributes, key in lists:
        attributes[key] = attributes[key].replace(",", " ")
    return (
        f"{len(lists)} lists of numbers have commas, such as {first}; they are read as blanks, "
        "which URDF requires"
    )


def prepare(robot: Element) -> None:
    """Replace words of other programs by those of URDF, in place.

    Raises:
        ModelError: A link or joint has a name or a type that cannot be read.
    """
    joints = [*robot.findall("joint"), *robot.findall("drake:joint")]
    _check_unique(robot.findall("link"), "link")
    _check_unique(joints, "joint")
    for joint in joints:
        name = f"joint {quoted(joint.get('name', '?'))}{place(joint)}"
        if joint.get("name") == "universe":
            raise ModelError(
                f"{name}: 'universe' is Pinocchio's name of the fixed world; rename the joint"
            )
        joint_type = joint.get("type", "").strip()
        joint_type = _SAME_TYPES.get(joint_type, joint_type)
        if joint_type not in _TYPES:
            shown = (
                f"the type {quoted(joint_type)}; replace it by" if joint_type else "no type; state"
            )
            raise ModelError(f"{name} has {shown} one of {listed(_TYPES, 20)}")
        joint.set("type", joint_type)
        if joint.tag == "drake:joint":
            joint.tag = "joint"
            if joint_type == "planar" and joint.find("axis") is None:
                SubElement(joint, "axis", xyz="0 0 1")
        for mimic in joint.findall("drake:mimic"):
            mimic.tag = "mimic"
    names = {link.get("name") for link in robot.findall("link")}
    ends = {end.get("link") for end in robot.iterfind("joint/parent")}
    if WORLD in ends - names:
        robot.append(FileElement("link", {"name": WORLD}))


def _check_unique(elements: list[Element], what: str) -> None:
    """Reject elements without a name, or with the same name.  Raises ModelError."""
    first: dict[str, Element] = {}
    for element in elements:
        name = element.get("name", "")
        if not name:
            raise ModelError(f"a {what}{place(element)} has no name; add the attribute name=")
        if name in first:
            raise ModelError(
                f"two {what}s are called {quoted(name)}{place(first[name])} and"
                f"{place(element) or ' elsewhere'}; rename one of them"
            )
        first[name] = element


def check_urdf(robot: Element) -> None:
    """Reject invalid axes, attitudes and inertias.

    Raises:
        ModelError: The message names the joint or link.
    """
    for joint in robot.findall("joint"):
        owner = f"joint {quoted(joint.get('name', '?'))}"
        _check_origin(robot, joint.find("origin"), owner)
        if joint.get("type") != "fixed":
            _check_axis(joint)
            _check_friction(joint)
    for link in robot.findall("link"):
        owner, inertials = f"link {quoted(link.get('name', '?'))}", link.findall("inertial")
        if len(inertials) > 1:
            raise ModelError(
                f"{owner} has {len(inertials)} inertial elements{place(inertials[1])}; keep only "
                "one of them"
            )
        for inertial in inertials:
            _check_inertial(inertial, owner)
            _check_origin(robot, inertial.find("origin"), f"the inertia of {owner}")


def link_inertias(robot: Element) -> dict[str, pin.Inertia]:
    """Return the inertia of each link with mass, in its own frame; call `check_urdf` first."""
    inertias = {}
    for link in robot.findall("link"):
        inertial, name = link.find("inertial"), link.get("name", "?")
        if inertial is None:
            continue
        mass, moments = inertial.find("mass"), inertial.find("inertia")
        value = 0.0 if mass is None else float(mass.get("value", "0"))
        if value > 0.0 and moments is not None:
            xx, yy, zz, xy, xz, yz = (float(moments.get(key, "0")) for key in _MOMENTS)
            I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            at = origin_of(inertial.find("origin"), f"link {quoted(name)}")
            I = at.rotation @ I @ at.rotation.T
            try:
                inertias[name] = pin.Inertia(value, at.translation, 0.5 * (I + I.T))
            except RuntimeError:  # Pinocchio rejects negative moments; so does the model's check.
                inertias[name] = pin.Inertia(value, at.translation, np.zeros((3, 3)))
    return inertias


def tree_depth(robot: Element) -> int:
    """Return the largest number of joints from the root link to a link.

    Raises:
        ModelError: A joint names a link that is missing, joints form a cycle, or several links
            have no joint that carries them.
    """
    _check_links(robot)
    depth: dict[str, int] = {}
    parent_of = {
        child.get("link", "?"): parent.get("link", "?")
        for joint in robot.findall("joint")
        if (parent := joint.find("parent")) is not None
        and (child := joint.find("child")) is not None
    }
    roots = [link for link in robot.findall("link") if link.get("name") not in parent_of]
    if len(roots) > 1:
        names = listed([f"{link.get('name', '?')}{place(link)}" for link in roots], 6)
        raise ModelError(
            f"the links {names} have no joint that carries them, but only the root link may have "
            "none; add joints to the others, or remove them"
        )
    for link in parent_of:
        path, end = {link: None}, link
        while end in parent_of and end not in depth:
            end = parent_of[end]
            if end in path:
                raise ModelError(
                    f"link {quoted(link)} is attached to itself through a cycle of joints; remove "
                    "one of them"
                )
            path[end] = None
        first = depth.setdefault(end, 0)
        depth |= {name: first + k for k, name in enumerate(reversed(path))}
    return max(depth.values(), default=0)


def _check_links(robot: Element) -> None:
    """Reject joints on links that are missing.  Raises ModelError."""
    links = {link.get("name", "") for link in robot.findall("link")}
    for joint in robot.findall("joint"):
        owner = f"joint {quoted(joint.get('name', '?'))}{place(joint)}"
        for tag in ("parent", "child"):
            end = joint.find(tag)
            if end is None or not end.get("link"):
                raise ModelError(f'{owner} names no {tag}; add <{tag} link="…"/>')
            name = end.get("link", "")
            if name not in links:
                raise ModelError(
                    f"the {tag} of {owner} is the link {quoted(name)}, which the file does not "
                    f"contain; {nearest(name, sorted(links))}name a link of the file"
                )


def moving_joints(robot: Element) -> list[Element]:
    """Return the joints that are not fixed."""
    return [joint for joint in robot.findall("joint") if joint.get("type") != "fixed"]


def mimic_couplings(robot: Element) -> tuple[Coupling, ...]:
    """Return the couplings that <mimic> elements define between moving joints.

    The <mimic> element of a fixed joint has no effect and is ignored.

    Raises:
        ModelError: A <mimic> names no joint, or has invalid numbers.
    """
    couplings = []
    for joint in moving_joints(robot):
        mimic, name = joint.find("mimic"), joint.get("name", "?")
        if mimic is None:
            continue
        leader = mimic.get("joint")
        if leader is None:
            raise ModelError(
                f"the <mimic> of joint '{name}'{place(mimic)} names no joint; add the attribute "
                "joint="
            )
        ratio, offset = (
            float(floats(mimic, key, f"the <mimic> of joint '{name}'", 1)[0])
            if key in mimic.attrib
            else default
            for key, default in (("multiplier", 1.0), ("offset", 0.0))
        )
        couplings.append(Coupling(name, {leader: ratio}, offset))
    return tuple(couplings)


def special_joints(robot: Element) -> dict[str, NewJoint]:
    """Return the joints that Pinocchio's parser does not read, by name.

    They are balls, universal and screw joints, and planar joints whose normal is not z.

    Raises:
        ModelError: A screw has no pitch, or a number is not valid.
    """
    joints = {}
    identity = pin.SE3.Identity()
    for joint in moving_joints(robot):
        name, joint_type = joint.get("name", "?"), joint.get("type")
        axis = joint.find("axis")
        if joint_type == "spherical":
            joints[name] = NewJoint(name, pin.JointModelSpherical(), identity)
        elif joint_type == "universal":
            joints[name] = NewJoint(name, pin.JointModelUniversal(*np.eye(3)[:2]), identity)
        elif joint_type == "screw":
            element, owner = joint.find("drake:screw_thread_pitch"), f"screw joint {quoted(name)}"
            if element is None:
                raise ModelError(
                    f"{owner}{place(joint)} has no <drake:screw_thread_pitch value=…/>; add it"
                )
            (pitch,) = floats(element, "value", f"the pitch of {owner}", 1)
            screw = pin.JointModelHelicalUnaligned(
                axis_of(axis, name), float(pitch) / (2.0 * np.pi)
            )
            joints[name] = NewJoint(name, screw, identity)
        elif joint_type == "planar" and (turn := rotation_to(axis_of(axis, name))) is not None:
            joints[name] = NewJoint(
                name, pin.JointModelPlanar(), pin.SE3(turn, np.zeros(3)),
                body=pin.SE3(turn.T, np.zeros(3)),
            )  # fmt: skip
    return joints


def rotation_to(axis: Array) -> Array | None:
    """Return the smallest rotation from z to a unit axis, (3, 3); None if the axis is z."""
    if not axis[:2].any() and axis[2] > 0.0:
        return None
    if axis[2] < 0.0 and not axis[:2].any():
        return np.diag([1.0, -1.0, -1.0])
    return np.asarray(pin.Quaternion.FromTwoVectors(np.eye(3)[2], axis).matrix())


def axis_of(element: Element | None, joint: str) -> Array:
    """Return the unit axis of a joint, (3,); x by default, as in URDF.  Raises ModelError."""
    if element is None:
        return np.array([1.0, 0.0, 0.0])
    return unit_vector(floats(element, "xyz", f"the axis of joint {quoted(joint)}", 3), joint)


def unit_vector(axis: Array, joint: str) -> Array:
    """Return the direction of the axis of a joint, (3,).  Raises ModelError if it is zero."""
    if not axis.any():
        raise ModelError(f"the axis of joint {quoted(joint)} is zero; state a direction")
    return np.asarray(axis / np.linalg.norm(axis))


def keep_numbers(robot: Element, model: pin.Model) -> None:
    """Copy the numbers of joints that Pinocchio drops to the model.

    They are damping, dry friction, and the limits of velocity and effort of joints with several
    degrees of freedom and of screws.
    """
    for joint in moving_joints(robot):
        if joint.get("type") not in _MANY:
            continue
        name = joint.get("name", "?")
        entry = model.joints[model.getJointId(name)]
        entries = slice(entry.idx_v, entry.idx_v + entry.nv)
        for tag, key, array, sign in (
            ("dynamics", "damping", model.damping, 1.0),
            ("dynamics", "friction", model.upperDryFrictionLimit, 1.0),
            ("dynamics", "friction", model.lowerDryFrictionLimit, -1.0),
            ("limit", "velocity", model.upperVelocityLimit, 1.0),
            ("limit", "effort", model.upperEffortLimit, 1.0),
        ):
            element = joint.find(tag)
            if element is None or key not in element.attrib:
                continue
            owner = f"the {tag} of joint '{name}'"
            if tag == "limit":
                array[entries] = float(_rate_limit(element, key, owner))
                continue
            size = len(element.get(key, "").split())  # Drake states one number for each axis.
            value = floats(element, key, owner, entry.nv if size > 1 else 1)
            array[entries] = sign * value


def file_frames(robot: Element, model: pin.Model) -> None:
    """Add Drake's frames to a model.

    Raises:
        ModelError: A frame has no name or no link, or its name is taken.
    """
    for element in [*robot.findall("frame"), *robot.findall("drake:frame")]:
        name, link = element.get("name", ""), element.get("link", "")
        owner = f"frame {quoted(name)}{place(element)}"
        if not name or not model.existBodyName(link) or model.existFrame(name):
            raise ModelError(
                f"{owner} on the link {quoted(link)}: expected a new name and a link of the robot"
            )
        body = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
        at, frame_type = body.placement * origin_of(element, owner), pin.FrameType.OP_FRAME
        model.addFrame(pin.Frame(name, body.parentJoint, 0, at, frame_type), False)


def origin_of(element: Element | None, owner: str) -> pin.SE3:
    """Return the placement that the attributes of an element state.

    Args:
        element: Element; None for the identity.
        owner: Owner of the placement, for messages.
    """
    if element is None:
        return pin.SE3.Identity()
    xyz, rpy = (
        floats(element, key, f"the origin of {owner}", 3) if key in element.attrib else np.zeros(3)
        for key in ("xyz", "rpy")
    )
    if "quat_xyzw" in element.attrib:
        quaternion = floats(element, "quat_xyzw", f"the origin of {owner}", 4)
        return pin.XYZQUATToSE3(np.append(xyz, quaternion / np.linalg.norm(quaternion)))
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def rotor_inertias(robot: Element) -> dict[str, float]:
    """Return the armature of joints, {joint: [kg m² | kg]}.

    Sources are `armature` and `rotor_inertia` of <dynamics>, and Drake's elements of
    <transmission>, whose rotor inertia counts gear ratio squared times.

    Raises:
        ModelError: Two sources contradict each other, or a transmission names no joint.
    """
    names = {joint.get("name") for joint in robot.findall("joint")}
    reflected: dict[str, float] = {}
    for transmission in robot.findall("transmission"):
        for actuator in transmission.findall("actuator"):
            owner = f"actuator {quoted(actuator.get('name', '?'))}"
            rotor, gear = (
                1.0 if element is None else float(floats(element, "value", owner, 1)[0])
                for element in map(actuator.find, ("drake:rotor_inertia", "drake:gear_ratio"))
            )
            if actuator.find("drake:rotor_inertia") is None or not rotor:
                continue
            driven = [joint.get("name", "?") for joint in transmission.findall("joint")]
            if len(driven) != 1 or driven[0] not in names:
                raise ModelError(
                    f"the transmission of {owner}{place(transmission)} has a rotor and the joints "
                    f"{listed(driven) or 'none'}; name one joint of the robot"
                )
            reflected[driven[0]] = reflected.get(driven[0], 0.0) + gear**2 * rotor
    armature: dict[str, float] = {}
    for joint in moving_joints(robot):
        name, dynamics = joint.get("name", "?"), joint.find("dynamics")
        stated = _stated(dynamics, ("armature", "rotor_inertia"), f"joint {quoted(name)}")
        if name in reflected:
            stated["drake:rotor_inertia of the transmission"] = reflected[name]
        if stated:
            armature[name] = _agreed(stated, f"joint {quoted(name)}{place(joint)}")
    return {name: value for name, value in armature.items() if value}


def file_springs(robot: Element) -> tuple[tuple[Spring, ...], tuple[LeftOut, ...]]:
    """Return the springs at joints with one degree of freedom, and the springs that are left out.

    Sources are `stiffness` of <dynamics>, and <springStiffness> of Gazebo.

    Raises:
        ModelError: Two sources contradict each other, or a number is not valid.
    """
    joints = {joint.get("name", "?"): joint for joint in robot.findall("joint")}
    extensions: dict[str, list[Element]] = {}
    for gazebo in robot.findall("gazebo"):
        if gazebo.find("springStiffness") is not None:
            extensions.setdefault(gazebo.get("reference", ""), []).append(gazebo)
    left_out = [f"{name or '?'}{place(extensions[name][0])}" for name in extensions.keys() - joints]
    springs = []
    for name, joint in joints.items():
        owner, dynamics = f"joint {quoted(name)}", joint.find("dynamics")
        stiffness = _stated(dynamics, ("stiffness", "spring_stiffness"), owner)
        for gazebo in extensions.get(name, []):
            key = f"springStiffness of <gazebo>{place(gazebo)}"
            stiffness[key] = _content(gazebo, "springStiffness", owner)
        k = _agreed(stiffness, f"{owner}{place(joint)}") if stiffness else 0.0
        if not k:
            continue
        if joint.get("type") not in _SINGLE:
            left_out.append(f"{name}{place(joint)}")
            continue
        rest_lengths = _stated(dynamics, ("spring_reference", "spring_mount"), owner)
        for gazebo in extensions.get(name, []):
            if gazebo.find("springReference") is not None:
                key = f"springReference of <gazebo>{place(gazebo)}"
                rest_lengths[key] = _content(gazebo, "springReference", owner)
        springs.append(Spring(name, k, _agreed(rest_lengths, owner) if rest_lengths else 0.0))
    return tuple(springs), (LeftOut(SPRINGS, tuple(left_out)),) if left_out else ()


def _stated(element: Element | None, keys: tuple[str, ...], owner: str) -> dict[str, float]:
    """Return the numbers of those attributes that an element has."""
    if element is None:
        return {}
    owner = f"the {element.tag} of {owner}"
    present = [key for key in keys if key in element.attrib]
    return {key: float(floats(element, key, owner, 1)[0]) for key in present}


def _content(element: Element, tag: str, owner: str) -> float:
    """Return the number in a child element, as its text or its attribute value."""
    child = element.find(tag)
    assert child is not None
    key = "value" if "value" in child.attrib else ""
    return float(floats(child, key, f"<{tag}> of {owner}", 1)[0])


def _agreed(stated: dict[str, float], owner: str) -> float:
    """Return the number that all sources state.  Raises ModelError if they differ."""
    first, *further = stated.values()
    if any(abs(value - first) > _SAME * max(abs(value), abs(first)) for value in further):
        words = " and ".join(f"{key} = {value:g}" for key, value in stated.items())
        raise ModelError(f"{owner} has {words} for one quantity; state it once")
    return first


def reduced_text(robot: Element, *, shapes: bool = False) -> str:
    """Return a URDF text with only the elements that affect the motion, after `check_urdf`.

    Args:
        robot: Element <robot>, after `prepare`.
        shapes: Whether to include the visual shapes.
    """
    copied = Element("robot", {"name": robot.get("name", "robot")})
    if version_of(robot):
        copied.set("version", "1.1")  # 1.2 differs by demands on limits, which are checked here
    if shapes:
        copied.extend(robot.findall("material"))
    for link in robot.findall("link"):
        target = SubElement(copied, "link", {"name": link.get("name", "")})
        if (inertial := link.find("inertial")) is not None:
            _copy(inertial, SubElement(target, "inertial"), ("origin", "mass", "inertia"))
        if shapes:
            target.extend(link.findall("visual"))
    for joint in robot.findall("joint"):
        joint_type = joint.get("type", "")
        target = SubElement(copied, "joint", {"name": joint.get("name", "")})
        target.set("type", "floating" if joint_type in _REPLACED else joint_type)
        _copy(joint, target, _JOINT)
        _copy_limit(robot, joint, target)
        dynamics = joint.find("dynamics")
        if dynamics is not None and joint_type not in _MANY:
            losses = {"damping": "0", "friction": "0"}  # The parser demands one of them.
            stated = {k: v for k, v in _trimmed(dynamics).items() if k in losses}
            SubElement(target, "dynamics", losses | stated)
    return ElementTree.tostring(copied, encoding="unicode")


def _copy(source: Element, target: Element, tags: tuple[str, ...]) -> None:
    for tag in tags:
        if (child := source.find(tag)) is not None:
            SubElement(target, tag, _trimmed(child))


def _copy_limit(robot: Element, joint: Element, target: Element) -> None:
    """Add the limits of a joint; numbers that state no limit become zero or `UNLIMITED`."""
    limit, joint_type = joint.find("limit"), joint.get("type")
    limits = {"effort": "0", "velocity": "0"}
    if limit is None:
        if joint_type in _NEEDS_LIMITS:
            limits |= {"lower": f"-{UNLIMITED}", "upper": f"{UNLIMITED}"}
            SubElement(target, "limit", limits)
        return
    owner = f"the limit of joint {quoted(joint.get('name', '?'))}"
    for key, sign in (("lower", "-"), ("upper", "")):
        if key in limit.attrib:
            value = _any_float(limit, key, owner)
            limits[key] = limit.get(key, "").strip() if np.isfinite(value) else f"{sign}{UNLIMITED}"
        elif version_of(robot) == 2 and joint_type in _NEEDS_LIMITS:
            raise ModelError(
                f"{owner}{place(limit)} lacks the attribute {key}, which URDF 1.2 demands; add it"
            )
    for key in ("velocity", "effort"):
        if key in limit.attrib:
            limits[key] = _rate_limit(limit, key, owner)
    SubElement(target, "limit", limits)


def _rate_limit(limit: Element, key: str, owner: str) -> str:
    """Return the text of a velocity or effort limit; "0" for one that states no limit.

    Zero, negative, infinite and NaN limits state none.
    """
    value = _any_float(limit, key, owner)
    return limit.get(key, "").strip() if 0.0 < value < np.inf else "0"


def _any_float(element: Element, key: str, owner: str) -> float:
    """Return the number in an attribute, which may be infinite or NaN.  Raises ModelError."""
    text = element.get(key, "").strip()
    if text.lower().lstrip("+-") in ("inf", "infinity", "nan"):
        return float(text)
    return float(floats(element, key, owner, 1)[0])


def _trimmed(element: Element) -> dict[str, str]:
    """Return the attributes with whitespace stripped from their values."""
    names = ("link", "joint")
    return {k: v if k in names else v.strip() for k, v in element.attrib.items()}


def _check_origin(robot: Element, origin: Element | None, owner: str) -> None:
    """Reject an origin whose numbers or attitude URDF does not define."""
    if origin is None:
        return
    for key in ("xyz", "rpy"):
        if key in origin.attrib:
            floats(origin, key, f"the origin of {owner}", 3)
    if "quat_xyzw" not in origin.attrib:
        return
    owner = f"an origin of {owner}"
    if not version_of(robot):
        if "rpy" in origin.attrib:
            del origin.attrib["quat_xyzw"]  # URDF 1.0 reads rpy; `left_out_words` reports the rest.
            return
        raise ModelError(
            f"{owner}{place(origin)} has quat_xyzw, which URDF has from version 1.1 on, but the "
            f"version of the file is {quoted(robot.get('version', '1.0'))}; set "
            '<robot version="1.1">, or state rpy'
        )
    if "rpy" in origin.attrib:
        raise ModelError(f"{owner}{place(origin)} has both rpy and quat_xyzw; keep one of them")
    if not floats(origin, "quat_xyzw", owner, 4).any():
        raise ModelError(f"{owner}{place(origin)} has a quaternion of zeros; state an attitude")


def _check_axis(joint: Element) -> None:
    name, axis = f"joint {quoted(joint.get('name', '?'))}", joint.find("axis")
    if joint.get("type") in ("floating", "spherical", "universal"):
        return
    if axis is None:
        if joint.get("type") == "planar":
            raise ModelError(f"planar {name}{place(joint)} has no <axis>; add <axis xyz='0 0 1'/>")
        return
    if not floats(axis, "xyz", f"the axis of {name}", 3).any():
        raise ModelError(f"the axis of {name}{place(axis)} is zero; state a direction")


def _check_friction(joint: Element) -> None:
    dynamics, owner = joint.find("dynamics"), f"joint {quoted(joint.get('name', '?'))}"
    if dynamics is None or "friction" not in dynamics.attrib:
        return
    values = dynamics.get("friction", "").split()
    most = floats(dynamics, "friction", f"the dynamics of {owner}", max(1, len(values)))
    if (most < 0.0).any():
        raise ModelError(
            f"{owner}{place(dynamics)} has negative friction {most.min():g}; it must be zero or "
            "positive"
        )


def _check_inertial(inertial: Element, owner: str) -> None:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None:
        missing = "mass" if mass is None else "inertia"
        raise ModelError(
            f"{owner} has an inertial element{place(inertial)} without <{missing}>; add it"
        )
    if len(masses := inertial.findall("mass")) > 1:
        raise ModelError(
            f"{owner} has {len(masses)} elements <mass>{place(masses[1])}; keep only one of them"
        )
    (value,) = floats(mass, "value", f"the mass of {owner}", 1)
    if value < 0:
        raise ModelError(
            f"{owner}{place(mass)} has negative mass {value:g}; it must be zero or positive"
        )
    for key in _MOMENTS:
        floats(inertia, key, f"the inertia of {owner}", 1)


def floats(element: Element, key: str, owner: str, size: int) -> Array:
    """Return the numbers in an attribute, read as strictly as Pinocchio's parsers do.

    Args:
        element: Element.
        key: Name of the attribute; "" for the text of the element.
        owner: Owner of the attribute, for the message.
        size: Expected number of numbers.
    Raises:
        ModelError: The attribute does not consist of `size` finite numbers.
    """
    text = element.get(key, "") if key else element.text or ""
    words = _BLANKS.split(text.strip(" \t\r\n"))  # unlike str.split, only at blanks of XML
    values = np.array([float(w) for w in words if _NUMBER.fullmatch(w)])
    if len(values) != len(words) or len(values) != size or not np.isfinite(values).all():
        raise ModelError(
            f"{owner}{place(element)}: '{key or element.tag}' must be {size} finite number(s), "
            f"got {quoted(text)}"
        )
    return values
