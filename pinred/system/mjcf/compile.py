"""From a file, a text in memory (MjSpec) or a compiled model to MuJoCo's compiled numbers."""

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

_OWN_LINES = re.compile(rb"^WARNING: XML contains [^\n]*\n?", re.MULTILINE)
# What MuJoCo reserves room for, which nothing here needs: sizes as its default spec has them.
_ROOM = (
    *("memory", "nstack", "njmax", "nconmax", "nkey", "nuserdata"),
    *("nuser_body", "nuser_jnt", "nuser_geom", "nuser_site", "nuser_cam"),
    *("nuser_tendon", "nuser_actuator", "nuser_sensor"),
)
_FINITE = (
    *("body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia"),
    *("jnt_pos", "jnt_axis", "dof_armature", "qpos0", "key_qpos", "key_qvel"),
)


def compiled(source: Any, *, shapes: bool = False) -> Any:
    """Return the MjModel of a path, an MjSpec or an MjModel (which is itself).

    shapes: whether meshes are read that carry no mass.
    Raises LoadError in one line if MuJoCo cannot read or compile it, ModelError for numbers
    that are not finite, MissingPackageError without mujoco.
    """
    if is_mujoco(source, "MjModel"):
        model = source
    elif is_mujoco(source, "MjSpec"):
        model = _checked("the MjSpec", lambda: _compiled(source.copy(), shapes=shapes))
    else:
        path = Path(source)
        mj = mujoco_package()
        check_text(path, read_text(path))
        model = _checked(
            str(path), lambda: _compiled(mj.MjSpec.from_file(str(path)), shapes=shapes)
        )
    for name in _FINITE:
        if not np.isfinite(getattr(model, name)).all():
            raise ModelError(f"the compiled model has numbers in {name} that are not finite")
    return model


def _checked(what: str, make: Callable[[], Any]) -> Any:
    """Return what `make` makes.  Raises LoadError for all that MuJoCo says against it."""
    # Its reader of XML prints on its own, too; and where it writes warnings is one place for all
    # threads.
    with library_output(_OWN_LINES), warnings_kept() as said:
        try:
            model = make()
        except PinredError:
            raise
        except Exception as error:  # MuJoCo raises ValueError, RuntimeError and its own
            raise LoadError(f"MuJoCo cannot read {what}: {_one_line(error)}") from None
    if any("NaN" in warning for warning in said):
        raise LoadError(f"{what} holds nan where a number should stand")
    return model


def _one_line(error: Exception) -> str:
    """Return what MuJoCo says, with the place in the file in brackets."""
    words, *place = str(error).strip().splitlines() or [type(error).__name__]
    for prefix in ("XML Error: ", "Error: "):
        words = words.removeprefix(prefix)
    where = " ".join(" ".join(place).split())
    return f"{words.strip().rstrip(':')} ({where})" if where else words.strip()


def _compiled(spec: Any, *, shapes: bool) -> Any:
    """Compile a spec, which is changed: without what is only seen, and with all its bodies."""
    mj = mujoco_package()
    fresh = mj.MjSpec()
    for size in _ROOM:
        setattr(spec, size, getattr(fresh, size))
    spec.compiler.fusestatic = False  # a base that is fixed to the world stays a body
    spec.compiler.discardvisual = False
    # Range of muscles, found by simulating them; actuators are not simulated here.
    spec.compiler.LRopt.mode = int(mj.mjtLRMode.mjLRMODE_NONE)
    _refuse_negative(spec)
    _drop_pictures(spec)
    needed = set()
    for geom in spec.geoms:
        if geom.type == mj.mjtGeom.mjGEOM_HFIELD or (
            geom.meshname and not (shapes or _may_weigh(mj, geom))
        ):
            _make_a_point(mj, geom)
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
    """Refuse negative masses, which MuJoCo's compiler takes for zero.  Raises ModelError."""
    for body in spec.bodies:
        for what, values in (("mass", [body.mass]), ("moment of inertia", body.inertia)):
            if min(values) < 0.0:
                raise ModelError(f"body '{body.name}' has negative {what} {min(values):g}")


def _drop_pictures(spec: Any) -> None:
    """Leave out textures and skins, for which files would be read, and what may name them."""
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for light in spec.lights:
        light.texture = ""
    for picture in (*spec.sensors, *spec.tuples, *spec.textures, *spec.skins):
        spec.delete(picture)


def _may_weigh(mj: Any, geom: Any) -> bool:
    """Return whether MuJoCo may take mass from a shape; if not, the shape does not matter."""
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


def _make_a_point(mj: Any, geom: Any) -> None:
    """Put a ball without mass in place of a shape, under the same name."""
    geom.type = mj.mjtGeom.mjGEOM_SPHERE
    geom.size = [1.0, 0.0, 0.0]
    geom.mass = 0.0
    geom.meshname = geom.hfieldname = ""
    geom.plugin.active = False
