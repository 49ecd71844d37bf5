"""The reduced motion against Pinocchio's full simulation: how the error grows."""

from __future__ import annotations

from matplotlib.figure import Figure

from ...common.errors import InputError
from ...simulation.recording import Recording
from ...simulation.trajectory import Trajectory
from ...verification.compare import Report, compare
from .style import legend, line, on_log, over_time, styled


@styled
def error(compared: Report | Trajectory) -> Figure:
    """Draw the errors of shape, rotation and position over time, on a logarithmic axis.

    compared: what `compare` returned; a Trajectory is compared first, which takes the full
    simulation.  Thin lines are what passes.  A part that the group lacks is left out.
    """
    if isinstance(compared, Trajectory):
        compared = compare(compared)
    if isinstance(compared, Recording):
        raise InputError(
            f"{compared.path} holds no forces, so the full simulation cannot be made from it; "
            "plot the error of the robot or of its scene file"
        )
    if not isinstance(compared, Report):
        raise InputError(
            f"a plot of the error takes the Report of compare, or a Trajectory, "
            f"got {type(compared).__name__}"
        )
    figure, (axes,) = over_time(f"{compared.robot}: reduced equations against full ABA", 1)
    series = [
        ("shape [rad | m]", compared.shape_errors, compared.shape_bound),
        ("rotation [rad]", compared.rotation_errors, compared.rotation_bound),
        ("position [m]", compared.position_errors, compared.position_bound),
    ]
    for k, (name, values, bound) in enumerate(series):
        if values.any():
            axes.plot(compared.t, on_log(values), label=name, **line(k))
            axes.axhline(
                bound, **{**line(k), "linewidth": 0.7}, label=f"allowed, {name.split()[0]}"
            )
    axes.set_yscale("log")
    axes.set_ylabel("error [rad | m]")
    legend(axes)
    figure.set_figheight(3.2)
    return figure
