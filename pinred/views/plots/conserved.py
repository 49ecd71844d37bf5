"""Momentum and energy over time, and their drift computed by Pinocchio."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...common.arrays import Array
from ...judge.audit import audit_trajectory
from ...judge.error_bounds import DRIFT_BOUND
from ...lie.groups import group_named
from ...simulation.trajectory import Trajectory
from ...system.state_fields import FIELDS
from ..motion_source import MotionSource
from .motion_labels import labels
from .style import legend, line, on_log, over_time, steady, styled

_TWIST_TO_MOMENTUM = str.maketrans("vω", "pL")  # names of momenta from those of twists
LINEAR, ANGULAR = "linear [N·s]", "angular [N·m·s]"


@styled
def momentum(motion: MotionSource) -> Figure:
    """Draw the spatial momentum over time, and its drift on a logarithmic axis.

    The momentum is expressed in the root joint's fixed frame, about its origin. The drift is the
    largest of the linear and of the angular components. For a Trajectory it is the relative drift
    of `compare`: computed by Pinocchio from q and v, less free fall and impulses, angular about
    the centre of mass if the group translates. For a recording it is the change since the start.

    Args:
        motion: Trajectory, or a recording read from a file.
    Returns:
        The figure.
    Raises:
        InputError: The base was left out.
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
        drift = _largest(audit_trajectory(motion, motion.states).momenta, linear)
        _drift_panel(panels[-1], motion, drift)
    else:
        _change_panel(
            panels[-1],
            motion.t,
            _largest(values - values[0], linear),
            FIELDS["spatial_momentum"].unit,
        )
    return figure


@styled
def energy(motion: MotionSource) -> Figure:
    """Draw the energy over time, and its drift on a logarithmic axis.

    For a Trajectory the drift is that of `compare`: computed by Pinocchio from q and v, less the
    work of forces without potential, relative to the largest kinetic energy about the centre of
    mass. For a recording it is the change since the start.

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


def _largest(values: Array, linear: int) -> dict[str, Array]:
    """Return the largest linear and angular component of values (T, r) over time, if present."""
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
