"""Newton's method in Gauss's methods, against closed forms and fixed-point iteration."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from stiff_kernels import kernels

import pinred
from pinred import Gauss
from pinred.common.arrays import Array
from pinred.common.errors import InputError, NoConvergence, NonFiniteState
from pinred.integrators import integrate as drive
from pinred.integrators.implicit.gauss_newton import pairs
from pinred.integrators.implicit.gauss_stages import tables
from pinred.integrators.integrate import Solution, integrate
from pinred.integrators.integrate_many import STATUS, integrate_many
from pinred.integrators.stepping import run_state
from pinred.integrators.stepping.run_state import MOST_STAGES

ORDERS = range(2, 17, 2)


def _wide(lanes: int) -> tuple[int, Any]:
    """Compile two coupled oscillators of squared frequencies 1 and p at several states."""

    def rate(y: Any, p: Any, d: Any) -> None:
        for j in range(lanes):
            a, b, u, v = y[j], y[lanes + j], y[2 * lanes + j], y[3 * lanes + j]
            d[j], d[lanes + j] = b, -a + u
            d[2 * lanes + j], d[3 * lanes + j] = v, -p[0] * u + a

    def slope(y: Any, p: Any, v: Any, d: Any) -> None:  # noqa: ARG001
        for j in range(8):
            d[j], d[8 + j] = v[8 + j], v[16 + j] - v[j]
            d[16 + j], d[24 + j] = v[24 + j], v[j] - p[0] * v[16 + j]

    return kernels(rate, slope)


OSCILLATORS = {4: _wide(4), 8: _wide(8)}
Y0 = [1.0, 0.0, 0.3, 0.0]
TIMES = np.array([0.0, 0.0, 0.3, 0.301, 1.0, 2.5, 2.5, 4.0])


def run(method: Gauss, square: float, times: Any, **more: Any) -> Solution:
    """Integrate the oscillators for 4 s."""
    address, tangent = OSCILLATORS[method.lanes]
    return integrate(method, address, [square], Y0, 4.0, times, tangent=tangent, **more)


def pade(A: Array, stages: int) -> Array:
    """The diagonal Padé approximation of exp A, which Gauss's methods are for linear systems."""
    s = stages
    terms = [
        factorial(2 * s - k) * factorial(s) / (factorial(2 * s) * factorial(k) * factorial(s - k))
        for k in range(s + 1)
    ]
    powers = [np.linalg.matrix_power(A, k) for k in range(s + 1)]
    top = sum(c * P for c, P in zip(terms, powers, strict=True))
    low = sum((-1) ** k * c * P for k, (c, P) in enumerate(zip(terms, powers, strict=True)))
    return np.asarray(np.linalg.solve(low, top))


@pytest.mark.parametrize("stages", range(1, 9))
def test_eigenvectors_reproduce_matrix(stages: int) -> None:
    """Eigenvalues and eigenvectors of diag(b) μ; their sum is the matrix."""
    method, table = tables(stages), pairs(stages)
    G = method.b[:stages, None] * method.mu[:stages, :stages]
    total = np.zeros((stages, stages))
    for entry in table:
        v, vi, w, wi = (entry[2 + k * MOST_STAGES :][:stages] for k in range(4))
        value, right_vector, left_vector = entry[0] + 1j * entry[1], v + 1j * vi, w + 1j * wi
        np.testing.assert_allclose(G @ right_vector, value * right_vector, atol=1e-13)
        total += 2.0 * np.real(value * np.outer(right_vector, left_vector))
    np.testing.assert_allclose(total, G, atol=1e-12)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("solver", ["auto", "Newton"])
def test_stiff_oscillator_equals_pade_approximation(order: int, solver: str) -> None:
    """Steps of 40 rad, where fixed-point iteration diverges."""
    square, count = 1e6, 100
    method = Gauss(0.04, order, solver)
    A = np.array([[0, 1, 0, 0], [-1, 0, 1, 0], [0, 0, 0, 1], [1, 0, -square, 0.0]])
    solution = run(method, square, [4.0])
    assert solution.steps == count
    exact = np.linalg.matrix_power(pade(0.04 * A, order // 2), count) @ Y0
    scale = np.array([1.0, 1.0, 1e-3, 1.0])  # of the slow motion, and round-off of the fast one
    np.testing.assert_allclose(solution.y[0] * scale, exact * scale, atol=3e-10)
    with pytest.raises(NoConvergence, match="use shorter steps"):
        run(Gauss(0.04, order, "fixed point"), square, [4.0])


@pytest.mark.parametrize("order", [2, 4, 6, 10, 16])
def test_solvers_agree_to_round_off(order: int) -> None:
    """On a robot, both solvers converge to round-off."""
    system = pinred.load("falling_cat")
    ends = [
        pinred.simulate(system, seed=3, times=[0.0, 2.0], method=Gauss(0.02, order, solver))
        for solver in ("fixed point", "Newton", "auto")
    ]
    for other in ends[1:]:
        np.testing.assert_allclose(other.q, ends[0].q, atol=3e-14)
    assert np.array_equal(ends[2].q, ends[0].q)  # where it converges well


@pytest.mark.slow
def test_hard_springs_conserve_energy_and_momentum() -> None:
    """Over 20000 steps far longer than the springs' period, and reversibly."""
    system = pinred.load("coupled_spatial")
    hard = 1e7
    scene: dict[str, Any] = {
        "springs": dict.fromkeys(system.shape_names, (hard, 0.0)),
        "xi0": [0.0, 0.0, 0.0, 0.3, 1.0, -0.2],
        "x0": np.zeros(system.m),
        "duration": 400.0,
        "times": np.linspace(0.0, 400.0, 401),
    }
    traj = pinred.simulate(system, method=Gauss(0.02, 4), **scene)
    with pytest.raises(NoConvergence):
        pinred.simulate(system, method=Gauss(0.02, 4, "fixed point"), **scene)
    data, J, E = system.model.createData(), [], []
    for q, v, x in zip(traj.q, traj.v, traj.x, strict=True):
        pin.ccrba(system.model, data, q, v)
        J.append(data.hg.angular.copy())
        E.append(pin.computeKineticEnergy(system.model, data, q, v) + 0.5 * hard * x @ x)
    drift = np.abs(np.array(J) - J[0]).max(axis=1)
    assert drift.max() < 1e-11 * np.linalg.norm(J[0])
    energy = np.array(E) / E[0] - 1.0
    assert abs(energy).max() < 1e-6
    first, last = energy[:200].mean(), energy[200:].mean()
    assert abs(last - first) < 0.1 * abs(energy).max() + 1e-11


@pytest.mark.parametrize("method", [Gauss(0.04), Gauss(0.04, 16), Gauss(0.04, 2, "Newton")])
def test_pauses_reports_and_storage_do_not_change_results(method: Gauss) -> None:
    """Dense output after the run equals that during the run."""
    uninterrupted = run(method, 1e6, TIMES)
    times = np.sort(np.concatenate([TIMES, np.linspace(0.0, 4.0, 201), uninterrupted.knots]))
    once = run(method, 1e6, times)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_state, "EVALUATIONS_BETWEEN_PAUSES", 1)
        patch.setattr(drive, "_FIRST_KNOTS", 1)
        paused = run(method, 1e6, TIMES)
    for other in (once, paused):
        assert np.array_equal(uninterrupted.states, other.states)
    assert np.array_equal(uninterrupted.y, paused.y)
    assert np.array_equal(uninterrupted.at(times), once.y)
    assert np.array_equal(once.at(TIMES), uninterrupted.y)
    address, tangent = OSCILLATORS[method.lanes]
    many = integrate_many(
        method, address, [[1e6], [np.nan], [1e6]], [Y0] * 3, 4.0, TIMES, threads=2, tangent=tangent
    )
    assert [STATUS[s] for s in many.status.tolist()] == ["done", "not finite", "done"]
    assert np.array_equal(many.y[0], uninterrupted.y)
    assert np.array_equal(many.y[2], uninterrupted.y)


@pytest.mark.parametrize("order", [4, 16])
def test_members_request_derivative_independently(order: int) -> None:
    """Only members that need the derivative use it, and all equal single runs."""
    address, tangent = OSCILLATORS[Gauss(0.04, order).lanes]
    squares = np.array([1.0, 1e6, 4.0, 1e5, 1.0, 9.0] * 4)
    asked: list[int] = []

    def counted() -> int:
        asked.append(tangent())
        return asked[-1]

    method = Gauss(0.04, order)
    many = integrate_many(
        method, address, squares[:, None], [Y0] * 24, 4.0, TIMES, threads=1, tangent=counted
    )
    assert many.ok.all()
    assert len(asked) == 8
    for k in range(6):
        alone = integrate(method, address, squares[k : k + 1], Y0, 4.0, TIMES, tangent=tangent)
        for member in range(k, 24, 6):
            assert np.array_equal(many.y[member], alone.y)
            assert many.evaluations[member] == alone.evaluations


def test_unsolved_steps_raise() -> None:
    """Without a derivative only the fixed point remains; non-finite entries are named."""
    address, tangent = OSCILLATORS[4]
    with pytest.raises(NoConvergence):
        integrate(Gauss(0.04), address, [1e6], Y0, 4.0, [])
    with pytest.raises(InputError, match="needs the derivative"):
        integrate(Gauss(0.04, 6, "Newton"), address, [1.0], Y0, 4.0, [])
    with pytest.raises(NonFiniteState) as start:
        integrate(Gauss(0.04, 6, "Newton"), address, [np.nan], Y0, 4.0, [], tangent=tangent)
    assert (start.value.entry, start.value.time) == (3, 0.0)
    with pytest.raises(InputError, match="solver must be one of auto, fixed point, Newton"):
        Gauss(0.1, 6, "newton")
