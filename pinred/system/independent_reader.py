"""Comparison of pinred's reading of a robot file with that of an independent reader.

pinred prepares the text of a URDF before Pinocchio's parser reads it.  The independent reader gets
the untouched file.  `READERS` has one reader for each format.

For SDF, only the names of joints and links, and the paths of included files, come from pinred.
Drake reads the file itself, without the copies of `sdf_document`, and computes the mass matrix at
random positions of all joints.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import LoadError, optional_package
from ..common.names import listed, plain_path, quoted
from .copy_model import NewJoint, rebuild
from .find_robot_files import outermost, read_text
from .joints import axes_of, joint_kind
from .passive import UNLIMITED
from .read_sdf import INSTALL, SdfRobot, drake_warnings, read_sdf
from .read_urdf import read_urdf, with_other_joints
from .sdf_document import read_document

_SAME = 1e-9  # largest difference of equal numbers, relative to the largest of their kind
_SHAPES = 3  # number of configurations at which mass matrices are compared
ROUNDED = 2e-8  # deviation of an axis from x, y or z, below which Drake rounds it
_WHY = f"the comparison needs Drake: {INSTALL}"
_SECONDS = 60.0  # time limit of the independent reader [s]
# The parser may crash or print, so it runs in a process of its own.
_PINOCCHIO = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
import pinocchio
try:
    model = pinocchio.buildModelFromUrdf(sys.argv[2])
except Exception as error:
    sys.exit(str(error).strip().splitlines()[-1] if str(error).strip() else type(error).__name__)
model.saveToText(sys.argv[3])
"""


@dataclass(frozen=True)
class SecondReading:
    """The reading of a file by an independent reader, compared with that of pinred.

    Attributes:
        reader: Name of the independent reader.
        differences: What differs, one phrase each.
        unread: Why the reader does not open the file; "" if it does.
    """

    reader: str
    differences: tuple[str, ...] = ()
    unread: str = ""


def second_reading(
    path: Path, folders: tuple[str, ...] = (), root: str | None = None
) -> SecondReading | None:
    """Compare pinred's reading of a robot file with that of an independent reader.

    Args:
        path: The file.
        folders: Folders in which models are searched that an SDF file includes.
        root: Robot of an SDF file, if several can move.
    Returns:
        The comparison; None if there is no independent reader for the format.
    Raises:
        LoadError: pinred cannot read the file.
        ModelError: Likewise.
    """
    reader = READERS.get(outermost(read_text(path)))
    return None if reader is None else reader(path, folders, root)


def _read_by_pinocchio(
    path: Path,
    folders: tuple[str, ...],  # noqa: ARG001
    root: str | None,  # noqa: ARG001
) -> SecondReading:
    """Compare with Pinocchio's reading of the untouched URDF file.

    Pinocchio reads neither armature and springs nor loops, so these are not compared.  It ignores
    the normal of a planar joint, so this joint is compared as if its normal were z.

    Returns:
        The comparison.
    """
    robot = read_urdf(path)
    with tempfile.TemporaryDirectory(prefix="pinred-") as folder:
        file = Path(folder) / "model"
        command = [sys.executable, "-c", _PINOCCHIO, json.dumps(sys.path), str(path), str(file)]
        try:
            child = subprocess.run(
                command, capture_output=True, timeout=_SECONDS, check=False,
                stdin=subprocess.DEVNULL,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return SecondReading("Pinocchio", unread=f"it takes more than {_SECONDS:g} s")
        if child.returncode or not file.exists():
            lines = child.stderr.decode(errors="replace").strip().splitlines()
            reason = lines[0] if lines else f"its process ended with code {child.returncode}"
            return SecondReading("Pinocchio", unread=reason)
        other = pin.Model()
        other.loadFromText(str(file))
    model = _with_z_normals(robot.model, robot.special)
    return SecondReading("Pinocchio", tuple(differences(model, other)))


def _read_by_drake(path: Path, folders: tuple[str, ...], root: str | None) -> SecondReading:
    """Compare mass matrices with those of Drake, which reads the untouched SDF file."""
    robot = read_sdf(path, folders, root)
    try:
        difference = mass_difference(path, robot, folders)
    except LoadError as error:
        return SecondReading("Drake", unread=str(error))
    if difference <= ROUNDED:
        return SecondReading("Drake")
    return SecondReading("Drake", (f"its mass matrix differs by {difference:.1e}",))


_Reader: TypeAlias = Callable[[Path, tuple[str, ...], "str | None"], SecondReading]
# Reader by outermost XML element of the file.
READERS: dict[str, _Reader] = {"robot": _read_by_pinocchio, "sdf": _read_by_drake}


def _with_z_normals(model: pin.Model, special: Mapping[str, NewJoint]) -> pin.Model:
    """Return a model whose planar joints have the normal z, as Pinocchio reads them."""
    replaced = {
        name: NewJoint(name, joint.joint, joint.placement.inverse(), body=joint.body.inverse())
        for name, joint in special.items()
        if joint.body is not None
    }
    return with_other_joints(model, replaced)


def differences(own: pin.Model, other: pin.Model) -> Iterator[str]:
    """Yield the differences between two readings of a robot, one phrase each.

    Masses, inertias, placements, types and axes of joints, stated limits, damping, dry friction,
    and mass matrices at random configurations are compared.

    Args:
        own: pinred's reading.
        other: Independent reading.
    """
    names = [str(name) for name in own.names[1:]]
    other_names = [str(name) for name in other.names[1:]]
    missing, more = set(other_names) - set(names), set(names) - set(other_names)
    for words, joints in (("is not read", missing), ("is read by pinred only", more)):
        yield from (f"joint {quoted(name)} {words}" for name in sorted(joints))
    if missing or more:
        return
    yield from _of_body(own, other, 0, 0, "the root link")
    differs = False
    for name in names:
        i, j = own.getJointId(name), other.getJointId(name)
        for phrase in _of_joint(own, other, i, j):
            differs = True
            yield f"joint {quoted(name)}: {phrase}"
        for phrase in _of_body(own, other, i, j, f"the body of joint {quoted(name)}"):
            differs = True
            yield phrase
    if not differs and own.nv:
        yield from _of_mass_matrices(own, other, names)


def _of_body(own: pin.Model, other: pin.Model, i: int, j: int, words: str) -> Iterator[str]:
    """Yield the differences between the inertias that two joints carry."""
    ours, theirs = own.inertias[i], other.inertias[j]
    scale = max(float(np.abs(theirs.matrix()).max()), float(np.abs(ours.matrix()).max()))
    if abs(ours.mass - theirs.mass) > _SAME * max(ours.mass, theirs.mass):
        yield f"{words} has the mass {ours.mass:g} instead of {theirs.mass:g}"
    elif scale and np.abs(ours.matrix() - theirs.matrix()).max() > _SAME * scale:
        yield f"{words} has another inertia"


def _of_joint(own: pin.Model, other: pin.Model, i: int, j: int) -> Iterator[str]:
    """Yield the differences between two joints."""
    ours, theirs = own.joints[i], other.joints[j]
    parents = own.names[own.parents[i]], other.names[other.parents[j]]
    if parents[0] != parents[1]:
        yield f"it is on {quoted(parents[0])} instead of {quoted(parents[1])}"
    at, other_placement = own.jointPlacements[i].homogeneous, other.jointPlacements[j].homogeneous
    if np.abs(at - other_placement).max() > _SAME * max(1.0, float(np.abs(other_placement).max())):
        yield "it has another placement"
    if ours.nq != theirs.nq or ours.nv != theirs.nv:
        yield f"it is of type {joint_kind(ours)} instead of {joint_kind(theirs)}"
        return
    if np.abs(axes_of(ours) - axes_of(theirs)).max() > _SAME:
        yield "it has another axis"
    q = [slice(joint.idx_q, joint.idx_q + joint.nq) for joint in (ours, theirs)]
    v = [slice(joint.idx_v, joint.idx_v + joint.nv) for joint in (ours, theirs)]
    if ours.nq == 1:
        for words in ("lowerPositionLimit", "upperPositionLimit"):
            if not _same_limits(getattr(own, words)[q[0]], getattr(other, words)[q[1]]):
                yield f"it has another {words}"
    if ours.nv == 1:  # Pinocchio drops these numbers of other joints.
        for words in ("upperVelocityLimit", "upperEffortLimit"):
            if not _same_limits(getattr(own, words)[v[0]], getattr(other, words)[v[1]]):
                yield f"it has another {words}"
        for words in ("damping", "upperDryFrictionLimit"):
            if not np.allclose(getattr(own, words)[v[0]], getattr(other, words)[v[1]], _SAME, 0.0):
                yield f"it has another {words}"


def _same_limits(ours: Array, theirs: Array) -> bool:
    """Return whether limits are equal; numbers that state no limit are equal."""
    ours, theirs = (
        np.where(np.isfinite(limit) & (np.abs(limit) < UNLIMITED), limit, 0.0)
        for limit in (ours, theirs)
    )
    return bool(np.allclose(ours, theirs, _SAME, 0.0))


def _of_mass_matrices(own: pin.Model, other: pin.Model, names: list[str]) -> Iterator[str]:
    """Yield a phrase if the mass matrices differ at random configurations."""
    rng, worst = np.random.default_rng(0), 0.0
    entries = [
        (own.joints[own.getJointId(name)], other.joints[other.getJointId(name)]) for name in names
    ]
    order = [k for joint, _ in entries for k in range(joint.idx_v, joint.idx_v + joint.nv)]
    other_order = [k for _, joint in entries for k in range(joint.idx_v, joint.idx_v + joint.nv)]
    data, other_data = own.createData(), other.createData()
    for _ in range(_SHAPES):
        q = pin.integrate(own, pin.neutral(own), rng.uniform(-1.0, 1.0, own.nv))
        other_q = pin.neutral(other)
        for ours, theirs in entries:
            value = q[ours.idx_q : ours.idx_q + ours.nq]
            other_q[theirs.idx_q : theirs.idx_q + theirs.nq] = value
        H, other_H = _mass_matrix(own, data, q), _mass_matrix(other, other_data, other_q)
        gap = np.abs(H[np.ix_(order, order)] - other_H[np.ix_(other_order, other_order)]).max()
        worst = max(worst, float(gap / max(np.abs(other_H).max(), 1e-300)))
    if not worst <= _SAME:
        yield f"the mass matrix differs by {worst:.2g} of its largest entry"


def _mass_matrix(model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Return the mass matrix without armature, which Pinocchio does not read."""
    upper = np.triu(pin.crba(model, data, q))
    return np.asarray(upper + np.triu(upper, 1).T - np.diag(model.armature))


def mass_difference(path: Path, robot: SdfRobot, folders: tuple[str, ...] = ()) -> float:
    """Return the largest relative difference between two mass matrices of an SDF robot.

    One is that of pinred's model, the other Drake's.  If the base floats, or the file welds it to
    the world, it floats in both; a welded base stays fixed if the file has springs.  Both matrices
    are those of the open tree.

    Drake rounds axes of joints within ROUNDED of x, y or z.  A difference up to ROUNDED is
    therefore no fault; without such axes it is round-off.

    Args:
        path: Path of the file.
        robot: The robot as pinred reads it.
        folders: Folders in which included models are searched.
    Returns:
        Largest difference over random positions, relative to the largest entry of the matrix.
    Raises:
        LoadError: Drake cannot read the untouched file, or lacks a joint or link.
        MissingPackageError: drake is not installed.
    """
    if replaced := [name for (_, name), (added, _) in robot.added.items() if added]:
        raise LoadError(f"Drake replaces inertias that no body has, of {listed(replaced, 6)}")
    plant = _plant(path, folders)
    pair = _Pair(plant, robot, path)
    rng = np.random.default_rng(0)
    return max(pair.difference(rng) for _ in range(3))


def _plant(path: Path, folders: tuple[str, ...]) -> Any:
    """Return Drake's plant of an untouched file, not finalised."""
    plants = optional_package("pydrake.multibody.plant", _WHY)
    parsing = optional_package("pydrake.multibody.parsing", _WHY)
    plant = plants.MultibodyPlant(0.0)
    paths = read_document(path, folders, tolerant=True).found
    with TemporaryDirectory(prefix="pinred-") as folder, drake_warnings():
        try:
            parsing.Parser(plant).AddModels(str(_with_paths(path, paths, Path(folder), {})))
        except Exception as error:  # Drake raises RuntimeError and other types.
            raise LoadError(f"Drake: {str(error).strip().splitlines()[0]}") from None
    return plant


def _with_paths(
    path: Path, found: Mapping[str, Path], folder: Path, copies: dict[Path, Path]
) -> Path:
    """Copy a file with paths in place of the URIs that it includes; return the path of the copy.

    Drake looks for models in other folders than Gazebo.

    Args:
        path: Path of the file.
        found: Path of the file that each URI names.
        folder: Folder of the copies.
        copies: Copies that exist, by their originals.
    Returns:
        Path of the copy.
    """
    if path not in copies:
        copies[path] = folder / f"{len(copies)}.sdf"

        def replaced(match: re.Match[str]) -> str:
            target = found.get(match[1].strip())
            if target is None:
                return match[0]
            if target.suffix in (".sdf", ".world", ".xml", ".model"):
                target = _with_paths(target, found, folder, copies)
            return f"<uri>file://{target.resolve()}</uri>"

        text = re.sub(r"<uri>([^<]*)</uri>", replaced, read_text(path))
        copies[path].write_text(text, "utf-8")
    return copies[path]


class _Pair:
    """A robot, and Drake's plant of the same file."""

    def __init__(self, plant: Any, robot: SdfRobot, path: Path) -> None:
        self._plant, self._robot = plant, robot
        try:
            self._bodies = {
                name: plant.GetBodyByName(key[1], plant.GetModelInstanceByName(key[0]))
                for name, key in robot.links.items()
            }
            self._joints = {
                name: plant.GetJointByName(key[1], plant.GetModelInstanceByName(key[0]))
                for name, key in robot.joints.items()
            }
        except RuntimeError as error:
            raise LoadError(f"Drake lacks a part of {plain_path(path)}: {error}") from None
        tree = {str(name) for name in robot.model.names}
        closing = [joint for name, joint in self._joints.items() if name not in tree]
        self._joints = {name: joint for name, joint in self._joints.items() if name in tree}
        bodies = {int(body.index()) for body in self._bodies.values()}
        joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
        ends = {
            int(joint.index()): {int(joint.parent_body().index()), int(joint.child_body().index())}
            for joint in joints
        }
        self._floats = bool(robot.base) and not any(
            0 in ends[int(joint.index())] for joint in self._joints.values()
        )
        if self._floats:
            welds = [
                joint
                for joint in joints
                if joint.type_name() == "weld"
                and 0 in ends[int(joint.index())]
                and not bodies.isdisjoint(ends[int(joint.index())])
            ]
            # Drake removes no joints from plants with springs; the base then stays fixed in both.
            self._floats = not welds or plant.num_force_elements() == 1
            closing += welds if self._floats else []
        # A cut weld has no name in the model.
        for loop in robot.loops:
            closing += [
                joint
                for joint in joints
                if joint.type_name() == "weld" and joint.name() == loop.name
            ]
        removed = {int(joint.index()) for joint in closing}
        actuators = [plant.get_joint_actuator(k) for k in plant.GetJointActuatorIndices()]
        try:
            for actuator in actuators:
                if int(actuator.joint().index()) in removed:
                    plant.RemoveJointActuator(actuator)
            for joint in closing:
                plant.RemoveJoint(joint)
            plant.Finalize()
        except Exception as error:
            raise LoadError(f"Drake: {str(error).strip().splitlines()[0]}") from None
        self._context = plant.CreateDefaultContext()
        self._model = robot.model
        if self._floats:
            self._model = rebuild(robot.model, root=pin.JointModelFreeFlyer())

    def difference(self, rng: np.random.Generator) -> float:
        """Return the relative difference at random positions."""
        plant, model, context = self._plant, self._model, self._context
        # T maps Drake's velocities to Pinocchio's.
        q, T = pin.neutral(model), np.zeros((model.nv, plant.num_velocities()))
        positions = plant.GetPositions(context).copy()
        for name, joint in self._joints.items():
            joint_model = model.joints[model.getJointId(name)]
            values = rng.uniform(-1.0, 1.0, joint.num_positions())
            start, size = joint.position_start(), joint.num_positions()
            positions[start : start + size] = values
            coordinates, rates = _converted(joint_model, values)
            q[joint_model.idx_q : joint_model.idx_q + joint_model.nq] = coordinates
            first = joint.velocity_start()
            T[
                joint_model.idx_v : joint_model.idx_v + joint_model.nv,
                first : first + joint.num_velocities(),
            ] = rates
        plant.SetPositions(context, positions)
        data = model.createData()
        if self._floats:
            # Drake may choose another base link; its velocities are angular, then linear, in the
            # axes of the world.
            name = next(name for name, body in self._bodies.items() if body.is_floating_base_body())
            base, frame = self._bodies[name], model.getFrameId(name, pin.FrameType.BODY)
            J = pin.computeFrameJacobian(model, data, q, frame)
            R = plant.EvalBodyPoseInWorld(context, base).rotation().matrix()
            first = int(base.floating_velocities_start_in_v())
            twists = np.zeros((6, plant.num_velocities()))
            twists[:3, first + 3 : first + 6] = twists[3:, first : first + 3] = R.T
            T[:6] = np.linalg.solve(J[:, :6], twists - J[:, 6:] @ T[6:])
        used = np.flatnonzero(np.abs(T).any(axis=0))
        upper = np.triu(pin.crba(model, data, q, pin.Convention.WORLD))
        H = upper + np.triu(upper, 1).T
        M = plant.CalcMassMatrix(context)[np.ix_(used, used)]
        own_matrix = T[:, used].T @ H @ T[:, used]
        return float(np.abs(own_matrix - M).max() / np.abs(M).max()) if M.size else 0.0


def _converted(joint: pin.JointModel, values: Array) -> tuple[Array, Array]:
    """Return Pinocchio's coordinates for Drake's, and the matrix from Drake's rates to its own."""
    kind = str(joint.shortname())
    if kind == "JointModelSpherical":
        # Drake's angular velocity of a ball is in the axes of the parent.
        R = pin.rpy.rpyToMatrix(*values)
        return pin.Quaternion(R).coeffs(), R.T
    if kind == "JointModelPlanar":
        c, s = np.cos(values[2]), np.sin(values[2])
        return np.array([*values[:2], c, s]), np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    return values, np.eye(len(values))
