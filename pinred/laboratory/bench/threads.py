"""The gain of threads in simulate_many(), and the memory it needs besides its results."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array, freeze
from ...common.errors import InputError
from ...common.progress import Progress, quiet, shown
from ...scene.random_state import random_state
from ...simulation.members.trajectories import Trajectories
from ...simulation.simulate_many import simulate_many
from ...system.system import System
from .timing import alternating

Counts = NDArray[np.int64]

DURATION = 2.0  # s
MEMBERS = 1000
FEW = 0.25  # of the members, with which memory is compared
ROUNDS = 5


@dataclass(frozen=True)
class ThreadsTiming:
    """Whole calls of simulate_many.

    wall: (2,) s with one thread and with two.  speedup: median of their ratio in each round.
    sizes: (2,) members of two calls whose memory was watched.  results: (2,) bytes of their
    reduced states.  kept: (2,) bytes that the trajectories hold, results included.  extra:
    (2,) bytes at the peak beyond what is kept.
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

    def __post_init__(self) -> None:
        freeze(self)

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


def bench_threads(
    system: System,
    *,
    members: int = MEMBERS,
    duration: float = DURATION,
    rounds: int = ROUNDS,
    progress: Progress | bool | None = None,
) -> ThreadsTiming:
    """Return what many random states of a system cost on one thread and on two.

    members: at least 4; memory is watched with all of them and with a quarter.  rounds: of
    which the median counts.  progress: as for `simulate`.
    Memory is what Python and numpy ask for; the compiled code asks for none of its own.
    """
    if members < 4:
        raise InputError(f"members must be at least 4, got {members}")
    with shown(progress, "threads") as bar:
        return _measured(system, members, duration, rounds, bar or quiet)


def _measured(
    system: System, members: int, duration: float, rounds: int, done: Progress
) -> ThreadsTiming:
    drawn = [random_state(system, seed) for seed in range(members)]
    x0, xdot0, xi0 = (np.array([getattr(s, name) for s in drawn]) for name in ("x", "xdot", "xi"))

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

    def on(threads: int) -> Callable[[int], None]:
        def several(count: int) -> None:
            for _ in range(count):
                call(members, threads)

        return several

    times = alternating([on(1), on(2)], rounds=rounds, progress=lambda part: done(0.8 * part))
    sizes = (round(FEW * members), members)
    results, kept, extra = [], [], []
    for k, size in enumerate(sizes):
        tracemalloc.start()
        try:
            found = call(size, 2)
            current, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        results.append(found.y.nbytes)
        kept.append(current)
        extra.append(peak - current)
        done(0.8 + 0.1 * (k + 1))
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
