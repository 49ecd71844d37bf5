"""No right motion is called wrong: random scenes of all kinds, in short."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from false_alarms import INACCURATE, _is_right, judged
from random_scenes import FAR, TINY, RandomScene, random_scene

import pinred


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(5, 12 * 12, 24))
def test_a_right_motion_does_not_fail(seed: int) -> None:
    """One scene of each of six trees; tests/helpers/false_alarms.py runs any number."""
    alarm = judged(seed)
    assert alarm.verdict in ("PASSED", "CANNOT TELL"), f"{alarm.about}: {alarm.said}"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "seed",
    [
        300353,
        301051,
        305207,
        305311,
        330803,
        331983,
        333656,
        pytest.param(305596, marks=pytest.mark.by_hand),
    ],
)
def test_what_was_called_wrong_once(seed: int) -> None:
    """Small spheres on a lever, wrenches on what falls or turns, a stiff spring by Tsit5."""
    assert judged(seed).verdict == "PASSED"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_less_accurate_is_not_wrong() -> None:
    """A motion that gets better with the tolerance is told from one that does not."""
    alarm = judged(300351)
    assert alarm.verdict == INACCURATE
    assert "FAILED" in alarm.said


@pytest.mark.parametrize(
    ("steps", "drift", "defect", "equations", "right"),
    [
        (9.0, 1.0, 0.09, 1.0, True),
        (0.9, 1.0, 0.09, 1.0, False),
        (9.0, 2.0, 0.09, 1.0, False),
        (9.0, 1.0, 0.2, 1.0, False),
        (9.0, 1.0, 0.09, 2.0, False),
    ],
)
def test_wrong_is_not_less_accurate(
    monkeypatch: pytest.MonkeyPatch,
    steps: float,
    drift: float,
    defect: float,
    equations: float,
    right: bool,
) -> None:
    """Steps miss the tolerance, all but them and ends is right, and finer ones miss less.

    Each of the four, alone, makes an alarm of it: what is given is in parts of the bounds, or of
    the first defect.
    """
    checks = {
        "defect of a step": (steps, 1.0),
        "shape error": (2.0, 1.0),
        "energy drift": (drift, 1.0),
    }
    again = SimpleNamespace(equations=equations, equations_bound=1.0, defect=defect * steps)
    monkeypatch.setattr(pinred, "compare", lambda _: again)
    scene = random_scene(300351)
    monkeypatch.setattr(RandomScene, "simulate", lambda _: None)
    found: Any = SimpleNamespace(checks=checks, defect=steps, defect_bound=1.0)
    assert _is_right(scene, found) is right


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("robot", ["planar_chain5", "reaction_wheel_satellite", "rigid_body"])
@pytest.mark.parametrize(("speed", "offset"), [(TINY, 0.0), (1.0, FAR)])
def test_extremes_do_not_fail(robot: str, speed: float, offset: float) -> None:
    """Squares of rates that are no numbers any more, and places with round-off of micrometres."""
    rng = np.random.default_rng(4)
    system = pinred.load(robot)
    pose = np.array(system.group.exp(rng.uniform(-1.0, 1.0, system.r)))
    pose[: system.group.linear] += offset
    report = pinred.compare(
        pinred.simulate(
            system,
            x0=rng.uniform(-1.0, 1.0, system.m),
            xdot0=speed * rng.normal(size=system.m),
            xi0=speed * rng.normal(size=system.r),
            pose0=pose,
            duration=0.5,
        )
    )
    expected = "CANNOT TELL" if speed == TINY else "PASSED"
    assert str(report.verdict) == expected, str(report)


def test_from_rest_to_rest() -> None:
    """At rest, accelerations are round-off alone, and no part of what is left of nothing."""
    rods = pinred.load("three_rods")
    angle = "(2*pi*t/2.0 - sin(2*pi*t/2.0))"
    plan = {"alpha1": f"0.3 - 0.3*cos({angle})", "alpha2": f"0.7*sin({angle})"}
    for duration in (2.0, 4.0):
        report = pinred.compare(
            pinred.simulate(
                rods, x0=[0.0, 0.0], momentum=0, prescribed=plan, duration=duration, rtol=1e-12
            )
        )
        assert report.passed, report
