"""Branch diagrams: relative equilibria over the momentum, with folds and pitchforks."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...analysis.branches.follow import Branches, BranchPoint
from ...common.arrays import Array
from ...common.errors import InputError
from ...common.names import joint_index
from .style import PALETTE, figure, legend, styled

GREY = "#555555"
_SAME = 2e-3  # of the width and height of the figure; lines that are nearer are one
_LINES: dict[
    str, dict[str, Any]
] = {  # by whether the index of the amended potential is zero, even or odd
    "stable": {"linestyle": "-", "linewidth": 1.8},
    "index even": {"linestyle": (0, (5, 1.5)), "linewidth": 1.2},
    "index odd: unstable": {"linestyle": (0, (1.2, 1.2)), "linewidth": 1.2},
}
_MARKS = {"folds": "o", "pitchforks": "^", "crossings": "s"}


@styled
def branches(found: Branches, *, joint: str | int | None = None) -> Figure:
    """Draw branches of relative equilibria over the momentum.

    found: what `pinred.branches` returned.  joint: whose coordinate to draw, by name or index; the
    amended potential if None.  Full lines are stable, dotted ones unstable.
    Raises InputError for anything else, or a joint that there is not.
    """
    if not isinstance(found, Branches):
        raise InputError("a branch diagram takes what pinred.branches returned")
    system = found.system
    k: int | None = None
    if isinstance(joint, str):
        k = joint_index(joint, system.shape_names, "joint")
    elif joint is not None:
        if isinstance(joint, bool) or not 0 <= joint < system.m:
            raise InputError(f"joint must be a name or an index from 0 to {system.m - 1}")
        k = int(joint)
    made = figure(f"{system.name}: relative equilibria", height=4.4)
    axes = made.subplots()

    def height(point: BranchPoint) -> float:
        return float(point.amended_potential if k is None else point.x[k])

    low, high = found.momentum
    size = np.ptp([height(p) for p in found.points]) if found.points else 0.0
    near = _SAME * np.array([high - low, size])
    drawn: dict[str, list[Array]] = {}
    for number in range(found.count):
        color = PALETTE[number % len(PALETTE)]
        for some, kind in _runs(found.branch(number)):
            line = np.array([(p.momentum, height(p)) for p in some])
            before = drawn.setdefault(kind, [])
            # Dashes over dashes would look like a full line: mirror images are drawn once.
            if not any(_covers(other, line, near) for other in before):
                axes.plot(*line.T, color=color, **_LINES[kind])
                before.append(line)
    for kind in (kind for kind in _LINES if kind in drawn):
        axes.plot([], [], color=GREY, label=kind, **_LINES[kind])
    for name, marker in _MARKS.items():
        points: tuple[BranchPoint, ...] = getattr(found, name)
        if points:
            axes.plot(
                [p.momentum for p in points], [height(p) for p in points],
                linestyle="", marker=marker, color="black", markerfacecolor="white", label=name,
                zorder=3,
            )  # fmt: skip
    one = system.group.turns == 0
    axes.set_xlabel("momentum [N·s]" if one else "angular momentum [N·m·s]")
    unit = "" if k is None else system.units[k]
    axes.set_ylabel("amended potential [J]" if k is None else f"{system.shape_names[k]} [{unit}]")
    legend(axes)
    return made


def _runs(points: tuple[BranchPoint, ...]) -> list[tuple[list[BranchPoint], str]]:
    """Return stretches of a branch of one kind and one way; each begins where one before ends."""
    out: list[tuple[list[BranchPoint], str]] = []
    was = 0.0
    for a, b in pairwise(points):
        kind, way = _kind(b), float(np.sign(b.momentum - a.momentum))
        if not out or out[-1][1] != kind or way * was < 0.0:
            out.append(([a], kind))
        out[-1][0].append(b)
        was = way or was
    if not out and points:
        out.append(([points[0]], _kind(points[0])))
    return out


def _covers(other: Array, line: Array, near: Array) -> bool:
    """Return whether a line (k, 2) of one way lies on another, nearer than what can be seen."""
    if len(other) < 2:
        return False
    x, y = other[np.argsort(other[:, 0])].T
    within = x[0] - near[0] <= line[:, 0].min() and line[:, 0].max() <= x[-1] + near[0]
    return bool(within and (np.abs(np.interp(line[:, 0], x, y) - line[:, 1]) <= near[1]).all())


def _kind(point: BranchPoint) -> str:
    if point.index == 0:
        return "stable"
    return "index odd: unstable" if point.index % 2 else "index even"
