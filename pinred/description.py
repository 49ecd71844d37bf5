"""Robot description files: URDF and MJCF, read through Pinocchio without their meshes.

Pinocchio passes over much that changes the dynamics, or fills it in: mimic joints,
equality constraints, links on two joints, axes of length zero, inertias with a part
missing, second bodies, gravity and inclusions in MJCF.  These are looked up in the file
itself here, so that they are honoured or refused, never dropped.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from .errors import LoadError
from .mjcf import check_mjcf
from .urdf import check_urdf
from .xml import floats


def read_description(path: Path, lock: Collection[str]) -> pin.Model:
    """Return the model in a URDF or MJCF file, on its own root, with its gravity.

    lock: joints that will be locked, which may therefore be mimic joints.
    Raises LoadError if the file cannot be read, ModelError if it holds what cannot be reduced.
    """
    root = read_xml(path)
    if root.tag == "robot":
        check_urdf(root, lock)
        build = pin.buildModelFromUrdf
    elif root.tag == "mujoco":
        check_mjcf(root)
        build = pin.buildModelFromMJCF
    else:
        raise LoadError(f"{path} is neither URDF (<robot>) nor MJCF (<mujoco>), but <{root.tag}>")
    try:
        model = build(str(path))
    except Exception as error:  # Pinocchio raises what its parsers raise, of any type
        reason = (str(error).strip() or type(error).__name__).splitlines()[-1]
        raise LoadError(f"Pinocchio cannot read {path}: {reason}") from None
    option = root.find("option")
    if root.tag == "mujoco" and option is not None and "gravity" in option.attrib:
        model.gravity.linear = floats(option, "gravity", "the MJCF option", 3)
    return model


def read_xml(path: Path) -> ElementTree.Element:
    """Return the root element of an XML file.  Raises LoadError."""
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "no such file"
        raise LoadError(f"{what}: {path}")
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise LoadError(f"{path} is not XML in UTF-8") from None
    except OSError as error:
        raise LoadError(f"{path} cannot be read: {error.strerror}") from None
    if "<!DOCTYPE" in text:
        raise LoadError(f"{path} declares a document type; entities are not supported")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise LoadError(f"{path} is not XML: {error}") from None
