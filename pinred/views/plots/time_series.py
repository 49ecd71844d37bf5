"""Joints, base pose, momentum, energy and errors over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...common.arrays import Array
from ...common.errors import InputError
from ...judge.audit import audit_trajectory
from ...judge.compare import DRIFT_BOUND, compare
from ...judge.verdict import Report
from ...lie.groups import group_named
from ...simulation.recording import Recording
from ...simulation.trajectory import Trajectory
from ...system.state_fields import FIELDS
from ..motion_source import MotionSource
from .motion_labels import Labels, labels
from .style import legend, line, on_log, over_time, shown, steady, styled

_TWIST_TO_MOMENTUM = str.maketrans("vω", "pL")  # twist component → momentum component
LINEAR, ANGULAR = "linear [N·s]", "angular [N·m·s]"


@styled
def shape(motion: MotionSource, *, joints: Sequence[str | int] | None = None) -> Figure:
    """Draw the joint values over time; many joints get one panel for each branch of the robot.

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


@styled
def error(compared: Report | Trajectory) -> Figure:
    """Draw the errors of shape, rotation and position over time on a logarithmic axis.

    Thin lines are the bounds of `compare`.

    Args:
        compared: Report of `compare`, or a Trajectory, which is compared first.
    Returns:
        The figure.
    Raises:
        InputError: `compared` is not a Report or a Trajectory; a recording stores no forces to
            compare with.
    """
    if isinstance(compared, Trajectory):
        compared = compare(compared)
    if isinstance(compared, Recording):
        raise InputError(
            f"{compared.path} contains no forces, so the full simulation cannot be run; "
            "plot the error of the robot or of its scene file"
        )
    if not isinstance(compared, Report):
        raise InputError(
            f"a plot of the error takes the Report of compare, or a Trajectory, "
            f"got {type(compared).__name__}"
        )
    figure, (axes,) = over_time(f"{compared.robot}: reduced equations against full ABA", 1)
    series = [
        ("shape [rad | m]", *_largest(compared.shape_errors, compared.shape_bounds)),
        ("rotation [rad]", compared.rotation_errors, compared.rotation_bounds),
        ("position [m]", compared.position_errors, compared.position_bounds),
    ]
    for k, (name, values, bounds) in enumerate(series):
        if values.any():
            thin = {**line(k), "linewidth": 0.7}
            axes.plot(compared.t, on_log(values), label=name, **line(k))
            axes.plot(compared.t, on_log(bounds), label=f"allowed, {name.split()[0]}", **thin)
    axes.set_yscale("log")
    axes.set_ylabel("error [rad | m]")
    legend(axes)
    figure.set_figheight(3.2)
    return figure


def _largest(errors: Array, bounds: Array) -> tuple[Array, Array]:
    """Return the error (T,) of the joint closest to its bound at each time, and that bound."""
    if not errors.shape[1]:
        return np.zeros(len(errors)), np.zeros(len(errors))
    k = np.argmax(errors / bounds, axis=1)
    times = np.arange(len(errors))
    return errors[times, k], bounds[times, k]


@styled
def momentum(motion: MotionSource) -> Figure:
    """Draw the spatial momentum over time, and its drift on a logarithmic axis.

    The momentum is expressed in the root joint's fixed frame, about its origin. The drift is the
    largest change of a linear component, and of an angular component. For a Trajectory it is the
    relative drift that `compare` reports: Pinocchio computes the momentum from q and v, and the
    effects of free fall and of impulses are subtracted. If the group contains translations, the
    angular momentum is then about the centre of mass. For a recording the drift is the change since
    the start.

    Args:
        motion: Trajectory, or a recording read from a file.
    Returns:
        The figure.
    Raises:
        InputError: The motion was simulated without its base (outputs="shape").
    """
    names = labels(motion)
    group = group_named(names.group)
    linear, values = group.linear, motion.spatial_momentum
    entries = [name.translate(_TWIST_TO_MOMENTUM) for name in group.twist_names]
    quantities = [(LINEAR, range(linear)), (ANGULAR, range(linear, len(entries)))]
    quantities = [(quantity, columns) for quantity, columns in quantities if len(columns)]
    figure, panels = over_time(f"{names.robot}: spatial momentum", len(quantities) + 1)
    for axes, (quantity, columns) in zip(panels, quantities, strict=False):
        for k, entry in enumerate(columns):
            axes.plot(motion.t, values[:, entry], label=entries[entry], **line(k))
        steady(axes, values[:, list(columns)])
        axes.set_ylabel(f"{entries[columns[0]]}: {quantity}" if len(columns) == 1 else quantity)
        legend(axes)
    if isinstance(motion, Trajectory):
        drift = _largest_by_quantity(audit_trajectory(motion, motion.states).momenta, linear)
        _drift_panel(panels[-1], motion, drift)
    else:
        _change_panel(
            panels[-1],
            motion.t,
            _largest_by_quantity(values - values[0], linear),
            FIELDS["spatial_momentum"].unit,
        )
    return figure


@styled
def energy(motion: MotionSource) -> Figure:
    """Draw the energy over time, and its drift on a logarithmic axis.

    For a Trajectory the drift is that of `compare`: Pinocchio computes the energy from q and v,
    and the work of forces without potential is subtracted; the drift is relative to the largest
    kinetic energy about the centre of mass. For a recording it is the change since the start.

    Args:
        motion: Trajectory, or a recording read from a file.
    Returns:
        The figure.
    Raises:
        InputError: The base was left out of a Trajectory.
    """
    names = labels(motion)
    figure, panels = over_time(f"{names.robot}: energy", 2)
    top, bottom = panels
    top.plot(motion.t, motion.energy, label="energy", **line(0))
    drawn = [motion.energy]
    if isinstance(motion, Trajectory):
        balance = motion.energy_balance
        for k, label in enumerate(balance.labels, start=1):
            top.plot(motion.t, balance.work[:, k - 1], label=f"work of {label}", **line(k))
            drawn.append(balance.work[:, k - 1])
        _drift_panel(bottom, motion, {"energy": audit_trajectory(motion, motion.states).energies})
    else:
        _change_panel(
            bottom, motion.t, {"energy": motion.energy - motion.energy[0]}, FIELDS["energy"].unit
        )
    steady(top, np.concatenate(drawn))
    top.set_ylabel(f"energy [{FIELDS['energy'].unit}]")
    legend(top)
    return figure


def _largest_by_quantity(values: Array, linear: int) -> dict[str, Array]:
    """Return over time the largest linear and largest angular component of `values`, (T, r)."""
    quantities = {"linear": values[:, :linear], "angular": values[:, linear:]}
    return {
        name: np.abs(columns).max(axis=1) for name, columns in quantities.items() if columns.size
    }


def _drift_panel(axes: Axes, traj: Trajectory, drift: dict[str, Array]) -> None:
    _log_lines(axes, traj.t, drift)
    allowed = DRIFT_BOUND * (traj.scene.rtol + traj.scene.atol)
    axes.axhline(allowed, color="#888888", linewidth=1.0, label="allowed")
    axes.set_ylabel("drift [relative]")
    legend(axes)


def _change_panel(axes: Axes, t: Array, change: dict[str, Array], unit: str) -> None:
    _log_lines(axes, t, change)
    axes.set_ylabel(f"change since start\n[{unit}]")
    legend(axes)


def _log_lines(axes: Axes, t: Array, series: dict[str, Array]) -> None:
    for k, (name, values) in enumerate(series.items()):
        axes.plot(t, on_log(values), label=name, **line(k))
    axes.set_yscale("log")
    if not any(values.any() for values in series.values()):
        axes.set_ylim(1e-17, 1e-7)
        axes.text(0.5, 0.3, "exactly zero", transform=axes.transAxes, ha="center")
