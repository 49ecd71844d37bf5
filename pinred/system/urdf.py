"""The parts of a URDF that Pinocchio's reader drops or fills in."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from ..common.errors import ModelError
from ..common.plain_names import quoted
from .contents import Coupling
from .xml_numbers import axis, floats

_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def check_urdf(robot: Element) -> None:
    """Refuse a file that cannot be reduced.  Raises ModelError that names the joint or link."""
    for joint in moving_joints(robot):
        _check_axis(joint)
    for link in robot.findall("link"):
        who, found = f"link {quoted(link.get('name', '?'))}", link.findall("inertial")
        if len(found) > 1:
            raise ModelError(f"{who} has {len(found)} inertial elements; keep the one that counts")
        for inertial in found:
            _check_inertial(inertial, who)
    _check_tree(robot)


def total_mass(robot: Element) -> float:
    """Return the mass of all links [kg], after `check_urdf`."""
    return sum(float(mass.get("value", "0")) for mass in robot.iterfind("link/inertial/mass"))


def deepest(robot: Element) -> int:
    """Return how many links are behind one another, after `check_urdf`."""
    depth: dict[str, int] = {}
    parent_of = _parents(robot)
    for link in parent_of:
        way = [link]
        while way[-1] in parent_of and way[-1] not in depth:
            way.append(parent_of[way[-1]])
        first = depth.setdefault(way[-1], 0)
        for k, passed in enumerate(reversed(way[:-1]), start=1):
            depth[passed] = first + k
    return max(depth.values(), default=0)


def moving_joints(robot: Element) -> list[Element]:
    """Return the joints that are not fixed."""
    return [joint for joint in robot.findall("joint") if joint.get("type") != "fixed"]


def mimic_couplings(robot: Element) -> tuple[Coupling, ...]:
    """Return how moving joints follow others (<mimic>).  Raises ModelError for what is no number.

    Of a joint that is fixed, a <mimic> means nothing.
    """
    found = []
    for joint in moving_joints(robot):
        mimic, name = joint.find("mimic"), joint.get("name", "?")
        if mimic is None:
            continue
        leader = mimic.get("joint")
        if leader is None:
            raise ModelError(f"the <mimic> of joint '{name}' names no joint; give it joint=")
        ratio, offset = (
            float(floats(mimic, key, f"the <mimic> of joint '{name}'", 1)[0])
            if key in mimic.attrib
            else usual
            for key, usual in (("multiplier", 1.0), ("offset", 0.0))
        )
        found.append(Coupling(name, leader, ratio, offset))
    return tuple(found)


def _check_axis(joint: Element) -> None:
    name, found = f"joint {quoted(joint.get('name', '?'))}", joint.find("axis")
    if joint.get("type") == "floating":
        return
    if found is None:
        if joint.get("type") == "planar":
            raise ModelError(f"planar {name} has no <axis>; give it the normal 0 0 1")
        return
    axis(found, "xyz", name)
    x, y, z = floats(found, "xyz", name, 3)
    if joint.get("type") == "planar" and (x or y or z <= 0):
        raise ModelError(
            f"planar {name} has the plane's normal ({x:g}, {y:g}, {z:g}); "
            "Pinocchio takes it along z: turn the joint's origin instead"
        )


def _check_inertial(inertial: Element, who: str) -> None:
    mass, inertia, origin = (inertial.find(tag) for tag in ("mass", "inertia", "origin"))
    if mass is None or inertia is None:
        missing = "mass" if mass is None else "inertia"
        raise ModelError(f"{who} has an inertial element without <{missing}>")
    (value,) = floats(mass, "value", f"the mass of {who}", 1)
    if value < 0:
        raise ModelError(f"{who} has negative mass {value:g}")
    for key in _MOMENTS:
        floats(inertia, key, f"the inertia of {who}", 1)
    for key in ("xyz", "rpy"):
        if origin is not None and key in origin.attrib:
            floats(origin, key, f"the inertial origin of {who}", 3)


def _check_tree(robot: Element) -> None:
    """Refuse links on two joints, and links that no chain of joints ties to the root."""
    parent_of = _parents(robot)
    tied: set[str] = set()  # to a root
    for link in parent_of:
        way, at = {link: None}, link
        while at in parent_of and at not in tied:
            at = parent_of[at]
            if at in way:
                raise ModelError(f"link {quoted(link)} hangs on itself through a cycle of joints")
            way[at] = None
        tied.update(way)


def _parents(robot: Element) -> dict[str, str]:
    """Return the link that carries each link.  Raises ModelError for a link on two joints."""
    parent_of: dict[str, str] = {}
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None:
            continue  # Pinocchio's reader says so
        name = child.get("link", "?")
        if name in parent_of:
            raise ModelError(
                f"closed loops are not supported: link {quoted(name)} is the child of two joints, "
                f"the second {quoted(joint.get('name', '?'))}"
            )
        parent_of[name] = parent.get("link", "?")
    return parent_of
