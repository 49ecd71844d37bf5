"""Colour maps of a quantity over two joints, with level sets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import QuadContourSet
from matplotlib.ticker import MaxNLocator

from ...common.arrays import Array
from .shape_plane import Limits
from .style import BLACK, FIELD, legend

NONE = 1e-12  # smaller values and differences are round-off
_LEVELS = 20


def fill(axes: Axes, plane: Sequence[Array], values: Array) -> QuadContourSet:
    """Draw values at the points of a plane of shapes as filled contours."""
    low, high = float(values.min()), float(values.max())
    if high - low < NONE:
        low, high = low - 1.0, high + 1.0
    if low < 0.0 < high:  # a symmetric range puts zero in the middle of the colour map
        low, high = -max(-low, high), max(-low, high)
    levels = MaxNLocator(_LEVELS).tick_values(low, high)
    return axes.contourf(*plane, values, levels=levels, cmap=FIELD)


def outline(axes: Axes, plane: Sequence[Array], values: Array, filled: QuadContourSet) -> None:
    """Draw every second level as a line, and zero as a thick line, unless all is round-off."""
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
    """Label both joint axes and the colour bar, and set the limits."""
    axes.grid(visible=False)
    axes.set(xlabel=f"{joints[0]} [{units[0]}]", ylabel=f"{joints[1]} [{units[1]}]")
    axes.set(xlim=limits[0], ylim=limits[1])
    bar = axes.figure.colorbar(filled, ax=axes, location="left", pad=0.02, shrink=0.9)
    bar.set_label(value)
    legend(axes)
