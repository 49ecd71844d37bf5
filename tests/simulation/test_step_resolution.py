"""The check of steps: forces in a narrow range of the shape are found, ordinary scenes pass."""

from __future__ import annotations

import pickle
from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred import Parameter
from pinred.forces import Torque
from pinred.scene.scene import ENGINES, Engine
from pinred.simulation import step_resolution
from pinred.simulation.step_resolution import find_defects
from pinred.system.find_robot_files import bundled_robots

CAT = pinred.load("falling_cat")
PLACE, WIDTH = Parameter("place", 0.3), Parameter("width", 1e-3)
TIMES = [1.0, 2.0]


def torque(s: Any) -> dict[str, Any]:
    """Return a Gaussian torque that acts where the joint is close to a place."""
    return {"bend": 0.5 * ca.exp(-0.5 * ((s.x["bend"] - PLACE) / WIDTH) ** 2)}


BUMP = Torque(torque)


def scene(place: float, width: float, **options: Any) -> pinred.Scene:
    """Return a scene of the falling cat with a bump of a width [rad] at a place [rad]."""
    settings: dict[str, Any] = {
        "times": TIMES, "seed": 1, "rtol": 1e-6, "atol": 1e-7, "method": "DOP853",
        "forces": [BUMP], "parameters": {"place": place, "width": width},
    } | options  # fmt: skip
    return pinred.Scene(system=CAT, **settings)


def bumps(count: int, seed: int) -> list[tuple[float, float]]:
    """Return places on the motion without bumps [rad], and widths from 0.3 to 30 mrad [rad]."""
    free = pinred.simulate(scene(0.0, 1.0, forces=[], parameters={}))
    times = np.random.default_rng(seed).uniform(0.3, 1.9, count)
    return list(zip(free(times).x[:, 0].tolist(), np.geomspace(3e-4, 3e-2, count), strict=True))


def errors(place: float, width: float, **options: Any) -> tuple[float, float]:
    """Return the largest errors of the shape without and with the check [rad]."""
    bare = pinred.simulate(scene(place, width, **options))
    checked = pinred.simulate(scene(place, width, **options), check=True)
    fine = f"DOP853(max_step={width})"
    exact = {"method": fine, "rtol": 1e-11, "atol": 1e-12}
    reference = pinred.simulate(scene(place, width, **options | exact))
    return float(np.abs(bare.x - reference.x).max()), float(np.abs(checked.x - reference.x).max())


def test_bumps_in_the_shape_are_found() -> None:
    """None of 25 bumps leaves an error of 100 tolerances; five do without the check."""
    both = np.array([errors(*bump) for bump in bumps(25, seed=3)])
    bare, checked = (both > 1e-4).sum(axis=0)
    assert bare >= 3
    assert checked == 0


@pytest.mark.by_hand
@pytest.mark.parametrize(("rtol", "most"), [(1e-6, 100.0), (1e-9, 300.0)])
def test_many_bumps_in_the_shape_are_found(rtol: float, most: float) -> None:
    """At 1e-9, three of 150 bumps leave errors of 100 to 210 tolerances, below the alarm."""
    for seed in range(3, 9):
        for bump in bumps(25, seed):
            assert errors(*bump, rtol=rtol, atol=0.1 * rtol)[1] < most * rtol


@pytest.mark.parametrize(
    ("method", "engine"),
    [
        ("auto", "pinocchio"),
        ("Tsit5", "compiled"),
        ("Radau", "compiled"),
        ("AdaptiveGauss", "compiled"),
    ],
)
def test_adaptive_methods_of_both_engines_are_checked(method: str, engine: Engine) -> None:
    """A bump that lies beside all steps of a run is found; the reruns stop there."""
    place, width = 0.5403, 3e-4
    options = scene(place, width, method=method)
    bare = pinred.simulate(options, engine=engine)
    checked = pinred.simulate(options, engine=engine, check=True)
    assert not find_defects(checked.plan, checked).times.size
    if find_defects(bare.plan, bare).times.size:
        assert len(checked.motion.segments) > 1
        assert checked.run.evaluations > bare.run.evaluations


def skipping() -> pinred.Scene:
    """Return a scene whose first run skips a bump."""
    for bump in bumps(25, seed=3):
        skipped = scene(*bump)
        traj = pinred.simulate(skipped)
        if find_defects(traj.plan, traj).times.size:
            return skipped
    pytest.fail("no run skips a bump")


def test_worst_times_become_stops() -> None:
    """Costs are those of all runs, and copies repeat the check."""
    skipped = skipping()
    bare, checked = pinred.simulate(skipped), pinred.simulate(skipped, check=True)
    assert len(checked.motion.segments) > len(bare.motion.segments) == 1
    assert checked.run.evaluations > 2 * bare.run.evaluations
    times = np.linspace(0.0, 2.0, 7)
    copy = pickle.loads(pickle.dumps(checked))
    np.testing.assert_array_equal(copy(times).x, checked(times).x)


def test_defects_that_stay_raise_if_the_motion_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error states time and shape; a defect that has no effect is no error."""
    skipped = skipping()
    monkeypatch.setattr(step_resolution, "_RERUNS", 1)
    monkeypatch.setattr(step_resolution, "_ALARM", 1.0)  # ordinary defects
    with pytest.raises(pinred.IntegrationError, match=r"near t = .* s, shape x = \[.* tolerances"):
        pinred.simulate(skipped, check=True)
    free = scene(0.0, 1.0, forces=[], parameters={})
    traj = pinred.simulate(free)
    assert find_defects(traj.plan, traj).times.size
    assert len(pinred.simulate(free, check=True).motion.segments) > 1


def test_equal_steps_are_refused() -> None:
    """Their defects are not related to a tolerance."""
    with pytest.raises(pinred.InputError, match=r"check: expected a method with step control"):
        pinred.simulate(scene(0.3, 1e-3, method="Gauss(0.01)"), check=True)
    body = pinred.load("rigid_body")
    pinred.simulate(body, xi0=np.zeros(body.r), duration=1.0, check=True)


def test_events_and_controllers_are_kept() -> None:
    """A terminal event ends the checked motion, too."""
    event = pinred.Event("x[0] - 0.2", "end", terminal=True)
    options = scene(0.0, 1.0, x0=[0.0, 0.1, 0.2], xdot0=[0.5, 0.0, 0.0], seed=None, events=event)
    bare, checked = pinred.simulate(options), pinred.simulate(options, check=True)
    assert checked.ended_by == "end"
    assert checked.scene.end == bare.scene.end


@pytest.mark.by_hand
@pytest.mark.parametrize("engine", ENGINES)
def test_ordinary_scenes_raise_no_alarm(engine: Engine) -> None:
    """Robots × initial states × tolerances, with every adaptive method."""
    alarms, count = [], 0
    tolerances = (1e-3, 1e-6, 1e-9, 1e-12) if engine == "compiled" else (1e-6,)
    for k, name in enumerate(bundled_robots()):
        robot = pinred.load(name)
        for seed in range(8):
            for j, rtol in enumerate(tolerances):
                methods = ("DOP853", "Tsit5", "AdaptiveGauss", "Radau")
                method = methods[(k + seed + j) % 4] if engine == "compiled" else "auto"
                method = "DOP853" if method != "auto" and seed < 4 else method
                options: dict[str, Any] = {"rtol": rtol, "atol": rtol, "method": method}
                traj = pinred.simulate(robot, seed=seed, duration=3.0, engine=engine, **options)
                count += 1
                if find_defects(traj.plan, traj).times.size:
                    alarms.append((name, seed, rtol, method))
    assert count >= 100
    assert not alarms


def test_bump_in_the_shape_is_found_beside_joint_stops() -> None:
    """The last steps before an impact and the flow of each mode are checked, too."""
    bare, checked = errors(-0.5289876563621796, 3.6e-4, stops={"sway": pinred.Stop(-0.7, 0.7, 0.6)})
    assert bare > 0.1
    assert checked < 1e-5
