"""What views read of a motion: its labels, its path on fine times, and its state at one time.

A motion is simulated, or a recording that was read from a file.  Labels are the names and units of
a robot and its joints, with the joints grouped into panels of figures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ..common.arrays import Array
from ..common.errors import InputError, LoadError
from ..simulation.read_recording import Recording
from ..simulation.trajectory import Trajectory
from ..system.state_fields import FIELDS, ShapeState, State, map_arrays
from ..system.system import System

if TYPE_CHECKING:
    from ..analysis.connections.connection import Connection

MotionSource: TypeAlias = Trajectory | Recording


FEW = 6  # largest number of joints that share a panel even if they are on different branches
MOST = 8  # largest number of lines in a panel
_SMALL = 4  # largest total number of joints of branches that share a panel


@dataclass(frozen=True)
class Labels:
    """Labels of a motion.

    Attributes:
        robot: Name of the robot.
        group: Name of the symmetry group.
        joints: Names of the joints, (m,).
        units: Units of the joints, (m,).
        limbs: Indices of the joints of each unbranched chain.
    """

    robot: str
    group: str
    joints: tuple[str, ...]
    units: tuple[str, ...]
    limbs: tuple[tuple[int, ...], ...]

    def index(self, joint: str | int) -> int:
        """Return the index of a joint in the shape; raise InputError if it does not exist."""
        if isinstance(joint, str):
            if joint not in self.joints:
                raise InputError(
                    f"'{self.robot}' has no joint '{joint}'; its joints are {self._listed()}"
                )
            return self.joints.index(joint)
        if isinstance(joint, bool) or not 0 <= joint < len(self.joints):
            raise InputError(
                f"joint index {joint!r} is out of range for {len(self.joints)} joints, counted "
                "from 0"
            )
        return int(joint)

    def indices(self, joints: Sequence[str | int] | str | int) -> list[int]:
        """Return the indices of distinct joints; raise InputError otherwise."""
        names = [joints] if isinstance(joints, (str, int)) else list(joints)
        indices = [self.index(joint) for joint in names]
        if not indices or len(set(indices)) != len(indices):
            raise InputError(f"joints must be one or more distinct joints, got {names}")
        return indices

    def require(self, least: int, what: str) -> None:
        """Raise InputError if there are fewer joints than a plot needs."""
        if len(self.joints) < least:
            raise InputError(
                f"{what} needs a robot with at least {least} joint{'s' * (least > 1)}, "
                f"but '{self.robot}' has {len(self.joints)}"
            )

    def pair(
        self, joints: Sequence[str | int] | None, what: str, path: Array | None = None
    ) -> list[int]:
        """Return the indices of two joints.

        Args:
            joints: The joints; if None, the two that move most on the path, or else the first two.
            what: Name of the plot in messages.
            path: Shapes over time, (T, m), or None.
        Raises:
            InputError: There are fewer than two joints, or other than two are given.
        """
        self.require(2, what)
        pair = self.indices(moving_most(path, 2) if joints is None else joints)
        if len(pair) != 2:
            raise InputError(f"joints: expected two joints for {what}, got {len(pair)}")
        return pair

    def with_unit(self, joint: int) -> str:
        """Return the name and the unit of a joint, for an axis."""
        return f"{self.joints[joint]} [{self.units[joint]}]"

    def panels(self, joints: Sequence[str | int] | str | int | None = None) -> list[list[int]]:
        """Group joints into panels; a panel has one unit, and one branch or several small ones."""
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


def moving_most(path: Array | None, count: int) -> list[int]:
    """Return the joints with the largest range on a path, (T, m), in order of the shape.

    Joints whose ranges are equal up to round-off, or all without a path, count in order.
    """
    if path is None:
        return list(range(count))
    ranges = np.ptp(path, axis=0)
    close = np.round(ranges / max(float(ranges.max(initial=0.0)), 1e-300), 6)
    return sorted(np.argsort(-close, kind="stable")[:count].tolist())


def labels(motion: MotionSource) -> Labels:
    """Return the labels of a motion; raise InputError for another type."""
    if isinstance(motion, Trajectory):
        return labels_of(motion.system)
    if not isinstance(motion, Recording):
        raise InputError(
            f"a plot over time takes a Trajectory, or a recording from read_recording, "
            f"got {type(motion).__name__}"
        )
    system = robot_of(motion)
    if system is not None:
        return labels_of(system)
    indices = tuple(range(len(motion.joints)))
    limbs = tuple(indices[i : i + MOST] for i in range(0, len(indices), MOST))
    # Without the robot, units are ambiguous.  Balls are drawn by their rotation vectors [rad].
    units = (FIELDS["x"].unit.removesuffix(" | 1"),) * len(indices)
    return Labels(motion.robot, motion.group, motion.joints, units, limbs)


def robot_of(motion: MotionSource) -> System | None:
    """Return the robot of a motion, or None if the robot of a recording is not found.

    Raises InputError if the robot does not match the recording.
    """
    try:
        return motion.system
    except LoadError:
        return None


def labels_of(system: System) -> Labels:
    """Return the labels of a system."""
    limbs = _limbs(system)
    return Labels(system.name, system.group.name, system.shape_names, system.units, limbs)


def labels_of_connection(connection: Connection) -> Labels:
    """Return the labels of a connection; it has no branches."""
    form = connection.form
    return Labels(repr(connection), form.group.name, form.joints, form.units, ())


def _limbs(system: System) -> tuple[tuple[int, ...], ...]:
    """Group the joints into unbranched chains."""
    parents = [_parent_joint(system, i) for i in system.joints]
    chains: list[list[int]] = []
    for k, parent in enumerate(parents):
        if k > 0 and parent == k - 1 and parents.count(parent) == 1:
            chains[-1].append(k)
        else:
            chains.append([k])
    return tuple(map(tuple, chains))


def _parent_joint(system: System, joint: int) -> int:
    """Return the shape index of the next joint towards the root; −1 for the root itself."""
    parent = int(system.model.parents[joint])
    while parent > 1 and parent not in system.joints:
        parent = int(system.model.parents[parent])
    return system.joints.index(parent) if parent > 1 else -1


Path: TypeAlias = State | ShapeState
_PARTS = 8  # number of subdivisions of each integration step


def fine_times(motion: MotionSource) -> Array:
    """Return a fine time grid from start to end, (T,) [s].

    The grid subdivides the integration steps of a Trajectory, or the report intervals of a
    recording.
    """
    knots = motion.t
    if isinstance(motion, Trajectory):
        ends = np.append(motion.motion.knots, [0.0, motion.scene.end])
        knots = np.unique(np.clip(ends, 0.0, motion.scene.end))
    offsets = np.arange(_PARTS) / _PARTS
    return np.append((knots[:-1, None] + offsets * np.diff(knots)[:, None]).ravel(), knots[-1])


def fine_path(motion: MotionSource) -> Path:
    """Return the states at the report times and, for a Trajectory, on the fine time grid."""
    if not isinstance(motion, Trajectory):
        return motion.outputs
    t, times = motion.t, fine_times(motion)
    return motion.at(np.union1d(t, times[(times >= t[0]) & (times <= t[-1])]))


def charted_path(motion: MotionSource) -> Path:
    """Return fine_path with a coordinate for each rate, and the derivatives of these coordinates.

    Balls have rotation vectors.  LoadError if a recording has balls and its robot is not found.
    """
    path = fine_path(motion)
    if path.x.shape[-1] == path.xdot.shape[-1]:
        return path
    space = motion.system.space
    w = space.chart(path.x)
    return replace(path, x=w, xdot=space.chart_rate(w, path.xdot))


def state_at(motion: MotionSource, time: float) -> Path:
    """Return the state at a time, or at the nearest report time of a recording.

    Args:
        motion: The motion.
        time: Time [s].
    Raises:
        InputError: The time is outside the motion.
    """
    if isinstance(motion, Trajectory):
        return motion.at(time)
    t, states = motion.t, motion.outputs
    if not 0.0 <= time <= t[-1]:
        raise InputError(f"when must lie between 0 and {t[-1]:g} s, got {time}")
    k = int(np.argmin(np.abs(t - time)))
    return map_arrays(lambda values: np.array(values[k]), states)


def shape_path(motion: MotionSource) -> Callable[[Array], tuple[Array, Array]]:
    """Return the function from times (T,) to coordinates and their derivatives, (T, m) each.

    A recording is interpolated with cubic Hermite splines (shapes have order 4, rates order 3).

    Args:
        motion: The motion.
    Raises:
        InputError: A recording with a single time has no path.
    """
    if len(motion.t) < 2 and not isinstance(motion, Trajectory):
        raise InputError(f"{motion.path} contains only one time, so it has no path")
    path = charted_path(motion)
    if isinstance(motion, Trajectory):
        space = motion.system.space

        def dense(t: Array) -> tuple[Array, Array]:
            states = motion.at(t)
            near = np.clip(np.searchsorted(path.t, t), 0, len(path.t) - 1)
            w = space.chart(states.x, near=path.x[near])
            return w, space.chart_rate(w, states.xdot)

        return dense
    x = CubicHermiteSpline(motion.t, path.x, path.xdot)
    xdot = x.derivative()
    return lambda t: (np.asarray(x(t)), np.asarray(xdot(t)))
