"""Comparisons of stiff scenes: solved steps, the implicit reference, and energies against it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from stiff_trees import damped_hinge
from tampering import tampered

import pinred
from pinred.forces import Damper
from pinred.judge.audit import audit_with_reference
from pinred.judge.reference_solution import FullState, StiffError
from pinred.judge.step_defects import compute_defects, defect_units, full_states, solve_stiff_steps


@cache
def hinge(mass: float) -> pinred.Trajectory:
    """Simulate a light link on a damped hinge for two seconds."""
    return pinred.simulate(damped_hinge(mass, 0.1))


def tolerance(traj: pinred.Trajectory) -> float:
    """Return the sum of relative and absolute tolerance."""
    return traj.scene.rtol + traj.scene.atol


@pytest.mark.parametrize("mass", [1e-3, 1e-4, 1e-6])
def test_light_link_on_damper_is_judged_by_its_rates(mass: float) -> None:
    """Rates λ of 3e3 to 3e6 per second; the hinge stops at x₀ + v₀/λ and then drifts slowly.

    The rate v₀ exp(−λt) is inaccurate at step ends while it decays, which cannot pass.
    """
    traj = hinge(mass)
    report = pinred.compare(traj, budget=10.0)
    assert report.verdict == "CANNOT TELL", str(report)
    reason = report.reasons[0]
    assert reason.startswith("errors up to")
    if mass == 1e-6:  # the rate is zero from the first step end on, where the drift is below 1e-8
        error = np.abs(traj(traj.motion.knots[1:]).xdot).max()
        assert float(reason.split()[3]) == pytest.approx(error / 0.7, rel=0.05)
    assert all(value <= bound for value, bound in report.checks.values())
    inertia = mass * (0.02 + 0.1**2 + 0.05**2)  # about the axis y of the hinge
    assert traj.x[-1, 0] == pytest.approx(0.4 + 0.7 * inertia / 0.1, abs=0.5 * inertia)


def test_solved_steps_excuse_residuals_that_decay() -> None:
    """The plain residual exceeds what passes, and the error that remains is far below it."""
    traj = hinge(1e-4)
    full = FullState(traj.scene)
    plain = compute_defects(traj, full)
    assert plain.worst > 100.0 * 3.0 * tolerance(traj)
    solved, count = solve_stiff_steps(traj, full, plain, tolerance(traj))
    assert count > 10
    assert solved.worst < 0.1 * tolerance(traj)
    assert (solved.steps <= plain.steps).all()


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
    solved, count = solve_stiff_steps(traj, full, plain, tolerance(traj))
    assert count == 0
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
