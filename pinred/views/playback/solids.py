"""Drawn shapes on the joints of a robot, and their meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array

Colour: TypeAlias = tuple[float, float, float, float]  # red, green, blue, opacity


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: Positions, (V, 3) [m].
        faces: Indices of vertices, (T, 3).
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


@dataclass(frozen=True)
class Solid:
    """One shape on a joint.

    Attributes:
        joint: Index of the joint; 0 is the world.
        kind: Box, sphere, cylinder, capsule, cone (along z), ellipsoid or mesh.
        size: Box: three half sides; sphere: radius; cylinder, capsule and cone: radius and half
            length; ellipsoid: three semi-axes [m]; mesh: index of a Mesh.
        placement: Position [m] and quaternion in the joint's frame, (7,).
        colour: Red, green, blue, opacity.
    """

    joint: int
    kind: str
    size: tuple[float, ...]
    placement: Array
    colour: Colour


@dataclass(frozen=True)
class Bodies:
    """All shapes of a robot.

    Attributes:
        solids: The shapes.
        meshes: Their meshes.
        note: Remark for the user on the origin of the shapes; may be empty.
    """

    solids: tuple[Solid, ...]
    meshes: tuple[Mesh, ...]
    note: str
