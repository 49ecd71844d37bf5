"""Style of all figures: colours, dashes, sizes, legends.

The style is applied only while a figure is built, drawn or saved; pyplot, GUIs and the user's
settings are not touched. The colours of Okabe and Ito ("Color universal design", 2008) are
distinguishable for colour-blind people. Each colour has distinct dashes for black-and-white prints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import wraps
from io import BytesIO
from textwrap import fill
from typing import Any, ParamSpec

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.text import Text

from ...common.arrays import Array
from ..playback.colours_and_view_options import LOOK

P = ParamSpec("P")

BLACK, RED, SKY, BLUE = "#000000", "#D55E00", "#56B4E9", "#0072B2"
ORANGE, GREEN, PURPLE = "#E69F00", "#009E73", "#CC79A7"
PALETTE = (BLACK, RED, SKY, BLUE, ORANGE, GREEN, PURPLE)
DASHES: tuple[Any, ...] = (
    *("-", (0, (5, 1.5)), (0, (7, 1.5, 1.2, 1.5)), (0, (1.2, 1.2))),
    *((0, (3, 1.2, 1.2, 1.2, 1.2, 1.2)), (0, (9, 2.5)), (0, (2.5, 1.2))),
)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
FIELD = "cividis"  # colour map that is also readable in grey
# Colour map of values of both signs, white at zero: the colours of playback (Look.field).
SIGNED = LinearSegmentedColormap.from_list(
    "pinred_signed", (LOOK.field[0], "#FFFFFF", LOOK.field[1])
)
WIDTH = 6.4  # text width of a page [in]
_LETTERS = 13.0  # number of letters of a title in an inch
PANEL = 1.9  # height of a panel in a figure with several panels [in]
STEADY = 1e-6  # largest relative change of values that count as constant

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
    "svg.hashsalt": "pinred",  # makes files of equal figures identical
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
}


def _style_context() -> AbstractContextManager[None]:
    return matplotlib.style.context(["default", _SETTINGS])


class StyledFigure(Figure):
    """A figure that is always drawn and saved in pinred's style."""

    def draw(self, renderer: Any) -> None:
        """Draw the figure in pinred's style."""
        with _style_context():
            super().draw(renderer)

    def savefig(self, *arguments: Any, **options: Any) -> None:
        """Write the figure to a file or stream, as `matplotlib.figure.Figure.savefig`."""
        with _style_context():
            super().savefig(*arguments, **options)

    def _repr_png_(self) -> bytes:
        """Return the PNG picture that notebooks show."""
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=100.0)
        return stream.getvalue()


def styled(function: Callable[P, Figure]) -> Callable[P, Figure]:
    """Decorate a function that builds a figure, so that it uses pinred's style."""

    @wraps(function)
    def build(*arguments: P.args, **options: P.kwargs) -> Figure:
        with _style_context():
            drawing = function(*arguments, **options)
        for text in _texts(drawing):
            text.set_parse_math(False)  # names may contain $, which must not start a formula
        return drawing

    return build


def _texts(drawing: Figure) -> Iterator[Text]:
    """Yield the texts of a figure that may contain names: legends and axis labels."""
    for key in [*drawing.legends, *(axes.get_legend() for axes in drawing.axes)]:
        yield from key.get_texts() if key is not None else ()
    for axes in drawing.axes:
        yield from (axes.xaxis.label, axes.yaxis.label)


def figure(title: str, *, width: float = WIDTH, height: float) -> StyledFigure:
    """Return an empty figure with a title, whose long lines are wrapped; sizes in inches."""
    drawing = StyledFigure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(drawing)
    title = "\n".join(fill(line, int(width * _LETTERS)) for line in title.split("\n"))
    drawing.suptitle(title, x=0.01, ha="left", parse_math=False)
    return drawing


def over_time(title: str, count: int) -> tuple[StyledFigure, list[Axes]]:
    """Return a figure with `count` panels over a common time axis, in two columns if 4 or more."""
    columns = 1 if count < 4 else 2
    rows = -(-count // columns)
    width = WIDTH * (1.0 if columns == 1 else 1.8)
    drawing = figure(title, width=width, height=0.6 + PANEL * rows)
    grid = drawing.subplots(rows, columns, sharex=True, squeeze=False)
    axes = list(grid.flat)
    for empty in axes[count:]:
        empty.remove()
    for last in axes[max(0, count - columns) : count]:
        last.set_xlabel("time [s]")
        last.tick_params(labelbottom=True)
    return drawing, axes[:count]


def line(k: int) -> dict[str, Any]:
    """Return the colour and dashes of the k-th line in a panel, and markers after the seventh."""
    cycle, n = divmod(k, len(PALETTE))
    style: dict[str, Any] = {
        "color": PALETTE[n],
        "linestyle": DASHES[(n + 3 * cycle) % len(DASHES)],
    }
    if cycle:
        style |= {"marker": MARKERS[(cycle - 1) % len(MARKERS)], "markevery": 0.1}
    return style


def dots(k: int) -> dict[str, Any]:
    """Return colour and marker of the k-th series of points."""
    cycle, n = divmod(k, len(PALETTE))
    return {"color": PALETTE[n], "marker": MARKERS[(n + cycle) % len(MARKERS)]}


def shown(name: str) -> str:
    """Return a name that legends show; matplotlib would omit a name that begins with _."""
    return f" {name}" if name.startswith("_") else name


def legend(axes: Axes, *, title: str | None = None) -> None:
    """Add a legend to the right of the axes if it has more than one entry, or a title."""
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
    """Widen the vertical limits if the values are constant up to STEADY."""
    low, high = float(np.min(values)), float(np.max(values))
    size = max(abs(low), abs(high))
    if high - low <= STEADY * size or size == 0.0:
        margin = 0.1 * size or 1.0
        axes.set_ylim(low - margin, high + margin)


def on_log(values: Array) -> Array:
    """Return the magnitudes of values for a logarithmic axis, with NaN instead of zero."""
    size = np.abs(values)
    return np.where(size > 0.0, size, np.nan)
