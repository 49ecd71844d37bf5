"""read_shapes(): the visual shapes of a URDF file, with meshes read in a child process.

A ball replaces each mesh in the text for Pinocchio, so that Pinocchio reads the mesh's placement
and colour, but not its file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ..common.errors import LoadError
from ..common.names import plain_path, quoted
from .mesh_files import Mesh, Unreadable, read_meshes
from .read_urdf import URDFDOM, take_closing_joints, with_deep_stack
from .robot_files import Visuals, library_output, read_xml
from .urdf_elements import prepare, reduced_text, replace_commas, tree_depth

_MOST_LINKS = 2000  # Pinocchio's time for shapes is quadratic in the number of links.
FARTHEST = 1e6  # largest accepted coordinate or size of a shape [m]


@dataclass(frozen=True)
class MeshShape:
    """A visual shape that is a mesh.

    Attributes:
        name: Name of the shape in Pinocchio's geometry model.
        link: Name of its link.
        file: Name of the mesh file, as written in the URDF file.
        scale: Factors along the axes of the mesh, as written in the URDF file.
    """

    name: str
    link: str
    file: str
    scale: str

    def __str__(self) -> str:
        return f"mesh '{plain_path(self.file)}' of link {quoted(self.link)}"


@dataclass(frozen=True)
class Shapes:
    """The visual shapes of a URDF file.

    Attributes:
        visuals: Model of the file and its shapes; a ball stands for each mesh.
        meshes: Mesh of each ball by its name, or why the mesh is not drawn.
        unreadable: Messages about meshes that are not drawn.
    """

    visuals: Visuals
    meshes: Mapping[str, Mesh | None]
    unreadable: tuple[str, ...]


def read_shapes(path: Path, folders: Sequence[str]) -> Shapes:
    """Read the visual shapes of a URDF file.

    Args:
        path: The file.
        folders: Additional search folders for meshes or packages.
    Returns:
        The shapes.
    Raises:
        LoadError: The file cannot be read.
        ValueError: Pinocchio cannot read the shapes.
    """
    # Packages are searched in all parent folders of the file, in `folders`, and next to them.
    named = [path for folder in folders for path in (folder, str(Path(folder).parent))]
    above = [str(folder) for folder in path.resolve().parents][:-1]
    robot = read_xml(path)
    replace_commas(robot)
    if (links := len(robot.findall("link"))) > _MOST_LINKS:
        raise LoadError(f"{plain_path(path)} has {links} links; at most {_MOST_LINKS} are drawn")
    prepare(robot)
    take_closing_joints(robot)
    meshes = _take_meshes(robot)
    text = reduced_text(robot, shapes=True)

    def parse() -> Visuals:
        raw = pin.buildModelFromXML(text)
        return Visuals(raw, pin.buildGeomFromUrdfString(raw, text, pin.GeometryType.VISUAL))

    with library_output(URDFDOM):
        visuals = with_deep_stack(parse, tree_depth(robot))
    results = _read(meshes, [*named, *above])
    unreadable = tuple(
        f"{shape} {result.reason}"
        for shape, result in results.items()
        if isinstance(result, Unreadable)
    )
    drawn = {
        shape.name: result if isinstance(result, Mesh) else None
        for shape, result in results.items()
    }
    return Shapes(visuals, drawn, unreadable)


def _take_meshes(robot: Element) -> tuple[MeshShape, ...]:
    """Replace the meshes of visual shapes by balls, in place.

    Args:
        robot: Root element of a URDF file.
    Returns:
        The meshes.
    """
    shapes = []
    for link, name, geometry in _geometries(robot):
        mesh = geometry[0]
        shapes.append(MeshShape(name, link, mesh.get("filename", ""), mesh.get("scale", "1 1 1")))
        mesh.tag = "sphere"
        mesh.attrib.clear()
        mesh.set("radius", "1")
    return tuple(shapes)


def _geometries(robot: Element) -> Iterator[tuple[str, str, Element]]:
    """Yield link, shape name and geometry element of each visual shape that is a mesh."""
    for link in robot.findall("link"):
        name = link.get("name", "")
        for number, visual in enumerate(link.findall("visual")):
            geometry = visual.find("geometry")
            if geometry is not None and len(geometry) and geometry[0].tag == "mesh":
                yield name, f"{name}_{number}", geometry


def _read(
    shapes: Sequence[MeshShape], folders: Sequence[str]
) -> dict[MeshShape, Mesh | Unreadable]:
    """Return the mesh of each shape in its scale, or why it cannot be drawn."""
    paths = {shape.file: _find(shape.file, folders) for shape in shapes}
    meshes = read_meshes([path for path in paths.values() if path is not None])
    scaled: dict[tuple[Path | None, str], Mesh | Unreadable] = {}
    for path, scale in {(paths[shape.file], shape.scale) for shape in shapes}:
        mesh = Unreadable("could not be found") if path is None else meshes[path]
        scaled[path, scale] = mesh if isinstance(mesh, Unreadable) else _scaled(mesh, scale)
    return {shape: scaled[paths[shape.file], shape.scale] for shape in shapes}


def _find(name: str, folders: Sequence[str]) -> Path | None:
    """Return the path of a mesh file; None if there is none."""
    scheme, mark, location = name.partition("://")
    if not mark or scheme == "file":
        folders, location = ([*folders, ""] if not mark else [""]), location if mark else name
    elif scheme not in ("package", "model"):
        return None
    for folder in folders:
        path = Path(folder, location)
        if location and _exists(path):
            return path
    return None


def _exists(path: Path) -> bool:
    try:
        return path.exists() and not path.is_dir()
    except (OSError, ValueError):
        return False


def _scaled(mesh: Mesh, scale: str) -> Mesh | Unreadable:
    try:
        factors = np.array([float(word) for word in scale.split()])
    except ValueError:
        factors = np.empty(0)
    if factors.shape != (3,) or not np.isfinite(factors).all():
        return Unreadable(f"has scale {quoted(scale)}, expected three numbers")
    with np.errstate(over="ignore"):
        vertices = mesh.vertices * factors
    if not np.abs(vertices).max() <= FARTHEST:
        return Unreadable(f"has vertices farther than {FARTHEST:g} m from its origin")
    return Mesh(vertices, mesh.faces)
