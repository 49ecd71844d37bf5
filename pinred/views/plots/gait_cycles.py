"""The path of the body over some cycles of a gait, and its pose after each cycle."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...analysis.phases.lift import in_space
from ...analysis.phases.phase import Phase
from ...common.arrays import Array
from ...common.errors import InputError
from .style import BLACK, RED, figure, legend, line, styled

_MOST = 1000


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
            f"cycles draws a Phase, as pinred.phase returns, got {type(source).__name__}"
        )
    if isinstance(count, bool) or not 1 <= int(count) <= _MOST:
        raise InputError(f"count must be a number of cycles from 1 to {_MOST}, got {count!r}")
    group, number = source.group, int(count)
    starts = np.array([source.cycles(k) for k in range(number + 1)])
    poses = np.concatenate([group.compose(start[None], source.path) for start in starts[:-1]])
    times = np.concatenate([source.times + k * source.times[-1] for k in range(number)])
    rotation = f"{np.degrees(source.screw.angle):.4g}° a cycle"
    if group.plane:
        drawing = figure(f"the base over {number} cycles: {rotation}", height=4.4)
        axes = drawing.subplots()
        i, j = group.plane
        axes.plot(poses[:, i], poses[:, j], color=BLACK, linewidth=1.0, label="path")
        _arrows(axes, starts[:, [i, j]], starts[:, -1], poses[:, [i, j]])
        axes.set(xlabel=f"{group.pose_names[i]} [m]", ylabel=f"{group.pose_names[j]} [m]")
        axes.set_aspect("equal", adjustable="datalim")
        legend(axes)
        return drawing
    drawing = figure(f"the base over {number} cycles: {rotation}", height=3.2)
    axes = drawing.subplots()
    log = np.unwrap(in_space(group, group.log(poses)), axis=0)
    names = ("x", "y", "z", "θx", "θy", "θz")
    for k in group.axes:
        axes.plot(times, log[:, k], label=names[k], **line(k))
    axes.set(xlabel="time [s]", ylabel="logarithm of the pose [m | rad]")
    legend(axes)
    return drawing


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
