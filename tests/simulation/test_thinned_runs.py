"""Long runs with equal steps store the states at report times, and integrate others again."""

from __future__ import annotations

import tracemalloc
from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred.common.errors import IntegrationError
from pinred.forces import Torque
from pinred.simulation.compiled import integrator, thinned_segments
from pinred.simulation.compiled.thinned_segments import ThinnedSegments

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
        patch.setattr(thinned_segments, "STORED_BYTES", 0)
        thinned = pinred.simulate(scene)
    assert isinstance(thinned.motion.segments, ThinnedSegments)
    assert not isinstance(stored.motion.segments, ThinnedSegments)
    return stored, thinned


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
    assert len(thinned.motion.segments) >= 4
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
    monkeypatch.setattr(thinned_segments, "STORED_BYTES", 0)
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
