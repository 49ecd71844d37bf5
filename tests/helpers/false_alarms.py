"""Compare random scenes with ABA: `python tests/helpers/false_alarms.py 1000 [first] [table.csv]`.

Every motion is correct, so no verdict may be FAILED. There is one exception: a light joint or a
thin axis amplifies small momentum errors into large rate errors, and the steps miss the requested
tolerance. The judge is right to reject such a motion. Its error decreases with the tolerance, and
it is counted separately. A short form is part of the suite (tests/judge/test_false_alarms.py).
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
_FINER = 1e-3  # factor on the tolerances of the second run
_SECONDS = 40.0  # processor time limit of one scene [s]


@dataclass(frozen=True)
class Alarm:
    """The outcome of the scene of a seed.

    Attributes:
        seed: Seed of the scene.
        verdict: Verdict of the report, or the name of the error that was raised.
        about: Description of the scene.
        message: The report or the error message.
        used: Error divided by its bound, by check.
    """

    seed: int
    verdict: str
    about: str
    message: str
    used: dict[str, float]


class _TooLongError(Exception):
    pass


def judged(seed: int) -> Alarm:
    """Return the verdict on the scene of a seed; an error of pinred is the verdict if raised."""
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
    """Return whether the errors of steps and final states shrink tenfold at finer tolerances."""
    accuracy_checks = ("defect", "shape", "rotation", "position")
    checks = report.checks.items()
    if report.defect <= report.defect_bound or any(
        not value <= bound
        for name, (value, bound) in checks
        if not name.startswith(accuracy_checks)
    ):
        return False
    finer_tolerances = {name: _FINER * scene.options[name] for name in ("rtol", "atol")}
    finer_report = pinred.compare(
        replace(scene, options={**scene.options, **finer_tolerances}).simulate()
    )
    return (
        finer_report.equations <= finer_report.equations_bound
        and finer_report.defect <= 0.1 * report.defect
    )


def alarms(seeds: range) -> Iterator[Alarm]:
    """Yield the outcomes of scenes, each with a limit on its processor time."""

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
    """Run the scenes; print the failures and the number of scenes per verdict."""
    count, first = int(arguments[0]), int(arguments[1]) if len(arguments) > 1 else 0
    path = Path(arguments[2]) if len(arguments) > 2 else None
    warnings.simplefilter("ignore")
    verdicts: Counter[str] = Counter()
    largest: dict[str, tuple[float, int]] = {}
    rows = []
    for alarm in alarms(range(first, first + count)):
        verdicts[alarm.verdict] += 1
        if alarm.verdict not in ("PASSED", "CANNOT TELL"):
            print(f"{alarm.seed}: {alarm.verdict}: {alarm.about}\n    {alarm.message}", flush=True)
        for name, fraction in alarm.used.items():
            largest[name] = max(largest.get(name, (0.0, -1)), (fraction, alarm.seed))
        rows.append([alarm.seed, alarm.verdict, alarm.about, alarm.message])
        if path is not None:
            with path.open("w", newline="") as file:
                csv.writer(file).writerows([["seed", "verdict", "scene", "report"], *rows])
    print(", ".join(f"{name}: {number}" for name, number in verdicts.most_common()))
    for name, (fraction, seed) in largest.items():
        print(f"  {name:<31} {fraction:9.2e} of its bound (largest), seed {seed}")
    return 1 if verdicts["FAILED"] else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
