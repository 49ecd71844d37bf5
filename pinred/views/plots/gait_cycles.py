"""Figures of gaits: the path of the body over some cycles, and an optimised loop.

The figure of an optimised loop shows the loop over the curvature, next to the joints and the base
over time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...analysis.connections.connection import Connection
from ...analysis.phases.gait import Gait
from ...analysis.phases.phase import Phase
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError, SingularInertiaError
from ...lie.group import Group
from ...lie.rotations import unwrapped_rotation_vectors
from ...planning.optimisation.gait_search import merit_name
from ...planning.optimisation.objective import AxisAim
from ...planning.optimisation.optimise import BestGait
from ...planning.reorientation.turning_loop import TurnPlan
from ..motion_source import labels_of_connection
from .connection_field import (
    PATH,
    around,
    component_of,
    draw_field,
    draw_path,
    motion_word,
    moved_component,
    plane,
    robot_name,
    title_at,
    unit_of_curvature,
)
from .style import BLACK, RED, figure, legend, line, styled

_MOST = 1000

_TIMES = 400
_PER_CYCLE = 200  # least number of line segments of a cycle, so that no corners are visible
_STILL = 1e-9  # largest rotation [rad] and displacement [m] that count as zero
_OTHERS = 5  # largest number of other local optima in the figure


@checks_arguments
@styled
def cycles(source: Phase, *, count: int = 5) -> Figure:
    """Draw the path of the body in the plane over some cycles, or its coordinates over time.

    Args:
        source: Result of `pinred.phase`.
        count: Number of cycles.
    Returns:
        The figure.
    Raises:
        InputError: `source` is not a Phase, or `count` is out of range.
    """
    if not isinstance(source, Phase):
        raise InputError(
            f"cycles draws a Phase, which pinred.phase returns; got {type(source).__name__}"
        )
    if isinstance(count, bool) or not 1 <= int(count) <= _MOST:
        raise InputError(f"count must be a number of cycles from 1 to {_MOST}, got {count!r}")
    group, number = source.group, int(count)
    starts = np.array([source.cycles(k) for k in range(number + 1)])
    at, path = source.fine_path(_PER_CYCLE)
    poses = np.concatenate([group.compose(start[None], path) for start in starts[:-1]])
    times = np.concatenate([at + k * at[-1] for k in range(number)])
    title = f"the base over {number} cycle{'s' * (number > 1)}: {_motion_of(source)}"
    if group.plane:
        drawing = figure(title, height=4.4)
        axes = drawing.subplots()
        i, j = group.plane
        axes.plot(poses[:, i], poses[:, j], color=BLACK, linewidth=1.0, label="path")
        _arrows(axes, starts[:, [i, j]], starts[:, -1], poses[:, [i, j]])
        axes.set(xlabel=f"{group.pose_names[i]} [m]", ylabel=f"{group.pose_names[j]} [m]")
        axes.set_aspect("equal", adjustable="datalim")
        legend(axes)
        return drawing
    panels = [name for name in ("position", "rotation") if _changes(group, poses, name)[1]]
    drawing = figure(title, height=0.6 + 2.2 * len(panels))
    for axes, name in zip(
        drawing.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0], panels, strict=True
    ):
        _draw_changes(axes, group, times, poses, name)
    drawing.axes[-1].set_xlabel("time [s]")
    return drawing


def _motion_of(source: Phase) -> str:
    """Describe the motion of the base in a cycle: its rotation and displacement, if not zero."""
    group, angle = source.group, float(source.screw.angle)
    distance = float(np.linalg.norm(source.pose[: group.linear]))
    phrases = []
    if abs(angle) > max(float(source.error.rotation), _STILL):
        phrases.append(f"{np.degrees(angle):.4g}°")
    if distance > max(float(source.error.translation), _STILL):
        phrases.append(f"{distance:.4g} m")
    return " and ".join(phrases) + " a cycle" if phrases else "returns after each cycle"


def _arrows(axes: Axes, places: Array, angles: Array, path: Array) -> None:
    """Draw the position and orientation of the base after each cycle."""
    size = 0.08 * max(float(np.ptp(path, axis=0).max()), 1e-9)
    axes.quiver(
        places[:, 0], places[:, 1], size * np.cos(angles), size * np.sin(angles),
        color=RED, angles="xy", scale_units="xy", scale=1.0, width=0.004, zorder=4,
    )  # fmt: skip
    axes.plot(
        places[:, 0], places[:, 1], "o", color=RED, markersize=3, linestyle="none",
        label="after each cycle",
    )  # fmt: skip


@checks_arguments
@styled
def loop(source: BestGait | TurnPlan) -> Figure:
    """Draw a best gait or a reorientation plan: the loop, its joints, and the base.

    The title states the motion of the base, and the merit.  The loop is drawn over the curvature of
    the two joints that move most, in the component that the objective concerns, with the other
    joints at their initial values; thin lines are further local optima.  The panels over time are
    the joints, and the rotation of the base [°], or its position if it cannot rotate [m].

    Args:
        source: Result of `optimise_gait` or `reorient`.
    Returns:
        The figure.
    Raises:
        InputError: `source` has another type.
    """
    if isinstance(source, BestGait):
        connection, gaits = source.task.connection, [optimum.gait for optimum in source.optima]
        gait = gaits[0]
        times = np.linspace(0.0, gait.period, _TIMES)
        shapes = gait.at(times)[0]
        at, poses = source.phase.times, source.phase.path
        name, unit = merit_name(source.task)
        title = f"{_motion_of(source.phase)}, {name} = {source.merit:.5g} {unit}"
    elif isinstance(source, TurnPlan):
        connection, gaits = source.connection, [source.gait]
        gait, traj = source.gait, source.trajectory
        times, at, poses = traj.t, traj.t, traj.pose
        names = source.system.x_names
        shapes = traj.x if source.chart is None else source.chart.coordinates(traj.x)
        if source.system.loops:
            shapes = shapes[:, [names.index(name) for name in connection.joints]]
        angle = np.degrees(np.linalg.norm(source.turned))
        count = f"{source.cycles} cycle{'s' * (source.cycles > 1)}"
        title = f"the base turns by {angle:.4g}° in {count}, {source.remaining:.1e} rad remain"
    else:
        raise InputError(
            "loop draws a BestGait or a TurnPlan, as optimise_gait and reorient return, got "
            f"{type(source).__name__}"
        )
    drawing = figure(f"{robot_name(connection)}: {title}", width=9.6, height=4.4)
    panels: Any = drawing.subfigures(1, 2, width_ratios=(1.25, 1.0))
    field_panel, time_panel = panels
    component = _component_of(connection.group, source, poses)
    _on_curvature(field_panel.subplots(), connection, gaits[: 1 + _OTHERS], component)
    joints, base = time_panel.subplots(2, 1, sharex=True)
    moving = np.argsort(-gait.amplitude, kind="stable")[:6]
    for k, joint in enumerate(sorted(moving)):
        joints.plot(times, shapes[:, joint], label=connection.joints[joint], **line(k))
    units = sorted({connection.form.units[k] for k in moving}, reverse=True)
    joints.set_ylabel(f"joints [{' | '.join(units)}]")
    if len(moving) < connection.m:
        text = f"the {len(moving)} of {connection.m} joints that move most"
        joints.set_title(text, loc="left")
    legend(joints)
    _over_time(base, connection.group, at, poses, component)
    return drawing


def _component_of(group: Group, source: BestGait | TurnPlan, poses: Array) -> int | None:
    """Return the component of the curvature that the objective concerns, or None.

    For a target pose it is the component of the largest turn from the first to the last pose, or
    without a turn of the largest displacement.
    """
    aim = source.task.aim if isinstance(source, BestGait) else source.aim
    if isinstance(aim, AxisAim):
        largest = int(np.argmax(np.abs(aim.axis)))
        return largest + (group.linear if aim.kind == "rotation" else 0)
    return moved_component(group, group.compose(group.inverse(poses[0]), poses[-1]))


def _on_curvature(
    axes: Axes, connection: Connection, gaits: list[Gait], component: int | None
) -> None:
    """Draw the loops over the curvature of the two joints that the first loop moves most."""
    gait = gaits[0]
    pair = sorted(np.argsort(-gait.amplitude, kind="stable")[:2].tolist())
    paths = [loop.at(np.linspace(0.0, loop.period, _TIMES))[0] for loop in gaits]
    paths = [path[[*range(_TIMES - 1), 0]] for path in paths]
    units = [connection.form.units[k] for k in pair]
    limits = around(np.concatenate(paths)[:, pair], units)
    shapes = plane(pair, limits, paths[0][0])
    names = [labels_of_connection(connection).with_unit(k) for k in pair]
    try:
        curvature = connection.grid(shapes.shapes).curvature[..., pair[0], pair[1]]
    except SingularInertiaError:  # closed loops do not close at all shapes of the plane
        draw_path(axes, *paths[0][:, pair].T)
        axes.set(xlabel=names[0], ylabel=names[1], title="no curvature: the loops do not close")
    else:
        index = component_of(connection.group, component, curvature)
        group, a_and_b = connection.group, ", ".join(connection.joints[k] for k in pair)
        label = group.twist_names[index]
        what = f"B, component {label} [{unit_of_curvature(label, units)}]"
        axes.set_title(
            f"{motion_word(group, index)} per area of {a_and_b}\n"
            f"{title_at(labels_of_connection(connection), pair, paths[0][0])}".rstrip(),
            loc="left", parse_math=False,
        )  # fmt: skip
        draw_field(axes, shapes, curvature[..., index], names, what, path=paths[0])
    for path in paths[1:]:
        axes.plot(path[:, pair[0]], path[:, pair[1]], color=PATH, linewidth=0.8, zorder=3)


def _over_time(axes: Axes, group: Group, t: Array, poses: Array, component: int | None) -> None:
    """Draw the position of the base over time if the objective is a displacement, or its rotation.

    Args:
        axes: The axes.
        group: Symmetry group.
        t: Times, (T,) [s].
        poses: Poses, (T, size).
        component: Component of a twist that the objective concerns, or None.
    """
    moves = not group.turns or (component is not None and component < group.linear)
    _draw_changes(axes, group, t, poses, "position" if moves else "rotation")
    axes.set_xlabel("time [s]")


def _draw_changes(axes: Axes, group: Group, t: Array, poses: Array, what: str) -> None:
    """Draw the changes of the position or the attitude of the base over time."""
    changes, names = _changes(group, poses, what)
    for k, name in enumerate(names):
        axes.plot(t, changes[:, k], label=name, **line(k))
    axes.set_ylabel("turn of the base [°]" if what == "rotation" else "position of the base [m]")
    legend(axes)


def _changes(group: Group, poses: Array, what: str) -> tuple[Array, list[str]]:
    """Compute the changes of the position [m] or the attitude [°] since the first pose.

    Attitudes in space are continuous rotation vectors along the axes of the first pose, also beyond
    half a turn.

    Args:
        group: Symmetry group.
        poses: Poses, (T, size).
        what: "position" or "rotation".
    Returns:
        The changes, (T, n), and their names; none if the group does not move so.
    """
    displacement = group.compose(group.inverse(poses[0])[None], poses)
    if what == "position":
        return displacement[:, : group.linear], list(group.pose_names[: group.linear])
    if group.turns == 1:
        return np.degrees(poses[:, -1:] - poses[0, -1]), ["θ"]
    if not group.turns:
        return displacement[:, :0], []
    return np.degrees(unwrapped_rotation_vectors(displacement[:, -4:])), ["θx", "θy", "θz"]
