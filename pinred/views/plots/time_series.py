"""Joints and base pose over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ...common.arrays import Array
from ...common.errors import InputError
from ...lie.groups import group_named
from ..motion_source import MotionSource
from .motion_labels import Labels, labels
from .style import legend, line, over_time, shown, steady, styled


@styled
def shape(motion: MotionSource, *, joints: Sequence[str | int] | None = None) -> Figure:
    """Draw the joints over time, in one panel for each branch if there are many.

    Args:
        motion: Trajectory, or a recording read from a file.
        joints: Names or indices of joints; all if None.
    Returns:
        The figure.
    Raises:
        InputError: Unknown joints, or a robot without joints.
    """
    names = labels(motion)
    require_joints(names, 1, "a plot of the shape")
    panels = names.panels(joints)
    figure, axes_list = over_time(f"{names.robot}: shape", len(panels))
    for axes, panel in zip(axes_list, panels, strict=True):
        for k, joint in enumerate(panel):
            axes.plot(motion.t, motion.x[:, joint], label=shown(names.joints[joint]), **line(k))
        steady(axes, motion.x[:, panel])
        axes.set_ylabel(
            f"{names.joints[panel[0]]} [{names.units[panel[0]]}]"
            if len(panel) == 1
            else f"shape [{names.units[panel[0]]}]"
        )
        legend(axes)
    return figure


@styled
def base(motion: MotionSource) -> Figure:
    """Draw the pose of the base over time: position, and angle or quaternion.

    Quaternions q and −q are the same orientation; signs are chosen so that curves are continuous.

    Args:
        motion: Trajectory, or a recording read from a file.
    Returns:
        The figure.
    Raises:
        InputError: The base was left out.
    """
    names = labels(motion)
    group = group_named(names.group)
    k, pose = group.linear, continuous(motion.pose) if group.turns == 3 else motion.pose
    attitude = "quaternion [1]" if group.turns == 3 else "angle [rad]"
    quantities = [("position [m]", group.pose_names[:k]), (attitude, group.pose_names[k:])]
    quantities = [(quantity, entries) for quantity, entries in quantities if entries]
    figure, panels = over_time(f"{names.robot}: pose of the base ({names.group})", len(quantities))
    first = 0
    for axes, (quantity, entries) in zip(panels, quantities, strict=True):
        for k, entry in enumerate(entries):
            axes.plot(motion.t, pose[:, first + k], label=entry, **line(k))
        steady(axes, pose[:, first : first + len(entries)])
        axes.set_ylabel(quantity if len(entries) > 1 else f"{entries[0]}: {quantity}")
        legend(axes)
        first += len(entries)
    return figure


def continuous(pose: Array) -> Array:
    """Return poses (T, size) with quaternion signs chosen for continuity."""
    quaternion = pose[:, -4:]
    flips = np.sign(np.sum(quaternion[1:] * quaternion[:-1], axis=1))
    signs = np.cumprod(np.append(1.0, np.where(flips == 0.0, 1.0, flips)))
    return np.concatenate([pose[:, :-4], quaternion * signs[:, None]], axis=1)


def require_joints(names: Labels, least: int, what: str) -> None:
    """Raise InputError if a robot has fewer joints than a plot needs."""
    if len(names.joints) < least:
        raise InputError(
            f"{what} needs a robot with at least {least} joint{'s' * (least > 1)}, "
            f"but '{names.robot}' has {len(names.joints)}"
        )
