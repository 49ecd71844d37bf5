"""Shapes for playback that were passed to `load` with a model, and folders with meshes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pinocchio as pin

from ..common.arrays import entries_of
from ..common.errors import InputError
from ..common.files import is_folder
from ..common.names import brief, quoted_path


@dataclass(frozen=True, eq=False)
class Visuals:
    """Shapes for playback; treat both attributes as read-only.

    Attributes:
        model: Model whose joints and frames carry the shapes.
        geometry: Geometry model that contains the shapes.
    """

    model: pin.Model
    geometry: pin.GeometryModel


def with_visuals(source: object) -> Visuals | None:
    """Copy the model and shapes of a pin.RobotWrapper or of a pair (model, visual_model).

    Returns:
        The copies, or None for other sources.
    Raises:
        InputError: The pair is not valid, or its shapes belong to another model.
    """
    if isinstance(source, pin.RobotWrapper):
        pair: Any = (source.model, source.visual_model)
    elif isinstance(source, tuple):
        pair = source
    else:
        return None
    if len(pair) != 2 or not isinstance(pair[0], pin.Model):
        raise InputError(
            "load takes a pair (model, visual_model) of a pin.Model and a pin.GeometryModel, got "
            f"({', '.join(type(entry).__name__ for entry in pair)})"
        )
    model, geometry = pair
    if geometry is None:  # A RobotWrapper may lack shapes.
        geometry = pin.GeometryModel()
    if not isinstance(geometry, pin.GeometryModel):
        raise InputError(f"visual_model must be a pin.GeometryModel, got {type(geometry).__name__}")
    for entry in geometry.geometryObjects:
        if entry.parentJoint >= model.njoints:
            raise InputError(
                f"visual_model: shape '{entry.name}' is attached to joint {entry.parentJoint}, "
                f"which model '{model.name}' does not have"
            )
    return Visuals(model.copy(), geometry.copy())


def mesh_folders(meshes: Any) -> tuple[str, ...]:
    """Return the absolute paths of one or several folders with meshes.

    Raises:
        InputError: `meshes` is not valid, or a folder does not exist.
    """
    entries = entries_of((meshes,) if isinstance(meshes, (str, Path)) else meshes)
    if entries is None or not all(isinstance(entry, (str, Path)) for entry in entries):
        raise InputError(f"meshes must be a folder or a list of folders, got {brief(meshes)}")
    folders = [Path(folder) for folder in entries]
    for folder in folders:
        if not is_folder(folder):
            raise InputError(f"meshes: there is no folder {quoted_path(folder)}")
    return tuple(str(folder.absolute()) for folder in folders)
