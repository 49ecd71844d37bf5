"""Speedup of simulate_many() with threads, and its memory use."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError
from ...common.progress import Progress, quiet, shown
from ...scene.random_state import random_state
from ...simulation.members.trajectories import Trajectories
from ...simulation.simulate_many import simulate_many
from ...system.system import System
from .timing import alternating, repeated

Counts = NDArray[np.int64]

DURATION = 2.0  # default duration of each motion [s]
MEMBERS = 1000
FEW = 0.25  # fraction of the members in the smaller of two memory measurements
ROUNDS = 5


@checks_arguments
@dataclass(frozen=True)
class ThreadsTiming(FrozenArrays):
    """Time and memory of calls of simulate_many; arrays are read-only.

    Attributes:
        robot: Name of the robot.
        members: Number of members.
        duration: Duration of each motion [s].
        wall: Median wall times with one thread and with two, (2,) [s].
        speedup: Median over rounds of the ratio of the two times.
        sizes: Numbers of members in the two calls whose memory was measured, (2,).
        results: Bytes of the reduced states in the results of these two calls, (2,).
        kept: Bytes kept by the trajectories, reduced states included, (2,).
        extra: Peak bytes in addition to `kept`, (2,).
    """

    robot: str
    members: int
    duration: float
    wall: Array
    speedup: float
    sizes: Counts
    results: Counts
    kept: Counts
    extra: Counts

    def __str__(self) -> str:
        rows = [
            f"{n:>8} {a / 1e6:>13.2f} {b / 1e6:>15.2f} {c / 1e6:>19.2f}"
            for n, a, b, c in zip(self.sizes, self.results, self.kept, self.extra, strict=True)
        ]
        return "\n".join(
            [
                f"{self.robot}: {self.members} trajectories of {self.duration:g} s, whole call",
                f"one thread {self.wall[0]:.3f} s, two threads {self.wall[1]:.3f} s: "
                f"{self.speedup:.2f} times faster",
                "",
                f"{'members':>8} {'results [MB]':>13} {'all kept [MB]':>15} "
                f"{'peak beyond it [MB]':>19}",
                *rows,
            ]
        )


@checks_arguments
def bench_threads(
    system: System,
    *,
    members: int = MEMBERS,
    duration: float = DURATION,
    rounds: int = ROUNDS,
    progress: Progress | bool | None = None,
) -> ThreadsTiming:
    """Measure simulate_many from random states on one thread and on two.

    Memory allocated by Python and numpy is measured; the compiled code allocates none.

    Args:
        system: The system.
        members: Number of members, at least 4. Memory is measured with all members and
            with a quarter.
        duration: Duration of each motion [s].
        rounds: Number of rounds, of which the median is reported.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        Times and memory.
    Raises:
        InputError: Fewer than 4 members.
    """
    if members < 4:
        raise InputError(f"members must be at least 4, got {members}")
    with shown(progress, "threads") as bar:
        return _measure(system, members, duration, rounds, bar or quiet)


def _measure(
    system: System, members: int, duration: float, rounds: int, report: Progress
) -> ThreadsTiming:
    states = [random_state(system, seed) for seed in range(members)]
    x0, xdot0, xi0 = (np.array([getattr(s, name) for s in states]) for name in ("x", "xdot", "xi"))

    def call(size: int, threads: int) -> Trajectories:
        return simulate_many(
            system,
            x0=x0[:size],
            xdot0=xdot0[:size],
            xi0=xi0[:size],
            duration=duration,
            times=[duration],
            threads=threads,
        )

    def calls_with(threads: int) -> Callable[[int], None]:
        return repeated(lambda: call(members, threads))

    times = alternating(
        [calls_with(1), calls_with(2)],
        rounds=rounds,
        progress=lambda fraction: report(0.8 * fraction),
    )
    sizes = (round(FEW * members), members)
    results, kept, extra = [], [], []
    for k, size in enumerate(sizes):
        tracemalloc.start()
        try:
            trajectories = call(size, 2)
            current, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        results.append(trajectories.y.nbytes)
        kept.append(current)
        extra.append(peak - current)
        report(0.8 + 0.1 * (k + 1))
    return ThreadsTiming(
        robot=system.name,
        members=members,
        duration=duration,
        wall=np.median(times, axis=0),
        speedup=float(np.median(times[:, 0] / times[:, 1])),
        sizes=np.array(sizes),
        results=np.array(results),
        kept=np.array(kept),
        extra=np.array(extra),
    )
