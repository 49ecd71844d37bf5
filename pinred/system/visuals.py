"""Shapes to draw that come with a model, and the folders in which meshes are looked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pinocchio as pin

from ..common.arrays import entries_of
from ..common.errors import InputError
from ..common.paths import is_folder
from ..common.plain_names import brief, quoted_path


@dataclass(frozen=True, eq=False)
class Visuals:
    """Shapes, and the model on whose joints and frames they sit: neither is changed."""

    model: pin.Model
    geometry: pin.GeometryModel


def with_visuals(source: object) -> Visuals | None:
    """Return model and shapes of a pin.RobotWrapper or a pair (model, visual_model).

    None for sources of another kind; copies otherwise.  Raises InputError for shapes that are
    not on this model.
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
    if geometry is None:  # a RobotWrapper without shapes
        geometry = pin.GeometryModel()
    if not isinstance(geometry, pin.GeometryModel):
        raise InputError(f"visual_model must be a pin.GeometryModel, got {type(geometry).__name__}")
    for entry in geometry.geometryObjects:
        if entry.parentJoint >= model.njoints:
            raise InputError(
                f"visual_model: shape '{entry.name}' sits on joint {entry.parentJoint}, which "
                f"model '{model.name}' does not have"
            )
    return Visuals(model.copy(), geometry.copy())


def mesh_folders(meshes: Any) -> tuple[str, ...]:
    """Return folders in which meshes are looked for, as absolute paths.

    meshes: a folder or several.  Raises InputError if one of them is not there.
    """
    given = (meshes,) if isinstance(meshes, (str, Path)) else meshes
    entries = entries_of(given)
    if entries is None or not all(isinstance(entry, (str, Path)) for entry in entries):
        raise InputError(f"meshes must be a folder or a list of folders, got {brief(meshes)}")
    folders = [Path(folder) for folder in entries]
    for folder in folders:
        if not is_folder(folder):
            raise InputError(f"meshes: there is no folder {quoted_path(folder)}")
    return tuple(str(folder.absolute()) for folder in folders)
