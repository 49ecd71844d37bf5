"""Defects of steps by ABA, and errors of the reference solution from its residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import casadi
import numpy as np
import pinocchio as pin
import pytest
from tampering import tampered

import pinred
from pinred.common.arrays import Array
from pinred.judge import step_defects as module
from pinred.judge.reference_solution import FullState, Solution
from pinred.judge.step_defects import (
    Defects,
    Quadrature,
    _sampled_steps,
    compute_defects,
    growth_over,
    integrate_residuals,
    largest_defect,
    node_times,
    reference_errors,
)
from pinred.laboratory.stress.extreme_parameters import single

RTOL, ATOL, END = 1e-9, 1e-11, 0.5
JUMP = 1e-3


@cache
def cat(atol: float, away: float = 0.0) -> pinred.Trajectory:
    """Simulate the falling cat with speeds of about 1 m/s and 1 rad/s."""
    pose0 = [away, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    return pinred.simulate(
        pinred.load("falling_cat"), duration=END, rtol=RTOL, atol=atol, pose0=pose0,
        x0=[0.5, 3.0, -2.0], xdot0=[1.0, -4.0, 2.0], xi0=[0.3, 2.0, -0.5, 1.5, 0.2, 3.0],
    )  # fmt: skip


def with_jump(traj: pinred.Trajectory, name: str, column: int, when: float) -> pinred.Trajectory:
    """Add a jump to one number after a time."""

    def change(state: pinred.State) -> pinred.State:
        values = getattr(state, name).copy()
        values[state.t >= when, column] += JUMP
        return replace(state, **{name: values})

    return tampered(traj, change)


KINDS = [("pose", 1), ("pose", 4), ("x", 0), ("x", 1), ("xi", 2), ("xi", 4), ("xdot", 2)]


@pytest.mark.parametrize(("name", "column"), KINDS)
@pytest.mark.parametrize(("atol", "away"), [(1e-2 * RTOL, 0.0), (1e3 * RTOL, 0.0), (RTOL, 1e7)])
@pytest.mark.sampled(3)
def test_defect_of_jump_is_relative_to_its_unit(
    name: str, column: int, atol: float, away: float
) -> None:
    """The unit is the largest of its kind, at least 1, the radius of gyration, or atol/rtol."""
    traj = with_jump(cat(atol, away), name, column, END)
    slow, states = atol / RTOL, traj(traj.motion.knots)
    full = FullState(traj.scene)
    radius = full.totals.radius_of_gyration(traj.system.q(states.pose[0], states.x[0]))
    assert radius < 1.0
    place = states.pose[:, :3]
    sizes = {
        "pose": 1.0,
        "x": float(max(1.0, np.abs(states.x).max())),
        "xi": float(max(slow, np.abs(states.xi[:, 3:]).max())),
        "xdot": float(max(slow, np.abs(states.xdot).max())),
    }
    if (name, column) == ("pose", 1):
        sizes["pose"] = max(radius, np.abs(place - place[0]).max(), 1e-5 * np.abs(place).max())
    if (name, column) == ("xi", 2):
        sizes["xi"] = max(slow * radius, np.abs(states.xi[:, :3]).max())
    assert largest_defect(traj, traj.system) == pytest.approx(JUMP / sizes[name], rel=1e-3)


def test_defects_of_correct_motions_are_small() -> None:
    """Below the tolerance; at round-off even if the base rotates six times in a step."""
    assert largest_defect(cat(RTOL), cat(RTOL).system) < RTOL
    exact = pinred.RKMK4(step=2.0)
    spinning = pinred.simulate(
        single([1.0, 1.0, 1.0]), xi0=[0.0, 0.0, 20.0], duration=4.0, method=exact
    )
    assert len(spinning.motion.knots) == 3
    assert largest_defect(spinning, spinning.system) < 1e-14


def test_subintervals_end_exactly_at_step_ends() -> None:
    """Steps are halved unless the base rotates by more than 2 rad."""
    traj = cat(RTOL)
    knots = traj.motion.knots
    count = len(knots) - 1
    a, b, first = module._subintervals(traj, np.arange(count))
    assert len(a) == 2 * count
    assert (a[first] == knots[:-1]).all()
    assert (b[first + 1] == knots[1:]).all()
    assert a[first + 1] == pytest.approx(0.5 * (knots[:-1] + knots[1:]), rel=1e-15)
    assert (b[first] == a[first + 1]).all()


def test_last_subinterval_ends_at_final_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Round-off of start + (end − start) must not exceed the end."""
    start, end = 0.001, 0.009
    assert start + (end - start) > end
    traj = pinred.simulate(pinred.load("rigid_body"), duration=end, xi0=[0.1, 0.2, 0.3])
    monkeypatch.setattr(type(traj.motion), "knots", np.array([0.0, start, end]))
    assert module._subintervals(traj, np.arange(2))[1][-1] == end
    assert np.isfinite(compute_defects(traj, FullState(traj.scene)).worst)


def test_subintervals_are_halves_without_rotation() -> None:
    """For any length of a step."""
    cart = pinred.load("cartpole", gravity=np.zeros(3))
    traj = pinred.simulate(
        cart, x0=[0.0], xdot0=[0.0], xi0=[0.3], duration=100.0, method=pinred.RKMK4(step=50.0)
    )
    a, b, first = module._subintervals(traj, np.arange(2))
    assert a.tolist() == [0.0, 25.0, 50.0, 75.0]
    assert b.tolist() == [25.0, 50.0, 75.0, 100.0]
    assert first.tolist() == [0, 2]


def test_defect_unit_of_angles_is_at_least_a_radian() -> None:
    """The unit is the largest angle, even if little of it is travelled."""
    system = pinred.load("elroys_beanie")
    traj = pinred.simulate(
        system, pose0=[8.0], x0=[0.1], xi0=[0.2], xdot0=[0.2], duration=END, rtol=RTOL, atol=ATOL
    )
    unit = 8.0 + 0.2 * END  # without springs both rotate at constant rates
    assert largest_defect(with_jump(traj, "pose", 0, END), system) == pytest.approx(
        JUMP / unit, rel=1e-3
    )
    assert largest_defect(with_jump(traj, "x", 0, END), system) == pytest.approx(JUMP, rel=1e-3)


def test_jump_inside_step_appears_in_subintervals_only() -> None:
    """It changes the dense output, but not the step ends."""
    knots = cat(RTOL).motion.knots
    middle = 0.5 * (knots[2] + knots[3])

    def change(state: pinred.State) -> pinred.State:
        x = state.x.copy()
        x[state.t == middle, 0] += JUMP
        return replace(state, x=x)

    traj = tampered(cat(RTOL), change)
    assert largest_defect(traj, traj.system) < RTOL
    assert largest_defect(traj, traj.system, subintervals=True) == pytest.approx(
        JUMP / np.abs(traj(knots).x).max(), rel=1e-6
    )


class FullStateWithRoundOff(FullState):
    """Full simulation with an artificial error of ABA in world axes."""

    left = 0.0

    def rates(
        self,
        t: Array,
        y: Array,
        parameters: Sequence[Array],
        axes: pin.Convention = pin.Convention.LOCAL,
    ) -> Array:
        """Add the artificial error to the last rate."""
        rates = super().rates(t, y, parameters, axes)
        rates[:, -1] += self.left * (axes == pin.Convention.WORLD)
        return rates


def test_defect_ignores_round_off_of_aba(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten times the difference between two evaluations of ABA is subtracted."""
    traj = with_jump(cat(RTOL), "xdot", 2, END)
    full = FullStateWithRoundOff(traj.scene)
    clean = compute_defects(traj, full)
    expected = clean.worst
    length = float(np.diff(traj.motion.knots)[-1])
    size = JUMP / expected
    monkeypatch.setattr(FullStateWithRoundOff, "left", 0.03 * JUMP / length)
    result = compute_defects(traj, full)
    assert result.worst == pytest.approx(expected - 0.3 * JUMP / size, rel=1e-3)
    # A subinterval is half as long, so half of that is subtracted.
    assert result.subintervals.max() == pytest.approx(expected - 0.15 * JUMP / size, rel=1e-3)
    unit = JUMP / clean.motion_steps.max()
    assert result.round_off_rate == pytest.approx(0.03 * JUMP / length / unit, rel=1e-3)
    monkeypatch.setattr(FullStateWithRoundOff, "left", 0.3 * JUMP / length)
    assert compute_defects(traj, full).worst < 1e-6


def test_round_off_is_measured_once_per_subinterval(monkeypatch: pytest.MonkeyPatch) -> None:
    """More evaluations in world axes would double the cost."""
    times: list[tuple[float, bool]] = []
    rates = FullState.rates

    def counted(
        self: FullState, t: Array, y: Array, parameters: Any, axes: Any = pin.Convention.LOCAL
    ) -> Array:
        times.extend((time, axes == pin.Convention.WORLD) for time in t.tolist())
        return rates(self, t, y, parameters, axes)

    monkeypatch.setattr(FullState, "rates", counted)
    traj = cat(RTOL)
    stretches = 2 * (len(traj.motion.knots) - 1)
    compute_defects(traj, FullState(traj.scene), propagate=False)
    of_bodies = [t for t, world in times if not world]
    assert len(of_bodies) == 8 * stretches
    assert [t for t, world in times if world] == of_bodies[::8]


def test_round_off_of_distant_base_is_small() -> None:
    """Both evaluations of ABA have the base at the origin."""
    traj = with_jump(cat(RTOL, 1e7), "xdot", 2, END)
    assert largest_defect(traj, traj.system) > 0.99 * JUMP / np.abs(traj.states.xdot).max()


@pytest.mark.parametrize(("slow", "duration", "unit"), [(1e-3, 1.0, 1.0), (1e-3, 50.0, 0.02)])
def test_motion_defect_of_slow_rates_uses_their_size(
    slow: float, duration: float, unit: float
) -> None:
    """The unit is the rate that covers a radian until the end, or the largest rate.

    For the tolerance the unit is atol/rtol, 1 rad/s.
    """
    x0, xdot0 = [0.5, 3.0, -2.0], [slow, 0.0, 0.0]
    resting = pinred.simulate(
        pinred.load("falling_cat"), duration=duration, rtol=1e-8, atol=1e-8, x0=x0, xdot0=xdot0
    )
    traj = with_jump(resting, "xdot", 1, duration)
    result = compute_defects(traj, FullState(resting.scene))
    scale = max(unit, float(np.abs(traj(traj.motion.knots).xdot[:, 1]).max()))
    assert result.worst == pytest.approx(JUMP, rel=1e-2)
    assert result.motion_steps.max() == pytest.approx(JUMP / scale, rel=1e-2)
    assert result.motion_subintervals.max() == pytest.approx(JUMP / scale, rel=1e-2)


@cache
def satellite() -> pinred.Trajectory:
    """Simulate a satellite with a panel (first joint) and fast wheels, rotated by a wrench."""
    return pinred.simulate(
        pinred.load("reaction_wheel_satellite"), duration=END, rtol=1e-8, atol=1e-8,
        xdot0=[0.1, 300.0, 200.0, 100.0], xi0=[9.0, 0.0, 0.0, 0.1, 0.2, 0.1],
        forces=[pinred.forces.Wrench([0.0, 0.0, 0.0, 500.0, 0.0, 0.0])],
    )  # fmt: skip


@pytest.mark.parametrize(("name", "column"), [("pose", 4), ("x", 0), ("x", 1), ("xi", 1)])
def test_motion_defect_of_other_numbers_equals_defect(name: str, column: int) -> None:
    """Positions, angles and linear velocities have the same unit in both."""
    traj = with_jump(satellite(), name, column, END)
    result = compute_defects(traj, FullState(traj.scene))
    assert result.motion_steps.max() == pytest.approx(result.worst, rel=1e-6)
    assert result.motion_subintervals.max() == pytest.approx(result.subintervals.max(), rel=1e-6)


@pytest.mark.parametrize(("name", "column"), [("xdot", 0), ("xi", 4)])
def test_motion_defect_of_joint_uses_its_rate(name: str, column: int) -> None:
    """Each joint has its own unit; the base's spin uses its initial value."""
    simulated = satellite()
    assert simulated.system.shape_names[0] == "panel_hinge"
    traj = with_jump(simulated, name, column, END)
    result, states = compute_defects(traj, FullState(simulated.scene)), traj(traj.motion.knots)
    largest = np.abs(states.xdot if name == "xdot" else states.xi[:, 3:]).max()
    unit = np.abs(states.xdot[:, column]).max() if name == "xdot" else 0.2
    unit = max(min(1.0 / END, 1.0), float(unit))  # the rate that covers a radian, or atol/rtol
    assert largest > 3.0 * unit
    assert result.worst == pytest.approx(JUMP / largest, rel=1e-2)
    assert result.motion_steps.max() == pytest.approx(JUMP / unit, rel=1e-2)


def test_motion_defect_of_spin_from_rest_uses_least_unit() -> None:
    """The unit is the rate that covers a radian until the end, however fast it becomes."""
    system = pinred.load("elroys_beanie")
    push = pinred.forces.Wrench([0.05])
    pushed = pinred.simulate(
        system, xi0=[0.0], xdot0=[0.0], duration=50.0, rtol=1e-8, atol=1e-8, forces=[push]
    )
    traj = with_jump(pushed, "xi", 0, 50.0)
    assert np.abs(pushed.xi).max() > 0.3
    result = compute_defects(traj, FullState(pushed.scene))
    assert result.motion_steps.max() == pytest.approx(JUMP / 0.02, rel=1e-3)


@pytest.mark.parametrize(
    ("method", "far"), [("Tsit5", 0.03), ("DOP853", 1.0), ("AdaptiveGauss", 0.03)]
)
def test_motion_defect_includes_residuals_that_cancel(method: str, far: float) -> None:
    """For a beanie on a spring, x = x₀ cos ωt, it equals the error of the step.

    The residual of Tsit5's interpolant cancels over the step. DOP853's steps span a radian of the
    spring, so a linearisation in each half is less accurate.
    """
    system = pinred.load("elroys_beanie")
    traj = pinred.simulate(
        system, duration=2.0, x0=[1.0], springs={"beanie": (30.0, 0.0)}, rtol=1e-6, atol=1e-6,
        method=method,
    )  # fmt: skip
    knots, full = traj.motion.knots, FullState(traj.scene)
    y, result = module.full_states(traj, full, knots), compute_defects(traj, full)
    inertia = pin.crba(system.model, pin.Data(system.model), system.q(y[0, :1], y[0, 1:2]))
    inertia = np.triu(inertia) + np.triu(inertia, 1).T
    share = inertia[0, 1] / inertia[0, 0]
    omega = np.sqrt(30.0 / (inertia[1, 1] - share * inertia[0, 1]))
    x, v, step = y[:-1, 1], y[:-1, 3], np.diff(knots)
    c, s = np.cos(omega * step), np.sin(omega * step)
    off = np.column_stack([y[1:, 1] - (c * x + s / omega * v), y[1:, 3] - (c * v - omega * s * x)])
    unit = module.defect_units(traj, full)[1]
    expected = np.abs(np.column_stack([off, share * off]) / unit[[1, 3, 0, 2]])
    assert result.motion_steps == pytest.approx(expected.max(axis=1), rel=far, abs=1e-12)
    if method == "Tsit5":
        assert result.worst < 1e-12 < 1e-9 < expected.max()
        assert compute_defects(traj, full, propagate=False).motion_steps.max() < 1e-12


def test_growth_over_subinterval_is_linearised_aba() -> None:
    """Compared with differences of ABA; a zero or non-finite error gives zero.

    The wheels of the satellite rotate at 300 rad/s, so the step of the difference must be scaled.
    """
    simulated = pinred.simulate(
        pinred.load("reaction_wheel_satellite"), duration=END, x0=[0.3, 0.0, 0.0, 0.0],
        xdot0=[0.1, 300.0, 200.0, 100.0], xi0=[0.1, 0.2, 0.3, 0.4, -0.2, 0.3],
    )  # fmt: skip
    full, rng = FullState(simulated.scene), np.random.default_rng(0)
    t = np.array([0.1, 0.2])
    nodes = np.concatenate([np.linspace(s, s + 0.1, 8) for s in t])
    y, none = module.full_states(simulated, full, nodes), np.zeros((2, 21))
    rates = np.array([full.rate(0.0, row) for row in y])
    course = Quadrature(nodes, [np.empty(0)] * 16, y, rates, none, none, none, np.array([0.3, 0.1]))
    sizes = module.defect_units(simulated, full)[0]
    off = 1e-9 * sizes * rng.normal(size=21)
    up, down = (full.rate(0.0, y[12] + s * 1e4 * off) for s in (1.0, -1.0))
    expected = 0.1 * (up - down) / 2e4
    result = growth_over(full, course, np.array([1, 1]), np.array([off, -off]), sizes)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(result, [expected, -expected], rtol=0.0, atol=1e-4 * scale)
    for odd in (0.0, np.nan, np.inf):
        result = growth_over(full, course, np.array([0, 1]), np.array([odd * sizes, off]), sizes)
        assert (result[0] == 0.0).all()
        np.testing.assert_allclose(result[1], expected, rtol=0.0, atol=1e-4 * scale)


def test_defects_use_at_most_200_steps() -> None:
    """Longer trajectories are sampled at random."""
    fine = pinred.DOP853(max_step=END / 230)
    traj = pinred.simulate(cat(RTOL).system, duration=END, method=fine)
    full = FullState(traj.scene)
    assert len(traj.motion.knots) > 230
    assert compute_defects(traj, full).steps.shape == (200,)
    few = compute_defects(traj, full, max_steps=7)
    assert few.steps.shape == few.smooth.shape == (7,)
    count = len(cat(RTOL).motion.knots) - 1
    assert compute_defects(cat(RTOL), full).steps.shape == (count,)


def test_last_step_is_always_sampled() -> None:
    """Errors of the last step have no time to decay; the random choice of 3000 steps misses it."""
    knots = np.arange(3001.0)
    traj: Any = SimpleNamespace(motion=SimpleNamespace(step_spans=(knots[:-1], knots[1:])))
    steps = _sampled_steps(traj, 200)
    assert steps[-1] == 2999
    assert (np.diff(steps) > 0).all()
    assert len(steps) == 200


@pytest.mark.parametrize("kinks", [True, False])
def test_steps_with_kinks_are_not_smooth(monkeypatch: pytest.MonkeyPatch, kinks: bool) -> None:
    """The threshold is ten times the median, only for forces with kinks; NaN is never excluded."""
    system = pinred.load("coupled_planar")
    acting = [pinred.forces.Torque(lambda _t, x, *_: 0.1 * casadi.fabs(x))] if kinks else []
    steps = np.array([2.0, 2.0, 2.0, 19.8, 20.2])

    def made(*_: object, **__: object) -> Defects:
        return Defects(steps, steps, np.ones(5, dtype=bool), steps, steps, 0.0)

    monkeypatch.setattr(module, "_defects_of_steps", made)
    scene = pinred.Scene(system=system, duration=0.1, xdot0=[1.0], forces=acting)
    traj = pinred.simulate(scene)
    result = compute_defects(traj, FullState(scene))
    assert result.smooth.tolist() == [True] * 4 + [not kinks]
    assert result.worst == (19.8 if kinks else 20.2)
    steps[0] = np.nan
    assert np.isnan(compute_defects(traj, FullState(scene)).worst)


def test_compare_uses_commands_held_by_controllers() -> None:
    """Full simulation, equations and defects use the command of each segment."""
    system = pinred.load("coupled_planar")
    wave = pinred.forces.Controller(lambda t, *_: [np.cos(9.0 * t)], 0.1, system.shape_names)
    traj = pinred.simulate(system, duration=0.4, xdot0=[0.3], forces=wave)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    assert np.ptp(traj.xdot) > 0.01


K, LAST = 3.0, 10.0
TIMES = np.linspace(0.0, LAST, 101)
OMEGA = np.sqrt(K * 3.0 / 2.0)


@cache
def scene() -> pinred.Scene:
    """Return the scene of a beanie on a spring."""
    system = pinred.load("elroys_beanie")
    return pinred.Scene(system=system, springs={"beanie": (K, 0.0)}, duration=LAST)


@cache
def beanie() -> FullState:
    """Return its full simulation."""
    return FullState(scene())


def y0() -> Array:
    """Return its initial state."""
    return beanie().state(np.zeros(1), np.array([0.5]), np.array([0.8]), np.array([-0.4]))


def solution(rtol: float, times: Array = TIMES) -> tuple[Solution, Array]:
    """Return the solution, and the errors of the joint."""
    result = beanie().solve(y0(), times, rtol, 1e-2 * rtol)
    exact = 0.5 * np.cos(OMEGA * times) - 0.4 / OMEGA * np.sin(OMEGA * times)
    return result, np.abs(result.motion.x[:, 0] - exact)


def errors_of(result: Solution, times: Array = TIMES, growth: float = 1.0) -> Array:
    """Return the errors from the residuals in the units of radians and radians per second."""
    return reference_errors(beanie(), result, times, np.full(len(times), growth), np.ones(4))


@pytest.mark.parametrize("rtol", [1e-5, 1e-8, 1e-11])
def test_residuals_bound_error(rtol: float) -> None:
    """The bound is at least half the error, and at most a hundred times the largest one."""
    result, error = solution(rtol)
    bound = errors_of(result)
    assert bound[0] == 0.0
    assert (error <= 2.0 * bound + 1e-15).all()
    assert bound[-1] < 100.0 * error.max() + 1e-13


def test_errors_are_multiplied_by_growth() -> None:
    """All except those within the current step."""
    result, _ = solution(1e-8)
    one, two, three = (errors_of(result, growth=growth) for growth in (1.0, 2.0, 3.0))
    np.testing.assert_allclose(three - two, two - one, rtol=1e-12)
    within = 2.0 * one - two
    assert (within[1:] > 0.0).all()
    assert (np.diff(within) > -1e-20).all()
    assert two[-1] > 1.3 * one[-1]


def test_steps_without_times_count() -> None:
    """Thirteen times lie in twelve of the 38 steps; the others are assumed to be like these."""
    result, _ = solution(1e-8)
    steps = result.steps
    assert steps is not None
    assert len(result.step_ends) == len(steps.ends) + 1  # the first one is very short
    times = np.linspace(0.0, LAST, 13)
    few, _ = solution(1e-8, times)
    assert few.steps is not None
    assert len(few.steps.ends) == 12
    assert len(few.step_ends) == len(result.step_ends)
    assert 0.7 * errors_of(result)[-1] < errors_of(few, times)[-1] < 1.5 * errors_of(result)[-1]


def test_step_without_times_counts_like_the_mean_of_the_others() -> None:
    """The first step is very short; after k further steps the sum of k counts (k + 1)/k times."""
    result, _ = solution(1e-8)
    steps = result.steps
    assert steps is not None
    without = replace(result, step_ends=steps.ends)
    sums, all_sums = (
        errors_of(each, growth=2.0) - errors_of(each, growth=1.0) for each in (without, result)
    )
    k = 1 + np.searchsorted(steps.ends, TIMES[1:])
    assert (sums[1:] > 0.0).all()
    np.testing.assert_allclose(all_sums[1:] / sums[1:], (k + 1) / k, rtol=1e-9)


def test_errors_are_relative_to_units() -> None:
    """Both those of steps and those within a step."""
    result, _ = solution(1e-8)
    for growth in (1.0, 1e3):
        errors = reference_errors(beanie(), result, TIMES, np.full(101, growth), np.full(4, 5.0))
        np.testing.assert_allclose(errors, errors_of(result, growth=growth) / 5.0, rtol=1e-6)


def test_time_just_after_the_last_step_has_its_error() -> None:
    """A stop within round-off of the end may be the end of the last step."""
    result, _ = solution(1e-8)
    later = np.append(TIMES, np.nextafter(LAST, np.inf))
    assert errors_of(result, later)[-1] == pytest.approx(errors_of(result)[-1], rel=0.1)


@pytest.mark.parametrize("where", ["end", "inside"])
def test_error_of_dense_output_is_detected(where: str) -> None:
    """A change of 1e-6 in one step appears in the bound from that step on."""
    result, _ = solution(1e-10)
    assert result.steps is not None
    coefficients = result.steps.coefficients.copy()
    coefficients[0 if where == "end" else 1, 9, 1] += 1e-6
    wrong = replace(result, steps=replace(result.steps, coefficients=coefficients))
    bound = errors_of(wrong)
    later = result.steps.starts[9] < TIMES
    assert (bound[later] > 2e-7).all()
    assert (bound[~later] < 1e-9).all()


def test_motion_at_its_initial_time_has_no_error() -> None:
    """Such a solution has no steps."""
    result = beanie().solve(y0(), np.zeros(1), 1e-8, 1e-10)
    assert result.steps is None
    assert errors_of(result, np.zeros(1)).tolist() == [0.0]


def test_residuals_use_parameters_of_their_segment() -> None:
    """A controller changes its command every 0.1 s."""
    system = pinred.load("coupled_planar")
    wave = pinred.forces.Controller(lambda t, *_: [np.cos(9.0 * t)], 0.1, system.shape_names)
    traj = pinred.simulate(system, duration=0.4, xdot0=[0.3], forces=wave)
    full, start = FullState(traj.scene, traj.motion.replay), traj.scene.start
    state, times = full.state(start.pose, start.x, start.xi, start.xdot), np.linspace(0, 0.4, 41)
    result = full.solve(state, times, 1e-10, 1e-12)
    units = np.ones(len(state))
    assert reference_errors(full, result, times, np.ones(41), units)[-1] < 1e-9
    shifted = replace(result, parameters=result.parameters[::-1])
    assert reference_errors(full, shifted, times, np.ones(41), units)[-1] > 1e-3


def test_accumulated_defect_is_that_of_the_polynomial() -> None:
    """For a resting beanie off its equilibrium, the residual of a constant state is known."""
    full, a, b = beanie(), np.array([0.2, 1.0]), np.array([0.4, 1.6])
    state = full.state(np.zeros(1), np.array([0.5]), np.zeros(1), np.zeros(1))
    rate, forces = full.rate(0.0, state), scene().force_model
    assert forces is not None
    result = integrate_residuals(
        full, a, b, lambda t: np.tile(state, (len(t), 1)), lambda t: len(t) * [forces.numbers]
    )
    length, last = b - a, node_times(a, b).reshape(2, 8)[:, -1] - a
    np.testing.assert_allclose(result.defects, -np.outer(length, rate), atol=1e-14)
    np.testing.assert_allclose(result.mean_defects, -0.5 * np.outer(length, rate), atol=1e-14)
    np.testing.assert_allclose(result.largest_defects, np.outer(last, np.abs(rate)), atol=1e-14)


@pytest.mark.parametrize("x0", [1e-2, 1e-4])
def test_reference_of_a_loose_motion_is_accurate(x0: float) -> None:
    """Neither a loose rtol (large motion) nor a loose atol (small motion) loosens the reference."""
    system = pinred.load("elroys_beanie")
    traj = pinred.simulate(
        system, x0=[x0], xdot0=[0.0], momentum=0, springs={"beanie": (1.0, 0.0)}, duration=5.0,
        rtol=1e-3, atol=1e-5,
    )  # fmt: skip
    report = pinred.compare(traj)
    assert report.reference_error < 1e-7
    errors = np.abs(traj(report.t).x[:, 0] - x0 * np.cos(np.sqrt(1.5) * report.t))
    np.testing.assert_allclose(report.shape_errors[:, 0], errors, rtol=0.0, atol=1e-9)
