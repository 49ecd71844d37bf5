"""Compilation of an MJCF file or an MjSpec by MuJoCo, and checks of the compiled numbers."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...common.errors import LoadError, ModelError, PinredError
from ...common.library_output import library_output
from ..robot_files import read_text
from .package import is_mujoco, mujoco_package, warnings_kept
from .text import check_text

# Lines that MuJoCo's XML reader prints itself.
_PRINTED = re.compile(rb"^WARNING: XML contains [^\n]*\n?", re.MULTILINE)
# Sizes for which MuJoCo reserves memory.  None is needed here, so they are set to the defaults.
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
    """Return a compiled model.  Raises LoadError for every error and bad warning of MuJoCo."""
    # MuJoCo's XML reader prints by itself, and its warnings share one handler for all threads.
    with library_output(_PRINTED), warnings_kept() as warnings:
        try:
            model = compile_source()
        except PinredError:
            raise
        except Exception as error:  # MuJoCo raises ValueError, RuntimeError and other types.
            raise LoadError(f"MuJoCo cannot read {what}: {_one_line(error)}") from None
    if any("NaN" in warning for warning in warnings):
        raise LoadError(f"{what} has nan instead of a number")
    return model


def _one_line(error: Exception) -> str:
    """Return MuJoCo's message in one line, with the position in the file in brackets."""
    words, *place = str(error).strip().splitlines() or [type(error).__name__]
    for prefix in ("XML Error: ", "Error: "):
        words = words.removeprefix(prefix)
    where = " ".join(" ".join(place).split())
    return f"{words.strip().rstrip(':')} ({where})" if where else words.strip()


def _compile(spec: Any, *, shapes: bool) -> Any:
    """Compile a spec with all its bodies and without pictures; the spec is changed."""
    mj = mujoco_package()
    fresh = mj.MjSpec()
    for size in _SIZES:
        setattr(spec, size, getattr(fresh, size))
    spec.compiler.fusestatic = False  # A base fixed to the world stays a body.
    spec.compiler.discardvisual = False
    # MuJoCo would simulate muscles for their ranges, but actuators are not used here.
    spec.compiler.LRopt.mode = int(mj.mjtLRMode.mjLRMODE_NONE)
    _refuse_negative(spec)
    _drop_pictures(spec)
    needed = set()  # names of meshes
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
    for field in list(spec.hfields):
        spec.delete(field)
    return spec.compile()


def _refuse_negative(spec: Any) -> None:
    """Refuse negative masses, which MuJoCo's compiler reads as zero.  Raises ModelError."""
    for body in spec.bodies:
        for what, values in (("mass", [body.mass]), ("moment of inertia", body.inertia)):
            if min(values) < 0.0:
                raise ModelError(f"body '{body.name}' has negative {what} {min(values):g}")


def _drop_pictures(spec: Any) -> None:
    """Delete textures and skins, for which files would be read, and the elements that use them."""
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
