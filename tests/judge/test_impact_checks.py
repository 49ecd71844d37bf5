"""The judge of motions with joint stops: it passes correct motions and finds planted faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hybrid_reference import stops_of
from random_stops import random_stops
from slides import bouncing_slide

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import IntegrationError
from pinred.forces import Torque
from pinred.judge import impact_checks
from pinred.judge.reference_integrators import TimeBudget
from pinred.judge.step_defects import defect_units, full_states
from pinred.judge.stop_reference import (
    Hit,
    StoppedFullState,
    complementary,
    matched,
    stopped_full_state,
)
from pinred.judge.verdict import Verdict
from pinred.simulation import run_with_stops
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.impacts import impulses, solve_complementarity
from pinred.simulation.reduced_flow import Segment

START: dict[str, Any] = {
    "x0": [0.1, 0.2, -0.1], "xdot0": [3.0, -3.0, 2.0], "xi0": [0.1, 0.2, 0.3, 0.1, 0.5, -0.2],
    "duration": 0.5,
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
    fine, options = np.linspace(0.0, 1.0, 20001), START | {"duration": 1.0}
    x = pinred.simulate(system, **options)(fine).x
    joint, k = next(
        (name, int(np.argmax(column)))
        for name, column in zip(system.shape_names, x.T, strict=True)
        if 0 < np.argmax(column) < 20000
    )
    top = float(x[k, system.shape_names.index(joint)]) + beyond
    report = pinred.compare(pinred.simulate(system, **options, stops={joint: (-10.0, top)}))
    assert report.verdict is Verdict.CANNOT_TELL
    assert "impacts can be judged until" in report.reasons[0]


def checked_hits(
    traj: pinred.Trajectory, hits: list[Hit], bound: float
) -> tuple[dict[str, tuple[float, float]], tuple[str, ...]]:
    """Return the checks of a motion against given impacts and a bound on positions; reasons."""
    full = stopped_full_state(traj)
    assert isinstance(full, StoppedFullState)
    times = np.linspace(0.0, traj.scene.end, 11)
    result = impact_checks.check_stops(traj, full, hits, np.inf, times, np.full(11, bound))
    return {name: (value, allowed) for name, value, allowed in result.checks}, result.reasons


def test_bounds_of_times_and_impulses_follow_from_the_bound_of_positions() -> None:
    """A time may have the error of the position over the speed, and round-off of the duration."""
    traj = cat(0.6)
    full = stopped_full_state(traj)
    unit = defect_units(traj, full)[1][-traj.system.model.nv :]
    hits = impact_checks._hits_of(traj.impacts)
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
            np.testing.assert_allclose(
                time, (1e-4, bound / hit.speed + 1e-13 * traj.scene.end), rtol=1e-6
            )
            factor = max(1.0, rates[hit.joint] / hit.speed)
            np.testing.assert_allclose(impulse, (0.01 / 1.01, 10.0 * bound * factor), rtol=1e-6)
            others[k] = replace(others[k], pull=3.0 * hit.speed * rates[hit.joint])
            checks, _ = checked_hits(traj, others, bound)
            late = 3.0 * rates[hit.joint] / hit.speed  # of the time, times the acceleration
            impulse = checks["impulse of an impact [relative]"]
            factor = max(1.0, late)
            np.testing.assert_allclose(impulse, (0.01 / 1.01, 10.0 * bound * factor), rtol=1e-6)


@pytest.mark.parametrize(("parts", "is_undecided"), [(0.9, True), (1.1, False)])
def test_order_of_impacts_within_the_errors_of_their_times_is_undecided(
    parts: float, is_undecided: bool
) -> None:
    """Impacts closer than the sum of both errors may happen in another order."""
    traj, bound = cat(0.6), 1e-7
    full = stopped_full_state(traj)
    assert isinstance(full, StoppedFullState)
    rules = impact_checks._Rules.of(traj, full, np.linspace(0.0, 1.0, 11), np.full(11, bound))
    first, second, *rest = impact_checks._hits_of(traj.impacts)
    assert first.joint != second.joint
    closest = bound / first.speed + bound / second.speed + traj.scene.rtol
    own = [first, replace(second, t=first.t + 0.5 * closest), *rest]
    other = replace(second, t=first.t - parts * closest)
    pairs, differs, undecided = impact_checks.pair_impacts(own, [other, first, *rest], 1.0, rules)
    assert not pairs
    assert (undecided if is_undecided else differs) == other.t
    assert (differs if is_undecided else undecided) == np.inf


def test_impacts_together_or_one_after_the_other_are_undecided() -> None:
    """Two joints that hit at once have other speeds and impulses than one after the other."""
    traj = cat(0.6)
    full = stopped_full_state(traj)
    assert isinstance(full, StoppedFullState)
    rules = impact_checks._Rules.of(traj, full, np.linspace(0.0, 1.0, 11), np.full(11, 1e-7))
    first, second, *rest = impact_checks._hits_of(traj.impacts)
    own = [first, replace(second, t=first.t), *rest]
    slower = replace(own[1], speed=0.9 * second.speed, impulse=0.9 * second.impulse)
    assert impact_checks.pair_impacts(own, [first, slower, *rest], 1.0, rules)[2] == first.t
    assert impact_checks.pair_impacts(own, [first, slower, *rest], first.t, rules)[2] == np.inf
    # A wrong impulse at the right speed is a fault.
    wrong = replace(own[1], impulse=0.9 * second.impulse)
    pairs, differs, undecided = impact_checks.pair_impacts(own, [first, wrong, *rest], 1.0, rules)
    assert (len(pairs), differs, undecided) == (len(own), np.inf, np.inf)


@pytest.mark.parametrize(("parts", "undecided"), [(1.8, True), (2.2, False)])
def test_impact_within_twice_its_error_before_the_end_is_undecided(
    parts: float, undecided: bool
) -> None:
    """Only an impact this close to the end may be missing in one of the motions."""
    traj, bound = cat(0.6), 1e-7
    hits = impact_checks._hits_of(traj.impacts)
    late = Hit(traj.scene.end, "bend", "upper", -1.0, 2.0)
    late = replace(late, t=late.t - parts * bound / late.speed)
    checks, reasons = checked_hits(traj, [*hits, late], bound)
    assert checks["impacts in other order"] == (float(not undecided), 0.0)
    assert bool(reasons) is undecided


@pytest.mark.parametrize(("size", "check"), [(3e-12, "_momentum_jump"), (3e-8, "_pull")])
def test_momentum_and_pulls_three_times_beyond_their_bounds_fail(
    size: float, check: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bounds are 1e-12 of the momentum and 1e-8 of the largest reaction."""
    traj = cat(0.6)
    monkeypatch.setattr(impact_checks, check, lambda *_: size)
    names = {"_momentum_jump": "momentum at an impact", "_pull": "pull of a stop"}
    assert failed(traj) == {f"{names[check]} [relative]"}
    monkeypatch.setattr(impact_checks, check, lambda *_: 0.3 * size)
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
    full = stopped_full_state(cat(0.6))
    assert isinstance(full, StoppedFullState)
    np.testing.assert_allclose(full.slowest, 1e-5, rtol=1e-12)


def test_grazes_within_the_error_of_positions_end_the_judgement() -> None:
    """Near misses by more than the bound decide nothing."""
    times, bounds = np.linspace(0.0, 1.0, 11), np.linspace(0.0, 1e-6, 11)
    assert impact_checks.judgeable_until([(0.55, 0.59e-6)], np.inf, times, bounds) == 0.55
    assert impact_checks.judgeable_until([(0.55, 0.61e-6)], np.inf, times, bounds) == np.inf
    assert impact_checks.judgeable_until([(0.55, 0.61e-6)], 0.7, times, bounds) == 0.7


SCENES = (0, 4, 5, 13, 24)  # a cluster, rests without reaction, an accumulation, and a loop


# Two further scenes run by default.
@pytest.mark.by_hand("4")
@pytest.mark.parametrize("seed", [4, 5, 135])
def test_random_scenes_with_stops_have_no_false_alarm(seed: int) -> None:
    """Joints rest without reaction, and long steps find impacts less accurately."""
    assert_no_false_alarm(seed)


@pytest.mark.by_hand
@pytest.mark.parametrize("seed", range(84))
def test_many_random_scenes_with_stops_have_no_false_alarm(seed: int) -> None:
    """Trees, followers, loops and robots with restitution 0, 0.3, 1 and mixed."""
    assert_no_false_alarm(seed)


def assert_no_false_alarm(seed: int) -> None:
    """Assert that a correct motion does not fail."""
    system, options = random_stops(seed)
    report = pinred.compare(pinred.simulate(system, **options))
    assert report.verdict is not Verdict.FAILED, report


def _of_impulses(patch: pytest.MonkeyPatch) -> None:
    correct = impulses
    patch.setattr(run_with_stops, "impulses", lambda *of: (1.0 + 1e-4) * correct(*of))


def _of_restitution(patch: pytest.MonkeyPatch) -> None:
    correct = impulses
    patch.setattr(run_with_stops, "impulses", lambda G, u, e: correct(G, u, 0.999 * e + 5e-4))


def _of_times(patch: pytest.MonkeyPatch) -> None:
    correct = run_with_stops._StopSearch.look

    def look(self: Any, segment: Segment) -> bool:
        had, has = bool(self.found), correct(self, segment)
        if has and not had:
            self.found = [(min(t + 1e-5, segment.end), bound) for t, bound in self.found]
        return has

    patch.setattr(run_with_stops._StopSearch, "look", look)


class _Loose:
    """A scene with a loose tolerance, so that impacts within 2 % of its duration happen at once."""

    rtol = 0.02

    def __init__(self, scene: pinred.Scene) -> None:
        """Store the scene."""
        self._scene = scene

    def __getattr__(self, name: str) -> Any:
        return getattr(self._scene, name)


def _of_order(patch: pytest.MonkeyPatch) -> None:
    correct = run_with_stops.RunWithStops._next

    def together(self: Any, *of: Any) -> Any:
        with pytest.MonkeyPatch.context() as inner:
            inner.setattr(self, "scene", _Loose(self.scene))
            return correct(self, *of)

    patch.setattr(run_with_stops.RunWithStops, "_next", together)


def _of_reactions(patch: pytest.MonkeyPatch) -> None:
    correct = run_with_stops.reactions_of
    patch.setattr(run_with_stops, "reactions_of", lambda *of: -correct(*of))


FAULTS = (_of_impulses, _of_restitution, _of_times, _of_order, _of_reactions)


@pytest.mark.by_hand
@pytest.mark.parametrize("seed", SCENES)
@pytest.mark.parametrize("plant", FAULTS)
def test_faults_of_the_simulation_fail(
    plant: Callable[[pytest.MonkeyPatch], None], seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fault that changes impacts or rests of a random scene fails, or ends the simulation."""
    system, options = random_stops(seed)
    correct = pinred.simulate(system, **options)
    monkeypatch.setattr(run_with_stops, "MOST_IMPACTS", 300)
    plant(monkeypatch)
    try:
        traj = pinred.simulate(system, **options)
    except IntegrationError:
        return
    changes = [correct.impacts.rows != traj.impacts.rows, correct.motion.modes != traj.motion.modes]
    assert (pinred.compare(traj).verdict is Verdict.FAILED) is any(changes)


def test_wrong_impulse_on_a_joint_at_rest_fails() -> None:
    """Joints that others push have no speed, but an impulse in the table."""
    traj = cat(0.0, forces=[PRESS], duration=1.0)
    table = traj.impacts
    k = int(np.flatnonzero(table.rate_before == 0.0)[0])
    impulse = table.impulse.copy()
    impulse[k] *= 1.0 + 1e-5
    vars(traj)["impacts"] = replace(table, impulse=impulse)
    assert failed(traj) == {"impulse of an impact [relative]"}


def test_pull_within_round_off_of_the_energy_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without forces, a cyclic joint rests without any reaction but round-off."""
    system, options = random_stops(5)
    traj = pinred.simulate(system, **options)
    full = stopped_full_state(traj)
    assert isinstance(full, StoppedFullState)
    assert any("at its" in label for _, label in traj.motion.modes)
    y = full_states(traj, full, traj.t)
    energy = full.totals.kinetic_energy(full.q(y), full.shapes_and_velocities(y)[1]).max()
    for part, passes in ((0.5, True), (5.0, False)):
        pull = part * 1e-13 * energy
        monkeypatch.setattr(StoppedFullState, "reactions", lambda *_, pull=pull: np.array([-pull]))
        assert (impact_checks._pull(traj, full) == 0.0) is passes


def test_reactions_are_computed_at_most_400_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """A motion with many short steps at rest costs no more."""
    traj = cat(0.0, forces=[PRESS], method="DOP853(max_step=1e-3)")
    full, counts = stopped_full_state(traj), list[int]()
    assert isinstance(full, StoppedFullState)
    assert len(traj.motion.knots) > 450

    def counted(*of: Any) -> Array:
        counts.append(len(of[2]))
        return full_states(*of)

    monkeypatch.setattr(impact_checks, "full_states", counted)
    assert impact_checks._pull(traj, full) == 0.0
    assert counts == [400]


def test_reference_finds_rebounds_that_are_short_for_its_steps() -> None:
    """A pressed slide bounces with half its speed until 1e-6 m/s, as in the closed form."""
    push, mass = 2.0, 0.75
    traj = pinred.simulate(
        bouncing_slide(), x0=[0.0], xdot0=[-1.0], xi0=[0.0], duration=4.0,
        forces=[Torque(lambda *_: [-push])], stops={"slide": pinred.Stop(0.0, restitution=0.5)},
    )  # fmt: skip
    full, start = stopped_full_state(traj, TimeBudget(60.0)), traj.scene.start
    assert isinstance(full, StoppedFullState)
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    hits = full.solve_with_stops(y0, np.array([0.0, 4.0]), 1e-12, 1e-14).hits
    speeds = 0.5 ** np.arange(len(hits))
    np.testing.assert_allclose([hit.speed for hit in hits], speeds, rtol=1e-6, atol=1e-9)
    times = np.cumsum(np.append(0.0, 2.0 * speeds[1:] * mass / push))
    np.testing.assert_allclose([hit.t for hit in hits], times, atol=1e-9)
    assert 10 <= len(hits) <= 21


def test_speeds_affected_by_round_off_are_ten_times_that_of_a_sustained_rebound() -> None:
    """A rebound lower than round-off of the position 0.3 ends at about 3e-5 m/s."""
    push = 1e6 * 0.75
    traj = pinred.simulate(
        bouncing_slide(), x0=[0.3], xdot0=[-1.0], xi0=[0.0], duration=1e-5,
        forces=[Torque(lambda *_: [-push])], stops={"slide": pinred.Stop(0.3, restitution=0.5)},
    )  # fmt: skip
    full, start = stopped_full_state(traj), traj.scene.start
    assert isinstance(full, StoppedFullState)
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    hits = full.solve_with_stops(y0, np.array([0.0, 1e-5]), 1e-12, 1e-14).hits
    assert hits[-1].speed > 1e-5
    np.testing.assert_allclose(full.lifted, 10.0 * hits[-1].speed, rtol=1e-12)


@pytest.mark.parametrize(("count", "most"), [(12, 5000), (13, 1)])
def test_sets_of_up_to_twelve_stops_are_all_tried(
    count: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More sets would take minutes; relaxation finds the same solution."""
    rng, calls, solve = np.random.default_rng(0), list[int](), np.linalg.solve
    root = rng.normal(size=(count, count))
    G, q = root @ root.T + np.eye(count), rng.normal(size=count)

    def counted(*of: Any) -> Array:
        calls.append(1)
        return np.asarray(solve(*of))

    monkeypatch.setattr(np.linalg, "solve", counted)
    z = complementary(G, q)
    assert (len(calls) > 4000) is (count == 12)
    assert len(calls) <= most
    w = G @ z + q
    assert min(z.min(), w.min()) > -1e-9
    np.testing.assert_allclose(z * w, 0.0, atol=1e-9)
    np.testing.assert_allclose(z, solve_complementarity(G, q), atol=1e-9)
