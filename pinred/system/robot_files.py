"""Robot description files: URDF and MJCF, read through Pinocchio without their meshes.

Pinocchio passes over much that changes the dynamics, or fills it in: mimic joints,
equality constraints, links on two joints, axes of length zero, inertias with a part
missing, second bodies, gravity and inclusions in MJCF.  Here these are looked up in the
file itself, so that they are honoured or refused, never dropped.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from ..common.errors import LoadError, ModelError
from .mjcf import check_mjcf, gravity_of
from .urdf import check_urdf, total_mass


def read_description(path: Path, lock: Collection[str]) -> pin.Model:
    """Return the model in a URDF or MJCF file, on its own root, with its gravity.

    lock: joints that will be locked, which may therefore be mimic joints.
    Raises LoadError if the file cannot be read, ModelError if its robot cannot be reduced.
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
    with _captured_stderr() as said:
        try:
            model = build(str(path))
        except Exception as error:  # Pinocchio raises what its parsers raise, of any type
            said.append(str(error).strip() or type(error).__name__)
            model = None
    if model is None:
        reason = said[0].splitlines()[0] if said[0] else said[-1].splitlines()[-1]
        raise LoadError(f"Pinocchio cannot read {path}: {reason.removeprefix('Error:').strip()}")
    if root.tag == "robot":
        _check_mass(path, model, total_mass(root))
    elif (gravity := gravity_of(root)) is not None:
        model.gravity.linear = gravity
    return model


def _check_mass(path: Path, model: pin.Model, written: float) -> None:
    """Refuse a model that has lost a link's inertia on the way."""
    read = sum(inertia.mass for inertia in model.inertias)
    if abs(read - written) > 1e-9 * max(read, written):
        raise ModelError(
            f"{path} gives its links {written:g} kg in all, but Pinocchio reads {read:g} kg; "
            "check the inertial elements"
        )


@contextmanager
def _captured_stderr() -> Iterator[list[str]]:
    """Collect what a C++ library prints on standard error; it becomes the first entry."""
    said: list[str] = []
    sys.stderr.flush()
    with tempfile.TemporaryFile() as file:
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield said
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            said.insert(0, file.read().decode(errors="replace").strip())


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
