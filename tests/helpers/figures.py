"""Read the data of a figure, for comparison with a trajectory."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pinred
from pinred.common.arrays import Array


def drawn(axes: Axes, label: str) -> tuple[Array, Array]:
    """Return x and y of the only line with a label."""
    (line,) = [line for line in axes.lines if line.get_label() == label]
    return np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)


def units(figure: Figure) -> list[str]:
    """Return the labels of the vertical axes."""
    return [axes.get_ylabel() for axes in figure.axes]


def beanie() -> tuple[pinred.Trajectory, Array]:
    """Return Elroy's beanie on a spring, x = 0.4 cos(√1.5 t), and its report times [s]."""
    t = np.linspace(0.0, 5.0, 101)
    system = pinred.load("elroys_beanie")
    spring = {"beanie": (1.0, 0.0)}
    return pinred.simulate(system, x0=[0.4], momentum=[1.5], springs=spring, times=t), t
