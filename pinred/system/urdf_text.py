"""A URDF as its parsers want it: only what moves or weighs, with nothing missing that has no say.

Pinocchio's parser refuses files over things that do not change a motion: limits without effort
or velocity, which pinred does not use, or none at all.  Shapes are left out, and with them all
that could be wrong about meshes, paths and materials.
"""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

UNLIMITED = 1.7e308  # the parser knows no infinity
_NEEDS_LIMITS = ("revolute", "prismatic")
_INERTIAL = ("origin", "mass", "inertia")
_JOINT = ("origin", "parent", "child", "axis", "mimic", "dynamics")


def tidied(robot: Element) -> str:
    """Return the text of a URDF with what matters of a <robot>, after `check_urdf`."""
    out = Element("robot", {"name": robot.get("name", "robot")})
    for link in robot.findall("link"):
        kept = SubElement(out, "link", link.attrib)
        if (inertial := link.find("inertial")) is not None:
            _copy(inertial, SubElement(kept, "inertial"), _INERTIAL)
    for joint in robot.findall("joint"):
        kept = SubElement(out, "joint", joint.attrib)
        _copy(joint, kept, _JOINT)
        limit = joint.find("limit")
        if limit is not None:
            SubElement(kept, "limit", {"effort": "0", "velocity": "0"} | _trimmed(limit))
        elif joint.get("type") in _NEEDS_LIMITS:
            ends = {"lower": f"-{UNLIMITED}", "upper": f"{UNLIMITED}"}
            SubElement(kept, "limit", {"effort": "0", "velocity": "0"} | ends)
    return ElementTree.tostring(out, encoding="unicode")


def _copy(source: Element, to: Element, tags: tuple[str, ...]) -> None:
    for tag in tags:
        if (found := source.find(tag)) is not None:
            SubElement(to, tag, _trimmed(found))


def _trimmed(element: Element) -> dict[str, str]:
    """Return the attributes without blanks around their values, of which names may have none."""
    names = ("link", "joint")
    return {k: v if k in names else v.strip() for k, v in element.attrib.items()}
