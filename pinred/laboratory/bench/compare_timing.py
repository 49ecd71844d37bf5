"""Time of compare() for scenes of various cost, beside one integration by ABA."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError
from ...common.waiting import Progress, one_by_one
from ...forces.kinds import Damper
from ...judge.compare import compare
from ...simulation.simulate import simulate
from ...simulation.trajectory import Trajectory
from ...system.load import load
from .timing import TimingRow, alternating, repeated, robots_to_measure

_ROUNDS = 7


def _free(robot: str, duration: float) -> Callable[[], Trajectory]:
    """Return a function that simulates a free motion from a random state."""
    return lambda: simulate(load(robot, gravity=(0.0, 0.0, 0.0)), seed=1, duration=duration)


def _driven() -> Trajectory:
    """Simulate the cat with a prescribed joint and a damper."""
    return simulate(
        load("falling_cat"),
        prescribed={"bend": "0.5*sin(2*t)"},
        forces=[Damper("sway", 0.1)],
        xdot0=[1.0, 0.5, 0.0],
        duration=10.0,
    )


BUNDLED: dict[str, Callable[[], Trajectory]] = {
    "falling_cat, 2 s": _free("falling_cat", 2.0),
    "falling_cat, 10 s, driven": _driven,
}
EXAMPLES: dict[str, Callable[[], Trajectory]] = {
    "solo12, 2 s": _free("solo12", 2.0),
    "solo12, 10 s": _free("solo12", 10.0),
    "talos, 2 s": _free("talos", 2.0),
}
SCENES = {**BUNDLED, **EXAMPLES}


@checks_arguments
@dataclass(frozen=True)
class CompareTiming(TimingRow):
    """Time of one comparison; medians of rounds that alternate between the scenes.

    Attributes:
        scene: Robot and duration.
        seconds: Time of `compare` [s].
        integrations: The same, relative to one integration by ABA at the scene's tolerance, which
            is a part of the comparison.
        verdict: The verdict.
    """

    ROW = "{scene:<28} {seconds:>12.3f} {integrations:>13.1f}  {verdict}"
    TITLES: ClassVar[Mapping[str, str]] = {"seconds": "compare [s]"}
    FILE = "compare"

    scene: str
    seconds: float
    integrations: float
    verdict: str


@checks_arguments
def bench_compare(
    scenes: Sequence[str] = (), *, progress: Progress | bool | None = None
) -> list[CompareTiming]:
    """Measure the time of `compare`.

    Args:
        scenes: Names of SCENES; by default all whose robots are installed.
        progress: True for a progress bar, or a function of the completed fraction.
    Returns:
        One result for each scene.
    Raises:
        InputError: A scene is unknown.
    """
    names = robots_to_measure(scenes, [*BUNDLED], [*EXAMPLES])
    if unknown := [name for name in names if name not in SCENES]:
        raise InputError(f"no scene '{unknown[0]}'; the scenes are {', '.join(SCENES)}")
    motions = one_by_one(names, lambda name: SCENES[name](), progress, "scenes")
    walls: list[list[float]] = [[] for _ in names]
    verdicts = [""] * len(names)

    def comparison(k: int) -> Callable[[], None]:
        def run() -> None:
            report = compare(motions[k])
            walls[k].append(report.wall_full)
            verdicts[k] = str(report.verdict)

        return run

    actions = [repeated(comparison(k)) for k in range(len(names))]
    times = alternating(actions, rounds=_ROUNDS, span=1e-3)
    seconds = np.nanmedian(times, axis=0).tolist()
    return [
        CompareTiming(name, s, s / float(np.median(wall)), verdict)
        for name, s, wall, verdict in zip(names, seconds, walls, verdicts, strict=True)
    ]
