"""Linearised flows of robots with loops, against independent joints and differences."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from finite_hessian import hessian
from loop_robots import five_bar, four_bar, random_loops

import pinred
from pinred.common.arrays import Array
from pinred.forces import Torque


def linkage() -> pinred.System:
    """Return the four-bar linkage."""
    model, loops = four_bar()
    return pinred.load(model, loops=loops)


def test_frequencies_of_a_sprung_five_bar_are_those_of_the_reduced_metric() -> None:
    """At rest, ω² are the eigenvalues of the potential's Hessian relative to GᵀMG."""
    model, loops = five_bar()
    system = pinred.load(model, loops=loops)
    red = pinred.LoopReduction(system, independent=("left_crank", "right_crank"))
    u = np.array([2.0, 1.0])
    x = red.shape(u)
    values = zip(system.shape_names, (3.0, 2.0, 5.0, 4.0), x.tolist(), strict=True)
    springs = {name: (k, rest) for name, k, rest in values}
    traj = pinred.simulate(system, x0=x, momentum=0, springs=springs, duration=0.5)
    linear = pinred.linearise(traj)
    stiffness = np.array([k for k, _ in springs.values()])

    def potential(u: Array) -> float:
        return float(0.5 * stiffness @ (red.shape(u) - x) ** 2)

    M = red.at(x).reduced_metric
    omega = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, hessian(potential, u))).real)
    expected = np.sort(np.concatenate([omega, -omega]))
    np.testing.assert_allclose(np.sort(linear.eigenvalues.imag), expected, rtol=1e-8)
    np.testing.assert_allclose(linear.eigenvalues.real, 0.0, atol=1e-7)
    exponents = pinred.floquet(traj).multipliers
    np.testing.assert_allclose(
        np.sort(np.angle(exponents)), np.sort(np.angle(np.exp(0.5j * expected))), atol=1e-8
    )


@pytest.mark.by_hand
def test_multipliers_and_exponents_of_a_driven_cycle_equal_differences() -> None:
    """A damped four-bar under a periodic torque, far from the gauge ν = 0 after one period.

    The dampers are strong, so one exponent lies below minus the rate of the gauge.
    """
    system, period = linkage(), 2.0
    push = Torque(
        lambda s: {"crank": 4.0 * ca.sin(np.pi * s.t) - 0.5 * s.xdot["crank"], "rocker": 1.0}
    )
    options = {"forces": [push], "springs": {"crank": (4.0, 1.0)}, "momentum": 0, "rtol": 1e-12}
    at = pinred.simulate(
        system,
        x0={"crank": 1.0},
        duration=40 * period,
        **options,  # type: ignore[arg-type]
    )
    start, rates = at.x[-1], at.xdot[-1]
    cycle = pinred.simulate(system, x0=start, xdot0=rates, duration=period, **options)  # type: ignore[arg-type]
    assert np.ptp(cycle.x[:, 0]) > 0.3
    floquet = pinred.floquet(cycle)

    def end(change: Array) -> Array:
        """Return the crank after a period, from a changed crank angle and rate."""
        traj = pinred.simulate(
            system, x0={"crank": start[0] + change[0]}, xdot0={"crank": rates[0] + change[1]},
            duration=period, **options,  # type: ignore[arg-type]
        )  # fmt: skip
        return np.array([traj.x[-1, 0], traj.xdot[-1, 0]])

    h, columns = 1e-3, []
    for unit in np.eye(2):
        f = [end(k * h * unit) for k in (-2, -1, 1, 2)]
        columns.append((f[0] - 8.0 * f[1] + 8.0 * f[2] - f[3]) / (12.0 * h))
    expected = np.linalg.eigvals(np.stack(columns, axis=1))
    found = floquet.multipliers
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(expected), atol=1e-8)
    growth = np.sort(np.log(np.abs(expected)) / period)
    assert growth[0] < -1.5
    spectrum = pinred.lyapunov(
        pinred.simulate(system, x0=start, xdot0=rates, duration=20 * period, **options)  # type: ignore[arg-type]
    )
    np.testing.assert_allclose(np.sort(spectrum.exponents), growth, atol=0.05)


@pytest.mark.by_hand
def test_linearise_with_balls_and_loops_has_pairs_of_eigenvalues() -> None:
    """At a state at rest without springs all eigenvalues of closed perturbations are zero."""
    model, loops = random_loops(3, ("3d", "3d"), 3, balls=True)
    system = pinred.load(model, loops=loops)
    assert system.closure is not None
    traj = pinred.simulate(system, x0=system.closure.x, momentum=0, duration=0.1)
    linear = pinred.linearise(traj)
    assert len(linear.eigenvalues) == 2 * system.shape_dim
    np.testing.assert_allclose(np.abs(linear.eigenvalues), 0.0, atol=1e-6)
