"""Random scenes, each judged: `python tests/helpers/false_alarms.py 1000 [first] [table.csv]`.

Every motion is right, so no verdict may be FAILED, unless the motion is less accurate than it was
asked to be: where a light joint or a thin axis turns a small error of momenta into a large one of
rates, steps miss the tolerance, and that is what the judge is for.  Such a motion gets better with
the tolerance, and is counted apart.  The short form is part of the suite
(tests/judge/test_false_alarms.py).
"""

from __future__ import annotations

import csv
import signal
import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from random_scenes import RandomScene, random_scene

import pinred

INACCURATE = "less accurate than asked"
_FINER = 1e-3  # of the tolerances
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
    verdict = str(report.verdict)
    if verdict == "FAILED" and _is_right(scene, report):
        verdict = INACCURATE
    used = {name: value / bound for name, (value, bound) in report.checks.items() if bound > 0.0}
    return Alarm(seed, verdict, scene.about, repr(report), used)


def _is_right(scene: RandomScene, report: pinred.Report) -> bool:
    """Return whether steps, and so ends, are off, by ten times less at finer tolerances."""
    ends = ("defect", "shape", "rotation", "position")
    checks = report.checks.items()
    if report.defect <= report.defect_bound or any(
        not value <= bound for name, (value, bound) in checks if not name.startswith(ends)
    ):
        return False
    finer = {name: _FINER * scene.options[name] for name in ("rtol", "atol")}
    again = pinred.compare(replace(scene, options={**scene.options, **finer}).simulate())
    return again.equations <= again.equations_bound and again.defect <= 0.1 * report.defect


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
