"""Long runs with equal steps store the states at report times, and integrate others again."""

from __future__ import annotations

import tracemalloc
from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred.common.errors import IntegrationError
from pinred.forces import Command, Controller, Torque
from pinred.integrators.thinned_run import ThinnedIntegration
from pinred.simulation.compiled import integrator

METHODS = [
    pinred.Gauss(0.01, 4),
    pinred.Gauss(0.01, 10),
    pinred.Gauss(0.01, 2, solver="Newton"),
    pinred.RKMK4(0.01),
    pinred.Variational(0.005),
]


def cat_scene(**options: Any) -> pinred.Scene:
    """Return a scene of 40 s of the falling cat."""
    settings: dict[str, Any] = {
        "seed": 3, "duration": 40.0, "times": [0.0, 3.333, 17.0, 40.0]
    } | options  # fmt: skip
    return pinred.Scene(system=pinred.load("falling_cat"), **settings)


def run_both(
    monkeypatch: pytest.MonkeyPatch, scene: pinred.Scene
) -> tuple[pinred.Trajectory, pinred.Trajectory]:
    """Return the trajectory with stored step ends, and without."""
    stored = pinred.simulate(scene)
    with monkeypatch.context() as patch:
        patch.setattr(integrator, "STORED_BYTES", 0)
        runs = counted_calls(patch)
        thinned = pinred.simulate(scene)
    assert runs
    return stored, thinned


@pytest.mark.by_hand("Variational(step=0.005)")
@pytest.mark.parametrize("method", METHODS, ids=str)
def test_thinned_run_has_the_bits_of_stored_steps(
    monkeypatch: pytest.MonkeyPatch, method: Any
) -> None:
    """Report times and step ends agree in all bits, other times to round-off."""
    stored, thinned = run_both(monkeypatch, cat_scene(method=method))
    np.testing.assert_array_equal(stored.q, thinned.q)
    np.testing.assert_array_equal(stored.v, thinned.v)
    assert stored.run.steps == thinned.run.steps
    assert stored.run.evaluations == thinned.run.evaluations
    steps = np.arange(stored.run.steps + 1)
    ends = np.asarray(steps * (40.0 / stored.run.steps))
    np.testing.assert_allclose(stored.motion.knots, thinned.motion.knots, rtol=0.0, atol=1e-12)
    assert np.isin(ends, thinned.motion.knots).mean() > 0.9
    np.testing.assert_array_equal(
        stored.motion.reduced(ends[::97]), thinned.motion.reduced(ends[::97])
    )
    times = np.random.default_rng(0).uniform(0.0, 40.0, 60)
    np.testing.assert_allclose(stored(times).q, thinned(times).q, rtol=0.0, atol=1e-9)


def test_thinned_run_passes_the_stops_of_forces(monkeypatch: pytest.MonkeyPatch) -> None:
    """A torque that jumps in time stops the steps; each span has its own parameters."""
    jump = Torque(lambda s: {"bend": ca.if_else(s.t > 7.77, 0.1 * ca.sin(s.t), 0.0)})
    scene = cat_scene(forces=[jump], method=pinred.Gauss(0.01, 4))
    stored, thinned = run_both(monkeypatch, scene)
    np.testing.assert_allclose(stored.q, thinned.q, rtol=0.0, atol=1e-11)
    np.testing.assert_array_equal(stored.q[-1], thinned.q[-1])
    assert 7.77 in thinned.motion.knots


def test_thinned_run_refuses_wild_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A joint that rotates by many turns within a step is refused without stored steps, too."""
    monkeypatch.setattr(integrator, "STORED_BYTES", 0)
    monkeypatch.setattr(integrator, "_WILD", 1e-4)
    with pytest.raises(IntegrationError, match="rotates by"):
        pinred.simulate(cat_scene(method=pinred.RKMK4(0.01)))


def test_thinned_run_takes_little_memory() -> None:
    """A run whose step ends take 35 MB adds less than 8 MB; 1e7 steps add as much."""
    chain = pinred.load("planar_chain5")
    method = pinred.Gauss(0.001, 4)
    pinred.simulate(chain, seed=1, times=[0.1], method=method)
    tracemalloc.start()
    try:
        traj = pinred.simulate(chain, seed=1, times=[400.0], method=method)
        assert np.isfinite(traj.energy).all()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert traj.run.steps == 400_000
    assert peak < 8e6


def steer(t: float, state: dict[str, Any], seen: Any) -> tuple[Any, dict[str, Any]]:
    """Return the torque of a controller whose state is changed in place."""
    state["sum"] += np.sin(seen.x["bend"])
    torque = {"bend": -0.001 * np.sin(seen.x["bend"]) - 0.0001 * state["sum"]}
    return Command(torque, width=0.65 if t < 5.0 else None), state


def followed_scene(method: Any, *, terminal: bool = False, controlled: bool = True) -> pinred.Scene:
    """Return a scene with events of the state, and a controller whose period has 73 steps."""
    events = [pinred.Event("sin(x['sway'])", "straight")]
    events += [pinred.Event("x['twist'] + 10.0", "turned", terminal=True)] * terminal
    controller = Controller(steer, 0.73, ("bend",), state0={"sum": 0.0})
    return cat_scene(method=method, events=events, forces=[controller] * controlled)


# Runs with a controller, or with a terminal event, or both, contain these steps.
@pytest.mark.by_hand(
    "False-False-Gauss(step=0.01, order=4, solver='auto')",
    "True-False-Gauss(step=0.01, order=4, solver='auto')",
)
@pytest.mark.parametrize(
    "method",
    [METHODS[0], *(pytest.param(method, marks=pytest.mark.by_hand) for method in METHODS[1:])],
    ids=str,
)
@pytest.mark.parametrize("terminal", [False, True])
@pytest.mark.parametrize("controlled", [False, True])
def test_followers_of_a_thinned_run_see_the_same_steps(
    monkeypatch: pytest.MonkeyPatch, method: Any, terminal: bool, controlled: bool
) -> None:
    """Crossings, calls and states agree with a run that stores all step ends."""
    scene = followed_scene(method, terminal=terminal, controlled=controlled)
    stored = pinred.simulate(scene)
    with monkeypatch.context() as patch:
        patch.setattr(integrator, "STORED_BYTES", 0)
        runs = counted_calls(patch)
        thinned = pinred.simulate(scene)
    assert runs
    assert (stored.ended_by, stored.run.steps) == (thinned.ended_by, thinned.run.steps)
    assert (stored.ended_by == "turned") == terminal
    np.testing.assert_allclose(stored.q, thinned.q, rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(stored.motion.knots, thinned.motion.knots)
    for name, crossings in stored.events.items():
        assert len(crossings) > 2 or name == "turned"
        np.testing.assert_allclose(crossings.t, thinned.events[name].t, rtol=0.0, atol=1e-10)
        np.testing.assert_array_equal(crossings.rising, thinned.events[name].rising)
    assert len(stored.actions) == len(thinned.actions)
    assert bool(stored.actions) == controlled
    times = np.random.default_rng(0).uniform(0.0, stored.t[-1], 60)
    np.testing.assert_allclose(stored(times).q, thinned(times).q, rtol=0.0, atol=1e-9)


def counted_calls(patch: pytest.MonkeyPatch) -> list[float]:
    """Return a list to which each thinned integration adds its end time."""
    ends: list[float] = []
    call = ThinnedIntegration.__call__

    def counted(self: ThinnedIntegration, *args: Any, **more: Any) -> Any:
        ends.append(self._end)
        return call(self, *args, **more)

    patch.setattr(ThinnedIntegration, "__call__", counted)
    return ends


def test_event_before_a_failure_ends_a_thinned_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """An event that ends the motion is found in the steps before a failure."""
    monkeypatch.setattr(integrator, "STORED_BYTES", 0)
    root = Torque(lambda _t, x, _xdot, _mu: {"hinge": 1e-9 * ca.sqrt(1.0 - x["hinge"])})
    scene = pinred.Scene(
        system=pinred.load("coupled_planar"), xdot0=[1.0], duration=9.0, times=[9.0],
        forces=[root], method=pinred.Gauss(0.001, 4),
    )  # fmt: skip
    with pytest.raises(IntegrationError, match="not finite"):
        pinred.simulate(scene)
    passed = pinred.Event("x['hinge'] - 0.999", "passed", terminal=True)
    runs = counted_calls(monkeypatch)
    traj = pinred.simulate(scene, events=[passed])
    assert runs
    assert traj.ended_by == "passed"
    np.testing.assert_allclose(traj.x[-1], 0.999, rtol=1e-9)
    np.testing.assert_allclose(traj.t[-1], 0.999, rtol=1e-6)


@pytest.mark.by_hand
def test_thinned_run_with_events_takes_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """With an event, a run whose step ends take 7 MB adds less than 3 MB if it is thinned."""
    options: dict[str, Any] = {
        "seed": 1, "method": pinred.Gauss(0.001, 4),
        "events": [pinred.Event("sin(x['joint1'])", "straight")],
    }  # fmt: skip
    chain = pinred.load("planar_chain5")
    peaks = []
    for most in (1 << 30, 0):
        monkeypatch.setattr(integrator, "STORED_BYTES", most)
        pinred.simulate(chain, times=[1.0], **options)
        tracemalloc.start()
        try:
            traj = pinred.simulate(chain, times=[80.0], **options)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
        assert traj.run.steps == 80_000
        assert len(traj.events["straight"]) > 3
    assert peaks[0] > 7e6
    assert peaks[1] < 3e6
