"""Long trials of planning.

    python tests/helpers/gait_trials.py turns [robot] [count]
    python tests/helpers/gait_trials.py gaits

turns: random reorientations by 20 to 180 degrees, each within joint limits. The hardest plan is
validated with `compare`. gaits: optimisations from five starts, for three links and for solo12
(extra `robots`). Short forms are part of the suite (tests/planning/).
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np

import pinred
from pinred.common.arrays import Array

ROBOTS = {"falling_cat": 1.6, "satellite_two_arms": 2.6, "solo12": 1.0}  # with joint limits [rad]


def target(rng: np.random.Generator) -> Array:
    """Return a rotation vector of random direction and 20 to 180 degrees, (3,) [rad]."""
    w = rng.normal(size=3)
    return np.asarray(np.radians(rng.uniform(20.0, 180.0)) * w / np.linalg.norm(w))


def turns(name: str, count: int) -> bool:
    """Reorient a robot to `count` random targets; return whether all were reached."""
    system, limit, reached, hardest = pinred.load(name), ROBOTS[name], 0, None
    pinred.reorient(system, [0.1, 0.0, 0.0], limits=limit)  # compile before the times are measured
    for seed in range(count):
        w = target(np.random.default_rng(seed))
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            plan = pinred.reorient(system, w, limits=limit)
        except pinred.NoOptimum as error:
            print(f"{name} {seed}: {np.degrees(np.linalg.norm(w)):.0f}° NOT REACHED: {error}")
            continue
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        within_limits = float(np.abs(plan.gait.limits).max()) <= limit
        reached += plan.missed < 1e-8 and within_limits
        if hardest is None or plan.cycles > hardest.cycles:
            hardest = plan
        print(
            f"{name} {seed}: {np.degrees(np.linalg.norm(w)):.0f}° in {plan.cycles} cycles, missed "
            f"{plan.missed:.1e} rad, limits {'respected' if within_limits else 'VIOLATED'}, "
            f"{wall:.1f} s, {cpu:.1f} s of CPU",
            flush=True,
        )
    print(f"{name}: {reached} of {count} reached")
    if hardest is not None:
        print(hardest.report)
    return reached == count and hardest is not None and bool(hardest.report)


def gaits() -> bool:
    """Optimise gaits of three links and of solo12 from five starts each."""
    rods = pinred.Connection.mechanical(pinred.load("three_rods"))
    solo = pinred.Connection.mechanical(pinred.load("solo12"))
    least_torque = {"objective": "target", "target": [0.0, np.radians(30.0), 0.0], "cost": "torque"}
    tasks: list[tuple[pinred.Connection, dict[str, Any]]] = [
        (rods, {}),
        (rods, {"cost": None, "vertices": 24, "limits": 1.0}),
        (solo, {"axis": "y", "limits": 1.0, "harmonics": 3}),
        (solo, least_torque | {"limits": 1.0, "harmonics": 3}),
    ]
    for connection, options in tasks:
        pinred.optimise_gait(
            connection, **options | {"starts": 1}
        )  # compile before the times are measured
        wall, cpu = time.perf_counter(), time.process_time()
        best = pinred.optimise_gait(connection, **options)
        print(best)
        print(
            f"  {time.perf_counter() - wall:.1f} s, {time.process_time() - cpu:.1f} s of CPU",
            flush=True,
        )
    return True


def main(words: list[str]) -> int:
    """Run the requested trials; return 1 if one fails."""
    if not words or words[0] not in ("turns", "gaits"):
        print(__doc__)
        return 2
    if words[0] == "gaits":
        return 0 if gaits() else 1
    names = [words[1]] if len(words) > 1 else list(ROBOTS)
    count = int(words[2]) if len(words) > 2 else 20
    return 0 if sum(turns(name, count) for name in names) == len(names) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
