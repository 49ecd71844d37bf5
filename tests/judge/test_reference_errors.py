"""Errors of the reference from its residuals, for oscillations with a closed form."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.judge.reference_solution import FullState, Solution
from pinred.judge.step_defects import integrate_residuals, node_times, reference_errors

K, END = 3.0, 10.0
TIMES = np.linspace(0.0, END, 101)
OMEGA = np.sqrt(K * 3.0 / 2.0)


@cache
def scene() -> pinred.Scene:
    """Return the scene of a beanie on a spring."""
    system = pinred.load("elroys_beanie")
    return pinred.Scene(system=system, springs={"beanie": (K, 0.0)}, duration=END)


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
    times = np.linspace(0.0, END, 13)
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
    later = np.append(TIMES, np.nextafter(END, np.inf))
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
