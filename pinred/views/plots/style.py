"""The looks of every figure: colours, dashes, sizes, legends, units.

Nothing here touches pyplot, a GUI, or the settings of the user: a figure carries its own style
and puts it on while it is built, drawn and saved.  Colours are those of Okabe and Ito ("Color
universal design", 2008), which colour-blind people can tell apart; each comes with its own dashes,
so that a grey print can be read too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import wraps
from io import BytesIO
from typing import Any, ParamSpec

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from ...common.arrays import Array

P = ParamSpec("P")

BLACK, RED, SKY, BLUE = "#000000", "#D55E00", "#56B4E9", "#0072B2"
ORANGE, GREEN, PURPLE = "#E69F00", "#009E73", "#CC79A7"
PALETTE = (BLACK, RED, SKY, BLUE, ORANGE, GREEN, PURPLE)
DASHES: tuple[Any, ...] = (
    *("-", (0, (5, 1.5)), (0, (7, 1.5, 1.2, 1.5)), (0, (1.2, 1.2))),
    *((0, (3, 1.2, 1.2, 1.2, 1.2, 1.2)), (0, (9, 2.5)), (0, (2.5, 1.2))),
)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
FIELD = "cividis"  # a colour map that is as good in grey
WIDTH = 6.4  # in; as wide as a page's text
PANEL = 1.9  # in; height of one of several panels
STEADY = 1e-6  # relative; what changes by less is drawn as a straight line

_SETTINGS: dict[str, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.use_mathtext": True,
    "axes.formatter.limits": (-3, 4),
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.5,
    "figure.titlesize": 10.0,
    "figure.dpi": 100.0,
    "legend.fontsize": 8.0,
    "legend.handlelength": 3.2,
    "lines.linewidth": 1.4,
    "lines.markersize": 4.0,
    "savefig.dpi": 200.0,
    "svg.hashsalt": "pinred",  # the same figure is the same file
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
}


def _worn() -> AbstractContextManager[None]:
    return matplotlib.style.context(["default", _SETTINGS])


class StyledFigure(Figure):
    """A figure that wears pinred's style whenever it is drawn; `savefig` writes it to a file."""

    def draw(self, renderer: Any) -> None:
        """Draw the figure in its own style."""
        with _worn():
            super().draw(renderer)

    def savefig(self, *arguments: Any, **options: Any) -> None:
        """Write the figure to a file or stream, as `matplotlib.figure.Figure.savefig`."""
        with _worn():
            super().savefig(*arguments, **options)

    def _repr_png_(self) -> bytes:
        """Return the picture that notebooks show where a figure is a cell's value."""
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=100.0)
        return stream.getvalue()


def styled(function: Callable[P, Figure]) -> Callable[P, Figure]:
    """Make a function that builds a figure build it in pinred's style."""

    @wraps(function)
    def build(*arguments: P.args, **options: P.kwargs) -> Figure:
        with _worn():
            made = function(*arguments, **options)
        for text in _named(made):
            text.set_parse_math(False)  # a name with $ in it is no formula
        return made

    return build


def _named(made: Figure) -> Iterator[Text]:
    """Give the texts of a figure that may hold names: all but the labels of ticks."""
    keys = [*made.legends, *(axes.get_legend() for axes in made.axes)]
    for key in keys:
        yield from key.get_texts() if key is not None else ()
    for axes in made.axes:
        yield from (axes.xaxis.label, axes.yaxis.label)


def figure(title: str, *, width: float = WIDTH, height: float) -> StyledFigure:
    """Return an empty figure with a title; sizes in inches."""
    made = StyledFigure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(made)
    made.suptitle(title, x=0.01, ha="left", parse_math=False)
    return made


def over_time(title: str, count: int) -> tuple[StyledFigure, list[Axes]]:
    """Return a figure with `count` panels over a common time axis, in two columns from 4 on."""
    columns = 1 if count < 4 else 2
    rows = -(-count // columns)
    made = figure(title, width=WIDTH * (1.0 if columns == 1 else 1.8), height=0.6 + PANEL * rows)
    grid = made.subplots(rows, columns, sharex=True, squeeze=False)
    axes = list(grid.flat)
    for empty in axes[count:]:
        empty.remove()
    for last in axes[max(0, count - columns) : count]:
        last.set_xlabel("time [s]")
        last.tick_params(labelbottom=True)
    return made, axes[:count]


def line(k: int) -> dict[str, Any]:
    """Return colour and dashes of the k-th line in a panel; from the eighth on with markers."""
    turn, n = divmod(k, len(PALETTE))
    style: dict[str, Any] = {"color": PALETTE[n], "linestyle": DASHES[(n + 3 * turn) % len(DASHES)]}
    if turn:
        style |= {"marker": MARKERS[(turn - 1) % len(MARKERS)], "markevery": 0.1}
    return style


def dots(k: int) -> dict[str, Any]:
    """Return colour and marker of the k-th cloud or series of points."""
    turn, n = divmod(k, len(PALETTE))
    return {"color": PALETTE[n], "marker": MARKERS[(n + turn) % len(MARKERS)]}


def shown(name: str) -> str:
    """Return a name as legends show it; those that begin with _ they would leave out."""
    return f" {name}" if name.startswith("_") else name


def legend(axes: Axes, *, title: str | None = None) -> None:
    """Put a legend beside the axes, where it hides nothing, if there is more than one thing."""
    if len(axes.get_legend_handles_labels()[1]) > 1 or title:
        axes.legend(
            loc="upper left",
            bbox_to_anchor=(1.0, 1.0),
            borderaxespad=0.3,
            frameon=False,
            title=title,
            title_fontsize=8.0,
            alignment="left",
        )


def steady(axes: Axes, values: Array) -> None:
    """Widen the vertical limits where values change so little that they count as constant."""
    low, high = float(np.min(values)), float(np.max(values))
    size = max(abs(low), abs(high))
    if high - low <= STEADY * size or size == 0.0:
        margin = 0.1 * size or 1.0
        axes.set_ylim(low - margin, high + margin)


def on_log(values: Array) -> Array:
    """Return magnitudes for a logarithmic axis, which has no place for an exact zero."""
    size = np.abs(values)
    return np.where(size > 0.0, size, np.nan)
