"""A number over two joints in colours, with its level sets: white where it is zero."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import QuadContourSet
from matplotlib.ticker import MaxNLocator

from ...common.arrays import Array
from .shape_plane import Limits
from .style import BLACK, FIELD, legend

NONE = 1e-12  # values and differences below it are round-off
_LEVELS = 20


def fill(axes: Axes, plane: Sequence[Array], values: Array) -> QuadContourSet:
    """Fill a plane of shapes with the colours of values, one for each of its points."""
    low, high = float(values.min()), float(values.max())
    if high - low < NONE:
        low, high = low - 1.0, high + 1.0
    if low < 0.0 < high:  # then the middle of the colours is zero
        low, high = -max(-low, high), max(-low, high)
    levels = MaxNLocator(_LEVELS).tick_values(low, high)
    return axes.contourf(*plane, values, levels=levels, cmap=FIELD)


def outline(axes: Axes, plane: Sequence[Array], values: Array, filled: QuadContourSet) -> None:
    """Draw every second level as a line, zero as a thick one; nothing where all is round-off."""
    if np.abs(values).max() < NONE:
        return
    axes.contour(
        *plane, values, levels=np.asarray(filled.levels)[::2], colors=BLACK, linewidths=0.4
    )
    if values.min() < 0.0 < values.max():
        axes.contour(*plane, values, levels=[0.0], colors=BLACK, linewidths=2.0)
        axes.plot([], [], color=BLACK, linewidth=2.0, label="zero")


def name_axes(
    axes: Axes,
    filled: QuadContourSet,
    joints: Sequence[str],
    units: Sequence[str],
    limits: Limits,
    value: str,
) -> None:
    """Name the two joints, in their limits, and the value that the colours mean."""
    axes.grid(visible=False)
    axes.set(xlabel=f"{joints[0]} [{units[0]}]", ylabel=f"{joints[1]} [{units[1]}]")
    axes.set(xlim=limits[0], ylim=limits[1])
    bar = axes.figure.colorbar(filled, ax=axes, location="left", pad=0.02, shrink=0.9)
    bar.set_label(value)
    legend(axes)
