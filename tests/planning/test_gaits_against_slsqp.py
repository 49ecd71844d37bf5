"""Optimal gaits without equations against SLSQP over samples of the connection."""

from __future__ import annotations

import time
from functools import cache
from typing import Any

import pytest
from gait_reference import Reference
from three_links import CENTRES, LENGTH, LINKS

import pinred

GAP = 1e-6  # largest relative gap to the best of STARTS loops by SLSQP
STARTS = 10
MOST = 10.0  # largest CPU time of an optimisation [s]
SLOWER = 2.0  # largest factor by which other processes slow down the CPU, as seen with full load
LIMITS = {0.5: 2, 0.7: 3, 0.9: 2, 1.1: 3, 1.3: 2}  # limits of all joints [rad], and harmonics
QUICK = ("three_rods-rotation-length-0.9", "three_rods-rotation-torque-0.5")
TASKS: dict[str, dict[str, dict[str, Any]]] = {
    "three_rods": {
        "rotation-length": {},
        "rotation-torque": {"cost": "torque"},
        "rotation-acceleration": {"cost": "acceleration"},
        "rotation-time": {"cost": "time", "speeds": 3.0},
    },
    "purcell_swimmer": {
        "rotation-length": {},
        "rotation-torque": {"cost": "torque"},
        "rotation-power": {"cost": "power"},
        "rotation-time": {"cost": "time", "speeds": 3.0},
    },
    "falling_cat": {
        "rotation-x-length": {"axis": "x"},
        "rotation-y-length": {"axis": "y"},
        "rotation-x-torque": {"axis": "x", "cost": "torque"},
        "rotation-x-acceleration": {"axis": "x", "cost": "acceleration"},
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
                name = f"{robot}-{task}-{limit}"
                marks = [] if name in QUICK else [pytest.mark.by_hand]
                cases.append(pytest.param(robot, options, id=name, marks=marks))
    return cases


@pytest.mark.parametrize(("robot", "options"), problems())
def test_slsqp_finds_no_better_gait(
    robot: str, options: dict[str, Any], request: pytest.FixtureRequest
) -> None:
    """The merit is at most GAP below the best loop of SLSQP, and the limits hold."""
    reference = Reference(connection(robot), options)
    begin = time.process_time()
    best = pinred.optimise_gait(connection(robot), **options)
    spent = time.process_time() - begin
    if request.config.getoption("--by-hand"):
        assert spent <= MOST * SLOWER
    expected = reference.best_of(STARTS)[0]
    merit = reference.merit(best.gait)  # of a target: −cost
    gap = (expected - merit) / abs(expected)
    print(f"GAP {gap:.1e} merit {merit:.10g} CPU {spent:.1f} s found {best.found}")
    assert gap <= GAP
    assert best.margins["limits"] >= 0.0
    assert best.merit == pytest.approx(merit, rel=1e-7)
