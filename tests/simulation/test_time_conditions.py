"""Conditions on time in forces: no pulse is skipped, and flows know how switch times move."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import pinred
from pinred import Gauss, InputError, Parameter
from pinred.forces import Torque
from pinred.forces.switch_times import SwitchTimes
from pinred.judge.reference_solution import FullState
from pinred.signals import Hold
from pinred.simulation.compiled import integrator

START, WIDTH, SIZE = Parameter("start", 0.4), Parameter("width", 0.1), Parameter("size", 0.2)
TIMES = np.array([0.0, 0.35, 1.0])


def pulse(s: Any) -> dict[str, Any]:
    """Return a torque pulse."""
    t = s.t
    return {"bend": ca.if_else(t > START, ca.if_else(t < START + WIDTH, SIZE, 0.0), 0.0)}


PULSE = Torque(pulse)


def scene(*forces: Any, **options: Any) -> pinred.Scene:
    """Return a scene of the falling cat."""
    settings: dict[str, Any] = {
        "times": TIMES, "x0": [0.3, 0.2, 0.1], "xdot0": [0.1, 0.2, 0.3], "rtol": 1e-9,
    } | options  # fmt: skip
    return pinred.Scene(system=pinred.load("falling_cat"), forces=list(forces), **settings)


def written_end(traj: pinred.Trajectory, torque: Any, spacing: float = 2e-3) -> Any:
    """Return the final shape from ABA with a torque as written, in steps between its switches."""
    full, start = FullState(scene()), traj.scene.start
    y = full.state(start.pose, start.x, start.xi, start.xdot)
    joint = np.zeros(full.system.n)

    def rate(t: float, y: Any) -> Any:
        base = full.rate(t, y)
        q, v = full.q(y), y[len(y) - full.system.n :]
        joint[6] = torque(t)
        base[-full.system.n :] = full.couplings.acceleration(q, v, joint)
        return base

    ends = np.union1d(np.arange(0.0, 1.0, spacing), np.append(traj.plan.stops, 1.0))
    for a, b in pairwise(ends.tolist()):
        inside = a + (b - a) * 1e-9, b - (b - a) * 1e-9
        y = solve_ivp(
            lambda t, y, inside=inside: rate(float(np.clip(t, *inside)), y), (a, b), y,
            method="DOP853", rtol=1e-12, atol=1e-13,
        ).y[:, -1]  # fmt: skip
    return full.couplings.shape(y[7 : 7 + full.coordinates])


@pytest.mark.parametrize(
    ("rtol", "count"),
    [
        (1e-6, 1),
        pytest.param(1e-6, 10, marks=pytest.mark.by_hand),
        pytest.param(1e-10, 10, marks=pytest.mark.by_hand),
    ],
)
def test_pulses_equal_tables(rtol: float, count: int) -> None:
    """A pulse written in time takes the steps of the same pulse as a Hold, wherever it is."""
    rng = np.random.default_rng(0)
    ends = {}
    for width in (1e-3, 5e-3, 2e-2, 5e-2):
        for start in rng.uniform(0.0, 0.9, count).tolist():
            values = {"start": start, "width": width, "size": 0.5}
            traj = pinred.simulate(scene(PULSE, rtol=rtol, parameters=values))
            table = Hold([0.0, start, start + width], [0.0, 0.5, 0.0])
            held = pinred.simulate(scene(Torque({"bend": table}), rtol=rtol))
            assert traj.run.evaluations == held.run.evaluations
            assert traj.motion.steps == held.motion.steps
            assert np.abs(traj.x - held.x).max() < 1e-12
            ends[start] = traj.x[-1]
    free = pinred.simulate(scene(rtol=rtol)).x[-1]
    assert min(np.abs(end - free).max() for end in ends.values()) > 1e-7


FUNCTIONS: dict[str, Any] = {
    "pulse width modulation": lambda t: 0.2 * ca.if_else(ca.fmod(t, 0.05) < 0.02, 1, -1),
    "floor": lambda t: 0.02 * ca.floor(7 * ca.fabs(ca.sin(3 * t))),
    "fmax": lambda t: ca.fmax(0.1 * ca.sin(9 * t), 0.05),
}


@pytest.mark.by_hand("floor-compiled")
@pytest.mark.slow
@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.sampled
def test_written_force_in_short_steps_agrees(name: str, engine: Any) -> None:
    """ABA with the force as written, in short steps between its switches, is the reference."""
    function = FUNCTIONS[name]
    traj = pinred.simulate(
        scene(Torque(lambda s: {"bend": function(s.t)}), rtol=1e-12), engine=engine
    )
    t = ca.SX.sym("t")
    torque = ca.Function("torque", [t], [function(t)])
    expected = written_end(traj, lambda t: float(torque(t)), spacing=0.05)
    assert np.abs(traj.x[-1] - expected).max() < 1e-10


@pytest.mark.parametrize(
    "method",
    # No code is shipped of the implicit methods; numba compiles each for five seconds.
    ["DOP853", *(pytest.param(m, marks=pytest.mark.by_hand) for m in ("AdaptiveGauss", "Radau"))],
)
def test_run_through_all_stops_equals_its_segments(
    method: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compiled loop over 100 spans takes the steps that one call for each span takes."""
    period = Parameter("period", 0.02)
    waves = Torque(lambda s: {"bend": 0.1 * ca.if_else(ca.fmod(s.t, period) < 0.4 * period, 1, -1)})
    options = scene(waves, method=method, rtol=1e-6, xi0=[0.0, 0.0, 0.0, 0.3, -0.2, 0.5])
    through = pinred.simulate(options)
    with monkeypatch.context() as patch:
        patch.setattr(integrator, "through_stops", lambda *_: None)
        one_by_one = pinred.simulate(options)
    assert len(through.plan.stops) == 100
    assert isinstance(through.motion.segments, integrator.PartSegments)
    assert through.run.evaluations == one_by_one.run.evaluations
    np.testing.assert_array_equal(through.motion.knots, one_by_one.motion.knots)
    times = np.linspace(0.0, 1.0, 73)
    for name in ("x", "xdot", "pose"):
        first, second = (getattr(traj(times), name) for traj in (through, one_by_one))
        assert np.abs(first - second).max() < 1e-13


def test_failure_in_a_span_names_its_time() -> None:
    """A run through all stops that fails reports the time and the shape, as any other."""
    blowing = Torque(lambda s: {"bend": ca.if_else(s.t > 0.3, 1e3 * s.xdot["bend"] ** 3, 0.0)})
    with pytest.raises(pinred.IntegrationError, match=r"t = 0\.3\d* s"):
        pinred.simulate(scene(blowing))


def test_engines_agree_on_a_short_pulse() -> None:
    """Both engines stop where the pulse begins and ends."""
    values = {"start": 0.613, "width": 2e-3, "size": 0.5}
    both = [
        pinred.simulate(scene(PULSE, parameters=values), engine=engine)
        for engine in ("compiled", "pinocchio")
    ]
    assert both[0].plan.stops.tolist() == pytest.approx([0.613, 0.615, 1.0], abs=1e-15)
    assert np.abs(both[0].x - both[1].x).max() < 1e-8


def test_compare_judges_forces_as_written(monkeypatch: pytest.MonkeyPatch) -> None:
    """A motion passes, and fails if any one of its switches is dropped."""
    options = scene(PULSE, parameters={"width": 0.05}, times=[0.6], rtol=1e-6)
    assert pinred.compare(pinred.simulate(options)).verdict == "PASSED"
    found = SwitchTimes.breaks
    for dropped in (0, 1):

        def breaks(self: Any, *arguments: Any, dropped: int = dropped) -> Any:
            return np.delete(found(self, *arguments), dropped)

        with monkeypatch.context() as patch:
            patch.setattr(SwitchTimes, "breaks", breaks)
            width = 0.05 + 1e-9 * (dropped + 1)  # another scene, so that nothing is cached
            mutant = scene(PULSE, parameters={"width": width}, times=[0.6], rtol=1e-6)
            assert pinred.compare(pinred.simulate(mutant)).verdict == "FAILED"


# Nested switch times contain these.
@pytest.mark.by_hand
@pytest.mark.parametrize("method", ["DOP853", "AdaptiveGauss"])
@pytest.mark.sampled
def test_flow_by_switch_times_equals_differences(method: Any) -> None:
    """Derivatives by the times of a pulse equal Richardson differences, forward and backward."""
    names = ("start", "width", "size")
    flow = pinred.flow(
        scene(PULSE, rtol=1e-12, times=[1.0], method=method), wrt=names, of=("x", "xdot")
    )
    jacobian = flow.jacobian()

    def end(name: str, change: float) -> Any:
        state = flow(**{name: flow.own(name)[0] + change})
        return np.concatenate([state.x, state.xdot]).ravel()

    for name in names:
        expected = richardson(lambda change, name=name: end(name, change), 0.0, 8e-3)
        assert np.abs(expected).max() > 1e-2
        assert np.abs(jacobian[name].ravel() - expected).max() < 1e-8 * np.abs(expected).max()
    covector = np.random.default_rng(0).normal(size=jacobian["start"].shape)
    pulled = flow.vjp(covector)
    for name in names:
        assert pulled[name] == pytest.approx(np.vdot(covector, jacobian[name]), rel=1e-10)


def richardson(function: Any, value: float, change: float) -> Any:
    """Return the derivative of a function from differences at four changes, extrapolated."""
    changes = change / 2.0 ** np.arange(4)
    rows = [(function(value + h) - function(value - h)) / (2.0 * h) for h in changes]
    for k in range(1, 4):
        rows = [(4**k * b - a) / (4**k - 1) for a, b in pairwise(rows)]
    return rows[0]


@pytest.mark.parametrize(
    ("values", "function"),
    [
        pytest.param(
            {"a": 7.3, "b": 3.1},
            lambda t, a, b: 0.02 * ca.floor(a * ca.fabs(ca.sin(b * t))),
            marks=pytest.mark.by_hand,
        ),
        # The floor jumps where fmod does, and moves with it.
        ({"a": 6.2, "b": 0.39}, lambda t, a, b: 0.05 * ca.floor(a * ca.fmod(t, b))),
        (
            {"a": 0.31, "b": 0.13},
            lambda t, a, b: 0.2 * ca.if_else(ca.fmod(t, a) < b, 1, -1),
        ),
        pytest.param(
            {"a": 3.4, "b": 2.7},
            lambda t, a, b: 0.03 * ca.floor(a * ca.floor(b * t) * t),
            marks=pytest.mark.by_hand,
        ),
    ],
)
@pytest.mark.sampled
def test_flow_by_nested_switch_times_equals_differences(values: Any, function: Any) -> None:
    """The changes are so small that no switch meets another; longer ones are off by up to 0.1."""
    a, b = Parameter("a", 1.0), Parameter("b", 1.0)
    torque = Torque(lambda s: {"bend": function(s.t, a, b)})
    options = scene(torque, rtol=1e-12, atol=1e-13, times=[1.0], parameters=values, method="DOP853")
    flow = pinred.flow(options, wrt=("a", "b"), of=("x", "xdot"))
    jacobian = flow.jacobian()
    for name, value in values.items():

        def end(x: float, name: str = name) -> Any:
            state = flow(**{name: x})
            return np.concatenate([state.x, state.xdot]).ravel()

        expected = richardson(end, value, 5e-4)
        assert np.abs(expected).max() > 1e-2
        assert np.abs(jacobian[name].ravel() - expected).max() < 2e-9 * np.abs(expected).max()
    covector = np.random.default_rng(0).normal(size=jacobian["a"].shape)
    for name, pulled in flow.vjp(covector).items():
        assert pulled == pytest.approx(np.vdot(covector, jacobian[name]), rel=1e-10)


def test_flow_by_coinciding_switches_is_refused() -> None:
    """Two conditions that change at once with different derivatives have no derivative."""
    stairs = Torque(lambda s: {"bend": SIZE * ((s.t > START) + (s.t > 0.4))})
    flow = pinred.flow(scene(stairs, times=[1.0]), wrt=("start", "size"))
    with pytest.raises(InputError, match="several conditions"):
        flow.jacobian()
    assert np.isfinite(flow.jvp({"size": 1.0})).all()
    assert np.isfinite(flow.jacobian(start=0.5)["start"]).all()


@pytest.mark.parametrize("method", ["DOP853", Gauss(0.01)])
def test_members_have_switches_of_their_own(method: Any) -> None:
    """Each member of a batch stops at its own switches, as it does alone; some have fewer."""
    rng = np.random.default_rng(1)
    starts, widths = rng.uniform(0.05, 0.8, 12), rng.uniform(1e-3, 0.1, 12)
    starts[3], starts[7] = 2.0, 0.95  # no switch, and only one of two
    options = scene(PULSE, method=method)
    batch = pinred.simulate_many(options, members={"start": starts, "width": widths})
    assert not batch.failures
    scenes = []
    for k in range(12):
        values = {"start": float(starts[k]), "width": float(widths[k])}
        scenes.append(replace(options, parameters=values))
        one = pinred.simulate(scenes[-1])
        assert np.abs(batch.x[k] - one.x).max() < 1e-8
    listed = pinred.simulate_many(scenes)
    assert np.abs(listed.x - batch.x).max() < 1e-12


def test_flows_of_members_stop_at_their_own_switches() -> None:
    """Columns of inputs of a flow give the states that single calls give."""
    rng = np.random.default_rng(2)
    starts = rng.uniform(0.05, 0.8, 5)
    flow = pinred.flow(scene(PULSE), wrt=("start", "width"), of=("x",))
    many = flow.columns().values(starts[:, None], np.full((5, 1), 0.1))
    for k in range(5):
        one = flow(start=float(starts[k])).x
        assert np.abs(many[k].reshape(one.shape) - one).max() < 1e-8


def test_step_map_checks_the_switches_of_its_own_parameters() -> None:
    """A step may not contain a switch of the given parameters; those of the scene do not count."""
    step = pinred.flow(scene(PULSE, times=[1.0]), wrt=("start", "width")).step(0.05)
    step(t=0.37, start=0.6)
    with pytest.raises(InputError, match=r"not smooth at t = 0\.4 s"):
        step(t=0.37)
    with pytest.raises(InputError, match=r"not smooth at t = 0\.6 s"):
        step(t=0.58, start=0.6)
