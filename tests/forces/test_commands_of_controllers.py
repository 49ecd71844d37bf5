"""Controllers with wrenches, pulses and states, in closed form; replay by compare."""

# ruff: noqa: ARG005  # functions are told apart by their arguments, used or not

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.forces import Command, Controller, SeenState
from pinred.judge.audit import measurement_error
from pinred.judge.reference_solution import FullState
from pinred.scene.scene import ENGINES, Engine
from pinred.simulation.trajectory import Trajectory

BEANIE = pinred.load("elroys_beanie")
WHEELS = ("wheel_x", "wheel_y", "wheel_z")
BRICK = pinred.load("reaction_wheel_satellite", lock=(*WHEELS, "panel_hinge"))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.sampled
def test_pulses_equal_closed_form(engine: Engine) -> None:
    """A push with a width each second: p and v follow constant forces during the pulses."""
    widths = [0.25, 0.0, 1.0, 7.0]
    measurements: list[SeenState] = []

    def push(s: SeenState) -> Command:
        measurements.append(s)
        com = BRICK.model.inertias[1].lever  # no moment about it
        F = np.array([2.0, -1.0, 0.5])
        return Command(wrench=np.append(F, np.cross(com, F)), width=widths[round(s.t)])

    controller = Controller(push, 1.0, wrench=True)
    traj = pinred.simulate(BRICK, x0=[], duration=4.0, forces=[controller], engine=engine)
    F, v, p = np.array([2.0, -1.0, 0.5]), np.zeros(3), np.zeros(3)
    for k, width in enumerate(widths):
        on = min(width, 1.0)
        np.testing.assert_allclose(measurements[k].pose[:3], p, atol=1e-10)
        np.testing.assert_allclose(measurements[k].xi[:3], v, atol=1e-10)
        np.testing.assert_allclose(measurements[k].J[:3], BRICK.mass * v, atol=1e-8)
        a = F / BRICK.mass
        p = p + v + a * on * (1.0 - on / 2.0)
        v = v + a * on
    np.testing.assert_allclose(traj.pose[-1, :3], p, atol=1e-10)
    np.testing.assert_allclose(traj.xi[-1], [*v, 0.0, 0.0, 0.0], atol=1e-10)
    assert 0.25 in traj.motion.knots
    assert [action.width for action in traj.actions] == widths
    wrench = traj.actions[0].wrench
    assert wrench is not None
    np.testing.assert_array_equal(wrench[:3], F)
    np.testing.assert_allclose(traj.momentum_balance.residual, 0.0, atol=1e-10)


def test_command_without_wrench_of_a_thruster_is_zero() -> None:
    """A controller of wrenches may return a command without one, for a period without thrust."""
    rest = Controller(lambda s: Command(), 0.5, wrench=True)
    np.testing.assert_array_equal(rest.held(Command(), (), 6, 0.0).values, np.zeros(6))
    traj = pinred.simulate(BRICK, x0=[], duration=1.0, forces=[rest])
    np.testing.assert_array_equal(traj.xi[-1], np.zeros(6))


def add_positions(_: float, state: list[float], seen: SeenState) -> tuple[list[float], list[float]]:
    """Return the sum of all positions so far; the state is changed in place."""
    state.append(float(seen.x["beanie"]))
    return [-sum(state)], state


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.sampled
def test_controller_state_equals_closed_form(engine: Engine) -> None:
    """The recursion x⁺ = x + v T + a T²/2, v⁺ = v + a T with a = −(3/2) Σ x."""
    state0 = [0.5]
    controller = Controller(add_positions, 0.25, state0=state0)
    options: dict[str, Any] = {"x0": [0.3], "xdot0": [-0.2], "duration": 2.0, "engine": engine}
    first, second = (pinred.simulate(BEANIE, **options, forces=controller) for _ in range(2))
    x, v, total = 0.3, -0.2, 0.5
    for k, action in enumerate(first.actions):
        assert action.t == pytest.approx(0.25 * k)
        assert action.seen.x[0] == pytest.approx(x, abs=1e-10)
        total += x
        assert action.torque["beanie"] == pytest.approx(-total, abs=1e-9)
        a = -1.5 * total
        x, v = x + 0.25 * v + 0.25**2 / 2 * a, v + 0.25 * a
    assert first.x[-1, 0] == pytest.approx(x, abs=1e-10)
    np.testing.assert_array_equal(first.x, second.x)  # each run begins with a copy
    assert state0 == [0.5]


def noise(period: float = 0.1) -> tuple[Controller, list[float]]:
    """A controller whose results never repeat, and the times at which it was called."""
    rng, calls = np.random.default_rng(), []

    def law(s: SeenState) -> Array:
        calls.append(s.t)
        return rng.normal(size=1)

    return Controller(law, period), calls


@pytest.mark.by_hand
def test_compare_replays_recorded_commands() -> None:
    """It passes for a controller that returns random torques, and does not call it again."""
    controller, calls = noise()
    traj = pinred.simulate(BEANIE, duration=0.5, forces=[controller], rtol=1e-8)
    before = list(calls)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    assert calls == before == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])


@pytest.mark.by_hand
def test_compare_detects_wrong_measurement() -> None:
    """The arguments of the controller are validated, because its commands are replayed."""
    controller, _ = noise()
    traj = pinred.simulate(BEANIE, duration=0.3, forces=[controller], rtol=1e-8)
    full = FullState(traj.scene)
    assert measurement_error(traj, full) < 1e-14

    def told(**wrong: Array) -> Trajectory:
        action = traj.actions[1]
        base = action.seen.base
        assert base is not None
        shape_values = {k: v for k, v in wrong.items() if k in ("x", "xdot")}
        space = {k: v for k, v in wrong.items() if k not in shape_values}
        wrong_state = replace(action.seen, **shape_values, base=replace(base, **space))
        traj.motion.actions = (
            traj.actions[0],
            replace(action, seen=wrong_state),
            *traj.actions[2:],
        )
        return traj

    kept = traj.motion.actions
    wrong_state, base = kept[1].seen, kept[1].seen.base
    assert base is not None
    for name in ("x", "xdot", "pose", "xi", "mu", "J"):
        value = getattr(wrong_state if name in ("x", "xdot") else base, name)
        assert measurement_error(told(**{name: value + 1e-6}), full) > 1e-7, name
        traj.motion.actions = kept
    report = pinred.compare(told(x=wrong_state.x + 1e-6))
    assert not report.passed
    assert report.field_error > report.field_bound


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Controller(lambda s: Command(wrench=[1.0]), 0.5), "returned a wrench .*=True"),
        (
            lambda: Controller(lambda s: Command(wrench=[1.0, 2.0]), 0.5, wrench=True),
            "must return a wrench of 1 finite entries",
        ),
        (lambda: Controller(lambda s: Command([1.0], width=-1.0), 0.5), "returned a width of -1 s"),
        (lambda: Controller(lambda s: Command([1.0], width=np.nan), 0.5), "must return one width"),
        (lambda: Controller(lambda t, a, s: [1.0], 0.5, state0=0), r"return \(action, state\)"),
        (lambda: Controller(lambda s: [1.0], 0.5, ()), "has no joints and no wrench"),
        (lambda: Controller(lambda s: [1.0], 0.5, wrench=[1.0]), "wrench of controller must be"),  # type: ignore[arg-type]
        (lambda: Controller(lambda t, x: [1.0], 0.5), "must be a function of .* takes 2"),
    ],
)  # fmt: skip
def test_invalid_commands_are_rejected(make: Any, message: str) -> None:
    """A command must have the announced torques and wrench, as finite numbers."""
    with pytest.raises(pinred.InputError, match=message):
        pinred.simulate(BEANIE, duration=1.0, forces=[make()])


def test_controller_of_base_needs_base() -> None:
    """outputs='shape' is only for controllers of the shape."""
    with pytest.raises(pinred.InputError, match="outputs='shape' omits"):
        pinred.Scene(
            system=BEANIE, outputs="shape", forces=[Controller(lambda s: [s.pose[0]], 0.5)]
        )
    blind = Controller(lambda t, x, xdot, mu: -x, 0.5)
    assert len(pinred.simulate(BEANIE, outputs="shape", forces=[blind], duration=1.0).actions) == 2
