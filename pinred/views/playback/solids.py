"""Drawn parts of a robot: shapes on its joints, and the meshes that they use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array

Colour: TypeAlias = tuple[float, float, float, float]  # red, green, blue, opacity


@dataclass(frozen=True)
class Mesh:
    """Triangles.  vertices: (V, 3) [m].  faces: (T, 3) of indices."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


@dataclass(frozen=True)
class Solid:
    """One shape on a joint (0 is the world).

    kind and size [m]: box (three half sides), sphere (radius), cylinder, capsule or cone
    (radius, half length, along z), ellipsoid (three semi-axes), mesh (index of a Mesh).
    placement: (7,) on the joint, position and quaternion.  colour: red, green, blue, opacity.
    """

    joint: int
    kind: str
    size: tuple[float, ...]
    placement: Array
    colour: Colour


@dataclass(frozen=True)
class Bodies:
    """All shapes, the meshes that they use, and a word on where they come from."""

    solids: tuple[Solid, ...]
    meshes: tuple[Mesh, ...]
    note: str
