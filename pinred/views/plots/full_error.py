"""Errors of the reduced motion against Pinocchio's full simulation over time."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ...common.arrays import Array
from ...common.errors import InputError
from ...judge.compare import compare
from ...judge.report import Report
from ...simulation.recording import Recording
from ...simulation.trajectory import Trajectory
from .style import legend, line, on_log, over_time, styled


@styled
def error(compared: Report | Trajectory) -> Figure:
    """Draw the errors of shape, rotation and position over time on a logarithmic axis.

    Thin lines are the bounds of `compare`.

    Args:
        compared: Report of `compare`, or a Trajectory, which is compared first.
    Returns:
        The figure.
    Raises:
        InputError: `compared` is neither; a recording contains no forces.
    """
    if isinstance(compared, Trajectory):
        compared = compare(compared)
    if isinstance(compared, Recording):
        raise InputError(
            f"{compared.path} holds no forces, so the full simulation cannot be run; "
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
