"""Work and precision: what accuracy costs, method by method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...common.errors import InputError
from ...verification.bench.work_precision import WorkPrecision
from .style import WIDTH, dots, figure, legend, line, shown, styled

_AGAINST = {
    "wall": ("wall time [ms]", 1e3),
    "evaluations": ("evaluations, or Taylor steps [1]", 1.0),
}


@styled
def work_precision(
    found: WorkPrecision | Sequence[WorkPrecision],
    *,
    against: Literal["wall", "evaluations"] = "wall",
) -> Figure:
    """Draw the work of each method against its error, a panel a problem, both axes logarithmic.

    found: what `bench_accuracy` returned.  against: "wall" time or "evaluations".
    In the grey band, errors are below what the references agree to, and say nothing.
    Raises InputError if there is nothing to draw.
    """
    every = [found] if isinstance(found, WorkPrecision) else list(found)
    if not every or not all(isinstance(each, WorkPrecision) for each in every):
        raise InputError(
            "work_precision takes one or more results of pinred.verification.bench.bench_accuracy"
        )
    if against not in _AGAINST:
        raise InputError(f"against must be one of {', '.join(_AGAINST)}, got {against!r}")
    names = list(dict.fromkeys(name for each in every for name in each.about))
    panel = max(3.2, 0.2 * max(len(each.about) for each in every))  # in; as high as its legend
    made = figure("Work and precision", width=1.15 * WIDTH, height=0.5 + panel * len(every))
    panels = made.subplots(len(every), 1, squeeze=False)[:, 0]
    for axes, each in zip(panels, every, strict=True):
        _panel(axes, each, names, against)
    return made


def _panel(axes: Axes, found: WorkPrecision, names: list[str], against: str) -> None:
    label, factor = _AGAINST[against]
    errors: list[float] = []
    for k, name in enumerate(names):
        if name not in found.about:
            continue
        points = sorted(found.of(name), key=lambda point: point.tolerance)
        series = [(p.error, factor * getattr(p, against)) for p in points if 0.0 < p.error < np.inf]
        if series:
            x, y = zip(*series, strict=True)
            axes.plot(x, y, label=shown(name), **{**line(k), **dots(k)}, markerfacecolor="white")
            errors += x
    axes.set(xscale="log", yscale="log", xlabel="error [rad | m]", ylabel=label)
    if errors and found.reference_error > 0.0:
        low = min(found.reference_error, *errors) / 3.0
        axes.axvspan(
            low, found.reference_error, color="#E4E4E4", linewidth=0.0, zorder=0.5,
            label="not known",
        )  # fmt: skip
        axes.set_xlim(low, max(errors) * 3.0)
    if not errors:
        axes.text(0.5, 0.5, "no method came to its end", transform=axes.transAxes, ha="center")
    axes.set_title(found.problem, loc="left", parse_math=False)
    legend(axes)
