"""Robot description files: what kind they are; URDF is read through Pinocchio without its meshes.

Pinocchio passes over much that changes the dynamics, or fills it in: mimic joints, links on
two joints, axes of length zero, inertias with a part missing.  Here these are looked up in
the file itself, so that they are honoured or refused, never dropped.
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
from ..common.library_output import library_output
from ..common.paths import is_file, is_folder
from ..common.plain_names import plain_path, quoted_path
from .contents import Coupling
from .model_passive import keep_dynamics
from .urdf import check_urdf, deepest, mimic_couplings, total_mass
from .urdf_text import UNLIMITED, tidied

# Two lines: what is wrong, and where in its own source the parser says so.
URDFDOM = re.compile(
    rb"^(?:Error|Warning|Info|Debug):[^\n]*\n +at line \d+ in [^\n]*\n?", re.MULTILINE
)
_MOST_BYTES = 256_000_000  # of a file that is read whole
_DEEP, _STACK = 500, 65536  # links behind one another, and bytes of stack for each
_DEEPEST = 100  # elements of a URDF within one another; the format has a few
_MOST_ELEMENTS = 1_000_000
_MOST_LINKS = 20_000  # that a parser sees; it calls itself for each behind another
_FEW = 4096  # letters that are looked at at once
_ELEMENT = re.compile(r"<[^!?]")


def read_description(path: Path) -> tuple[pin.Model, tuple[Coupling, ...]]:
    """Return the model in a URDF file, on its own root, and how joints follow others.

    Raises LoadError if the file cannot be read, ModelError if its robot cannot be reduced.
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
    couplings = mimic_couplings(root)
    model, why = None, ""
    with library_output(URDFDOM) as said:
        try:
            model = _built(tidied(root), depth=deepest(root))
        except Exception as error:  # Pinocchio raises what its parsers raise, of any type
            why = str(error).strip() or type(error).__name__
    if model is None:
        reason = said[0].splitlines()[0] if said else why.splitlines()[-1]
        raise LoadError(
            f"Pinocchio cannot read {plain_path(path)}: {reason.removeprefix('Error:').strip()}"
        )
    _check_mass(path, model, total_mass(root))
    keep_dynamics(root, model)
    for limits in (model.lowerPositionLimit, model.upperPositionLimit):
        limits[np.abs(limits) >= UNLIMITED] *= np.inf
    return model, couplings


def _built(text: str, *, depth: int) -> pin.Model:
    """Return Pinocchio's model of a URDF.  depth: of links behind one another."""
    if depth < _DEEP:
        return pin.buildModelFromXML(text)
    # The parser calls itself for every link, and would run out of the usual stack.
    before = threading.stack_size(_STACK * depth)
    try:
        with ThreadPoolExecutor(1) as one:
            return one.submit(pin.buildModelFromXML, text).result()
    finally:
        threading.stack_size(before)


def _check_mass(path: Path, model: pin.Model, written: float) -> None:
    """Refuse a model that has lost a link's inertia on the way."""
    read = sum(inertia.mass for inertia in model.inertias)
    if abs(read - written) > 1e-9 * max(read, written):
        raise ModelError(
            f"{plain_path(path)} gives its links {written:g} kg in all, but Pinocchio reads "
            f"{read:g} kg; check the inertial elements"
        )


def read_text(path: Path) -> str:
    """Return what stands in a file of XML.  Raises LoadError."""
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
        if path.stat().st_size == 0:  # as what the system makes up is, which may never end
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
    """Return whether the outermost element of a text is MJCF's."""
    found: list[str] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda tag, _: found.append(tag) if not found else None
    text = _without_declaration(text)
    with suppress(expat.ExpatError, ValueError):
        for start in range(0, len(text), _FEW):
            parser.Parse(text[start : start + _FEW])
            if found:
                break
    return bool(found) and found[0].lower() == "mujoco"


def read_xml(path: Path) -> ElementTree.Element:
    """Return the root element of an XML file.  Raises LoadError.

    Prefixes of names are part of them, whether the file declares them or not.
    """
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    count = depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count, depth
        count, depth = count + 1, depth + 1
        if count > _MOST_ELEMENTS or depth > _DEEPEST:
            deep = depth > _DEEPEST
            what = f"{_DEEPEST} elements within one another" if deep else f"{count - 1} elements"
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
    """Raise LoadError, saying what to run, for a template that xacro has to expand."""
    used = next((e.tag for e in root.iter() if e.tag.startswith("xacro:")), "")
    if used or any(mark in tidied(root) for mark in ("${", "$(")):
        name = path.name.partition(".")[0] + ("" if path.suffix == ".xacro" else "_expanded")
        shown = plain_path(path)
        raise LoadError(
            f"{shown} is a template with macros{f' (<{used}>)' if used else ''}; expand it with "
            f"`xacro {shown} > {plain_path(Path(name))}.urdf`, and load what comes out"
        )


def _without_declaration(text: str) -> str:
    """Return a text that begins with its first element or comment.

    The declaration of XML must stand at the very beginning; here it says nothing new.
    """
    head, found, rest = text.partition("<?xml")
    if found and not _ELEMENT.search(head):
        text = head + rest.partition("?>")[2]
    return text.lstrip()
