"""read_urdf(): the model and the joint couplings of a URDF file, without meshes.

Pinocchio ignores, or replaces by defaults, entries that change the dynamics: mimic joints, links
on two joints, axes of length zero, incomplete inertias.  `urdf_elements` reads these entries from
the file; they are used or refused.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ..common.errors import LoadError, ModelError
from ..common.library_output import library_output
from ..common.names import plain_path
from .robot_file_contents import Coupling
from .robot_files import read_xml
from .urdf_elements import (
    UNLIMITED,
    check_urdf,
    keep_numbers,
    mimic_couplings,
    reduced_text,
    replace_commas,
    total_mass,
    tree_depth,
)

T = TypeVar("T")

# Message of the URDF parser: one line with the error, and one with a position in its C++ source.
URDFDOM = re.compile(
    rb"^(?:Error|Warning|Info|Debug):[^\n]*\n +at line \d+ in [^\n]*\n?", re.MULTILINE
)
# Above this depth of links, the parser runs in a thread with this stack size per link [byte].
_DEEP, _STACK = 500, 65536
_MOST_LINKS = 20_000  # largest accepted number of links, because the parser recurses once per link


def read_urdf(path: Path) -> tuple[pin.Model, tuple[Coupling, ...], str]:
    """Return the model in a URDF file, its joint couplings, and a warning about its text or "".

    The model has the root joint of the file.

    Raises:
        LoadError: The file cannot be read.
        ModelError: pinred cannot reduce the robot.
    """
    root = read_xml(path)
    _refuse_macros(path, root)
    if root.tag != "robot":
        raise LoadError(
            f"{plain_path(path)} is neither URDF (<robot>) nor MJCF (<mujoco>), but <{root.tag}>"
        )
    if (links := len(root.findall("link"))) > _MOST_LINKS:
        raise LoadError(f"{plain_path(path)} has {links} links, more than {_MOST_LINKS}")
    warning = replace_commas(root)
    check_urdf(root)
    depth = tree_depth(root)
    couplings = mimic_couplings(root)
    model, why = None, ""
    with library_output(URDFDOM) as messages:
        try:
            text = reduced_text(root)
            model = with_deep_stack(lambda: pin.buildModelFromXML(text), depth)
        except Exception as error:  # Pinocchio raises parser errors of any type.
            why = str(error).strip() or type(error).__name__
    if model is None:
        reason = messages[0].splitlines()[0] if messages else why.splitlines()[-1]
        raise LoadError(
            f"Pinocchio cannot read {plain_path(path)}: {reason.removeprefix('Error:').strip()}"
        )
    _check_mass(path, model, total_mass(root))
    keep_numbers(root, model)
    for limits in (model.lowerPositionLimit, model.upperPositionLimit):
        limits[np.abs(limits) >= UNLIMITED] *= np.inf
    return model, couplings, warning


def with_deep_stack(parse: Callable[[], T], depth: int) -> T:
    """Run a parser on a robot whose chains have at most `depth` links; return its result."""
    if depth < _DEEP:
        return parse()
    # The parser recurses once per link and would overflow the default stack.
    before = threading.stack_size(_STACK * depth)
    try:
        with ThreadPoolExecutor(1) as one:
            return one.submit(parse).result()
    finally:
        threading.stack_size(before)


def _check_mass(path: Path, model: pin.Model, file_mass: float) -> None:
    """Reject a model from which Pinocchio dropped the inertia of a link."""
    model_mass = sum(inertia.mass for inertia in model.inertias)
    if abs(model_mass - file_mass) > 1e-9 * max(model_mass, file_mass):
        raise ModelError(
            f"{plain_path(path)} has links of {file_mass:g} kg in total, but Pinocchio reads "
            f"{model_mass:g} kg; check the inertial elements"
        )


def _refuse_macros(path: Path, root: ElementTree.Element) -> None:
    """Reject a template that xacro must expand.  Raises LoadError with the command to run."""
    used = next((e.tag for e in root.iter() if e.tag.startswith("xacro:")), "")
    if used or any(mark in reduced_text(root) for mark in ("${", "$(")):
        name = path.name.partition(".")[0] + ("" if path.suffix == ".xacro" else "_expanded")
        shown = plain_path(path)
        raise LoadError(
            f"{shown} is a template with macros{f' (<{used}>)' if used else ''}; expand it with "
            f"`xacro {shown} > {plain_path(Path(name))}.urdf`, and load the result"
        )
