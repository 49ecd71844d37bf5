"""Events: zero crossings against closed forms, and ends of motions."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.forces import Controller, Torque
from pinred.scene.scene import ENGINES, Engine
from pinred.simulation import events, motion
from pinred.simulation.events import extremum_times

BEANIE = pinred.load("elroys_beanie")
W = np.sqrt(1.5)  # of x = sin(W t)/W: a spring of 1 N·m/rad on the shape's inertia 2/3
SPRUNG: dict[str, Any] = {"x0": [0.0], "xdot0": [1.0], "springs": {"beanie": (1.0, 0.0)}}


def times(level: float, end: float, *, rising: bool) -> Array:
    """Return the times at which sin(W t)/W crosses a level in one direction."""
    first = np.arcsin(level * W)
    phase = (first if rising else np.pi - first) + 2 * np.pi * np.arange(-1, 9)
    t = phase / W
    return np.asarray(t[(t > 1e-9) & (t < end)])


@pytest.mark.parametrize("engine", ENGINES)
def test_crossings_agree_with_closed_form(engine: Engine) -> None:
    """Rising, falling and both, from formulas and functions of the state."""
    crossings = pinred.simulate(
        BEANIE, **SPRUNG, duration=9.0, engine=engine,
        events=[
            pinred.Event("x['beanie'] - 0.3", "up", direction=1),
            pinred.Event(lambda t, x, xdot, mu: x[0] - 0.3, "down", direction=-1),  # noqa: ARG005
            pinred.Event(lambda s: s.x["beanie"] + 0.1, "both"),
            pinred.Event("J[0] + 10", "never"),
            pinred.Event(lambda s: s.x[0], "middle"),
        ],
    ).events  # fmt: skip
    np.testing.assert_allclose(crossings["up"].t, times(0.3, 9.0, rising=True), atol=2e-10)
    np.testing.assert_allclose(crossings["down"].t, times(0.3, 9.0, rising=False), atol=2e-10)
    either = [times(-0.1, 9.0, rising=rising) for rising in (True, False)]
    np.testing.assert_allclose(crossings["both"].t, np.sort(np.concatenate(either)), atol=2e-10)
    assert crossings["both"].rising.tolist() == [False, True, False]
    np.testing.assert_allclose(crossings["both"].states.x, -0.1, atol=1e-12)
    assert len(crossings["never"]) == 0
    # The motion starts at zero, which is no crossing.
    np.testing.assert_allclose(
        crossings["middle"].t, np.pi / W * np.array([1.0, 2.0, 3.0]), atol=2e-10
    )


@pytest.mark.slow
@pytest.mark.parametrize("method", ["AdaptiveGauss", "Gauss(0.05, 8)"])
def test_crossings_on_dense_output_of_implicit_methods(method: str) -> None:
    """Crossings inside long steps are located on the dense output."""
    traj = pinred.simulate(
        BEANIE, **SPRUNG, duration=4.0, method=method,
        events=[pinred.Event("x[0] - 0.3", "up"), pinred.Event("x[0] + 0.5", "low", terminal=True)],
    )  # fmt: skip
    both = [times(0.3, 4.0, rising=rising)[:1] for rising in (True, False)]
    np.testing.assert_allclose(traj.events["up"].t, np.concatenate(both), atol=1e-8)
    end = times(-0.5, 4.0, rising=False)
    np.testing.assert_allclose(traj.events["low"].t, end, atol=1e-8)
    assert traj.t[-1] == traj.scene.end == traj.events["low"].t[0]
    assert traj.x[-1, 0] == pytest.approx(-0.5, abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.sampled
def test_terminal_event_ends_the_scene(engine: Engine) -> None:
    """The last report is at the event; later reports are dropped, and compare passes."""
    traj = pinred.simulate(
        BEANIE, **SPRUNG, duration=50.0, times=[0.0, 0.1, 2.0, 40.0], engine=engine, rtol=1e-8,
        events=[
            pinred.Event("x[0] - 0.3", "end", terminal=True, direction=-1),
            pinred.Event("x[0] - 0.2", "seen"),
        ],
    )  # fmt: skip
    (end,) = traj.events["end"].t
    assert end == pytest.approx(times(0.3, 3.0, rising=False)[0], abs=1e-7)
    assert traj.ended_by == "end"
    assert traj.scene.end == end
    np.testing.assert_array_equal(traj.t, [0.0, 0.1, 2.0, end])
    assert traj.motion.knots[-1] == end
    assert len(traj.events["seen"]) == 1
    with pytest.raises(pinred.InputError, match="between 0 and"):
        traj(end + 0.1)
    report = pinred.compare(traj)
    assert report.passed, str(report)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.sampled
def test_motion_beyond_terminal_event_is_not_integrated(engine: Engine) -> None:
    """A motion that would fail later ends at the event."""
    wall = Torque(lambda s: {"beanie": 1.0 / (0.5 - s.x[0]) ** 2}, name="pull")
    options: dict[str, Any] = {"x0": [0.0], "xdot0": [0.0], "duration": 5.0, "forces": [wall]}
    with pytest.raises(pinred.IntegrationError):
        pinred.simulate(BEANIE, engine=engine, **options)
    stop = pinred.Event("x[0] - 0.4", terminal=True)
    traj = pinred.simulate(BEANIE, engine=engine, **options, events=stop)
    assert traj.x[-1, 0] == pytest.approx(0.4, abs=1e-9)
    assert traj.run.evaluations < 20_000


@pytest.mark.slow
def test_crossings_at_controller_stops() -> None:
    """One crossing is at the end of a segment; a terminal one is in the third segment."""
    push = Controller(lambda s: [1.0 if s.t < 0.6 else -1.0], 0.5)
    traj = pinred.simulate(
        BEANIE, x0=[-0.1875], xdot0=[0.0], duration=3.0, forces=[push],
        events=[
            pinred.Event("x[0]", "middle"),  # ẍ = 3/2: at t = 0.5, the end of the first segment
            pinred.Event("xdot[0] - 0.75", "half", direction=-1, terminal=True),
        ],
    )  # fmt: skip
    assert traj.events["middle"].t == pytest.approx([0.5], abs=1e-9)
    assert traj.events["half"].t == pytest.approx([1.5], abs=1e-9)
    assert [action.t for action in traj.actions][:3] == [0.0, 0.5, 1.0]
    report = pinred.compare(traj)
    assert report.passed, str(report)


def test_events_of_base_and_parameters() -> None:
    """Events may depend on pose, momentum about the centre of mass, and Parameters."""
    level = pinred.Parameter("level", 5.0)
    body = pinred.load("rigid_body")
    # Rotation about the axis of the largest moment of inertia is uniform.
    traj = pinred.simulate(
        body, xi0=[0.0, 0.0, 2.0], duration=2.0, parameters={"level": 0.5},
        events=[
            pinred.Event(lambda s: s.pose[2] - ca.sin(level / 2.0), "turned"),
            pinred.Event(lambda t, x, xdot, mu: mu[2] * (t - 0.25), "time"),  # noqa: ARG005
        ],
    )  # fmt: skip
    assert traj.events["turned"].t == pytest.approx([0.25], abs=1e-9)
    assert traj.events["time"].t == pytest.approx([0.25], abs=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: [pinred.Event("x[0]"), pinred.Event("x[0] - 1")], "two events are called 'event'"),
        (lambda: [pinred.Event("x[0]", direction=2)], r"must be 1 \(rising\), -1"),  # type: ignore[arg-type]
        (lambda: [pinred.Event("x[0]", terminal=1)], "terminal of event 'event' must be True"),  # type: ignore[arg-type]
        (lambda: [pinred.Event("x[0", "bad")], "event 'bad'|cannot be used"),
        (lambda: [pinred.Event(3)], "must have a function of the state or a formula"),  # type: ignore[arg-type]
        (lambda: [pinred.Event("x[0]", " ")], "the name of an event must be text"),
        (lambda: ["x[0]"], "must be a list of Event"),
        (lambda: "x[0]", "must be a list of Event"),
        (lambda: [pinred.Event(lambda t, x: x[0])], "must be a function of"),  # noqa: ARG005
    ],
)  # fmt: skip
def test_invalid_events_are_rejected(make: Any, message: str) -> None:
    """A scene rejects events that cannot be evaluated."""
    with pytest.raises(pinred.InputError, match=message):
        pinred.Scene(system=BEANIE, **SPRUNG, events=make())


def test_non_finite_event_raises() -> None:
    """The message states the name of the event and the time."""
    event = pinred.Event("log(x[0])", "log")
    with pytest.raises(pinred.IntegrationError, match="event 'log' is -inf at t = 0 s"):
        pinred.simulate(BEANIE, **SPRUNG, duration=1.0, events=[event])


def test_event_of_base_needs_base() -> None:
    """An event that depends on the base rejects outputs='shape'; others accept it."""
    with pytest.raises(pinred.InputError, match="an event depends on the base in space"):
        pinred.Scene(system=BEANIE, **SPRUNG, events=[pinred.Event("pose[0]")], outputs="shape")
    traj = pinred.simulate(
        BEANIE, **SPRUNG, duration=1.0, events=[pinred.Event("x[0] - 0.1")], outputs="shape"
    )
    assert len(traj.events["event"]) == 1


def test_scene_without_events_has_no_watch(monkeypatch: pytest.MonkeyPatch) -> None:
    """No Watch is created, and the motion is the same to the last bit."""
    with_events = pinred.simulate(BEANIE, **SPRUNG, events=[pinred.Event("x[0] - 0.1")])
    monkeypatch.setattr(motion, "Watch", lambda *_: pytest.fail("nobody asked"))
    without = pinred.simulate(BEANIE, **SPRUNG)
    assert without.events == {}
    np.testing.assert_array_equal(without.x, with_events.x)


def test_two_crossings_in_one_step_are_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values inside a step reveal them; values at step ends alone miss them."""
    event = pinred.Event(f"x[0] - {0.97 / W}")
    first = pinred.simulate(BEANIE, **SPRUNG, duration=2.0, rtol=1e-4, atol=1e-4, events=event)
    assert len(first.events["event"]) == 2
    monkeypatch.setattr(events, "_PARTS", 1)
    monkeypatch.setattr(events, "_HALVINGS", 0)
    monkeypatch.setattr(events, "_EXTREMA", 0)
    second = pinred.simulate(BEANIE, **SPRUNG, duration=2.0, rtol=1e-4, atol=1e-4, events=event)
    assert len(second.events["event"]) < 2


@pytest.mark.parametrize("engine", ENGINES)
def test_all_crossings_of_time_alone_are_found(engine: Engine) -> None:
    """They are computed before the run, whatever the steps are."""
    rate = pinred.Parameter("rate", 50.0)
    traj = pinred.simulate(
        BEANIE, **SPRUNG, duration=2.0, engine=engine, rtol=1e-4, atol=1e-4,
        parameters={"rate": 100.0},
        events=[
            pinred.Event(lambda s: ca.sin(rate * s.t), "fast"),
            pinred.Event("sin(100*t)", "rising", direction=1),
            pinred.Event("abs(t - 1) - 0.001", "short"),
            pinred.Event("(t - 1)**2", "touching"),
            pinred.Event(lambda s: ca.if_else(s.t > 0.3, 1.0, -1.0), "jump"),
            pinred.Event("t", "start"),
        ],
    ).events  # fmt: skip
    zeros = np.pi / 100.0 * np.arange(1, 64)
    np.testing.assert_allclose(traj["fast"].t, zeros, rtol=1e-15, atol=0.0)
    np.testing.assert_allclose(traj["rising"].t, zeros[1::2], rtol=1e-15, atol=0.0)
    assert traj["fast"].rising.tolist() == [k % 2 == 1 for k in range(63)]
    np.testing.assert_allclose(traj["short"].t, [0.999, 1.001], rtol=1e-14)
    assert traj["jump"].t.tolist() == [0.3]
    assert len(traj["touching"]) == len(traj["start"]) == 0
    np.testing.assert_allclose(traj["fast"].states.t, zeros, rtol=1e-15, atol=0.0)


def test_terminal_event_of_time_ends_the_motion() -> None:
    """Crossings after it do not count."""
    events = [pinred.Event("cos(t) - 0.5", "end", terminal=True), pinred.Event("sin(40*t)", "fast")]
    traj = pinred.simulate(BEANIE, **SPRUNG, duration=5.0, events=events)
    assert traj.scene.end == pytest.approx(np.pi / 3.0, rel=1e-15)
    np.testing.assert_allclose(traj.events["fast"].t, np.pi / 40.0 * np.arange(1, 14), rtol=1e-14)


def test_event_of_time_that_is_not_finite_raises() -> None:
    """The message states the name of the event and a time."""
    event = pinred.Event("log(t - 1)", "log")
    with pytest.raises(pinred.IntegrationError, match="event 'log' is nan at t = "):
        pinred.simulate(BEANIE, **SPRUNG, duration=2.0, events=[event])


def test_fast_events_of_the_state_are_sampled_densely() -> None:
    """sin(60 x) has many zeros within one step, and its samples do not predict each other."""
    traj = pinred.simulate(
        BEANIE, **SPRUNG, duration=5.0, rtol=1e-4, atol=1e-4,
        events=pinred.Event(lambda s: ca.sin(60.0 * s.x[0]) + 0.01, "fast"),
    )  # fmt: skip
    t = np.linspace(0.0, 5.0, 200_001)
    signs = np.sign(np.sin(60.0 * traj(t).x[:, 0]) + 0.01)
    expected = t[1:][signs[1:] * signs[:-1] < 0.0]
    assert len(expected) > 50 > traj.run.steps
    np.testing.assert_allclose(traj.events["fast"].t, expected, atol=3e-5)


def test_short_crossings_of_the_state_are_sampled_densely() -> None:
    """Samples that are off by a fifth of the largest value hide pairs of crossings."""
    traj = pinred.simulate(
        BEANIE, **SPRUNG, duration=5.0, rtol=1e-4, atol=1e-4,
        events=pinred.Event(lambda s: 0.2 * ca.sin(30.0 * s.x[0]) + 0.19, "dips"),
    )  # fmt: skip
    signs = np.sign(0.2 * np.sin(30.0 * traj(np.linspace(0.0, 5.0, 200_001)).x[:, 0]) + 0.19)
    assert len(traj.events["dips"]) == (signs[1:] * signs[:-1] < 0.0).sum() == 30


@pytest.mark.by_hand("60.0-0.1999-60")
@pytest.mark.parametrize(
    ("rate", "level", "least"), [(60.0, 0.199, 60), (60.0, 0.1999, 60), (30.0, -0.199, 30)]
)
def test_grazing_pairs_of_crossings_are_found(
    rate: float, level: float, least: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Extrema close to zero are searched between samples; samples alone miss half of the pairs."""
    scene = pinred.Scene(
        system=BEANIE, **SPRUNG, duration=5.0, rtol=1e-4, atol=1e-4,
        events=pinred.Event(lambda s: 0.2 * ca.sin(rate * s.x[0]) + level, "dips"),
    )  # fmt: skip
    traj = pinred.simulate(scene)
    signs = np.sign(0.2 * np.sin(rate * traj(np.linspace(0.0, 5.0, 500_001)).x[:, 0]) + level)
    assert len(traj.events["dips"]) == (signs[1:] * signs[:-1] < 0.0).sum() >= least
    monkeypatch.setattr(events, "_EXTREMA", 0)
    assert len(pinred.simulate(scene).events["dips"]) < 0.6 * least


def test_events_that_touch_zero_end_the_search() -> None:
    """A double zero inside a step is sampled a few times, and is no crossing."""
    traj = pinred.simulate(
        BEANIE, **SPRUNG, duration=5.0, events=pinred.Event("(x[0] - 0.3)**2", "touching")
    )
    assert len(traj.events["touching"]) == 0


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1.0, 0.01, 1.1], 1),  # may reach zero inside
        ([1.0, 0.9, 1.1], 0),  # too far from zero
        ([0.0, 1.0, 2.0], 0),  # linear
        ([0.02, 0.1, 1.0], 1),  # at the start
        ([1.0, 0.1, 0.02], 1),  # at the end
        ([1.0, -0.01, 1.1], 0),  # two crossings are known already
        ([-1.0, -0.01, -1.1], 1),
        ([1.0, 2.0], 0),
    ],
)
def test_extrema_close_to_zero_are_sampled(values: list[float], expected: int) -> None:
    """New times lie between samples, where a parabola predicts an extremum close to zero."""
    times = np.arange(float(len(values)))
    found = extremum_times(times, np.array([values]))
    assert len(found) == expected
    assert not np.isin(found, times).any()
