"""Local optima: loops that no small change makes better, and how often each was found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from ...analysis.gaits.gait import Gait
from ...analysis.phases.phase import Phase

SAME = 1e-5  # relative, of merits; loops that are images of each other count as one


@dataclass(frozen=True, eq=False)
class Optimum:
    """A loop that no small change within the limits makes better.

    value: what it does [rad | m]; of a target, what is missing of it.  cost: in the units of its
    cost, NaN without one.  merit: what was to be great.  phase: of one cycle, by samples that know
    nothing of the optimiser.  residual: of the Karush–Kuhn–Tucker conditions, relative to the
    merit.  margins: least distance to the limits of each kind.  winding: how often it goes round in
    the plane of its two joints, None with more.  found: from how many starts.
    """

    gait: Gait
    phase: Phase
    value: float
    cost: float
    merit: float
    residual: float
    margins: Mapping[str, float]
    winding: float | None
    found: int = 1


def gathered(optima: list[Optimum]) -> tuple[Optimum, ...]:
    """Return the best of each kind, best first, with how often the kind was found."""
    out: list[Optimum] = []
    for each in sorted(optima, key=lambda optimum: -optimum.merit):
        if out and out[-1].merit - each.merit <= SAME * abs(out[-1].merit):
            out[-1] = replace(out[-1], found=out[-1].found + 1)
        else:
            out.append(each)
    return tuple(out)
