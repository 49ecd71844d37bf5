"""Momentum and energy, and how far they drift: what Pinocchio says of q and v."""

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

_OF_TWISTS = str.maketrans("vω", "pL")  # what momenta are called, by the twists they go with
LINEAR, ANGULAR = "linear [N·s]", "angular [N·m·s]"


@styled
def momentum(motion: MotionSource) -> Figure:
    """Draw the spatial momentum over time, and below its drift on a logarithmic axis.

    The momentum is that in the root joint's fixed frame, about its origin.  The drift is that
    of the component that drifts most, linear and angular.  Of a Trajectory it is relative, and
    as `compare` judges it: computed by Pinocchio from q and v, less falling and impulses,
    angular about the centre of mass where the group translates.  Of a file it is the change
    since the first time, whatever caused it.
    Raises InputError if the base was left out.
    """
    names = labels(motion)
    group = group_named(names.group)
    linear, values = group.linear, motion.spatial_momentum
    entries = [name.translate(_OF_TWISTS) for name in group.twist_names]
    parts = [(LINEAR, range(linear)), (ANGULAR, range(linear, len(entries)))]
    parts = [(quantity, part) for quantity, part in parts if len(part)]
    figure, every = over_time(f"{names.robot}: spatial momentum", len(parts) + 1)
    for axes, (quantity, part) in zip(every, parts, strict=False):
        for k, entry in enumerate(part):
            axes.plot(motion.t, values[:, entry], label=entries[entry], **line(k))
        steady(axes, values[:, list(part)])
        axes.set_ylabel(f"{entries[part[0]]}: {quantity}" if len(part) == 1 else quantity)
        legend(axes)
    if isinstance(motion, Trajectory):
        lost = _largest(audit_trajectory(motion, motion.states).momenta, linear)
        _drift_panel(every[-1], motion, lost)
    else:
        _change_panel(
            every[-1],
            motion.t,
            _largest(values - values[0], linear),
            FIELDS["spatial_momentum"].unit,
        )
    return figure


@styled
def energy(motion: MotionSource) -> Figure:
    """Draw the energy over time, and below its drift on a logarithmic axis.

    The drift of a Trajectory is computed by Pinocchio from q and v, less the work of the forces
    without a potential, over the largest kinetic energy about the centre of mass, as `compare`
    judges it.  Of a file it is the change since the first time, whatever caused it.
    Raises InputError if the base was left out of a Trajectory.
    """
    names = labels(motion)
    figure, every = over_time(f"{names.robot}: energy", 2)
    top, bottom = every
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
    """Return the largest linear and angular entry of values (T, r), those there are."""
    parts = {"linear": values[:, :linear], "angular": values[:, linear:]}
    return {name: np.abs(part).max(axis=1) for name, part in parts.items() if part.size}


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
