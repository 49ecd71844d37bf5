"""Branch diagrams: relative equilibria against momentum, with folds and pitchforks."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...analysis.equilibria.branches import Branches, BranchPoint
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError
from ..motion_source import labels_of
from .style import PALETTE, figure, legend, styled

GREY = "#555555"
_SAME = 2e-3  # largest distance between lines that coincide, relative to the size of the figure
# Line styles by the index of the amended potential: the number of directions in which it falls.
_STABLE, _EVEN, _ODD = "stable: a minimum", "undecided: index even", "unstable: index odd"
_LINES: dict[str, dict[str, Any]] = {
    _STABLE: {"linestyle": "-", "linewidth": 1.8},
    _EVEN: {"linestyle": (0, (5, 1.5)), "linewidth": 1.2},
    _ODD: {"linestyle": (0, (1.2, 1.2)), "linewidth": 1.2},
}
_MARKS = {"folds": "o", "pitchforks": "^", "crossings": "s"}
_MEANINGS = {"folds": "fold", "pitchforks": "pitchfork", "crossings": "crossing"}


@checks_arguments
@styled
def branches(found: Branches, *, joint: str | int | None = None) -> Figure:
    """Draw the branches of relative equilibria against the momentum.

    Solid lines are stable, dotted lines are unstable. The amended potential alone does not decide
    whether dashed lines are stable.

    Args:
        found: Result of `pinred.branches`.
        joint: Name or index of the joint on the vertical axis; the amended potential if None.
    Returns:
        The figure.
    Raises:
        InputError: `found` has another type, or the joint does not exist.
    """
    if not isinstance(found, Branches):
        raise InputError(
            f"a branch diagram takes the result of pinred.branches, got {type(found).__name__}"
        )
    system = found.system
    names = labels_of(system)
    k = None if joint is None else names.index(joint)
    is_linear = system.group.turns == 0
    momentum = "momentum" if is_linear else "angular momentum"
    drawing = figure(f"{system.name}: steady motions at each {momentum}", height=4.4)
    axes = drawing.subplots()

    def height(point: BranchPoint) -> float:
        if k is None:
            return point.amended_potential
        return float(system.space.chart(point.x[None])[0, k])

    low, high = found.momentum
    size = np.ptp([height(p) for p in found.points]) if found.points else 0.0
    near = _SAME * np.array([high - low, size])
    drawn: dict[str, list[Array]] = {}
    for number in range(found.count):
        color = PALETTE[number % len(PALETTE)]
        for segment, label in _segments(found.branch(number)):
            line = np.array([(p.momentum, height(p)) for p in segment])
            earlier = drawn.setdefault(label, [])
            # Overlapping dashed lines would look solid, so only one of two mirror images is drawn.
            if not any(_covers(other, line, near) for other in earlier):
                axes.plot(*line.T, color=color, **_LINES[label])
                earlier.append(line)
    for label in (label for label in _LINES if label in drawn):
        axes.plot([], [], color=GREY, label=label, **_LINES[label])
    for name, marker in _MARKS.items():
        points: tuple[BranchPoint, ...] = getattr(found, name)
        if points:
            axes.plot(
                [p.momentum for p in points], [height(p) for p in points],
                linestyle="", marker=marker, color="black", markerfacecolor="white",
                label=_MEANINGS[name], zorder=3,
            )  # fmt: skip
    axes.set_xlabel(f"{momentum} [{'N·s' if is_linear else 'N·m·s'}]")
    axes.set_ylabel("amended potential [J]" if k is None else names.with_unit(k))
    legend(axes)
    return drawing


def _segments(points: tuple[BranchPoint, ...]) -> list[tuple[list[BranchPoint], str]]:
    """Split a branch into segments of one stability and monotonic momentum, with shared ends."""
    segments: list[tuple[list[BranchPoint], str]] = []
    last_direction = 0.0
    for a, b in pairwise(points):
        label, direction = _stability(b), float(np.sign(b.momentum - a.momentum))
        if not segments or segments[-1][1] != label or direction * last_direction < 0.0:
            segments.append(([a], label))
        segments[-1][0].append(b)
        last_direction = direction or last_direction
    if not segments and points:
        segments.append(([points[0]], _stability(points[0])))
    return segments


def _covers(other: Array, line: Array, near: Array) -> bool:
    """Return whether one monotonic curve, (k, 2), visibly coincides with part of another curve."""
    if len(other) < 2:
        return False
    x, y = other[np.argsort(other[:, 0])].T
    within = x[0] - near[0] <= line[:, 0].min() and line[:, 0].max() <= x[-1] + near[0]
    return bool(within and (np.abs(np.interp(line[:, 0], x, y) - line[:, 1]) <= near[1]).all())


def _stability(point: BranchPoint) -> str:
    if point.index == 0:
        return _STABLE
    return _ODD if point.index % 2 else _EVEN
