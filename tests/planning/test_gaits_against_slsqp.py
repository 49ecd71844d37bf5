"""Optimal gaits against SLSQP and, for targets, Ipopt over samples of the connection."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from gait_reference import Reference
from three_links import CENTRES, LENGTH, LINKS

import pinred
from pinred.analysis.phases.lift import PathLift, path_lift
from pinred.planning.optimisation import gait_search

GAP = 1e-6  # largest relative gap to the best of STARTS loops of the reference
STARTS = 10
# Largest number of evaluations of all starts, which take about 1 ms, or 1.5 ms with three joints.
MOST = {"three_rods": 9000, "purcell_swimmer": 9000, "falling_cat": 6000}
LIMITS = {0.5: 2, 0.7: 3, 0.9: 2, 1.1: 3, 1.3: 2}  # limits of all joints [rad], and harmonics
QUICK = ("three_rods-rotation-length-0.9",)
TASKS: dict[str, dict[str, dict[str, Any]]] = {
    "three_rods": {
        "rotation-length": {},
        "rotation-torque": {"cost": "torque"},
        "rotation-acceleration": {"cost": "acceleration"},
        "rotation-time": {"cost": "time", "speeds": 3.0},
        "target-length": {"objective": "target", "target": -0.02},
    },
    "purcell_swimmer": {
        "rotation-length": {},
        "rotation-torque": {"cost": "torque"},
        "rotation-power": {"cost": "power"},
        "rotation-time": {"cost": "time", "speeds": 3.0},
        "target-torque": {"objective": "target", "target": 0.02, "cost": "torque"},
    },
    "falling_cat": {
        "rotation-x-length": {"axis": "x"},
        "rotation-y-length": {"axis": "y"},
        "rotation-x-torque": {"axis": "x", "cost": "torque"},
        "rotation-x-acceleration": {"axis": "x", "cost": "acceleration"},
        "target-length": {"objective": "target", "target": (0.05, 0.0, 0.0)},
    },
}


@cache
def connection(robot: str) -> pinred.Connection:
    """Return the connection of a robot: by drag for the swimmer, by momenta for others."""
    system = pinred.load(robot)
    if robot != "purcell_swimmer":
        return pinred.Connection.mechanical(system)
    rods = {name: pinred.Rod(LENGTH, 2.0, 1.0, centre=(CENTRES[name], 0.0, 0.0)) for name in LINKS}
    return pinred.Connection.viscous(system, rods)


def problems() -> list[Any]:
    """Return robot and options of each problem; all but the quick ones are run by hand."""
    cases = []
    for robot, tasks in TASKS.items():
        for task, more in tasks.items():
            for limit, harmonics in LIMITS.items():
                options = more | {"limits": limit, "harmonics": 2 if "cat" in robot else harmonics}
                if "target" in more:  # about half of the largest phase within the limits
                    options["target"] = np.multiply(limit**3, more["target"])
                name = f"{robot}-{task}-{limit}"
                marks = [] if name in QUICK else [pytest.mark.by_hand]
                cases.append(pytest.param(robot, options, id=name, marks=marks))
    return cases


# test_extremal.py compares the best rotation per length with an independent extremal.
@pytest.mark.by_hand("three_rods-rotation-length-0.9")
@pytest.mark.parametrize(("robot", "options"), problems())
def test_reference_finds_no_better_gait(
    robot: str, options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The merit is at most GAP below the best loop of the reference, and the limits hold."""
    reference, count, lift = Reference(connection(robot), options), [0], path_lift

    def counted(*arguments: Any) -> PathLift:
        count[0] += 1
        return lift(*arguments)

    monkeypatch.setattr(gait_search, "path_lift", counted)
    best = pinred.optimise_gait(connection(robot), **options)
    expected = reference.best_of(STARTS, near=best.gait if "target" in options else None)[0]
    merit = reference.merit(best.gait)  # of a target: −cost
    gap = (expected - merit) / abs(expected)
    print(f"GAP {gap:.1e} merit {merit:.10g} evaluations {count[0]} found {best.found}")
    assert count[0] <= MOST[robot]
    assert gap <= GAP
    assert best.margins["limits"] >= 0.0
    assert best.merit == pytest.approx(merit, rel=1e-7)
