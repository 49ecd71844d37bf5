"""Joints, base pose, momentum, energy and errors over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...common.argument_kinds import checks_arguments
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
from .motion_labels import labels
from .style import legend, line, on_log, over_time, shown, steady, styled

LINEAR, ANGULAR = "linear [N·s]", "angular [N·m·s]"


@checks_arguments
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
    names.require(1, "a plot of the shape")
    panels, x = names.panels(joints), motion.x
    if x.shape[-1] != len(names.joints):  # draw the rotation vectors of balls
        x = motion.system.space.chart(x)
    figure, axes_list = over_time(f"{names.robot}: shape", len(panels))
    for axes, panel in zip(axes_list, panels, strict=True):
        title = names.with_unit(panel[0]) if len(panel) == 1 else f"shape [{names.units[panel[0]]}]"
        _lines(axes, motion.t, x[:, panel], [shown(names.joints[k]) for k in panel], title)
    return figure


def _lines(axes: Axes, t: Array, values: Array, names: Sequence[str], title: str) -> None:
    """Draw the columns of `values`, (T, n), over time in one panel with a legend."""
    for k, (name, column) in enumerate(zip(names, values.T, strict=True)):
        axes.plot(t, column, label=name, **line(k))
    steady(axes, values)
    axes.set_ylabel(title)
    legend(axes)


@checks_arguments
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
    title = f"{names.robot}: pose of the base ({names.group})"
    quantities = {"position [m]": slice(0, k), attitude: slice(k, None)}
    return _quantities(title, motion.t, pose, group.pose_names, quantities)[0]


def _quantities(
    title: str, t: Array, values: Array, names: Sequence[str], columns: Mapping[str, slice],
    more: int = 0,
) -> tuple[Figure, list[Axes]]:  # fmt: skip
    """Draw quantities over time in one panel each.

    Args:
        title: Title of the figure.
        t: Times, (T,) [s].
        values: Values, (T, n).
        names: Names of the n columns.
        columns: Columns of each quantity, by name and unit; a quantity without columns is left out.
        more: Number of further, empty panels.
    Returns:
        The figure and its panels.
    """
    columns = {quantity: part for quantity, part in columns.items() if names[part]}
    figure, panels = over_time(title, len(columns) + more)
    for axes, (quantity, part) in zip(panels, columns.items(), strict=False):
        entries = names[part]
        label = quantity if len(entries) > 1 else f"{entries[0]}: {quantity}"
        _lines(axes, t, values[:, part], entries, label)
    return figure, panels


def continuous(pose: Array) -> Array:
    """Return poses (T, size) with quaternion signs chosen for continuity."""
    quaternion = pose[:, -4:]
    flips = np.sign(np.sum(quaternion[1:] * quaternion[:-1], axis=1))
    signs = np.cumprod(np.append(1.0, np.where(flips == 0.0, 1.0, flips)))
    return np.concatenate([pose[:, :-4], quaternion * signs[:, None]], axis=1)


@checks_arguments
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
    """Return error and bound, (T,) each, of the joint that is closest to its bound at each time."""
    if not errors.shape[1]:
        return np.zeros(len(errors)), np.zeros(len(errors))
    k = np.argmax(errors / bounds, axis=1)
    times = np.arange(len(errors))
    return errors[times, k], bounds[times, k]


@checks_arguments
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
    title = f"{names.robot}: spatial momentum"
    quantities = {LINEAR: slice(0, linear), ANGULAR: slice(linear, None)}
    figure, panels = _quantities(title, motion.t, values, group.momentum_names, quantities, more=1)
    if isinstance(motion, Trajectory):
        momenta = audit_trajectory(motion, motion.states).momenta[:, : group.dim]
        drift = _largest_by_quantity(momenta, linear)
        _drift_panel(panels[-1], motion, drift)
    else:
        _change_panel(
            panels[-1],
            motion.t,
            _largest_by_quantity(values - values[0], linear),
            FIELDS["spatial_momentum"].unit,
        )
    return figure


@checks_arguments
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
    drawn, entries = motion.energy[:, None], ["energy"]
    if isinstance(motion, Trajectory):
        balance = motion.energy_balance
        drawn = np.hstack([drawn, balance.work])
        entries += [f"work of {label}" for label in balance.labels]
        _drift_panel(bottom, motion, {"energy": audit_trajectory(motion, motion.states).energies})
    else:
        _change_panel(
            bottom, motion.t, {"energy": motion.energy - motion.energy[0]}, FIELDS["energy"].unit
        )
    _lines(top, motion.t, drawn, entries, f"energy [{FIELDS['energy'].unit}]")
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
