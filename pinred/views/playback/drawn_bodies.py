"""Shapes for drawing a robot: from its URDF or MJCF file, or ellipsoids of its inertias.

Triangle meshes of shapes are for all viewers but pinred's page, which makes its own.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import LoadError, PinredError
from ...system.assembly import take_apart
from ...system.find_robot_files import (
    bundled_robots,
    example_robot,
    is_mjcf,
    mesh_folders,
    read_text,
    text_in_file,
)
from ...system.mjcf.compile import compiled
from ...system.mjcf.world import World, frame, robot_in
from ...system.robot_file_contents import Derivation, Origin
from ...system.system import System
from ...system.urdf_shapes import FARTHEST, Mesh, Shapes, read_shapes

# Muted colours that colour-blind people can distinguish (after Okabe and Ito).
PALETTE = (
    (0.55, 0.62, 0.70), (0.90, 0.62, 0.20), (0.35, 0.70, 0.85), (0.25, 0.62, 0.48),
    (0.80, 0.55, 0.68), (0.85, 0.80, 0.45), (0.40, 0.48, 0.70),
)  # fmt: skip
_SLENDER = 0.04  # radius of a connecting capsule, relative to the robot's size
_THIN = 1e-3  # smallest semi-axis of an ellipsoid, relative to the robot's size

# MuJoCo's mjtGeom → kind and number of sizes. Planes and height fields are not drawn.
_SHAPES = {
    2: ("sphere", 1),
    3: ("capsule", 2),
    4: ("ellipsoid", 3),
    5: ("cylinder", 2),
    6: ("box", 3),
}
_MESHES = (7, 8)  # mesh, and signed distance function, which includes a mesh
_VISIBLE_GROUPS = (
    3  # MuJoCo's viewer shows groups below this number; higher groups are usually collision shapes
)
_NO_SHAPES = "there are no shapes with the model"
_NO_COLOUR = (0.5, 0.5, 0.5, 1.0)  # default colour, replaced by the colour of the material

Colour: TypeAlias = tuple[float, float, float, float]  # red, green, blue, opacity


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
        link: Name of the link in the file, if it is known.
    """

    joint: int
    kind: str
    size: tuple[float, ...]
    placement: Array
    colour: Colour
    link: str = ""


@dataclass(frozen=True)
class Bodies:
    """All shapes of a robot.

    Attributes:
        solids: The shapes.
        meshes: Their meshes.
        note: Remark for the user about the origin of the shapes, or empty.
    """

    solids: tuple[Solid, ...]
    meshes: tuple[Mesh, ...]
    note: str


def drawn_bodies(
    system: System, *, meshes: bool | str | Path | Sequence[str | Path] = True
) -> Bodies:
    """Return the shapes of a system: from its file, or ellipsoids of its inertias.

    meshes: whether to use the shapes of the file, or folders to search for mesh files.
    """
    if meshes is False:
        return Bodies(_from_inertias(system), (), "bodies drawn from their inertias")
    visuals = system.contents.visuals
    if system.origin is None and visuals is None:
        reason = "the model was given without its file"
    else:
        try:
            folders = () if meshes is True else mesh_folders(meshes)
            bodies = _file_shapes(system, folders)
            if bodies.solids:
                return bodies
            nothing = "its file has no shapes" if visuals is None else _NO_SHAPES
            reason = bodies.note or nothing
        except (PinredError, ValueError, RuntimeError, OSError) as error:
            reason = _message(error)
    return Bodies(_from_inertias(system), (), f"bodies drawn from their inertias: {reason}")


def _message(error: Exception) -> str:
    """Return the message of an error without Pinocchio's C++ source location."""
    text = str(error).rpartition("message:")[2].partition("Hint:")[0]
    return " ".join(text.split()) or type(error).__name__


def extents(bodies: Bodies) -> list[tuple[int, Array, float]]:
    """Return a bounding ball of each shape: joint, centre (3,) in the joint frame, radius [m]."""
    balls = []
    for solid in bodies.solids:
        placement = pin.XYZQUATToSE3(solid.placement)
        centre = np.zeros(3)
        if solid.kind == "mesh":
            vertices = bodies.meshes[int(solid.size[0])].vertices
            centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
            radius = float(np.linalg.norm(vertices - centre, axis=1).max())
        elif solid.kind in ("box", "cylinder", "cone"):
            radius = float(np.linalg.norm(solid.size))
        elif solid.kind == "capsule":
            radius = sum(solid.size)
        else:
            radius = max(solid.size)
        balls.append((solid.joint, np.asarray(placement.act(centre)), radius))
    return balls


@contextmanager
def _file(origin: Origin) -> Iterator[Path]:
    """Yield the path of a robot's file; a text is written to a temporary file."""
    source, robot = origin.source, bundled_robots().get(origin.source)
    if origin.text is not None:
        with text_in_file(origin.text) as path:
            yield path
    elif robot is not None:
        yield robot.path
    else:
        yield Path(source) if Path(source).is_absolute() else example_robot(source).urdf


def _file_shapes(system: System, folders: Sequence[str]) -> Bodies:
    """Return the shapes that were passed with the model, or the shapes in its file."""
    if system.contents.visuals is not None:
        return _from_geometry(system, Shapes(system.contents.visuals, {}, ()))
    origin = system.origin
    assert origin is not None
    if origin.derivation is not None:
        return _shapes_of_parts(system, origin.derivation, folders)
    with _file(origin) as path:
        if is_mjcf(read_text(path)):
            return mjcf_shapes(system, path)
        return _from_geometry(system, read_shapes(path, [*folders, *origin.meshes]))


def _shapes_of_parts(system: System, derivation: Derivation, folders: Sequence[str]) -> Bodies:
    """Return the shapes of the systems from which a system was made, on its own joints."""
    solids, meshes, notes = list[Solid](), list[Mesh](), list[str]()
    drawn = set[int]()  # joints with shapes
    new = take_apart(system)
    prefixes = ("", derivation.arguments.get("prefix", ""))[: len(derivation.systems)]
    for component, prefix in zip(derivation.systems, prefixes, strict=True):
        bodies, old = drawn_bodies(component, meshes=folders or True), take_apart(component)
        link_of_joint = {joint: name for name, (joint, _) in reversed([*old.places.items()])}
        if bodies.note:
            notes.append(f"{component.name}: {bodies.note}")
        for solid in bodies.solids:
            link = solid.link if solid.link in old.places else link_of_joint[solid.joint]
            if prefix + link not in new.places or (bodies.note and not solid.link):
                continue
            joint, at = new.places[prefix + link]
            on_link = old.places[link][1].actInv(pin.XYZQUATToSE3(solid.placement))
            size = solid.size
            if solid.kind == "mesh":
                size = (size[0] + len(meshes),)
            placement = np.array(pin.SE3ToXYZQUAT(at * on_link))
            solids.append(Solid(joint, solid.kind, size, placement, solid.colour, link))
            drawn.add(joint)
        meshes += bodies.meshes
    solids += [solid for solid in _from_inertias(system) if solid.joint not in drawn]
    return Bodies(tuple(solids), tuple(meshes), "; ".join(notes))


def _from_geometry(system: System, shapes: Shapes) -> Bodies:
    """Convert Pinocchio's geometry to shapes on the joints of a system."""
    raw, geometry = shapes.visuals.model, shapes.visuals.geometry
    solids: list[Solid] = []
    meshes: dict[Hashable, int] = {}
    drawn: list[Mesh] = []
    skipped: list[int] = []  # joints of the shapes that cannot be drawn
    # A ball has replaced these hinges, between which bodies are massless.
    between = {name for triple in system.contents.merged for name in triple.hinges[:-1]}
    for entry in geometry.geometryObjects:
        if str(raw.names[entry.parentJoint]) in between:
            continue
        joint, placement = _joint_of(system, raw, entry)
        solid_kind, size = _primitive(entry.geometry)
        if entry.name in shapes.meshes or solid_kind == "mesh":
            key_and_mesh = _mesh_of(entry, shapes.meshes)
            if key_and_mesh is None:
                skipped.append(joint)
                continue
            key, mesh = key_and_mesh
            if meshes.setdefault(key, len(drawn)) == len(drawn):
                drawn.append(mesh())
            solid_kind, size = "mesh", (float(meshes[key]),)
        place = np.array(pin.SE3ToXYZQUAT(placement))
        if not solid_kind or not np.abs([*size, *place]).max() <= FARTHEST:
            skipped.append(joint)
            continue
        colour = tuple(float(c) for c in entry.meshColor)
        link = str(raw.frames[entry.parentFrame].name) if entry.parentFrame < raw.nframes else ""
        solids.append(Solid(joint, solid_kind, size, place, colour, link))  # type: ignore[arg-type]
    # Bodies of which no shape can be drawn are ellipsoids.
    empty = {*skipped} - {solid.joint for solid in solids}
    if solids and empty:
        solids += [solid for solid in _from_inertias(system) if solid.joint in empty]
    return Bodies(tuple(solids), tuple(drawn), _remark(len(skipped), shapes.unreadable))


def _mesh_of(
    entry: Any, meshes: Mapping[str, Mesh | None]
) -> tuple[Hashable, Callable[[], Mesh]] | None:
    """Return a key of a shape's mesh, and a function that returns the mesh; None without mesh."""
    if entry.name not in meshes:
        same = (entry.meshPath, tuple(entry.meshScale)) if entry.meshPath else entry.name
        return same, lambda: _mesh(entry.geometry)
    mesh = meshes[entry.name]
    return None if mesh is None else (id(mesh), lambda: mesh)


def _remark(skipped: int, reasons: Sequence[str]) -> str:
    """Return a remark on shapes that are not drawn, or ""."""
    if not skipped:
        return ""
    first = f": {reasons[0]}" if reasons else ""
    return f"{skipped} of its shapes cannot be drawn{first}"


def _joint_of(system: System, raw: pin.Model, entry: Any) -> tuple[int, pin.SE3]:
    """Return the joint that moves a shape, and the shape's placement on it.

    The link frame identifies the shape's position in the system, whose joints may be locked and
    whose root may differ from the file's.
    """
    if entry.parentFrame >= raw.nframes:  # the shape is attached to a joint without a frame
        return _on_joint(system, raw, entry)
    link = raw.frames[entry.parentFrame]
    on_link = link.placement.inverse() * entry.placement
    frame_type = link.type
    if link.name == "universe" or not system.model.existFrame(link.name, frame_type):
        # Shapes on the file's ground move with a root joint that was added below them.
        floats = not raw.existJointName(system.root_name)
        return (1 if floats else 0), link.placement * on_link
    frame = system.sorted_model.frames[system.model.getFrameId(link.name, frame_type)]
    return frame.parentJoint, frame.placement * on_link


def _on_joint(system: System, raw: pin.Model, entry: Any) -> tuple[int, pin.SE3]:
    name = str(raw.names[entry.parentJoint])
    if entry.parentJoint == 0:
        return int(not raw.existJointName(system.root_name)), entry.placement
    if system.model.existFrame(name, pin.FrameType.JOINT):  # also of a joint that was split
        frame = system.sorted_model.frames[system.model.getFrameId(name, pin.FrameType.JOINT)]
        return frame.parentJoint, frame.placement * entry.placement
    if not system.model.existJointName(name):
        raise LoadError(f"shape '{entry.name}' is attached to joint '{name}', which is locked")
    return system.sorted_model.getJointId(name), entry.placement


def _primitive(shape: Any) -> tuple[str, tuple[float, ...]]:
    """Return the kind and size of a coal shape; the kind is empty if it cannot be drawn."""
    name = type(shape).__name__
    if name == "Box":
        return "box", tuple(map(float, shape.halfSide))
    if name == "Sphere":
        return "sphere", (float(shape.radius),)
    if name in ("Cylinder", "Capsule", "Cone"):
        return name.lower(), (float(shape.radius), float(shape.halfLength))
    if name == "Ellipsoid":
        return "ellipsoid", tuple(map(float, shape.radii))
    return ("mesh", ()) if name.startswith("BVHModel") else ("", ())


def _mesh(shape: Any) -> Mesh:
    faces = np.empty((shape.num_tris, 3), dtype=np.uint32)
    for k in range(shape.num_tris):
        triangle = shape.tri_indices(k)
        faces[k] = triangle[0], triangle[1], triangle[2]
    return Mesh(np.array(shape.vertices(), dtype=float), faces)


def _from_inertias(system: System) -> tuple[Solid, ...]:
    """Build an ellipsoid for each body with mass, and capsules from joint to joint."""
    model = system.sorted_model
    inertias = [model.inertias[i] for i in range(model.njoints)]
    radii = [np.sqrt(np.trace(y.inertia) / y.mass) for y in inertias[1:] if y.mass > 0]
    offsets = [model.jointPlacements[i].translation for i in range(2, model.njoints)]
    size = max([*radii, *(float(np.linalg.norm(p)) for p in offsets)])
    solids = []
    for i in range(1, model.njoints):
        colour = (*PALETTE[(i - 1) % len(PALETTE)], 1.0)
        inertia = inertias[i]
        if inertia.mass > 0.0:
            moments, axes = np.linalg.eigh(inertia.inertia)
            axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
            squares = 2.5 / inertia.mass * (moments.sum() - 2.0 * moments)
            semi = np.maximum(np.sqrt(np.maximum(squares, 0.0)), _THIN * size)
            placement = np.array(pin.SE3ToXYZQUAT(pin.SE3(axes, inertia.lever)))
            solids.append(Solid(i, "ellipsoid", tuple(map(float, semi)), placement, colour))
        parent = model.parents[i]
        if parent > 0:
            solids += _capsule(parent, model.jointPlacements[i].translation, size)
        solids += _capsule(i, np.array(inertia.lever), size)
    return tuple(solids)


def _capsule(joint: int, end: Array, size: float) -> list[Solid]:
    """Build a capsule from a joint's origin to a point, or nothing if they coincide."""
    length = float(np.linalg.norm(end))
    if length < 1e-3 * size:
        return []
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end / length)
    placement = np.concatenate([0.5 * end, rotation.coeffs()])
    colour = (0.45, 0.48, 0.52, 1.0)
    return [Solid(joint, "capsule", (_SLENDER * size, 0.5 * length), placement, colour)]


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
    return Bodies(tuple(solids), tuple(_mjcf_mesh(model, k) for k in meshes), "")


def _solid(system: System, world: World, geom: int, meshes: dict[int, int]) -> Solid | None:
    """Convert a geom, or return None if it is not drawn; `meshes` (id → index) is extended."""
    model, geometry = world.model, int(world.model.geom_type[geom])
    size: tuple[float, ...]
    if geometry in _MESHES:
        name, size = "mesh", (float(meshes.setdefault(int(model.geom_dataid[geom]), len(meshes))),)
    elif geometry in _SHAPES:
        name, count = _SHAPES[geometry]
        size = tuple(map(float, model.geom_size[geom, :count]))
    else:
        return None
    colour = _colour(model, geom)
    if colour[3] == 0.0:
        return None
    body = world.body_names[int(model.geom_bodyid[geom])]
    if not system.model.existFrame(body, pin.FrameType.BODY):  # a massless body between hinges
        return None
    link = system.sorted_model.frames[system.model.getFrameId(body, pin.FrameType.BODY)]
    placement = link.placement * frame(model.geom_pos[geom], model.geom_quat[geom])
    place = np.array(pin.SE3ToXYZQUAT(placement))
    return Solid(link.parentJoint, name, size, place, colour, body)


def _colour(model: Any, geom: int) -> Colour:
    material = int(model.geom_matid[geom])
    colour = tuple(map(float, model.geom_rgba[geom]))
    rgba = model.mat_rgba[material] if material >= 0 and colour == _NO_COLOUR else colour
    red, green, blue, opacity = map(float, rgba)
    return red, green, blue, opacity


def _mjcf_mesh(model: Any, mesh: int) -> Mesh:
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return Mesh(
        np.array(model.mesh_vert[first : first + count], dtype=float),
        np.array(model.mesh_face[face : face + faces], dtype=np.uint32),
    )


_AROUND = 32  # number of sides of a round shape
_RISE = 16  # number of steps from pole to pole
_CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])  # of a square, anticlockwise


def solid_mesh(solid: Solid, meshes: Sequence[Mesh]) -> Mesh:
    """Return the surface of a shape in the shape's own frame, with faces anticlockwise outside.

    Edges have separate vertices on each side, so that averaged normals keep them sharp.

    Args:
        solid: The shape.
        meshes: The meshes of the robot.
    Returns:
        The surface.
    """
    size = solid.size
    if solid.kind == "mesh":
        return meshes[int(size[0])]
    if solid.kind == "box":
        return _box(np.array(size))
    if solid.kind == "sphere":
        return _ball(np.full(3, size[0]))
    if solid.kind == "ellipsoid":
        return _ball(np.array(size))
    radius, half = size
    if solid.kind == "capsule":
        quarter = np.linspace(0.0, 0.5 * np.pi, _RISE // 2 + 1)
        angles = np.concatenate([-quarter[::-1], quarter])
        shift = np.repeat([-half, half], len(quarter))
        height = radius * np.sin(angles) + shift
        return _revolve([np.column_stack([radius * np.cos(angles), height])])
    base = np.array([[0.0, -half], [radius, -half]])
    if solid.kind == "cone":
        return _revolve([base, np.array([[radius, -half], [0.0, half]])])
    side, top = np.array([[radius, -half], [radius, half]]), np.array([[radius, half], [0.0, half]])
    return _revolve([base, side, top])


def vertex_normals(mesh: Mesh) -> Array:
    """Return unit normals of the vertices, means over the faces weighted by area, (V, 3)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.zeros_like(mesh.vertices)
    for k in range(3):
        np.add.at(normals, mesh.faces[:, k], np.cross(b - a, c - a))
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(lengths > 0.0, lengths, 1.0))


def face_normals(mesh: Mesh) -> Array:
    """Return unit normals of the triangles, (T, 3); zero for triangles without area."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(lengths > 0.0, lengths, 1.0))


def facets(mesh: Mesh) -> Mesh:
    """Return a mesh whose triangles share no vertices, so that each is drawn flat."""
    return Mesh(
        mesh.vertices[mesh.faces].reshape(-1, 3),
        np.arange(mesh.faces.size, dtype=np.uint32).reshape(-1, 3),
    )


def _ball(semi_axes: Array) -> Mesh:
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _RISE + 1)
    unit = _revolve([np.column_stack([np.cos(angles), np.sin(angles)])])
    return Mesh(unit.vertices * semi_axes, unit.faces)


def _box(half: Array) -> Mesh:
    """Return a box of six faces with four vertices each."""
    vertices: list[Array] = []
    faces: list[list[int]] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            corners = np.empty((4, 3))
            corners[:, axis] = sign
            corners[:, [(axis + 1) % 3, (axis + 2) % 3]] = _CORNERS[:: int(sign)]
            first = 4 * len(vertices)
            faces += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
            vertices.append(corners * half)
    return Mesh(np.concatenate(vertices), np.array(faces, dtype=np.uint32))


def _revolve(profiles: Sequence[Array]) -> Mesh:
    """Return the surface swept by curves of radius and height, from below to above, about z.

    Args:
        profiles: Points (radius, height) of each curve, (P, 2) [m].  Curves share no vertices.
    Returns:
        The surface.
    """
    angles = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    vertices, faces, first = [], [], 0
    for profile in profiles:
        rings = np.empty((len(profile), _AROUND, 3))
        rings[..., :2] = profile[:, None, :1] * circle
        rings[..., 2] = profile[:, 1:]
        vertices.append(rings.reshape(-1, 3))
        starts = first + _AROUND * np.arange(len(profile) - 1)[:, None]
        below = (starts + np.arange(_AROUND)).ravel()
        after = (starts + (np.arange(_AROUND) + 1) % _AROUND).ravel()
        faces.append(np.column_stack([below, after, after + _AROUND]))
        faces.append(np.column_stack([below, after + _AROUND, below + _AROUND]))
        first += rings[..., 0].size
    return Mesh(np.concatenate(vertices), np.concatenate(faces).astype(np.uint32))
