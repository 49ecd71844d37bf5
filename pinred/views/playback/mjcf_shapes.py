"""Shapes of an MJCF file, compiled by MuJoCo, on the joints of a system."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ...system.mjcf.compile import compiled
from ...system.mjcf.mujoco_joints import frame
from ...system.mjcf.world import World, robot_in
from ...system.system import System
from .solids import Bodies, Colour, Mesh, Solid

# MuJoCo's mjtGeom → kind and number of sizes. Planes and height fields are not drawn.
_SHAPES = {
    2: ("sphere", 1),
    3: ("capsule", 2),
    4: ("ellipsoid", 3),
    5: ("cylinder", 2),
    6: ("box", 3),
}
_MESHES = (7, 8)  # mesh, and signed distance function, which includes a mesh
_VISIBLE_GROUPS = 3  # MuJoCo's viewer shows groups below; others usually have collision shapes
_NO_COLOUR = (0.5, 0.5, 0.5, 1.0)  # default colour, replaced by that of the material


def mjcf_shapes(system: System, path: Path) -> Bodies:
    """Return the shapes of the robot in an MJCF file.

    Raises LoadError if MuJoCo cannot read it or one of its meshes.
    """
    model = compiled(path, shapes=True)
    world = robot_in(model, None if system.origin is None else system.origin.root)
    bodies = set(world.bodies)
    geoms = [k for k in range(model.ngeom) if int(model.geom_bodyid[k]) in bodies]
    visible = [k for k in geoms if model.geom_group[k] < _VISIBLE_GROUPS] or geoms
    meshes: dict[int, int] = {}
    solids = [solid for k in visible if (solid := _solid(system, world, k, meshes)) is not None]
    return Bodies(tuple(solids), tuple(_mesh(model, k) for k in meshes), "")


def _solid(system: System, world: World, geom: int, meshes: dict[int, int]) -> Solid | None:
    """Convert a geom; None if it is not drawn.  meshes: mesh id → index, extended on use."""
    model, kind = world.model, int(world.model.geom_type[geom])
    size: tuple[float, ...]
    if kind in _MESHES:
        name, size = "mesh", (float(meshes.setdefault(int(model.geom_dataid[geom]), len(meshes))),)
    elif kind in _SHAPES:
        name, count = _SHAPES[kind]
        size = tuple(map(float, model.geom_size[geom, :count]))
    else:
        return None
    colour = _colour(model, geom)
    if colour[3] == 0.0:
        return None
    body = world.body_names[int(model.geom_bodyid[geom])]
    link = system.model.frames[system.model.getFrameId(body, pin.FrameType.BODY)]
    placement = link.placement * frame(model.geom_pos[geom], model.geom_quat[geom])
    return Solid(link.parentJoint, name, size, np.array(pin.SE3ToXYZQUAT(placement)), colour)


def _colour(model: Any, geom: int) -> Colour:
    material = int(model.geom_matid[geom])
    colour = tuple(map(float, model.geom_rgba[geom]))
    rgba = model.mat_rgba[material] if material >= 0 and colour == _NO_COLOUR else colour
    red, green, blue, opacity = map(float, rgba)
    return red, green, blue, opacity


def _mesh(model: Any, mesh: int) -> Mesh:
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return Mesh(
        np.array(model.mesh_vert[first : first + count], dtype=np.float32),
        np.array(model.mesh_face[face : face + faces], dtype=np.uint32),
    )
