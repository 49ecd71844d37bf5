"""Comparisons of stiff scenes: solved steps, the implicit reference, and energies against it."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from stiff_trees import damped_hinge
from tampering import tampered

import pinred
from pinred.forces import Damper, Spring
from pinred.judge.audit import audit_with_reference
from pinred.judge.compare import explain_decaying_errors
from pinred.judge.reference_solution import FullState, StiffError
from pinred.judge.step_defects import (
    DecayingErrors,
    _propagate_error,
    compute_defects,
    defect_units,
    full_states,
    solve_stiff_steps,
)


@cache
def hinge(mass: float) -> pinred.Trajectory:
    """Simulate a light link on a damped hinge for two seconds."""
    return pinred.simulate(damped_hinge(mass, 0.1))


def tolerance(traj: pinred.Trajectory) -> float:
    """Return the sum of relative and absolute tolerance."""
    return traj.scene.rtol + traj.scene.atol


# Motions with 1e-4 and 1e-6 have tests of their own.
@pytest.mark.by_hand("0.01")
@pytest.mark.parametrize(
    "mass", [1e-2, *(pytest.param(m, marks=pytest.mark.by_hand) for m in (1e-3, 1e-5)), 1e-7]
)
def test_light_link_on_damper_passes(mass: float) -> None:
    """Rates λ of 3e2 to 3e7 per second; the hinge stops at x₀ + v₀/λ and then drifts slowly."""
    traj = hinge(mass)
    report = pinred.compare(traj, budget=10.0)
    assert report.passed, str(report)
    inertia = mass * (0.02 + 0.1**2 + 0.05**2)  # about the axis y of the hinge
    assert traj.x[-1, 0] == pytest.approx(0.4 + 0.7 * inertia / 0.1, abs=0.5 * inertia)
    assert f"{report.rate_error:.2e}" in str(report)
    assert report.rate_error > report.defect_bound


def test_errors_that_decay_are_those_of_first_step() -> None:
    """The rate is zero from the first step end on; its error e there moves the hinge by e/λ."""
    traj = hinge(1e-6)
    full = FullState(traj.scene)
    tol = tolerance(traj)
    _, decaying = solve_stiff_steps(traj, full, compute_defects(traj, full), tol)
    error, decay = abs(traj(traj.motion.knots[1:2]).xdot[0, 0]), 0.1 / (0.0325 * 1e-6)
    assert decaying.rates == pytest.approx(error / 0.7, rel=0.02)
    assert decaying.rates > 1e-3
    assert decaying.coordinates == pytest.approx(error / decay, rel=0.05)
    assert pinred.compare(traj).rate_error == pytest.approx(decaying.rates)


@pytest.mark.by_hand("False")
@pytest.mark.parametrize("reported", [True, False])
def test_wrong_rate_at_report_time_cannot_tell(reported: bool) -> None:
    """The rate at the first step end is wrong by 2e-3, which counts only if it is reported."""
    first = hinge(1e-6).motion.knots[1]
    times = [0.0, first if reported else 0.1, 2.0]
    traj = pinred.simulate(damped_hinge(1e-6, 0.1), times=times)
    report = pinred.compare(traj)
    assert report.passed != reported, str(report)
    if reported:
        assert report.verdict == "CANNOT TELL"
        wrong = float(
            re.findall(r"differ from the reference by up to (\S+) at", report.reasons[0])[0]
        )
        assert wrong == pytest.approx(np.abs(traj.xdot[1, 0]) / 0.7, rel=0.05)


def test_errors_that_decay_have_bounds() -> None:
    """Coordinates: 50 tolerances; rates: 3 tolerances, or the bound at report times."""
    rates, bounds = np.array([0.0, 2e-6, 3e-6]), np.array([1e-6, 1e-6, 2.5e-6])

    def reasons(coordinates: float, rate: float, size: float = 1.0) -> tuple[str, ...]:
        errors = DecayingErrors(5, coordinates, rate)
        return explain_decaying_errors(errors, size * rates, bounds, 1e-8)

    assert reasons(4.9e-7, 2.9e-8) == ()
    assert reasons(4.9e-7, 1.0, 0.49) == ()
    (found,) = reasons(5.1e-7, 0.0)
    assert "errors up to 5.1e-07 at the ends of stiff steps decay" in found
    (found,) = reasons(0.0, 3.1e-8)
    assert "by up to 3.0e-06 at report times, without effect" in found
    assert len(reasons(np.nan, 0.0)) == 1


@pytest.mark.parametrize(("column", "size"), [("x", 1e-8), ("xdot", 1e-2)])
def test_error_of_coordinate_counts_before_it_decays(column: str, size: float) -> None:
    """A critically damped spring removes an offset; a rate e first moves it by e/(2.718 λ)."""
    inertia, rate = 0.0325e-3, 1e4
    spring = Spring("a", rate**2 * inertia, 0.4)
    light = damped_hinge(1e-3, 2.0 * rate * inertia)
    scene = replace(light, forces=[spring, Damper("a", 2.0 * rate * inertia)])
    traj = pinred.simulate(scene, method="Radau")
    first, last = traj.motion.knots[-3:-1]

    def change(state: pinred.State) -> pinred.State:
        values = getattr(state, column).copy()
        values[(state.t >= first) & (state.t < last), 0] += size
        return replace(state, **{column: values})

    wrong = tampered(traj, change)
    full = FullState(wrong.scene)
    plain = compute_defects(wrong, full)
    solved, decaying = solve_stiff_steps(wrong, full, plain, tolerance(traj))
    moved = size if column == "x" else size * np.exp(-1.0) / rate
    assert plain.steps[-3] > 0.9 * size
    assert decaying.coordinates == pytest.approx(moved, rel=0.1)
    assert solved.steps[-3] < 1e-3 * size


def test_linear_propagation_is_that_of_oscillator_and_decay() -> None:
    """A rate moves the coordinate by up to e/ω, or e/λ at the end; growth is that of cosh."""
    units, error = np.array([1.0, 50.0]), np.array([0.0, 1.0])
    oscillator, damped = np.array([[0.0, 1.0], [-1e6, 0.0]]), np.array([[0.0, 1.0], [0.0, -1e4]])
    path = _propagate_error(oscillator, error, 0.7, units)
    assert np.abs(path[:, 0]).max() == pytest.approx(50.0 / 1e3, rel=0.3)
    assert path[-1] == pytest.approx([0.05 * np.sin(700.0), np.cos(700.0)], rel=1e-6)
    np.testing.assert_array_equal(path[0], error)
    path = _propagate_error(damped, error, 0.7, units)
    assert path[-1] == pytest.approx([50.0 / 1e4, 0.0], rel=1e-9, abs=1e-12)
    saddle = np.array([[0.0, 1.0], [9.0, 0.0]])
    path = _propagate_error(saddle, error, 0.7, units)
    assert path[-1] == pytest.approx([50.0 * np.sinh(2.1) / 3.0, np.cosh(2.1)], rel=1e-9)
    path = _propagate_error(np.full((2, 2), np.nan), error, 0.7, units)
    np.testing.assert_array_equal(path, error[None])


def test_error_decays_for_hundredth_of_duration_or_until_end() -> None:
    """Decay of 60/s in steps of 13 ms: over 20 ms in the middle, one step for the last but one."""
    steps, rate, size = 150, 60.0, 1e-7
    scene = replace(damped_hinge(1e-3, rate * 0.0325e-3), times=[2.0])
    traj = pinred.simulate(scene, method=pinred.DOP853(max_step=2.0 / steps))
    knots = traj.motion.knots
    assert 150 < len(knots) <= 201
    for back in (75, 2, 1):
        when = knots[-back]

        def change(state: pinred.State, when: float = when) -> pinred.State:
            xdot = state.xdot.copy()
            xdot[state.t >= when, 0] += size
            return replace(state, xdot=xdot)

        wrong = tampered(traj, change)
        full = FullState(wrong.scene)
        solved, _ = solve_stiff_steps(wrong, full, compute_defects(wrong, full), tolerance(traj))
        remains = np.exp(-rate * min(0.02, knots[-1] - when))
        assert solved.steps[-back] == pytest.approx(size / 0.7 * remains, rel=0.02)


def test_solved_steps_excuse_residuals_that_decay() -> None:
    """The plain residual exceeds what passes, and the error that remains is far below it."""
    traj = hinge(1e-4)
    full = FullState(traj.scene)
    plain = compute_defects(traj, full)
    assert plain.worst > 100.0 * 3.0 * tolerance(traj)
    solved, decaying = solve_stiff_steps(traj, full, plain, tolerance(traj))
    assert decaying.steps > 10
    assert solved.worst < 0.1 * tolerance(traj)
    assert (solved.steps <= plain.steps).all()


@pytest.mark.by_hand("xi-0.5")
@pytest.mark.parametrize(("column", "unit"), [("x", 1.0), ("xi", 0.5)])
def test_solved_steps_keep_errors_that_remain(column: str, unit: float) -> None:
    """A jump of a number that does not decay is the error of its step, also in a stiff step."""
    traj, size = hinge(1e-4), 1e-7
    knots = traj.motion.knots
    when = knots[-3]

    def change(state: pinred.State) -> pinred.State:
        values = getattr(state, column).copy()
        values[state.t >= when, 0] += size
        return replace(state, **{column: values})

    wrong = tampered(traj, change)
    full = FullState(wrong.scene)
    plain = compute_defects(wrong, full)
    solved, _ = solve_stiff_steps(wrong, full, plain, tolerance(traj))
    assert solved.steps[-3] == pytest.approx(size / unit, rel=0.05)
    assert pinred.compare(wrong).verdict == "FAILED"


def test_solved_steps_leave_other_scenes_unchanged() -> None:
    """Without stiff steps the residuals are those of before, also where they fail."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=0.5)
    model = traj.system.model.copy()
    model.inertias[1].mass *= 1.0 + 1e-5
    start = traj.scene.start
    other = replace(
        traj.scene, system=pinred.load(model), x0=start.x, xdot0=start.xdot, xi0=start.xi
    )
    full = FullState(other)
    plain = compute_defects(traj, full)
    assert plain.worst > 3.0 * tolerance(traj)
    solved, decaying = solve_stiff_steps(traj, full, plain, tolerance(traj))
    assert decaying == DecayingErrors()
    np.testing.assert_array_equal(solved.steps, plain.steps)
    np.testing.assert_array_equal(solved.motion_steps, plain.motion_steps)


def test_explicit_run_stops_in_stiff_scenes_only() -> None:
    """A scene that needs more than 1e4 evaluations, once stiff and once not."""
    traj = hinge(1e-5)
    full, start = FullState(traj.scene), traj.scene.start
    y0, units = full.state(start.pose, start.x, start.xi, start.xdot), defect_units(traj, full)[1]
    with pytest.raises(StiffError):
        full.run_unless_stiff(y0, 2.0, 1e-10, 1e-12, units)
    long = pinred.simulate(pinred.load("rigid_body"), xi0=[1.0, 2.0, 3.0], duration=400.0)
    full, start = FullState(long.scene), long.scene.start
    y0, units = full.state(start.pose, start.x, start.xi, start.xdot), defect_units(long, full)[1]
    full.run_unless_stiff(y0, 400.0, 1e-10, 1e-12, units)


def test_implicit_reference_agrees_with_explicit_one() -> None:
    """Both integrators give the same motion and growth of a cat, within the estimated errors."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=1.0)
    full, start, times = FullState(traj.scene), traj.scene.start, np.linspace(0.0, 1.0, 21)
    y0, units = full.state(start.pose, start.x, start.xi, start.xdot), defect_units(traj, full)[1]
    explicit, implicit = (
        full.solve(y0, times, 1e-13, 1e-15),
        full.solve_stiff(y0, times, 1e-13, units),
    )
    assert implicit.estimates is not None
    difference = np.abs((explicit.states - implicit.states) / units).max(axis=1)
    growth = full.growth(y0, explicit.motion, times, 1e-10, 1e-12)
    accumulated, largest = implicit.estimates.T
    assert (difference <= growth * accumulated + largest + 1e-12).all()
    assert accumulated[-1] < 1e-10
    other = full.growth(y0, explicit.motion, times, 1e-10, 1e-12, units=units)
    assert other == pytest.approx(growth, rel=1e-3)


def test_wrong_coefficient_of_damper_fails_equations() -> None:
    """The forces of the scene count, not the numbers with which the motion was computed."""
    traj = hinge(1e-4)
    scene = replace(traj.scene, forces=[Damper("a", 0.1 * (1.0 + 1e-6))])
    report = pinred.compare(pinred.Trajectory(scene, traj.motion, traj.run))
    assert report.verdict == "FAILED"
    assert report.equations > 100.0 * report.equations_bound


def test_drifts_against_reference_are_differences_of_energy_and_momentum() -> None:
    """A rate that is wrong by δ changes the energy by v H δ, here with Pinocchio's mass matrix."""
    traj = hinge(1e-4)
    states, full = traj.states, FullState(traj.scene)
    y = full_states(traj, full, states.t)
    assert audit_with_reference(full, states, y).energy < 1e-14
    wrong = y.copy()
    wrong[-1, -2] += 1e-3
    model = traj.system.model
    H = pin.crba(model, model.createData(), traj.q[-1])
    H = np.triu(H) + np.triu(H, 1).T
    expected = traj.v[-1] @ H[:, 0] * 1e-3
    unit = 0.5 * traj.v[0] @ H @ traj.v[0]
    energy = audit_with_reference(full, states, wrong).energy
    assert energy == pytest.approx(expected / unit, rel=0.05)


def test_comparison_out_of_budget_cannot_tell() -> None:
    """Without a reference, residuals of stiff steps are no failure."""
    report = pinred.compare(hinge(1e-5), budget=0.02)
    assert report.verdict == "CANNOT TELL"
    assert any("stiff steps" in reason for reason in report.reasons)
