"""Batch: members that were integrated together, and Failure: a member that stopped early."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...system.coordinates import Indices

if TYPE_CHECKING:
    from ..compiled.compiled_flow import CompiledFlow


@dataclass(frozen=True)
class Failure:
    """A member of simulate_many that did not reach its end time.

    Attributes:
        member: Index of the member.
        time: Last time that it reached [s].
        reason: The cause, in words.
    """

    member: int
    time: float
    reason: str


@dataclass(frozen=True)
class Batch:
    """Members that were integrated together under one kernel.

    Attributes:
        members: Their indices, (N,) sorted.
        flow: Their flow; None for members that were unpickled.
        method: Name of the integrator.
        y: Reduced states at the report times, (N, T, k); NaN at times that were not reached.
        steps: Number of accepted steps of each, (N,).
        evaluations: Number of evaluations of the vector field for each, (N,).
        failures: Members that did not come to their end.
        wall: Mean wall time of one member [s].
    """

    members: Indices
    flow: CompiledFlow | None
    method: str
    y: Array
    steps: NDArray[np.int64]
    evaluations: NDArray[np.int64]
    failures: list[Failure]
    wall: float
