"""Smooth functions of time in forces: no step skips a bump, and ordinary ones cost no rerun."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred import Parameter
from pinred.common.arrays import Array
from pinred.forces import Torque
from pinred.scene.scene import ENGINES, Engine
from pinred.signals import Hold
from pinred.simulation import time_resolution
from pinred.simulation.flow_map import resolved_run
from pinred.simulation.members import integrate_members
from pinred.simulation.plan import plan_of

CAT = pinred.load("falling_cat")
CENTRE, WIDTH, RATE = Parameter("centre", 1.0), Parameter("width", 0.01), Parameter("rate", 1.0)


def bump(s: Any) -> dict[str, Any]:
    """Return a Gaussian torque that also depends on the state."""
    gaussian = ca.exp(-0.5 * ((s.t - CENTRE) / WIDTH) ** 2)
    return {"bend": 0.5 * gaussian * (1.0 + 0.1 * s.x["bend"])}


def scene(*forces: Any, **options: Any) -> pinred.Scene:
    """Return a scene of the falling cat."""
    settings: dict[str, Any] = {
        "times": [2.0], "seed": 1, "rtol": 1e-6, "atol": 1e-7, "method": "DOP853",
    } | options  # fmt: skip
    return pinred.Scene(system=CAT, forces=list(forces), **settings)


def stopped(centre: float, width: float) -> Torque:
    """Return a torque of zero at whose breaks the integration stops, all over a bump."""
    times = np.clip(centre + width * np.arange(-6.0, 7.0), 1e-3, 1.99) + 1e-6 * np.arange(13)
    return Torque({"bend": Hold([0.0, *times.tolist()], [0.0] * 14)})


def never_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switch the check off."""
    monkeypatch.setattr(time_resolution, "find_unresolved", lambda *_: np.empty(0))


def test_bumps_are_not_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 25 Gaussians of 0.3 to 50 ms, none has an error of 100 tolerances; eight had."""
    rng = np.random.default_rng(1)
    torque, errors, bare = Torque(bump), [], []
    for width in np.geomspace(3e-4, 5e-2, 25).tolist():
        centre = float(rng.uniform(0.1, 1.9))
        values = {"centre": centre, "width": width}
        checked = pinred.simulate(scene(torque, parameters=values)).x
        with monkeypatch.context() as context:
            never_check(context)
            plain = pinred.simulate(scene(torque, parameters=values)).x
            fine = scene(torque, stopped(centre, width), parameters=values, rtol=1e-11, atol=1e-12)
            reference = pinred.simulate(fine).x
        errors.append(np.abs(checked - reference).max())
        bare.append(np.abs(plain - reference).max())
    assert max(errors) < 1e-4
    assert (np.array(bare) > 1e-4).sum() >= 5


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.sampled
def test_resolved_bump_passes_the_comparison(engine: Engine) -> None:
    """Its reference solution stops where the motion does."""
    options: dict[str, Any] = {"parameters": {"centre": 1.3, "width": 1e-3}, "duration": 2.0}
    options |= {"times": None, "method": "auto"}
    traj = pinred.simulate(scene(Torque(bump), **options), engine=engine)
    assert len(traj.motion.segments) > 1
    assert traj.run.notices == ()
    report = pinred.compare(traj)
    assert report.passed, str(report)


@pytest.mark.parametrize("method", ["DOP853", "Tsit5", "Radau", "AdaptiveGauss"])
def test_ordinary_functions_cause_no_rerun(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sines up to 300 rad/s, and a sine within a pulse, are resolved by the first run."""
    seen: list[Array] = []
    find = time_resolution.find_unresolved

    def spy(*arguments: Any) -> Array:
        seen.append(find(*arguments))
        return seen[-1]

    monkeypatch.setattr(time_resolution, "find_unresolved", spy)
    sine = Torque(lambda s: {"bend": ca.sin(RATE * s.t) * ca.if_else(s.t > 0.7, 1.0, 0.4)})
    for rate in (1.0, 10.0, 300.0):
        pinred.simulate(scene(sine, method=method, parameters={"rate": rate}, times=[1.0]))
    assert len(seen) == 3
    assert all(times.size == 0 for times in seen)


def test_functions_that_stay_unresolved_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """After two reruns, a warning and a notice state the times if the motion still changes."""
    scenes = scene(Torque(bump), parameters={"centre": 1.0, "width": 0.3})
    assert pinred.simulate(scenes).run.notices == ()
    stops = iter([0.5, 1.0, 1.5])
    monkeypatch.setattr(time_resolution, "find_unresolved", lambda *_: np.array([next(stops)]))
    traj = pinred.simulate(scenes)
    assert traj.run.notices == ()  # further stops do not change the motion
    assert traj.motion.segments.ends.tolist() == [0.5, 1.0, 2.0]
    stops = iter([0.5, 1.0, 1.5])
    monkeypatch.setattr(time_resolution, "_CHANGED", 0.0)
    with pytest.warns(pinred.AccuracyWarning, match=r"changes faster than the steps near t = 1.5"):
        traj = pinred.simulate(scenes)
    assert "max_step" in traj.run.notices[0]


def test_functions_of_time_are_factors_of_expressions() -> None:
    """Parts that depend on the state, or are linear in time, do not count."""

    def torque(s: Any) -> dict[str, Any]:
        return {"bend": WIDTH * ca.exp(-(s.t**2)) * s.x[0] + 3.0 * s.t + ca.cos(s.t - s.x[0])}

    forces = scene(Torque(torque)).force_model
    assert forces is not None
    functions, times = forces.time_functions, np.linspace(0.0, 2.0, 5)
    values = functions(times, forces.numbers, forces.within, times)
    assert values.shape == (1, 5)
    assert values[0] / np.exp(-(times**2)) == pytest.approx(values[0, 0], rel=1e-14)


def test_scenes_without_functions_of_time_are_not_checked() -> None:
    """Methods with fixed steps cannot refine their steps, so they are not checked either."""
    linear = Torque(lambda s: {"bend": 0.1 * s.t - s.x["bend"]})
    for other in (scene(), scene(linear), scene(Torque(bump), method="Gauss(0.01)")):
        assert not plan_of(other).has_time_functions
    assert plan_of(scene(Torque(bump))).has_time_functions


@pytest.mark.parametrize(("rate", "missed"), [(3.0, 0), (5.0, 1)])
def test_one_step_resolves_half_a_period(rate: float, missed: int) -> None:
    """A polynomial of degree 7 over 2 s is off by 10 to 20 % of the range at 5 rad/s."""
    plan = plan_of(scene(Torque(lambda s: {"bend": ca.sin(RATE * s.t)}), parameters={"rate": rate}))
    motion: Any = SimpleNamespace(segments=[SimpleNamespace(knots=np.array([0.0, 2.0]))])
    assert time_resolution.find_unresolved(plan, motion, pinred.DOP853).size == missed


BUMPS = [(3e-4, 1.2465), (1.1e-3, 1.1919), (2.5e-3, 1.5686), (2e-2, 0.7)]  # widths and times [s]


def end_of(width: float, centre: float) -> Array:
    """Return the final shape of a run with steps shorter than a bump."""
    values = {"centre": centre, "width": width}
    fine = scene(Torque(bump), parameters=values, method=f"DOP853(max_step={width / 3.0})")
    return np.asarray(pinred.simulate(fine, rtol=1e-11, atol=1e-12).x[-1])


@pytest.mark.parametrize("method", ["DOP853", "AdaptiveGauss"])
def test_flows_and_implicit_methods_skip_no_bumps(method: str) -> None:
    """Each call of a flow is checked; Gauss methods stop at several times around a bump."""
    options = scene(Torque(bump), parameters={"centre": 1.0, "width": 0.01}, method=method)
    flow = pinred.flow(options, wrt=("centre", "width"), of=("x",))
    for width, centre in BUMPS:
        values = {"centre": centre, "width": width}
        expected = end_of(width, centre)
        assert np.abs(flow(**values).x.ravel() - expected).max() < 2e-4
        checked = pinred.simulate(options, parameters=values).x[-1]
        assert np.abs(checked - expected).max() < 2e-4


def test_flow_of_a_bump_has_its_derivatives() -> None:
    """Stops at a bump do not change the derivatives by its time."""
    values = {"centre": 1.2465, "width": 1e-3}
    options = scene(Torque(bump), parameters=values, rtol=1e-10, atol=1e-11)
    flow = pinred.flow(options, wrt=("centre",), of=("x",))
    ends = [flow(centre=1.2465 + h).x.ravel() for h in (1e-4, -1e-4)]
    slope = flow.jacobian()["centre"].ravel()
    assert slope == pytest.approx((ends[0] - ends[1]) / 2e-4, abs=1e-4 * np.abs(slope).max())


def test_flow_with_unresolved_functions_warns(monkeypatch: pytest.MonkeyPatch) -> None:
    """The warning is that of `simulate`."""
    flow = pinred.flow(scene(Torque(bump)), wrt=("centre",), of=("x",))
    stops = iter([0.5, 1.0, 1.5])
    monkeypatch.setattr(resolved_run, "unresolved_times", lambda *_: np.array([next(stops)]))
    monkeypatch.setattr(time_resolution, "_CHANGED", 0.0)
    with pytest.warns(pinred.AccuracyWarning, match=r"changes faster than the steps near t = 1.5"):
        flow(centre=1.0)


def test_members_skip_no_bumps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Members stop in short changes, each as without the others; sines need no stop."""
    widths, centres = np.array(BUMPS).T
    options = scene(Torque(bump))
    batch = pinred.simulate_many(options, members={"width": widths, "centre": centres})
    for k, (width, centre) in enumerate(BUMPS):
        assert np.abs(batch.x[k, -1] - end_of(width, centre)).max() < 1e-4
    alone = pinred.simulate_many(options, members={"width": widths[:1], "centre": centres[:1]})
    np.testing.assert_array_equal(alone.x[0], batch.x[0])
    shared = replace(options, parameters={"width": widths[0], "centre": centres[0]})
    np.testing.assert_array_equal(pinred.simulate_many([shared, shared]).x[1], batch.x[0])
    monkeypatch.setattr(integrate_members, "stops_for_any_steps", lambda *_: np.empty(0))
    bare = pinred.simulate_many(options, members={"width": widths, "centre": centres})
    assert np.abs(bare.x[:3] - batch.x[:3]).max() > 1e-2


@pytest.mark.parametrize("rate", [1.0, 10.0, 30.0, 300.0])
def test_ordinary_functions_need_few_stops(rate: float) -> None:
    """They change everywhere, so that no step is long before a change."""
    sine = Torque(lambda s: {"bend": ca.sin(RATE * s.t)})
    plan = plan_of(scene(sine, parameters={"rate": rate}))
    assert plan.forces is not None
    numbers = plan.forces.numbers
    stops = time_resolution.stops_for_any_steps(plan, plan.forces, numbers, pinred.DOP853)
    assert len(stops) <= rate / 30.0
