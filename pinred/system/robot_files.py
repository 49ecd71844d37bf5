"""Robot description files: detection of their format, and URDF models without meshes.

Pinocchio ignores, or replaces by defaults, entries that change the dynamics: mimic joints, links
on two joints, axes of length zero, incomplete inertias.  This module reads these entries from the
file, and uses or refuses them.
"""

from __future__ import annotations

import re
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
import pinocchio as pin

from ..common.errors import LoadError, ModelError
from ..common.files import is_file, is_folder
from ..common.library_output import library_output
from ..common.names import plain_path, quoted_path
from .robot_file_contents import Coupling
from .urdf_elements import (
    UNLIMITED,
    check_urdf,
    keep_dynamics,
    mimic_couplings,
    reduced_text,
    total_mass,
    tree_depth,
)

# Message of the URDF parser: one line with the error, and one with a position in its C++ source.
URDFDOM = re.compile(
    rb"^(?:Error|Warning|Info|Debug):[^\n]*\n +at line \d+ in [^\n]*\n?", re.MULTILINE
)
_MOST_BYTES = 256_000_000  # largest accepted size of a file [byte]
# Above this depth of links, the parser runs in a thread with this stack size per link [byte].
_DEEP, _STACK = 500, 65536
_DEEPEST = 100  # largest depth of nested URDF elements; valid files need only a few
_MOST_ELEMENTS = 1_000_000
_MOST_LINKS = 20_000  # largest accepted number of links, because the parser recurses once per link
_CHUNK = 4096  # number of characters per call of the XML parser
_ELEMENT = re.compile(r"<[^!?]")


def read_description(path: Path) -> tuple[pin.Model, tuple[Coupling, ...]]:
    """Return the model in a URDF file, with the root joint of the file, and its joint couplings.

    Raises:
        LoadError: The file cannot be read.
        ModelError: pinred cannot reduce the robot.
    """
    root = read_xml(path)
    refuse_macros(path, root)
    if root.tag != "robot":
        raise LoadError(
            f"{plain_path(path)} is neither URDF (<robot>) nor MJCF (<mujoco>), but <{root.tag}>"
        )
    if (links := len(root.findall("link"))) > _MOST_LINKS:
        raise LoadError(f"{plain_path(path)} has {links} links, more than {_MOST_LINKS}")
    check_urdf(root)
    depth = tree_depth(root)
    couplings = mimic_couplings(root)
    model, why = None, ""
    with library_output(URDFDOM) as messages:
        try:
            model = _parse(reduced_text(root), depth)
        except Exception as error:  # Pinocchio raises parser errors of any type.
            why = str(error).strip() or type(error).__name__
    if model is None:
        reason = messages[0].splitlines()[0] if messages else why.splitlines()[-1]
        raise LoadError(
            f"Pinocchio cannot read {plain_path(path)}: {reason.removeprefix('Error:').strip()}"
        )
    _check_mass(path, model, total_mass(root))
    keep_dynamics(root, model)
    for limits in (model.lowerPositionLimit, model.upperPositionLimit):
        limits[np.abs(limits) >= UNLIMITED] *= np.inf
    return model, couplings


def _parse(text: str, depth: int) -> pin.Model:
    """Return Pinocchio's model of a URDF text whose chains have at most `depth` links."""
    if depth < _DEEP:
        return pin.buildModelFromXML(text)
    # The parser recurses once per link and would overflow the default stack.
    before = threading.stack_size(_STACK * depth)
    try:
        with ThreadPoolExecutor(1) as one:
            return one.submit(pin.buildModelFromXML, text).result()
    finally:
        threading.stack_size(before)


def _check_mass(path: Path, model: pin.Model, file_mass: float) -> None:
    """Refuse a model from which Pinocchio dropped the inertia of a link."""
    model_mass = sum(inertia.mass for inertia in model.inertias)
    if abs(model_mass - file_mass) > 1e-9 * max(model_mass, file_mass):
        raise ModelError(
            f"{plain_path(path)} has links of {file_mass:g} kg in total, but Pinocchio reads "
            f"{model_mass:g} kg; check the inertial elements"
        )


def read_text(path: Path) -> str:
    """Return the text of an XML file.  Raises LoadError."""
    if not is_file(path):
        what = "is a folder" if is_folder(path) else "no such file"
        raise LoadError(f"{what}: {plain_path(path)}")
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise LoadError(
            f"the name {quoted_path(path)} has bytes that are not UTF-8, which neither Pinocchio "
            "nor MuJoCo opens; rename the file or its folder"
        ) from None
    try:
        # The operating system's virtual files, which may be endless, also report size zero.
        if path.stat().st_size == 0:
            raise LoadError(f"{plain_path(path)} is empty, so not XML")
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
        if len(content) > _MOST_BYTES:
            raise LoadError(f"{plain_path(path)} is larger than {_MOST_BYTES // 10**6} MB")
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise LoadError(f"{plain_path(path)} is not XML in UTF-8") from None
    except OSError as error:
        raise LoadError(f"{plain_path(path)} cannot be read: {error.strerror}") from None
    if "<!DOCTYPE" in text:
        raise LoadError(f"{plain_path(path)} declares a document type; entities are not supported")
    return text


def is_mjcf(text: str) -> bool:
    """Return whether the outermost XML element of a text is that of an MJCF file."""
    tags: list[str] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda tag, _: tags.append(tag) if not tags else None
    text = _without_declaration(text)
    with suppress(expat.ExpatError, ValueError):
        for start in range(0, len(text), _CHUNK):
            parser.Parse(text[start : start + _CHUNK])
            if tags:
                break
    return bool(tags) and tags[0].lower() == "mujoco"


def read_xml(path: Path) -> ElementTree.Element:
    """Return the root element of an XML file.

    Element names keep their namespace prefixes, whether or not the file declares them.

    Raises:
        LoadError: The file cannot be read, is too large, or is not XML.
    """
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    count = depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count, depth
        count, depth = count + 1, depth + 1
        if count > _MOST_ELEMENTS or depth > _DEEPEST:
            deep = depth > _DEEPEST
            what = f"{_DEEPEST} nested elements" if deep else f"{count - 1} elements"
            where = f"{plain_path(path)}, line {parser.CurrentLineNumber}"
            raise LoadError(f"{where}: more than {what}")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(_without_declaration(read_text(path)), True)
        return builder.close()
    except (expat.ExpatError, ValueError) as error:
        raise LoadError(f"{plain_path(path)} is not XML: {error}") from None


def refuse_macros(path: Path, root: ElementTree.Element) -> None:
    """Refuse a template that xacro must expand.  Raises LoadError with the command to run."""
    used = next((e.tag for e in root.iter() if e.tag.startswith("xacro:")), "")
    if used or any(mark in reduced_text(root) for mark in ("${", "$(")):
        name = path.name.partition(".")[0] + ("" if path.suffix == ".xacro" else "_expanded")
        shown = plain_path(path)
        raise LoadError(
            f"{shown} is a template with macros{f' (<{used}>)' if used else ''}; expand it with "
            f"`xacro {shown} > {plain_path(Path(name))}.urdf`, and load the result"
        )


def _without_declaration(text: str) -> str:
    """Return an XML text without its XML declaration.

    An XML declaration is an error unless it starts the file, and it is not needed here.
    """
    head, mark, tail = text.partition("<?xml")
    if mark and not _ELEMENT.search(head):
        text = head + tail.partition("?>")[2]
    return text.lstrip()
