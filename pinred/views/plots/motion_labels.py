"""Names of the numbers of a motion: robot, group, joints, units, and which stand together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...common.errors import InputError, LoadError
from ...simulation.recording import Recording
from ...simulation.trajectory import Trajectory
from ...system.state_fields import FIELDS
from ...system.system import System
from ..motion_source import MotionSource

FEW = 6  # joints that share a panel whatever they are
MOST = 8  # lines that a panel can bear
_SMALL = 4  # limbs of fewer joints in all share a panel


@dataclass(frozen=True)
class Labels:
    """Names of a motion.  units: of each joint.  limbs: indices of joints in one row."""

    robot: str
    group: str
    joints: tuple[str, ...]
    units: tuple[str, ...]
    limbs: tuple[tuple[int, ...], ...]

    def index(self, joint: str | int) -> int:
        """Return where a joint stands in the shape.  Raises InputError."""
        if isinstance(joint, str):
            if joint not in self.joints:
                raise InputError(
                    f"'{self.robot}' has no joint '{joint}'; its joints are {self._listed()}"
                )
            return self.joints.index(joint)
        if isinstance(joint, bool) or not 0 <= joint < len(self.joints):
            raise InputError(f"joint {joint!r} is not among the {len(self.joints)} joints from 0")
        return int(joint)

    def indices(self, joints: Sequence[str | int] | str | int) -> list[int]:
        """Return where some joints stand, each once.  Raises InputError."""
        given = [joints] if isinstance(joints, (str, int)) else list(joints)
        found = [self.index(joint) for joint in given]
        if not found or len(set(found)) != len(found):
            raise InputError(f"joints must be different ones, at least one, got {given}")
        return found

    def panels(self, joints: Sequence[str | int] | str | int | None = None) -> list[list[int]]:
        """Return which joints share a panel: one unit, one limb or a few small ones."""
        if joints is not None:
            groups = [self.indices(joints)]
        elif len(self.joints) <= FEW:
            groups = [list(range(len(self.joints)))]
        else:
            groups = []
            for limb in self.limbs:
                if groups and len(groups[-1]) + len(limb) <= _SMALL:
                    groups[-1].extend(limb)
                else:
                    groups.append(list(limb))
        panels = []
        for group in groups:
            for unit in dict.fromkeys(self.units[k] for k in group):
                same = [k for k in group if self.units[k] == unit]
                panels += [same[i : i + MOST] for i in range(0, len(same), MOST)]
        return panels

    def _listed(self) -> str:
        return ", ".join(self.joints) or "none"


def labels(motion: MotionSource) -> Labels:
    """Return the labels of a motion.  Raises InputError for anything else."""
    if isinstance(motion, Trajectory):
        return labels_of(motion.system)
    if not isinstance(motion, Recording):
        raise InputError(
            f"a plot over time takes a Trajectory, or what read_recording makes of a npz file, "
            f"got {type(motion).__name__}"
        )
    system = robot_of(motion)
    if system is not None:
        return labels_of(system)
    row = tuple(range(len(motion.joints)))
    limbs = tuple(row[i : i + MOST] for i in range(0, len(row), MOST))
    units = (FIELDS["x"].unit,) * len(row)  # only the robot says which
    return Labels(motion.robot, motion.group, motion.joints, units, limbs)


def robot_of(motion: MotionSource) -> System | None:
    """Return the robot of a motion, or None if that of a file cannot be found.

    Raises InputError if it is not the one that moved.
    """
    try:
        return motion.system
    except LoadError:
        return None


def labels_of(system: System) -> Labels:
    """Return the labels of a system."""
    limbs = _limbs(system)
    return Labels(system.name, system.group.name, system.shape_names, system.units, limbs)


def _limbs(system: System) -> tuple[tuple[int, ...], ...]:
    """Return the joints in unbranched rows."""
    parents = [_before(system, i) for i in system.joints]
    rows: list[list[int]] = []
    for k, parent in enumerate(parents):
        follows = k > 0 and parent == k - 1 and parents.count(parent) == 1
        if follows:
            rows[-1].append(k)
        else:
            rows.append([k])
    return tuple(map(tuple, rows))


def _before(system: System, joint: int) -> int:
    """Return the shape coordinate that moves what a joint hangs on; −1 for the root."""
    at = int(system.model.parents[joint])
    while at > 1 and at not in system.joints:
        at = int(system.model.parents[at])
    return system.joints.index(at) if at > 1 else -1
