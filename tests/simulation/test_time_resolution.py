"""Smooth functions of time in forces: no step skips a bump, and ordinary ones cost no rerun."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
import timed_torques
from scipy.optimize import brentq
from scipy.special import jv

import pinred
from pinred import Parameter
from pinred.common.arrays import Array
from pinred.forces import Torque, time_functions
from pinred.scene.scene import ENGINES, Engine
from pinred.signals import Hold
from pinred.simulation import longest_steps, step_resolution
from pinred.simulation.flow_map import run_and_adjoint
from pinred.simulation.longest_steps import StepLimits
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


UNLIMITED = longest_steps.Limited(np.inf, np.empty(0))


def never_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switch limits and checks of steps off."""

    def runs(_: StepLimits, __: tuple[float, float], run: Any, *___: Any) -> list[Any]:
        return [run(UNLIMITED)]

    monkeypatch.setattr(step_resolution, "resolved_runs", runs)
    monkeypatch.setattr(run_and_adjoint, "resolved_runs", runs)


def test_bumps_are_not_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 25 Gaussians of 0.3 to 50 ms, none has an error of 100 tolerances; eight had."""
    rng = np.random.default_rng(1)
    torque, errors, bare = Torque(bump), [], []
    for width in np.geomspace(3e-4, 5e-2, 25).tolist():
        centre = float(rng.uniform(0.1, 1.9))
        values = {"centre": centre, "width": width}
        checked = pinred.simulate(scene(torque, parameters=values)).x
        with monkeypatch.context() as context:
            never_limit(context)
            plain = pinred.simulate(scene(torque, parameters=values)).x
            fine = scene(torque, stopped(centre, width), parameters=values, rtol=1e-11, atol=1e-12)
            reference = pinred.simulate(fine).x
        errors.append(np.abs(checked - reference).max())
        bare.append(np.abs(plain - reference).max())
    assert max(errors) < 1e-4
    assert (np.array(bare) > 1e-4).sum() >= 5


@pytest.mark.by_hand("pinocchio")
@pytest.mark.parametrize("engine", ENGINES)
def test_resolved_bump_passes_the_comparison(engine: Engine) -> None:
    """Its reference solution stops where the motion does."""
    options: dict[str, Any] = {"parameters": {"centre": 1.3, "width": 1e-3}, "duration": 2.0}
    options |= {"times": None, "method": "auto"}
    traj = pinred.simulate(scene(Torque(bump), **options), engine=engine)
    assert len(traj.motion.segments) > 1
    assert traj.run.notices == ()
    report = pinred.compare(traj)
    assert report.passed, str(report)


METHODS = ("auto", "DOP853", "AdaptiveGauss", "Tsit5", "Radau")


def runs_of(
    cases: list[timed_torques.Case], method: str, rtol: float
) -> Iterator[pinred.Trajectory]:
    """Yield the trajectory of each case."""
    options: dict[str, Any] = {"method": method, "rtol": rtol, "atol": rtol / 100.0}
    for case in cases:
        yield pinred.simulate(case.scene, parameters=case.parameters, **options)


# The limits of steps depend on no method; `test_bursts_are_resolved` has these methods.
@pytest.mark.by_hand("auto", "Radau", "Tsit5", "AdaptiveGauss")
@pytest.mark.parametrize("method", METHODS)
def test_ordinary_torques_cost_no_evaluations(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Limits of steps add at most 3 % to the evaluations of 18 scenes."""
    cases, counts = list(timed_torques.ordinary_cases("planar_chain5")), []
    for limit in (True, False):
        if not limit:
            never_limit(monkeypatch)
        counts.append([r.run.evaluations for x in (1e-8, 1e-6) for r in runs_of(cases, method, x)])
    assert sum(counts[0]) <= 1.03 * sum(counts[1])


@pytest.mark.by_hand
@pytest.mark.parametrize("method", METHODS)
def test_right_runs_with_ordinary_torques_cost_no_evaluations(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 288 scenes, limits add at most 3 % to those that are right without; all become right."""
    cases = list(timed_torques.ordinary_cases())
    references = [timed_torques.reference(case) for case in cases]
    for rtol in (1e-10, 1e-8, 1e-6, 1e-4):
        bounds = [rtol * max(1.0, growth) for _, growth in references]
        runs = list(runs_of(cases, method, rtol))
        with monkeypatch.context() as context:
            never_limit(context)
            free = list(runs_of(cases, method, rtol))
        errors, free_errors = (
            [
                np.abs(r.x[-1] - e).max() / b
                for r, (e, _), b in zip(each, references, bounds, strict=True)
            ]
            for each in (runs, free)
        )
        assert max(errors) < 10.0
        right = [k for k, error in enumerate(free_errors) if error < 1.0]
        counts = [sum(each[k].run.evaluations for k in right) for each in (runs, free)]
        assert counts[0] <= 1.03 * counts[1]


def test_functions_that_stay_unresolved_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the search for panels ends early, `simulate` and flows warn with the times."""
    scenes = scene(Torque(bump), parameters={"centre": 1.0, "width": 1.1e-4})
    assert pinred.simulate(scenes).run.notices == ()
    monkeypatch.setattr(longest_steps, "_MOST", 64)
    scenes = replace(scenes, parameters={"centre": 1.0, "width": 1.2e-4})
    with pytest.warns(pinred.AccuracyWarning, match=r"changes faster than the steps near t = 0.9"):
        traj = pinred.simulate(scenes)
    assert "max_step" in traj.run.notices[0]
    with pytest.warns(pinred.AccuracyWarning, match=r"changes faster than the steps near t = 0.9"):
        pinred.flow(scenes, wrt=("centre",), of=("x",))()


def test_functions_of_time_are_factors_of_expressions() -> None:
    """Parts linear in time do not count; waves in time and shape count at a fixed shape."""

    def torque(s: Any) -> dict[str, Any]:
        return {"bend": WIDTH * ca.exp(-(s.t**2)) * s.x[0] + 3.0 * s.t + ca.cos(s.t - s.x[0])}

    forces = scene(Torque(torque)).force_model
    assert forces is not None
    functions, times = forces.time_functions, np.linspace(0.0, 2.0, 5)
    values = functions(times, forces.numbers, forces.within, times[None])
    assert values.shape == (2, 5)
    assert values[0] / np.exp(-(times**2)) == pytest.approx(values[0, 0], rel=1e-14)


def test_scenes_without_functions_of_time_are_not_checked() -> None:
    """A torque that is linear in time changes no faster than any step."""
    linear = Torque(lambda s: {"bend": 0.1 * s.t - s.x["bend"]})
    for other in (scene(), scene(linear)):
        assert not plan_of(other).has_time_functions
    assert plan_of(scene(Torque(bump))).has_time_functions


BUMPS = [(3e-4, 1.2465), (1.1e-3, 1.1919), (2.5e-3, 1.5686), (2e-2, 0.7)]  # widths and times [s]


def end_of(width: float, centre: float) -> Array:
    """Return the final shape of a run with steps shorter than a bump."""
    values = {"centre": centre, "width": width}
    fine = scene(Torque(bump), parameters=values, method=f"DOP853(max_step={width / 3.0})")
    return np.asarray(pinred.simulate(fine, rtol=1e-11, atol=1e-12).x[-1])


# Bursts are resolved with AdaptiveGauss.
@pytest.mark.by_hand("AdaptiveGauss")
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
    monkeypatch.setattr(StepLimits, "cheapest", UNLIMITED)
    bare = pinred.simulate_many(options, members={"width": widths, "centre": centres})
    assert np.abs(bare.x[:3] - batch.x[:3]).max() > 1e-2


def limits_of(function: Any, end: float = 2.0, rtol: float = 1e-10, order: int = 16) -> StepLimits:
    """Return the limits for a torque that is a function of time."""
    forces = scene(Torque(lambda s: {"bend": function(s.t)}), times=[end]).force_model
    assert forces is not None
    return longest_steps.step_limits(forces, end, forces.numbers, rtol, order)


@pytest.mark.parametrize(("rate", "rtol"), [(30.0, 1e-10), (400.0, 1e-10), (400.0, 1e-5)])
def test_limits_of_a_sine_agree_with_bessel_functions(rate: float, rtol: float) -> None:
    """The Chebyshev coefficients of sin(ωt) on a step of length h are 2 J_k(ωh/2)."""

    def excess(h: float) -> float:
        tail = 2.0 * max(abs(jv(15, 0.5 * rate * h)), abs(jv(16, 0.5 * rate * h)))
        return float(np.log(tail * h * rate / (2.0 * rtol)))  # the integral has the range 2/ω

    exact = brentq(excess, 0.1 / rate, 12.0 / rate)
    limits = limits_of(lambda t: ca.sin(rate * t), rtol=rtol)
    assert limits.ends[-1] == 2.0
    assert (np.abs(np.log2(limits.longest / exact)) < 0.35).all()
    longest, stops = limits.cheapest
    assert longest == pytest.approx(exact, rel=0.3)
    assert stops.size == 0


def test_limits_of_lower_order_are_shorter() -> None:
    """Their error estimates hold for a smaller part of a period."""
    longest = [limits_of(lambda t: ca.sin(90.0 * t), order=p).longest.min() for p in (16, 5, 3)]
    assert longest[1] / longest[0] == pytest.approx(0.5**2.5)
    assert longest[2] / longest[0] == pytest.approx(0.3**2.5)


def test_limits_find_a_needle_between_all_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bounds over intervals see a pulse of a microsecond, which no grid of samples does."""

    def needle(t: ca.SX) -> ca.SX:
        return ca.exp(-(((t - 1.2345678) / 1e-6) ** 2))

    limits = limits_of(needle)
    at = int(np.searchsorted(limits.ends, 1.2345678))
    assert 1e-7 < limits.longest[at] < 1e-5
    assert len(limits.ends) < 100
    monkeypatch.setattr(longest_steps, "_LOOK", 0)
    assert limits_of(lambda t: 1.0 * needle(t), end=2.0000001).longest.min() > 1e-3


@pytest.mark.parametrize("kind", ["sum", "multiple", "product"])
def test_limits_find_a_needle_in_a_sum(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A slow term of the same size does not hide it, although bounds of the sum are not wider."""

    def torque(t: ca.SX) -> ca.SX:
        both = ca.sin(3.0 * t) - 0.5 * ca.exp(-(((t - 1.2345678) / 1e-5) ** 2)) + 2.0
        return {"sum": both, "multiple": -0.3 * both, "product": both * ca.tanh(t)}[kind]

    limits = limits_of(torque)
    at = int(np.searchsorted(limits.ends, 1.2345678))
    assert limits.longest[at] < 1e-4
    assert limits.longest.max() > 0.1
    monkeypatch.setattr(time_functions, "_MOST_TERMS", 0)
    assert limits_of(torque, end=2.0000001).longest.min() > 0.03


def needle(t: ca.SX, width: float, centre: float = 1.2359) -> ca.SX:
    """Return a Gaussian whose default centre is between the samples of panels."""
    return ca.exp(-(((t - centre) / width) ** 2))


# Constants of the search, the function that is hidden, and the constant ten times looser.
HIDDEN: dict[str, tuple[Callable[[ca.SX], ca.SX], float]] = {
    "_UNSEEN": (lambda t: (1.0 + 0.5 * ca.sin(3.0 * t)) ** 2 + needle(t, 1e-4), 80.0),
    "_HIDDEN": (lambda t: (1.0 + 0.01 * ca.sin(3.0 * t)) ** 2 + needle(t, 1e-5), 1e4),
    "_FAINT": (lambda t: needle(t, 0.05, 0.4) ** 2 + (2e-3 * needle(t, 1e-5)) ** 2, 1e-2),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_limits_find_a_needle_that_is_no_term(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A root of a sum is no sum; bounds show the needle up to a ratio of sizes."""
    function, loose = HIDDEN[name]
    limits = limits_of(lambda t: ca.sqrt(function(t)))
    assert limits.longest[np.searchsorted(limits.ends, 1.2359)] < 1e-3
    monkeypatch.setattr(longest_steps, name, loose)
    limits = limits_of(lambda t: ca.sqrt(function(t)), end=2.0000001)
    assert limits.longest[np.searchsorted(limits.ends, 1.2359)] > 0.02


@pytest.mark.parametrize(("terms", "most"), [(64, 64), (65, 2), (640, 64)])
def test_long_sums_are_few_functions(terms: int, most: int) -> None:
    """The search evaluates at most 64 terms, so that its memory is bounded."""
    forces = scene(
        Torque(lambda s: {"bend": sum(ca.sin(k * s.t) for k in range(1, terms + 1))})
    ).force_model
    assert forces is not None
    assert 1 <= forces.time_functions.count <= most


def test_limits_of_a_sum_are_not_those_of_its_faint_terms() -> None:
    """A term of 1e-6 needs fewer digits than a sum of one."""
    faint = limits_of(lambda t: ca.sin(5.0 * t) + 1e-6 * ca.sin(60.0 * t)).longest.min()
    alone = limits_of(lambda t: 1e-6 * ca.sin(60.0 * t)).longest.min()
    assert faint > 2.0 * alone


def test_limits_stop_at_round_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Late in a run the round-off of time exceeds the tolerance; panels do not chase it."""
    function = lambda t: ca.sin(40.0 * t) + ca.cos(ca.sin(t))  # noqa: E731
    limits = limits_of(function, end=1000.0, rtol=1e-17)
    assert limits.unresolved.size == 0
    assert len(limits.ends) < 24_000
    monkeypatch.setattr(longest_steps, "_ROUND_OFF", 0.0)
    assert len(limits_of(function, end=1000.0001, rtol=1e-17).ends) > 40_000


def test_stops_of_limits_separate_no_step_that_is_too_long() -> None:
    """Between stops, and elsewhere with the longest step, all functions are resolved."""
    for order in (16, 3):
        limits = limits_of(lambda t: ca.sin(300 * t) * ca.exp(-(((t - 1) / 0.1) ** 2)), order=order)
        longest, stops = limits.cheapest
        ends = np.append(stops, 2.0)
        starts = np.append(0.0, stops)
        lengths = np.minimum(ends - starts, longest)
        parts = np.ceil((ends - starts) / lengths * (1.0 - 1e-12)).astype(int)
        for start, end, count in zip(starts, ends, parts.tolist(), strict=True):
            grid = np.linspace(start, end, count + 1)
            inside = limits.within(grid[:-1] + 1e-12, grid[1:] - 1e-12)
            assert (np.diff(grid) <= 1.0000001 * inside).all()


def burst(s: Any) -> dict[str, Any]:
    """Return a torque that oscillates in a Gaussian envelope."""
    return {"bend": 3.0 * ca.sin(RATE * s.t) * ca.exp(-(((s.t - CENTRE) / 0.1) ** 2))}


def end_by_short_steps(torque: Any, **options: Any) -> Array:
    """Return the final shape of a run with short steps."""
    method = pinred.DOP853(max_step=5e-4, rtol=1e-13, atol=1e-15)
    run = pinred.simulate(CAT, forces=[Torque(torque)], times=[2.0], method=method, **options)
    return np.asarray(run.x[-1])


@pytest.mark.by_hand("auto")
@pytest.mark.parametrize("method", ["auto", "AdaptiveGauss", "Radau"])
def test_bursts_are_resolved(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the check, AdaptiveGauss is off by 1e5 tolerances, and Radau by 100."""
    rtol = 1e-7 if method == "Radau" else 1e-10
    values = {"rate": 400.0, "centre": 1.017}
    options = scene(
        Torque(burst), method=method, rtol=rtol, atol=rtol / 100, seed=2, parameters=values
    )
    expected = end_by_short_steps(burst, seed=2, parameters=values)
    assert np.abs(pinred.simulate(options).x[-1] - expected).max() < 20 * rtol
    if method != "Radau":
        many = pinred.simulate_many(options, members={"centre": [1.017, 0.7]})
        assert np.abs(many.x[0, -1] - expected).max() < 20 * rtol
        flow = pinred.flow(options, wrt=("rate",), of=("x",))
        assert np.abs(flow(rate=400.0).x.ravel() - expected).max() < 20 * rtol
        never_limit(monkeypatch)
        assert np.abs(pinred.simulate(options).x[-1] - expected).max() > 1e4 * rtol
        assert np.abs(flow(rate=400.0 + 1e-13).x.ravel() - expected).max() > 1e4 * rtol


def test_waves_in_time_and_shape_are_resolved(monkeypatch: pytest.MonkeyPatch) -> None:
    """sin(ωt − kx) is no function of time alone, but as fast as one."""

    def wave(s: Any) -> dict[str, Any]:
        inside = ca.if_else(s.t > 1, s.t - 1, 0) * ca.if_else(s.t < 1.8, 1.8 - s.t, 0)
        return {"bend": ca.sin(400 * s.t - 2 * s.x[0]) * (6 * inside) ** 6}

    options = scene(Torque(wave), method="AdaptiveGauss", rtol=1e-10, atol=1e-12)
    expected = end_by_short_steps(wave, seed=1)
    assert np.abs(pinred.simulate(options).x[-1] - expected).max() < 2e-9
    never_limit(monkeypatch)
    assert np.abs(pinred.simulate(options).x[-1] - expected).max() > 1e-8


@pytest.mark.parametrize(
    "options",
    [{}, {"engine": "pinocchio"}, {"check": True}],
    ids=["compiled", "pinocchio", "check"],
)
def test_steps_are_limited_in_all_runs(
    options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both engines limit all steps, also in runs that `check` repeats."""
    found = iter([np.array([0.1]), np.empty(0)] * 2)
    monkeypatch.setattr(
        step_resolution, "find_defects", lambda *_: SimpleNamespace(times=next(found))
    )
    small = Torque(lambda s: {"bend": 1e-7 * ca.sin(60.0 * s.t)})
    traj = pinred.simulate(scene(small, method="auto"), **options)
    forces = traj.plan.forces
    assert forces is not None
    limits = longest_steps.step_limits(forces, 2.0, forces.numbers, 1e-7, 8)
    knots = traj.motion.segments.knots
    assert (np.diff(knots) <= limits.within(knots[:-1], knots[1:]) * (1.0 + 1e-9)).all()
    never_limit(monkeypatch)
    free = pinred.simulate(scene(small, method="auto"), **options).motion.segments.knots
    assert np.diff(free).max() > 2.0 * limits.longest.max()


def test_equal_steps_that_miss_functions_are_reported() -> None:
    """`simulate`, flows and batches warn; steps that see the function do not."""
    parameters = {"centre": 1.0, "width": 0.02}
    fine = scene(Torque(bump), method="Gauss(0.01)", parameters=parameters)
    assert pinred.simulate(fine).run.notices == ()
    coarse = scene(Torque(bump), method="Gauss(0.1)", parameters=parameters)
    match = r"steps of 0.1 s with Gauss6 integrate a function of time"
    with pytest.warns(pinred.AccuracyWarning, match=match):
        pinred.simulate(coarse)
    with pytest.warns(pinred.AccuracyWarning, match=match):
        pinred.flow(coarse, wrt=("centre",), of=("x",))()
    with pytest.warns(pinred.AccuracyWarning, match=match):
        pinred.simulate_many(coarse, members={"centre": [1.0, 1.1]})


def errors_of(case: timed_torques.Case, method: str, rtol: float) -> float:
    """Return the error of the final shape in tolerances, relative to the growth of errors."""
    expected, growth = timed_torques.reference(case)
    options: dict[str, Any] = {"method": method, "rtol": rtol, "atol": rtol / 100}
    traj = pinred.simulate(case.scene, parameters=case.parameters, **options)
    return float(np.abs(traj.x[-1] - expected).max() / (rtol * max(1.0, growth)))


TOLERANCES = {"auto": 1e-10, "DOP853": 1e-10, "AdaptiveGauss": 1e-10, "Tsit5": 1e-7, "Radau": 1e-7}


@pytest.mark.by_hand
@pytest.mark.parametrize("block", range(10))
def test_fast_torques_are_resolved_by_each_method(block: int) -> None:
    """Of 1,000 random torques on four robots, none has an error of 100 tolerances."""
    for case in timed_torques.cases(100, seed=100 + block):
        for method, rtol in TOLERANCES.items():
            assert errors_of(case, method, rtol) < 100.0, (case, method)


@pytest.mark.by_hand
def test_fast_torques_are_resolved_by_flows_and_batches() -> None:
    """Batches limit their steps before the run; flows check each call."""
    groups: dict[tuple[str, str], list[timed_torques.Case]] = {}
    for case in timed_torques.cases(240, seed=11):
        groups.setdefault((case.robot, case.kind), []).append(case)
    for cases in groups.values():
        references = [timed_torques.reference(case) for case in cases]
        names = list(cases[0].parameters)
        members = {name: [case.parameters[name] for case in cases] for name in names}
        for method, rtol in TOLERANCES.items():
            options = replace(cases[0].scene, method=method, rtol=rtol, atol=rtol / 100)
            many = pinred.simulate_many(options, members=members).x[:, -1]
            errors = [
                np.abs(x - expected).max() / max(1.0, growth)
                for x, (expected, growth) in zip(many, references, strict=True)
            ]
            assert max(errors) < 100.0 * rtol
            if method == "Radau":  # has no derivatives
                continue
            flow = pinred.flow(options, wrt=names, of=("x",))
            for case, (expected, growth) in zip(cases, references, strict=True):
                x = flow(**case.parameters).x.ravel()
                assert np.abs(x - expected).max() < 100.0 * rtol * max(1.0, growth)


def pulse(s: Any) -> dict[str, Any]:
    """Return a short torque that is hard for error estimates."""
    return {"bend": 3.0 * ca.sin(RATE * s.t) * ca.exp(-(((s.t - CENTRE) / WIDTH) ** 2))}


def test_step_in_the_flank_of_a_pulse_is_checked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error estimate of DOP853 fails in a step that sees the pulse; a second run is shorter."""
    values = {"rate": 34.0, "centre": 1.1, "width": 0.033}
    options = scene(Torque(pulse), rtol=1e-10, atol=1e-12, seed=2, parameters=values)
    expected = end_by_short_steps(pulse, seed=2, parameters=values)
    assert np.abs(pinred.simulate(options).x[-1] - expected).max() < 2e-10
    assert np.abs(pinred.simulate_many([options, options]).x[0, -1] - expected).max() < 2e-10
    monkeypatch.setattr(step_resolution, "SHARES", (1.0,))
    assert np.abs(pinred.simulate(options).x[-1] - expected).max() > 1e-8
    monkeypatch.setattr(integrate_members, "_SHARE", 1.0)
    assert np.abs(pinred.simulate_many([options, options]).x[0, -1] - expected).max() > 1e-8


def test_sum_of_defects_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sum that is a few times larger than the bound is an error of 70 tolerances."""
    values = {"rate": 46.97977080398951, "centre": 0.6171005539553089, "width": 0.06665264743290232}
    options = scene(Torque(pulse), rtol=1e-10, atol=1e-12, seed=2, parameters=values)
    expected = end_by_short_steps(pulse, seed=2, parameters=values)
    assert np.abs(pinred.simulate(options).x[-1] - expected).max() < 2e-10
    monkeypatch.setattr(step_resolution, "_DEFECT", 500.0)
    assert np.abs(pinred.simulate(options).x[-1] - expected).max() > 2e-9
