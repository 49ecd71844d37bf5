"""Decide which descriptions should work, without using pinred's readers.

A URDF should work if Pinocchio or MuJoCo opens it, if it is one open tree, and if its mass matrix
is positive definite at zero and at some random shapes. An MJCF file should work if MuJoCo compiles
it and if it contains an open tree of joints. An SDF file should work if Drake opens it and if
something moves.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ...common.errors import LoadError, MissingPackageError
from ...common.optional_packages import optional_package
from ...system.mjcf.package import mujoco_package, warnings_kept
from ...system.read_sdf import drake_warnings
from ...system.robot_files import EVERYTHING, library_output, read_xml

_SHAPES = 4
_REGULAR = 1e-13  # least eigenvalue of a regular mass matrix, scaled to a unit diagonal


def why_not_due(file: str, kind: str) -> str:
    """Return a short reason why a description is not required to work, or ""."""
    reason = _urdf(Path(file)) if kind == "urdf" else _sdf(file) if kind == "sdf" else _mjcf(file)
    return " ".join(reason.split())[:200]


def _urdf(path: Path) -> str:
    try:
        tree = read_xml(path)
    except LoadError as error:
        return str(error)
    links = [link.get("name") for link in tree.findall("link")]
    children = [child.get("link") for child in tree.findall("joint/child")]
    if len(set(children)) < len(children):
        return "closed loop"
    if len(links) - len(children) != 1:
        return "not one tree"
    with library_output(EVERYTHING) as output:
        fixed = _build(path, None)
        floating = _build(path, pin.JointModelFreeFlyer())
    if fixed is None or floating is None:
        return _by_mujoco(path, output[0].splitlines()[0] if output else "")
    has_fixed_base = fixed.inertias[0].mass == 0.0 and list(fixed.parents[1:]).count(0) == 1
    if not _is_regular(fixed if has_fixed_base else floating):
        return "mass matrix singular"
    return ""


def _by_mujoco(path: Path, message: str) -> str:
    """Return why a URDF that Pinocchio rejects is not required to work; "" if MuJoCo opens it.

    message: Pinocchio's error message.
    """
    try:
        mj = mujoco_package()
        with library_output(EVERYTHING), warnings_kept():
            spec = mj.MjSpec.from_file(str(path))
            for element in (*spec.geoms, *spec.meshes):
                spec.delete(element)
            spec.compile()
    except Exception:  # parsers raise various types, and MuJoCo may not be installed
        return f"Pinocchio does not open it: {message}"
    return ""


def _build(path: Path, root: pin.JointModel | None) -> pin.Model | None:
    try:
        if root is None:
            return pin.buildModelFromUrdf(str(path))
        return pin.buildModelFromUrdf(str(path), root)
    except Exception:  # parsers raise exceptions of various types
        return None


def _is_regular(model: pin.Model) -> bool:
    """Return whether the mass matrix is positive definite at zero and some random shapes."""
    data = model.createData()
    if model.nv == 0:
        return False
    model.lowerPositionLimit = np.full(model.nq, -1.0)
    model.upperPositionLimit = np.full(model.nq, 1.0)
    pin.seed(0)
    eigenvalues = []
    shapes = [pin.neutral(model), *(pin.randomConfiguration(model) for _ in range(_SHAPES))]
    for q in shapes:
        upper = np.triu(pin.crba(model, data, q))
        H = upper + np.triu(upper, 1).T
        sizes = np.sqrt(np.abs(np.diag(H)))
        if not (np.isfinite(H).all() and sizes.all()):
            return False
        eigenvalues.append(np.linalg.eigvalsh(H / np.outer(sizes, sizes))[0])
    return bool(min(eigenvalues) > _REGULAR)


def _mjcf(file: str) -> str:
    try:
        mj = mujoco_package()
    except ImportError:
        return "no mujoco"
    with library_output(EVERYTHING), warnings_kept():
        try:
            model = mj.MjModel.from_xml_path(file)
        except Exception as error:  # parsers raise exceptions of various types
            return f"MuJoCo does not compile it: {str(error).splitlines()[0]}"
    tops = _tops(model)
    if not tops:
        return "nothing moves"
    reasons = [_why_closed(mj, model, joints) for joints in tops]
    return "" if "" in reasons else reasons[0]


def _sdf(file: str) -> str:
    try:
        plants = optional_package("pydrake.multibody.plant", "the corpus needs Drake")
        parsing = optional_package("pydrake.multibody.parsing", "the corpus needs Drake")
    except MissingPackageError:
        return "no drake"
    plant = plants.MultibodyPlant(0.0)
    with library_output(EVERYTHING), drake_warnings():
        try:
            parsing.Parser(plant).AddModels(file)
            plant.Finalize()
        except Exception as error:  # Drake raises RuntimeError and other types.
            return f"Drake does not open it: {str(error).strip().splitlines()[0]}"
    return "" if plant.num_velocities() else "nothing moves"


def _tops(model: Any) -> list[list[int]]:
    """Return the joints of the subtree of each moving child of the world."""
    roots = model.body_rootid[model.jnt_bodyid]
    return [np.flatnonzero(roots == top).tolist() for top in np.unique(roots)]


def _why_closed(mj: Any, model: Any, joints: list[int]) -> str:
    """Return why joints do not form an open tree; "" if they do."""
    top = _root_of(model, int(model.jnt_bodyid[joints[0]]))
    if int(model.opt.disableflags) & int(mj.mjtDisableBit.mjDSBL_EQUALITY):
        return ""
    welds = {int(mj.mjtEq.mjEQ_CONNECT), int(mj.mjtEq.mjEQ_WELD)}
    for k in np.flatnonzero(model.eq_active0).tolist():
        if int(model.eq_type[k]) in welds and _welded_roots(mj, model, k) - {0} == {top}:
            return "closed loop"
    return ""


def _welded_roots(mj: Any, model: Any, k: int) -> set[int]:
    """Return the root bodies that a connect or weld constraint joins; 0 is the ground."""
    ends = [int(model.eq_obj1id[k]), int(model.eq_obj2id[k])]
    if int(model.eq_objtype[k]) == int(mj.mjtObj.mjOBJ_SITE):
        ends = [int(model.site_bodyid[end]) for end in ends]
    if any(model.body_mocapid[end] >= 0 for end in ends):
        return set()
    is_fixed = [int(model.body_weldid[end]) == 0 for end in ends]
    return {0 if fixed else _root_of(model, end) for fixed, end in zip(is_fixed, ends, strict=True)}


def _root_of(model: Any, body: int) -> int:
    """Return the child of the world whose subtree contains a body."""
    return int(model.body_rootid[body])
