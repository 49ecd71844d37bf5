"""mass_difference(): an SDF robot against Drake's own reading of the untouched file.

Only the names of joints and links, and the paths of included files, come from pinred.  Drake reads
the file itself, without the copies of `sdf_document`, and computes the mass matrix at random
positions of all joints.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import LoadError
from ..common.names import listed, plain_path
from ..common.optional_packages import optional_package
from .read_sdf import INSTALL, SdfRobot, drake_warnings
from .rebuild import rebuild
from .robot_files import read_text
from .sdf_document import read_document

ROUNDED = 2e-8  # deviation of an axis from x, y or z, below which Drake rounds it
_WHY = f"the comparison needs Drake: {INSTALL}"


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
    found = read_document(path, folders, tolerant=True).found
    with TemporaryDirectory(prefix="pinred-") as folder, drake_warnings():
        try:
            parsing.Parser(plant).AddModels(str(_with_paths(path, found, Path(folder), {})))
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
            own = model.joints[model.getJointId(name)]
            values = rng.uniform(-1.0, 1.0, joint.num_positions())
            start, size = joint.position_start(), joint.num_positions()
            positions[start : start + size] = values
            coordinates, rates = _converted(own, values)
            q[own.idx_q : own.idx_q + own.nq] = coordinates
            first = joint.velocity_start()
            T[own.idx_v : own.idx_v + own.nv, first : first + joint.num_velocities()] = rates
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
