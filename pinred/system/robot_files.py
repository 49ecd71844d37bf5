"""Robot description files: what kind they are; URDF is read through Pinocchio without its meshes.

Pinocchio passes over much that changes the dynamics, or fills it in: mimic joints, links on
two joints, axes of length zero, inertias with a part missing.  Here these are looked up in
the file itself, so that they are honoured or refused, never dropped.
"""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import pinocchio as pin

from ..common.errors import LoadError, ModelError
from ..common.library_output import library_output
from ..common.plain_names import plain_path, quoted_path
from .contents import Coupling
from .model_passive import keep_dynamics
from .urdf import check_urdf, mimic_couplings, total_mass

# Two lines: what is wrong, and where in its own source the parser says so.
URDFDOM = re.compile(
    rb"^(?:Error|Warning|Info|Debug):[^\n]*\n +at line \d+ in [^\n]*\n?", re.MULTILINE
)
_MOST_BYTES = 256_000_000  # of a file that is read whole
_FEW = 4096  # letters that are looked at at once


def read_description(path: Path) -> tuple[pin.Model, tuple[Coupling, ...]]:
    """Return the model in a URDF file, on its own root, and how joints follow others.

    Raises LoadError if the file cannot be read, ModelError if its robot cannot be reduced.
    """
    root = read_xml(path)
    if root.tag != "robot":
        raise LoadError(
            f"{plain_path(path)} is neither URDF (<robot>) nor MJCF (<mujoco>), but <{root.tag}>"
        )
    check_urdf(root)
    couplings = mimic_couplings(root)
    model, why = None, ""
    with library_output(URDFDOM) as said:
        try:
            model = pin.buildModelFromUrdf(str(path))
        except Exception as error:  # Pinocchio raises what its parsers raise, of any type
            why = str(error).strip() or type(error).__name__
    if model is None:
        reason = said[0].splitlines()[0] if said else why.splitlines()[-1]
        raise LoadError(
            f"Pinocchio cannot read {plain_path(path)}: {reason.removeprefix('Error:').strip()}"
        )
    _check_mass(path, model, total_mass(root))
    keep_dynamics(root, model)
    return model, couplings


def _check_mass(path: Path, model: pin.Model, written: float) -> None:
    """Refuse a model that has lost a link's inertia on the way."""
    read = sum(inertia.mass for inertia in model.inertias)
    if abs(read - written) > 1e-9 * max(read, written):
        raise ModelError(
            f"{plain_path(path)} gives its links {written:g} kg in all, but Pinocchio reads "
            f"{read:g} kg; check the inertial elements"
        )


def is_file(path: Path) -> bool:
    """Return whether there is such a file; what is no name of a file at all is none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def read_text(path: Path) -> str:
    """Return what stands in a file of XML.  Raises LoadError."""
    if not is_file(path):
        what = "is a folder" if path.is_dir() else "no such file"
        raise LoadError(f"{what}: {plain_path(path)}")
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise LoadError(
            f"the name {quoted_path(path)} has bytes that are not UTF-8, which neither Pinocchio "
            "nor MuJoCo opens; rename the file or its folder"
        ) from None
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise LoadError(f"{plain_path(path)} is larger than {_MOST_BYTES // 10**6} MB")
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise LoadError(f"{plain_path(path)} is not XML in UTF-8") from None
    except OSError as error:
        raise LoadError(f"{plain_path(path)} cannot be read: {error.strerror}") from None
    if "<!DOCTYPE" in text:
        raise LoadError(f"{plain_path(path)} declares a document type; entities are not supported")
    return text


def is_mjcf(text: str) -> bool:
    """Return whether the outermost element of a text is MJCF's."""
    found: list[str] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda tag, _: found.append(tag) if not found else None
    with suppress(expat.ExpatError, ValueError):
        for start in range(0, len(text), _FEW):
            parser.Parse(text[start : start + _FEW])
            if found:
                break
    return bool(found) and found[0].lower() == "mujoco"


def read_xml(path: Path) -> ElementTree.Element:
    """Return the root element of an XML file.  Raises LoadError."""
    try:
        return ElementTree.fromstring(read_text(path))
    except (ElementTree.ParseError, ValueError) as error:
        raise LoadError(f"{plain_path(path)} is not XML: {error}") from None
