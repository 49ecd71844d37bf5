"""The judge of motions with joint stops: it passes correct motions and finds planted faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hybrid_reference import stops_of

import pinred
from pinred.forces import Torque
from pinred.judge import stop_checks
from pinred.judge.step_defects import defect_units
from pinred.judge.stop_reference import Hit, StoppedFullState, full_state_of, matched
from pinred.judge.verdict import Verdict
from pinred.simulation import run_with_stops
from pinred.simulation.compiled.compiled_flow import CompiledFlow

START: dict[str, Any] = {
    "x0": [0.1, 0.2, -0.1], "xdot0": [3.0, -3.0, 2.0], "xi0": [0.1, 0.2, 0.3, 0.1, 0.5, -0.2],
    "duration": 1.0,
}  # fmt: skip
PRESS = Torque(lambda *_: [0.05, 0.04, -0.02])


def cat(restitution: float, **options: Any) -> pinred.Trajectory:
    """Return a motion of the cat with stops at ±0.5 rad."""
    system = pinred.load("falling_cat")
    stops = {name: pinred.Stop(-0.5, 0.5, restitution) for name in system.shape_names}
    return pinred.simulate(system, **START | {"stops": stops} | options)


def failed(traj: pinred.Trajectory) -> set[str]:
    """Return the names of the checks that fail."""
    checks = pinred.compare(traj).checks
    return {name for name, (value, bound) in checks.items() if not value <= bound}


@pytest.mark.parametrize(("restitution", "forces"), [(0.6, []), (0.0, [PRESS])])
def test_correct_motions_with_stops_pass(restitution: float, forces: list[Torque]) -> None:
    """Correct motions with stops pass."""
    traj = cat(restitution, forces=forces)
    assert len(traj.impacts) >= 3
    if forces:
        assert any("at its" in label for _, label in traj.motion.modes)
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report
    assert "time of an impact [s]" in report.checks
    assert "time of an impact [s]" in str(report)


def test_wrong_restitution_fails() -> None:
    """Wrong restitution fails."""
    traj = cat(0.6 * (1.0 + 1e-4))
    stops = {name: replace(stop, restitution=0.6) for name, stop in stops_of(traj).items()}
    traj.scene = replace(traj.scene, stops=stops)
    assert "impulse of an impact [relative]" in failed(traj)


def test_missed_impact_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Missed impact fails."""
    first = cat(0.6).impacts.joint[0]
    search = run_with_stops._StopSearch.look

    def look(self: Any, segment: Any) -> bool:
        search(self, segment)
        self.found = [root for root in self.found if root[1].joint != first]
        return bool(self.found)

    monkeypatch.setattr(run_with_stops._StopSearch, "look", look)
    names = failed(cat(0.6, stops={first: pinred.Stop(-0.5, 0.5, 0.6)}))
    assert {"impacts in other order", "distance beyond a stop"} <= names


def _negative(traj: pinred.Trajectory) -> None:
    table = traj.impacts
    vars(traj)["impacts"] = replace(table, impulse=-table.impulse)


def _late(traj: pinred.Trajectory) -> None:
    table = traj.impacts
    vars(traj)["impacts"] = replace(table, t=table.t + 1e-6)


def _swapped(traj: pinred.Trajectory) -> None:
    table = traj.impacts
    joint = list(table.joint)
    k = next(k for k in range(len(joint) - 1) if joint[k] != joint[k + 1])
    joint[k], joint[k + 1] = joint[k + 1], joint[k]
    vars(traj)["impacts"] = replace(table, joint=tuple(joint))


@pytest.mark.parametrize(
    ("plant", "check"),
    [
        (_negative, "impulse of an impact [relative]"),
        (_late, "time of an impact [s]"),
        (_swapped, "impacts in other order"),
    ],
)
def test_faults_in_the_table_fail(plant: Callable[[pinred.Trajectory], None], check: str) -> None:
    """Faults in the table fail."""
    traj = cat(0.6)
    plant(traj)
    assert check in failed(traj)


def test_stop_that_pulls_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stop that pulls fails."""
    monkeypatch.setattr(run_with_stops, "_CLINGING", 1.0)
    names = failed(cat(0.0, forces=[PRESS]))
    assert "pull of a stop [relative]" in names


def test_momentum_that_jumps_at_an_impact_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Momentum that jumps at an impact fails."""
    resumed = CompiledFlow.resumed

    def jump(self: Any, t: float, *arguments: Any) -> CompiledFlow:
        flow = resumed(self, t, *arguments)
        flow.parameters[: flow.kernel.layout.base.spin] *= 1.0 + 1e-9
        return flow

    monkeypatch.setattr(CompiledFlow, "resumed", jump)
    assert "momentum at an impact [relative]" in failed(cat(0.6))


@pytest.mark.parametrize("beyond", [1e-9, -1e-9])
def test_grazing_impact_cannot_be_told(beyond: float) -> None:
    """Grazing impact cannot be told."""
    system = pinred.load("falling_cat")
    fine = np.linspace(0.0, 1.0, 20001)
    x = pinred.simulate(system, **START)(fine).x
    joint, k = next(
        (name, int(np.argmax(column)))
        for name, column in zip(system.shape_names, x.T, strict=True)
        if 0 < np.argmax(column) < 20000
    )
    top = float(x[k, system.shape_names.index(joint)]) + beyond
    report = pinred.compare(pinred.simulate(system, **START, stops={joint: (-10.0, top)}))
    assert report.verdict is Verdict.CANNOT_TELL
    assert "impacts can be judged until" in report.reasons[0]


def checked_hits(
    traj: pinred.Trajectory, hits: list[Hit], bound: float
) -> tuple[dict[str, tuple[float, float]], tuple[str, ...]]:
    """Return the checks of a motion against given impacts and a bound on positions; reasons."""
    full = full_state_of(traj)
    assert isinstance(full, StoppedFullState)
    times = np.linspace(0.0, traj.scene.end, 11)
    result = stop_checks.check_stops(traj, full, hits, np.inf, times, np.full(11, bound))
    return {name: (value, allowed) for name, value, allowed in result.checks}, result.reasons


def test_bounds_of_times_and_impulses_follow_from_the_bound_of_positions() -> None:
    """A time may have the error of the position over the speed, and round-off of the duration."""
    traj = cat(0.6)
    full = full_state_of(traj)
    unit = defect_units(traj, full)[1][-traj.system.model.nv :]
    hits = stop_checks._hits_of(traj.impacts)
    rates = {
        name: unit[traj.system.model.joints[traj.system.model.getJointId(name)].idx_v]
        for name in traj.system.shape_names
    }
    for k, hit in enumerate(hits):
        for bound in (1e-7, 1e-16):
            others = [*hits]
            others[k] = replace(hit, t=hit.t - 1e-4, impulse=hit.impulse * 1.01)
            checks, _ = checked_hits(traj, others, bound)
            time, impulse = (
                checks[name]
                for name in ("time of an impact [s]", "impulse of an impact [relative]")
            )
            np.testing.assert_allclose(time, (1e-4, bound / hit.speed + 1e-13), rtol=1e-6)
            factor = max(1.0, rates[hit.joint] / hit.speed)
            np.testing.assert_allclose(impulse, (0.01 / 1.01, 10.0 * bound * factor), rtol=1e-6)
            others[k] = replace(others[k], pull=3.0 * hit.speed * rates[hit.joint])
            checks, _ = checked_hits(traj, others, bound)
            late = 3.0 * rates[hit.joint] / hit.speed  # of the time, times the acceleration
            impulse = checks["impulse of an impact [relative]"]
            factor = max(1.0, late)
            np.testing.assert_allclose(impulse, (0.01 / 1.01, 10.0 * bound * factor), rtol=1e-6)


@pytest.mark.parametrize(("parts", "undecided"), [(1.8, True), (2.2, False)])
def test_order_of_impacts_within_twice_the_error_of_their_times_is_undecided(
    parts: float, undecided: bool
) -> None:
    """Only impacts closer than twice the error of their times may be in other order."""
    traj, bound = cat(0.6), 1e-7
    first, second, *rest = stop_checks._hits_of(traj.impacts)
    assert first.joint != second.joint
    earlier = replace(second, t=first.t - parts * bound / max(first.speed, second.speed))
    checks, reasons = checked_hits(traj, [earlier, first, *rest], bound)
    assert checks["impacts in other order"] == (float(not undecided), 0.0)
    assert any("order of the impacts" in reason for reason in reasons) is undecided


@pytest.mark.parametrize(("parts", "undecided"), [(1.8, True), (2.2, False)])
def test_impact_within_twice_its_error_before_the_end_is_undecided(
    parts: float, undecided: bool
) -> None:
    """Only an impact this close to the end may be missing in one of the motions."""
    traj, bound = cat(0.6), 1e-7
    hits = stop_checks._hits_of(traj.impacts)
    late = Hit(1.0, "bend", "upper", -1.0, 2.0)
    late = replace(late, t=1.0 - parts * bound / late.speed)
    checks, reasons = checked_hits(traj, [*hits, late], bound)
    assert checks["impacts in other order"] == (float(not undecided), 0.0)
    assert bool(reasons) is undecided


@pytest.mark.parametrize(("size", "check"), [(3e-12, "_momentum_jump"), (3e-8, "_pull")])
def test_momentum_and_pulls_three_times_beyond_their_bounds_fail(
    size: float, check: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bounds are 1e-12 of the momentum and 1e-8 of the largest reaction."""
    traj = cat(0.6)
    monkeypatch.setattr(stop_checks, check, lambda *_: size)
    names = {"_momentum_jump": "momentum at an impact", "_pull": "pull of a stop"}
    assert failed(traj) == {f"{names[check]} [relative]"}
    monkeypatch.setattr(stop_checks, check, lambda *_: 0.3 * size)
    assert pinred.compare(traj)


@pytest.mark.parametrize(("beyond", "passes"), [(4e-9, True), (8e-9, False)])
def test_distance_beyond_a_stop_of_more_than_50_tolerances_fails(
    beyond: float, passes: bool
) -> None:
    """Judge a motion with stops that are a little wider than those of the scene."""
    traj = cat(0.6)
    position = 0.5 - beyond
    stops = dict.fromkeys(traj.system.shape_names, pinred.Stop(-position, position, 0.6))
    traj.scene = replace(traj.scene, stops=stops)
    assert ("distance beyond a stop" not in failed(traj)) is passes


def test_planted_pull_and_momentum_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """A change of the momentum by 6e-11 of itself, and a stop that pulls a little, fail."""
    resumed = CompiledFlow.resumed

    def jump(self: Any, t: float, *arguments: Any) -> CompiledFlow:
        flow = resumed(self, t, *arguments)
        flow.parameters[: flow.kernel.layout.base.spin] *= 1.0 + 6e-11
        return flow

    with monkeypatch.context() as patch:
        patch.setattr(CompiledFlow, "resumed", jump)
        assert failed(cat(0.6)) == {"momentum at an impact [relative]"}


def test_slow_impacts_may_be_missing_in_either_motion() -> None:
    """Impacts of ten times the slowest rate or less, and three times more at a difference."""
    slowest = 1e-5

    def hits(*speeds: float, joint: str = "a") -> list[Hit]:
        return [Hit(0.1 * k, joint, "upper", 1.0, speed) for k, speed in enumerate(speeds)]

    assert matched(hits(1.0, 1e-5), hits(1.0), slowest)[1] == np.inf
    assert matched(hits(1.0, 2.9e-5), hits(1.0), slowest)[1] == np.inf
    assert matched(hits(1.0), hits(1.0, 2.9e-5), slowest)[1] == np.inf
    assert matched(hits(1.0, 3.1e-5), hits(1.0), slowest)[1] == 0.1
    assert matched(hits(1.0), hits(1.0, 3.1e-5), slowest)[1] == 0.1
    other = hits(1.0, joint="b")
    assert matched([*hits(2.9e-5), *other], other, slowest)[1] == np.inf
    assert matched(other, [*hits(2.9e-5), *other], slowest)[1] == np.inf
    assert matched([*hits(3.1e-5), *other], other, slowest)[1] == 0.0
    full = full_state_of(cat(0.6))
    assert isinstance(full, StoppedFullState)
    np.testing.assert_allclose(full.slowest, 1e-5, rtol=1e-12)


def test_grazes_within_the_error_of_positions_end_the_judgement() -> None:
    """Near misses by more than the bound decide nothing."""
    times, bounds = np.linspace(0.0, 1.0, 11), np.linspace(0.0, 1e-6, 11)
    assert stop_checks.judgeable_until([(0.55, 0.59e-6)], np.inf, times, bounds) == 0.55
    assert stop_checks.judgeable_until([(0.55, 0.61e-6)], np.inf, times, bounds) == np.inf
    assert stop_checks.judgeable_until([(0.55, 0.61e-6)], 0.7, times, bounds) == 0.7
