"""Compilation of an MJCF file or an MjSpec by MuJoCo, and checks of the compiled numbers.

The package mujoco is imported only when needed; the extra `mjcf` installs it.

The size of a file is estimated from its text first, because MuJoCo expands some short texts to
millions of elements.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from ...common.errors import LoadError, ModelError, PinredError, install_command, optional_package
from ...common.files import is_file, is_special
from ...common.names import plain_path
from ..find_robot_files import is_mujoco, library_output, read_text, without_hyphens

INSTALL = install_command("mjcf")


def mujoco_package() -> Any:
    """Return the module mujoco.  Raises MissingPackageError with the command that installs it."""
    return optional_package("mujoco", f"MJCF is read by MuJoCo's compiler: {INSTALL}")


@contextmanager
def warnings_kept() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings; by default, MuJoCo writes them to a file in the current folder."""
    mj = mujoco_package()
    messages: list[str] = []
    before = mj.get_mju_user_warning()
    mj.set_mju_user_warning(messages.append)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield messages
            messages += [str(warning.message) for warning in caught]
    finally:
        mj.set_mju_user_warning(before)


# Lines that MuJoCo's XML reader prints itself.
_PRINTED = re.compile(rb"^WARNING: XML contains [^\n]*\n?", re.MULTILINE)
# Sizes for which MuJoCo reserves memory.  They are set to their defaults, because pinred does not
# simulate with MuJoCo.
_SIZES = (
    *("memory", "nstack", "njmax", "nconmax", "nkey", "nuserdata"),
    *("nuser_body", "nuser_jnt", "nuser_geom", "nuser_site", "nuser_cam"),
    *("nuser_tendon", "nuser_actuator", "nuser_sensor"),
)
# Arrays of the compiled model that must be finite.
_FINITE = (
    *("body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia"),
    *("jnt_pos", "jnt_axis", "dof_armature", "qpos0", "key_qpos", "key_qvel"),
)

_DEEPEST = 450  # largest depth of nested elements; MuJoCo rejects 500
_DEEPEST_INCLUDES = 50  # largest depth of nested includes
_MOST = 100_000  # largest number of expanded elements; the largest known files have a tenth of it
_CELLS = 100  # number of height-field cells that need as much memory as one element
_MOST_ATTRIBUTES = (
    100  # largest number of attributes per element; MuJoCo's schema allows half of it
)
_MOST_FOLDERS = 50  # largest number of different folders of meshes
_READING = ("include", "model", "mesh", "flexcomp")  # elements whose files are read
_MOST_LETTERS = 64_000_000  # largest number of characters of all files together


def compiled(source: Any, *, shapes: bool = False) -> Any:
    """Compile a path or an MjSpec; return an MjModel unchanged.

    Args:
        source: Path, MjSpec or MjModel.
        shapes: Whether to read meshes that carry no mass.
    Returns:
        The MjModel.
    Raises:
        LoadError: MuJoCo cannot read or compile the source; the message has one line.
        ModelError: A number is not finite.
        MissingPackageError: mujoco is not installed.
    """
    if is_mujoco(source, "MjModel"):
        model = source
    elif is_mujoco(source, "MjSpec"):
        model = _guarded("the MjSpec", lambda: _compile(source.copy(), shapes=shapes))
    else:
        path = Path(source)
        mj = mujoco_package()
        check_text(path, read_text(path))
        model = _guarded(str(path), lambda: _compile(mj.MjSpec.from_file(str(path)), shapes=shapes))
    for name in _FINITE:
        if not np.isfinite(getattr(model, name)).all():
            raise ModelError(f"the compiled model has numbers in {name} that are not finite")
    return model


def _guarded(what: str, compile_source: Callable[[], Any]) -> Any:
    """Return a compiled model.  Raises LoadError for MuJoCo's errors and serious warnings."""
    # MuJoCo's XML reader prints to the console, and all threads share one warning handler.
    with library_output(_PRINTED), warnings_kept() as messages:
        try:
            model = compile_source()
        except PinredError:
            raise
        except Exception as error:  # MuJoCo raises ValueError, RuntimeError and other types.
            raise LoadError(f"MuJoCo cannot read {what}: {_one_line(error)}") from None
    if any("NaN" in warning for warning in messages):
        raise LoadError(f"{what} contains nan where a number is required")
    return model


def _one_line(error: Exception) -> str:
    """Return MuJoCo's message in one line, with the position in the file in brackets."""
    words, *place = str(error).strip().splitlines() or [type(error).__name__]
    for prefix in ("XML Error: ", "Error: "):
        words = words.removeprefix(prefix)
    where = " ".join(" ".join(place).split())
    return f"{words.strip().rstrip(':')} ({where})" if where else words.strip()


def _compile(spec: Any, *, shapes: bool) -> Any:
    """Compile a spec, keep all its bodies and drop textures; the spec is modified."""
    mj = mujoco_package()
    fresh = mj.MjSpec()
    for size in _SIZES:
        setattr(spec, size, getattr(fresh, size))
    spec.compiler.fusestatic = False  # Keep a base that is fixed to the world as a body.
    spec.compiler.discardvisual = False
    # MuJoCo would simulate muscles to find their ranges, but pinred uses no actuators.
    spec.compiler.LRopt.mode = int(mj.mjtLRMode.mjLRMODE_NONE)
    _refuse_negative(spec)
    _drop_pictures(spec)
    needed = set()  # names of the meshes that MuJoCo must read
    for geom in spec.geoms:
        if geom.type == mj.mjtGeom.mjGEOM_HFIELD or (
            geom.meshname and not (shapes or _may_have_mass(mj, geom))
        ):
            _replace_by_point(mj, geom)
        elif geom.meshname:
            needed.add(geom.meshname)
    for site in spec.sites:
        if getattr(site, "meshname", ""):
            needed.add(site.meshname)
    for mesh in [mesh for mesh in spec.meshes if mesh.name not in needed]:
        spec.delete(mesh)
    for mesh in spec.meshes:
        refuse_special_files([Path(spec.modelfiledir)], [mesh.compiler.meshdir], mesh.file)
    for height_field in list(spec.hfields):
        spec.delete(height_field)
    return spec.compile()


def _refuse_negative(spec: Any) -> None:
    """Reject negative masses, which MuJoCo's compiler reads as zero.  Raises ModelError."""
    for body in spec.bodies:
        for what, values in (("mass", [body.mass]), ("moment of inertia", body.inertia)):
            if min(values) < 0.0:
                raise ModelError(
                    f"body '{body.name}' has negative {what} {min(values):g}; state a positive one"
                )


def _drop_pictures(spec: Any) -> None:
    """Delete textures and skins, whose files are not needed, and the elements that use them."""
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for light in spec.lights:
        light.texture = ""
    for picture in (*spec.sensors, *spec.tuples, *spec.textures, *spec.skins):
        spec.delete(picture)


def _may_have_mass(mj: Any, geom: Any) -> bool:
    """Return whether MuJoCo may derive mass from a geom."""
    body, rules = geom.parent, geom.compiler
    never, always = (
        int(getattr(mj.mjtInertiaFromGeom, f"mjINERTIAFROMGEOM_{word}"))
        for word in ("FALSE", "TRUE")
    )
    least, most = rules.inertiagrouprange
    return not (
        body.name == "world"
        or rules.inertiafromgeom == never
        or (body.explicitinertial and rules.inertiafromgeom != always)
        or not least <= geom.group <= most
        or geom.mass == 0.0
        or (np.isnan(geom.mass) and geom.density == 0.0)
    )


def _replace_by_point(mj: Any, geom: Any) -> None:
    """Replace a geom by a massless ball of the same name."""
    geom.type = mj.mjtGeom.mjGEOM_SPHERE
    geom.size = [1.0, 0.0, 0.0]
    geom.mass = 0.0
    geom.meshname = geom.hfieldname = ""
    geom.plugin.active = False


@dataclass
class _Open:
    """An open XML element.  before: number of elements counted before it."""

    tag: str
    attributes: dict[str, str]
    before: int


@dataclass
class _Measure:
    """The size of the part of a file and its includes that has been read so far.

    Attributes:
        top: Folder of the file.
        count: Number of expanded elements.
        letters: Number of characters.
        named: Number of elements in each named body or frame.
        models: Number of elements in each attached file, by its model name.
        reading: Open files; each file is included by the file before.
        files: Folder and name of each file that MuJoCo may read.
        mesh_folders: Folders of meshes, as written in the files.
    """

    top: Path
    count: int = 0
    letters: int = 0
    named: dict[str, int] = field(default_factory=dict)
    models: dict[str, int] = field(default_factory=dict)
    reading: list[Path] = field(default_factory=list)
    files: set[tuple[Path, str]] = field(default_factory=set)
    mesh_folders: set[str] = field(default_factory=set)


def check_text(path: Path, text: str) -> None:
    """Reject an MJCF file whose text is too large or too deeply nested for a parser.

    Files that it names must be regular files.  Raises LoadError, which names the file at fault.
    """
    size = _Measure(path.parent)
    _measure(path, text, size, 0)
    for folder, name in size.files:
        refuse_special_files([size.top, folder], size.mesh_folders, name)


def refuse_special_files(folders: Iterable[Path], inner: Iterable[str], name: str) -> None:
    """Reject a pipe or a device of this name, whose reading may never end.

    Args:
        folders: Folders of MJCF files.
        inner: Folders of meshes, relative to those.
        name: Name of a file, which MuJoCo may reduce to its last component.
    Raises:
        LoadError: The file is neither regular nor missing.
    """
    for folder, below, end in product(folders, ("", *inner), (name, Path(name).name)):
        if is_special(path := folder / below / end):
            raise LoadError(f"{plain_path(path)} is a pipe or a device, not a regular file")


def _measure(path: Path, text: str, size: _Measure, depth: int) -> None:
    """Add the size of a file to `size`.  depth: number of enclosing elements."""
    size.letters += len(text)
    if size.letters > _MOST_LETTERS:
        raise LoadError(
            f"{plain_path(path)}: more than {_MOST_LETTERS} characters of MJCF in total; "
            "simplify the file"
        )
    if path.resolve() in size.reading or len(size.reading) > _DEEPEST_INCLUDES:
        raise LoadError(f"{plain_path(path)} includes itself, or too many files include each other")
    size.reading.append(path.resolve())
    stack: list[_Open] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = _Open(tag.lower(), attributes, size.count)
        stack.append(element)
        size.count += 1
        if depth + len(stack) > _DEEPEST:
            raise LoadError(f"{where()}: more than {_DEEPEST} nested elements")
        if len(attributes) > _MOST_ATTRIBUTES:
            raise LoadError(f"{where()}: <{tag}> has more than {_MOST_ATTRIBUTES} attributes")
        if element.tag in _READING and "file" in attributes:
            size.files.add((path.parent, attributes["file"]))
        if element.tag == "compiler":
            size.mesh_folders |= {attributes.get(key, "") for key in ("meshdir", "assetdir")}
            if len(size.mesh_folders) > _MOST_FOLDERS:
                raise LoadError(f"{where()}: more than {_MOST_FOLDERS} folders of meshes")
        if element.tag in ("include", "model") and "file" in attributes:
            _measure_named(path, attributes, element.tag, size, depth + len(stack))
        elif element.tag in _EXPANSIONS:
            size.count += _EXPANSIONS[element.tag](attributes)
        elif element.tag == "attach":
            size.count += size.models.get(attributes.get("model", ""), 0)
            size.count += _attached_size(
                attributes.get("body", attributes.get("frame", "")), size.named
            )
        check_count()

    def end(_: str) -> None:
        element = stack.pop()
        count = size.count - element.before
        if element.tag == "replicate":
            count *= _product(element.attributes.get("count", ""))
            size.count = element.before + count
            check_count()
        if element.tag in ("body", "frame") and "name" in element.attributes:
            name = element.attributes["name"]
            size.named[name] = max(count, size.named.get(name, 0))

    def where() -> str:
        return f"{path}, line {parser.CurrentLineNumber}"

    def check_count() -> None:
        if size.count > _MOST:
            raise LoadError(f"{where()}: more than {_MOST} elements of MJCF in total")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(without_hyphens(text), True)
    except expat.ExpatError as error:
        raise LoadError(f"{plain_path(path)} is not XML: {error}") from None
    size.reading.pop()


def _measure_named(
    path: Path, attributes: dict[str, str], tag: str, size: _Measure, depth: int
) -> None:
    """Measure an included or attached file, in every folder where MuJoCo may find it."""
    before = size.count
    name, last = attributes["file"], Path(attributes["file"]).name
    folders = dict.fromkeys((size.top, path.parent))
    files = [folder / name for folder in folders]
    # With strippath="true", MuJoCo uses only the last component of a name.  If that is the name
    # of an open file, MuJoCo does not include it again.
    stripped = [folder / last for folder in folders if name != last]
    if tag == "include":
        stripped = [file for file in stripped if file.resolve() not in size.reading]
    for file in dict.fromkeys([*files, *stripped]):
        if is_file(file):
            _measure(file, read_text(file), size, depth)
    if tag == "model":  # Elements of a model are counted where it is attached.
        name = attributes.get("name", Path(attributes["file"]).stem)
        size.models[name], size.count = size.count - before, before


def _product(counts: str) -> int:
    """Return the product of the integers in a text, at least 1 and bounded above."""
    product = 1.0
    for word in counts.split():
        try:
            product *= max(1.0, float(word))
        except ValueError:  # MuJoCo rejects a count that is not a number.
            continue
    return int(min(product, _CELLS * _MOST))


def _mesh_vertices(attributes: dict[str, str]) -> int:
    """Estimate the number of vertices of a mesh that MuJoCo generates from parameters."""
    if "builtin" not in attributes:
        return 0
    first, *more = attributes.get("params", "").split() or [""]
    # The first parameter of a superquadric divides it along both directions.
    twice = attributes["builtin"].startswith("super")
    return _product(f"{first} {first if twice else more[0] if more else ''}")


# Number of elements to which MuJoCo expands one element.  A height-field cell stores one number
# only, so _CELLS cells count as one element.
_EXPANSIONS: dict[str, Callable[[dict[str, str]], int]] = {
    "flexcomp": lambda attributes: (
        _product(attributes.get("count", "")) + _product(attributes.get("cellcount", ""))
    ),
    "mesh": _mesh_vertices,
    "hfield": lambda attributes: (
        _product(f"{attributes.get('nrow', '')} {attributes.get('ncol', '')}") // _CELLS
    ),
}


def _attached_size(target: str, sizes: dict[str, int]) -> int:
    """Return the number of elements in an attached body; its name may have a prefix."""
    return max((count for name, count in sizes.items() if target.endswith(name)), default=0)
