"""Random scenes, each judged: `python tests/helpers/false_alarms.py 1000 [first] [table.csv]`.

Every motion is right, so no verdict may be FAILED.  The short form is part of the suite
(tests/verification/test_false_alarms.py).
"""

from __future__ import annotations

import csv
import signal
import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from random_scenes import random_scene

import pinred

_SECONDS = 40.0  # of the processor, for one scene


@dataclass(frozen=True)
class Alarm:
    """The outcome of a seed.  used: the largest part of a bound, and of which."""

    seed: int
    verdict: str
    about: str
    said: str
    used: dict[str, float]


class _TooLongError(Exception):
    pass


def judged(seed: int) -> Alarm:
    """Return the verdict of the scene of a seed; what cannot be followed is named by its error."""
    scene = random_scene(seed)
    try:
        report = pinred.compare(scene.simulate())
    except pinred.PinredError as error:
        return Alarm(seed, type(error).__name__, scene.about, str(error).splitlines()[0], {})
    used = {name: value / bound for name, (value, bound) in report.checks.items() if bound > 0.0}
    return Alarm(seed, str(report.verdict), scene.about, repr(report), used)


def alarms(seeds: range) -> Iterator[Alarm]:
    """Judge one after the other, each within its time."""

    def stop(*_: Any) -> None:
        raise _TooLongError

    signal.signal(signal.SIGPROF, stop)
    for seed in seeds:
        signal.setitimer(signal.ITIMER_PROF, _SECONDS)
        try:
            yield judged(seed)
        except _TooLongError:
            yield Alarm(seed, "too long", random_scene(seed).about, "", {})
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)


def main(arguments: list[str]) -> int:
    """Run them, print those that fail and how many there are of each verdict."""
    count, first = int(arguments[0]), int(arguments[1]) if len(arguments) > 1 else 0
    path = Path(arguments[2]) if len(arguments) > 2 else None
    warnings.simplefilter("ignore")
    found: Counter[str] = Counter()
    most: dict[str, tuple[float, int]] = {}
    rows = []
    for alarm in alarms(range(first, first + count)):
        found[alarm.verdict] += 1
        if alarm.verdict not in ("PASSED", "CANNOT TELL"):
            print(f"{alarm.seed}: {alarm.verdict}: {alarm.about}\n    {alarm.said}", flush=True)
        for name, part in alarm.used.items():
            most[name] = max(most.get(name, (0.0, -1)), (part, alarm.seed))
        rows.append([alarm.seed, alarm.verdict, alarm.about, alarm.said])
        if path is not None:
            with path.open("w", newline="") as file:
                csv.writer(file).writerows([["seed", "verdict", "scene", "report"], *rows])
    print(", ".join(f"{name}: {number}" for name, number in found.most_common()))
    for name, (part, seed) in most.items():
        print(f"  {name:<31} {part:9.2e} of its bound at most, seed {seed}")
    return 1 if found["FAILED"] else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
