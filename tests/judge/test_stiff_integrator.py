"""The implicit integrator of the judge, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from pinred.common.arrays import Array
from pinred.judge.reference_integrators import NODES, StiffIntegrator, jacobian, spectral_radius


def integrate(rate: object, y0: list[float], end: float, tolerance: float) -> StiffIntegrator:
    """Return an integrator that has not yet started."""
    y = np.array(y0)
    return StiffIntegrator(rate, y, 0.0, tolerance, np.ones(len(y)), end)  # type: ignore[arg-type]


@pytest.mark.parametrize("decay", [1.0, 1e3, 1e6, 1e9])
def test_decay_to_known_motion_is_accurate_in_few_steps(decay: float) -> None:
    """Y' = −λ (y − cos t) − sin t has the solution cos t + e^(−λt), however fast it decays."""

    def rate(t: float, y: Array) -> Array:
        return np.asarray(-decay * (y - np.cos(t)) - np.sin(t))

    times = np.linspace(0.0, 5.0, 41)
    solver = integrate(rate, [2.0], 5.0, 1e-12)
    end, states = solver.integrate(5.0, times)
    exact = np.cos(times) + np.exp(-decay * times)
    assert end == pytest.approx(exact[-1], abs=1e-11)
    assert states[:, 0] == pytest.approx(exact, abs=1e-11)
    assert len(solver.step_ends) < 120


def test_oscillation_has_error_within_estimates() -> None:
    """A harmonic oscillator; looser tolerances give larger errors and longer steps."""

    def rate(_: float, y: Array) -> Array:
        return np.array([3.0 * y[1], -3.0 * y[0]])

    counts = []
    for tolerance in (1e-12, 1e-9, 1e-6):
        solver = integrate(rate, [1.0, 0.0], 10.0, tolerance)
        end, _ = solver.integrate(10.0, np.empty(0))
        assert end is not None
        error = np.abs(end - [np.cos(30.0), -np.sin(30.0)]).max()
        assert error < max(sum(solver.lasting), 1e-13)
        assert max(solver.errors) < 2.0 * tolerance
        counts.append(len(solver.step_ends))
    assert counts[0] > 1.5 * counts[1] > 2.0 * counts[2]


def test_nonlinear_equation_converges() -> None:
    """Y' = −y² has the solution 1/(1 + t); a coupled stiff part does not disturb it."""

    def rate(_: float, y: Array) -> Array:
        return np.array([-(y[0] ** 2), -1e5 * (y[1] - y[0] ** 3)])

    solver = integrate(rate, [1.0, 0.0], 4.0, 1e-12)
    times = np.array([0.5, 1.0, 4.0])
    _, states = solver.integrate(4.0, times)
    assert states[:, 0] == pytest.approx(1.0 / (1.0 + times), abs=1e-11)
    # The slaved part follows y₀³ with the lag −(y₀³)'/λ = 3 y₀⁴/λ.
    assert states[:, 1] == pytest.approx((1.0 + times) ** -3 + 3e-5 * (1.0 + times) ** -4, abs=3e-9)


def test_spans_restart_with_changed_equations() -> None:
    """Integration in two spans gives the states at the times of each."""
    rates = {0: 1.0, 1: -1.0}

    def rate(t: float, _: Array) -> Array:
        return np.array([rates[int(t >= 1.0 and now)]])

    now = 0
    solver = integrate(rate, [0.0], 2.0, 1e-10)
    solver.integrate(1.0, np.empty(0))
    now = 1
    end, states = solver.integrate(2.0, np.array([1.5, 2.0]))
    assert end == pytest.approx(0.0, abs=1e-14)
    assert states[:, 0] == pytest.approx([0.5, 0.0], abs=1e-14)


def test_integration_gives_up() -> None:
    """After the allowed evaluations, or where the solution 1/√(1 − t) ends."""

    def rate(_: float, y: Array) -> Array:
        return np.asarray(0.5 * y**3)

    solver = integrate(rate, [1.0], 2.0, 1e-8)
    assert solver.integrate(2.0, np.empty(0))[0] is None
    assert solver.t == pytest.approx(1.0, abs=1e-6)
    solver = integrate(rate, [1.0], 0.5, 1e-8)
    solver.most_evaluations = 50
    assert solver.integrate(0.5, np.empty(0))[0] is None
    assert solver.t < 0.1


def test_round_off_of_stiff_forces_is_accepted_and_reported() -> None:
    """A critically damped spring at 1e5/s has accelerations with a noise of 1e-6."""

    def rate(t: float, y: Array) -> Array:
        stretched = 1e10 * (y[0] - np.cos(t))
        return np.array([y[1], -stretched - 2e5 * y[1]])

    solver = integrate(rate, [1.0, 0.0], 3.0, 1e-13)
    times = np.linspace(0.0, 3.0, 20)
    _, states = solver.integrate(3.0, times)
    assert states[1:, 0] == pytest.approx(np.cos(times[1:] - 2e-5), abs=1e-9)
    assert max(solver.errors) > 1e-13


def test_jacobian_and_spectral_radius_of_linear_equations() -> None:
    """A stiff diagonal, and a matrix that is not finite."""
    matrix = np.array([[0.0, 1.0], [-4e6, -1e3]])
    J = jacobian(lambda _t, y: matrix @ y, 0.0, np.array([0.3, 7.0]), np.array([1.0, 100.0]))
    assert pytest.approx(matrix, rel=1e-6, abs=1e-6) == J
    assert spectral_radius(J) == pytest.approx(2e3, rel=1e-6)
    assert spectral_radius(np.array([[np.nan]])) == np.inf


def test_nodes_are_radau_points() -> None:
    """Weights of the interpolatory formula integrate t^12 exactly, but not t^13."""
    powers = np.vander(NODES, 7, increasing=True).T
    weights = np.linalg.solve(powers, 1.0 / np.arange(1, 8))
    assert weights @ NODES**12 == pytest.approx(1.0 / 13.0, rel=1e-12)
    assert abs(weights @ NODES**13 - 1.0 / 14.0) > 1e-10
