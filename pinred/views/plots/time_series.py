"""Joints, base pose, momentum, energy and errors over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, TypeAlias, get_args

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
from ...lie.rotations import rotation, unwrapped_rotation_vectors
from ...simulation.read_recording import Recording
from ...simulation.trajectory import Trajectory
from ...system.passive import joint_limits
from ...system.state_fields import FIELDS
from ..motion_source import Labels, MotionSource, labels
from .style import legend, line, on_log, over_time, shown, steady, styled

Attitudes: TypeAlias = Literal["quaternion", "vector", "rpy"]
ATTITUDES: tuple[Attitudes, ...] = get_args(Attitudes)
_NAMED = 6  # largest number of joints that the legend of a panel of `limits` names
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
    names = _labels_of_joints(motion, "shape")
    return _by_joint(motion, names, "shape", _chart(motion, names), names.units, joints, "shape ")


@checks_arguments
@styled
def rates(motion: MotionSource, *, joints: Sequence[str | int] | None = None) -> Figure:
    """Draw the joint rates over time, in the panels of `shape`.

    Args:
        motion: Trajectory, or a recording read from a file.
        joints: Names or indices of joints; all if None.
    Returns:
        The figure.
    Raises:
        InputError: Unknown joints, or a robot without joints.
    """
    names = _labels_of_joints(motion, "rates")
    units = [f"{unit}/s" for unit in names.units]
    return _by_joint(motion, names, "joint rates", motion.xdot, units, joints)


@checks_arguments
@styled
def torques(traj: Trajectory, *, joints: Sequence[str | int] | None = None) -> Figure:
    """Draw the torques on the joints over time (`Trajectory.torques`), in the panels of `shape`.

    Args:
        traj: Trajectory; a recording has no forces.
        joints: Names or indices of joints; all if None.
    Returns:
        The figure.
    Raises:
        InputError: Unknown joints, a robot without joints, or a recording.
    """
    if not isinstance(traj, Trajectory):
        raise InputError(
            f"a plot of the torques takes a Trajectory, got {type(traj).__name__}, which has no "
            "forces. Plot the torques of the robot or of its scene file"
        )
    names = _labels_of_joints(traj, "torques")
    units = ["N" if unit == "m" else "N·m" for unit in names.units]
    return _by_joint(traj, names, "joint torques", traj.torques, units, joints)


def _labels_of_joints(motion: MotionSource, quantity: str) -> Labels:
    """Return the labels of a motion.  Raises InputError for a robot without joints."""
    names = labels(motion)
    names.require(1, f"a plot of the {quantity}")
    return names


def _chart(motion: MotionSource, names: Labels) -> Array:
    """Return the joint values, (T, m), with the rotation vectors of balls."""
    x = motion.x
    return x if x.shape[-1] == len(names.joints) else motion.system.space.chart(x)


def _with_impacts(figure: Figure, motion: MotionSource) -> Figure:
    """Mark the times of impacts at joint stops in all panels."""
    times = motion.impacts.times
    for axes in figure.axes if len(times) else []:
        bottom, top = axes.get_ylim()
        axes.vlines(times, bottom, top, colors="0.75", linewidths=0.6, zorder=0, label="_impacts")
        axes.set_ylim(bottom, top)
    return figure


def _by_joint(
    motion: MotionSource, names: Labels, quantity: str, values: Array, units: Sequence[str],
    joints: Sequence[str | int] | None, what: str = "",
) -> Figure:  # fmt: skip
    """Draw values by joint, (T, m), over time in the panels of `shape`; `what` labels a panel."""
    panels = names.panels(joints)
    drawing, axes_list = over_time(f"{names.robot}: {quantity}", len(panels))
    for axes, panel in zip(axes_list, panels, strict=True):
        label = f"{names.joints[panel[0]]} " if len(panel) == 1 else what
        entries = [shown(names.joints[k]) for k in panel]
        _lines(axes, motion.t, values[:, panel], entries, f"{label}[{units[panel[0]]}]")
    return _with_impacts(drawing, motion)


@checks_arguments
@styled
def limits(motion: MotionSource, *, joints: Sequence[str | int] | None = None) -> Figure:
    """Draw positions, rates and torques over time, relative to the limits of the robot's file.

    1 is the upper and −1 the lower limit.  A rate or torque is divided by its limit; a position is
    measured from the middle between its limits.  Joints without a limit are left out, and so are
    the torques of recordings.  The title names the largest value; the legend of a panel names the
    joints with the largest ones, and the others are grey.

    Args:
        motion: Trajectory, or a recording read from a file.
        joints: Names or indices of joints; all with limits if None.
    Returns:
        The figure.
    Raises:
        InputError: Unknown joints, or the file states no limits of them.
        LoadError: The robot of a recording is not found.
    """
    names, stated = labels(motion), joint_limits(motion.system)
    chosen = [*range(len(names.joints))] if joints is None else names.indices(joints)
    x = _chart(motion, names)
    quantities = {"position": (x, stated.position), "rate": (motion.xdot, stated.rate)}
    if isinstance(motion, Trajectory):
        quantities["torque"] = (motion.torques, stated.effort)
    panels: dict[str, tuple[Array, list[str]]] = {}
    for quantity, (values, ends) in quantities.items():
        kept = [k for k in chosen if np.isfinite(ends[k]).any()]
        if kept:
            share = _share_of_limits(values[:, kept], ends[kept], quantity == "position")
            panels[quantity] = share, [names.joints[k] for k in kept]
    if not panels:
        raise InputError(
            f"the file of '{names.robot}' states no limits of {', '.join(names.joints) or 'joints'}"
        )
    excess = max(
        (float(np.abs(share).max()), f"{quantity} of {joint[np.abs(share).max(axis=0).argmax()]}")
        for quantity, (share, joint) in panels.items()
    )
    words = f"largest {excess[0]:.3g} of the limit, {excess[1]}"
    drawing, axes_list = over_time(f"{names.robot}: limits of the file ({words})", len(panels))
    for axes, (quantity, (share, entries)) in zip(axes_list, panels.items(), strict=True):
        order = np.argsort(-np.abs(share).max(axis=0), kind="stable")
        named = sorted(order[:_NAMED].tolist())
        for k, column in enumerate(share.T):
            if k not in named:
                axes.plot(motion.t, column, color="#AAAAAA", linewidth=0.7)
        for style, k in enumerate(named):
            axes.plot(motion.t, share[:, k], label=shown(entries[k]), **line(style))
        if unnamed := len(entries) - len(named):
            axes.plot([], [], color="#AAAAAA", linewidth=0.7, label=f"{unnamed} others")
        for end in (-1.0, 1.0):
            axes.axhline(end, color="#888888", linewidth=1.0)
        axes.set_ylabel(f"{quantity} / limit")
        legend(axes)
    return drawing


def _share_of_limits(values: Array, ends: Array, from_middle: bool) -> Array:
    """Return values (T, n) as shares of their limits (n, 2): 1 at the upper, −1 at the lower."""
    low, high = ends.T
    if from_middle:
        both = np.isfinite(ends).all(axis=1)
        middle = np.where(both, 0.5 * (np.where(both, low, 0.0) + np.where(both, high, 0.0)), 0.0)
        values, low, high = values - middle, low - middle, high - middle
    size = np.where(values >= 0.0, np.abs(high), np.abs(low))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(values == 0.0, 0.0, values / size)
    return np.asarray(share)


def _lines(axes: Axes, t: Array, values: Array, names: Sequence[str], title: str) -> None:
    """Draw the columns of `values`, (T, n), over time in one panel with a legend."""
    for k, (name, column) in enumerate(zip(names, values.T, strict=True)):
        axes.plot(t, column, label=name, **line(k))
    steady(axes, values)
    axes.set_ylabel(title)
    legend(axes)


@checks_arguments
@styled
def base(motion: MotionSource, *, attitude: Attitudes = "quaternion") -> Figure:
    """Draw the pose of the base over time: position, and angle or attitude.

    Quaternions q and −q are the same orientation; signs are chosen so that curves are continuous.
    Roll, pitch and yaw are R = Rz(yaw) Ry(pitch) Rx(roll).

    Args:
        motion: Trajectory, or a recording read from a file.
        attitude: "quaternion", or "vector" for the rotation vector or "rpy" for roll, pitch and
            yaw, both in degrees; a planar angle is then in degrees, too.
    Returns:
        The figure.
    Raises:
        InputError: The base was left out, or `attitude` is unknown.
    """
    if attitude not in ATTITUDES:
        raise InputError(f"attitude: expected {' or '.join(ATTITUDES)}, got {attitude!r}")
    names = labels(motion)
    group = group_named(names.group)
    k, pose, entries = group.linear, motion.pose, group.pose_names
    label = "quaternion [1]" if group.turns == 3 else "angle [rad]"
    if group.turns == 3:
        pose = continuous(pose)
    if attitude != "quaternion" and group.turns:
        angles, label, words = _in_degrees(pose[:, k:], attitude)
        pose, entries = np.column_stack([pose[:, :k], angles]), (*entries[:k], *words)
    title = f"{names.robot}: pose of the base ({names.group})"
    quantities = {"position [m]": slice(0, k), label: slice(k, None)}
    return _quantities(title, motion.t, pose, entries, quantities)[0]


def _in_degrees(attitude: Array, kind: Attitudes) -> tuple[Array, str, tuple[str, ...]]:
    """Return angles (T, 1 or 3) in degrees, their axis label, and the names of the columns."""
    if attitude.shape[1] == 1:
        return np.rad2deg(attitude), "angle [°]", ("θ",)
    if kind == "vector":
        vectors = unwrapped_rotation_vectors(attitude)
        return np.rad2deg(vectors), "rotation vector [°]", ("x", "y", "z")
    R = rotation(attitude)
    roll = np.unwrap(np.arctan2(R[:, 2, 1], R[:, 2, 2]))
    pitch = np.arcsin(np.clip(-R[:, 2, 0], -1.0, 1.0))
    yaw = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    angles = np.rad2deg(np.column_stack([roll, pitch, yaw]))
    return angles, "attitude [°]", ("roll", "pitch", "yaw")


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
    columns = {quantity: place for quantity, place in columns.items() if names[place]}
    figure, panels = over_time(title, len(columns) + more)
    for axes, (quantity, place) in zip(panels, columns.items(), strict=False):
        entries = names[place]
        label = quantity if len(entries) > 1 else f"{entries[0]}: {quantity}"
        _lines(axes, t, values[:, place], entries, label)
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
    return _with_impacts(figure, motion)


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
