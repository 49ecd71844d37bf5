"""Derivatives of phases by coefficients, against differences of SciPy over Pinocchio."""

from __future__ import annotations

import numpy as np
import pytest
from assertions import close
from lifts import by_pinocchio, random_gait
from scipy.integrate import solve_ivp
from strategies import make_case

import pinred
from pinred.analysis.phases.gait import FourierArc
from pinred.analysis.phases.lift import Drift, cycloid_basis, path_lift
from pinred.common.arrays import Array


def with_coefficients(gait: pinred.Gait, coefficients: Array) -> pinred.Gait:
    """Return the gait with other coefficients."""
    (arc,) = gait.arcs
    assert isinstance(arc, FourierArc)
    half = len(arc.cos)
    mean, cos, sin = np.split(coefficients, [1, 1 + half])
    return pinred.Gait.fourier(mean[0], cos, sin, period=gait.period)


def coefficients_of(gait: pinred.Gait) -> Array:
    """Return mean, cosines and sines, (1 + 2 harmonics, m)."""
    (arc,) = gait.arcs
    assert isinstance(arc, FourierArc)
    return np.vstack([arc.mean[None], arc.cos, arc.sin])


@pytest.mark.by_hand
@pytest.mark.parametrize("group", ["SE2", "SO3", "SE3"])
def test_phase_derivative_matches_differences(group: str) -> None:
    """The derivative along a random direction of all coefficients equals differences."""
    case = make_case(group, 3, 11)
    gait = random_gait(case.rng, 3)
    slopes = pinred.phase_slopes(pinred.Connection.mechanical(case.system), gait)
    start = coefficients_of(gait)
    direction = case.rng.normal(size=start.shape)
    zero, G = np.zeros(case.system.r), case.system.group
    close(G.error(by_pinocchio(case.system, gait, zero), slopes.pose).rotation, 0.0, 1e-9)
    h, expected = 1e-4, np.zeros(case.system.r)
    for step in (1, -1):
        displacement = by_pinocchio(
            case.system, with_coefficients(gait, start + step * h * direction), zero
        )
        expected += 0.5 * step / h * G.log(G.compose(G.inverse(slopes.pose), displacement))
    close(np.tensordot(slopes.twist, direction, 2), expected, 1e-6)


def test_effort_derivatives_match_differences() -> None:
    """Length, action and their derivatives match quadrature over Pinocchio's metric."""
    system = pinred.load("three_rods")
    red = pinred.Reduction(system)
    gait = random_gait(np.random.default_rng(3), 2)
    start = coefficients_of(gait)
    direction = np.random.default_rng(4).normal(size=start.shape)

    def effort(coefficients: Array) -> Array:
        x, xdot = with_coefficients(gait, coefficients).samples(200)
        square = np.array([v @ red.reduced_metric(y) @ v for y, v in zip(x, xdot, strict=True)])
        return gait.period * np.array([np.sqrt(square).mean(), square.mean()])

    found = pinred.phase_slopes(pinred.Connection.mechanical(system), gait)
    close([found.length, found.action], effort(start), 1e-9)
    h = 1e-3
    expected = sum(
        weight / (12.0 * h) * effort(start + step * h * direction)
        for step, weight in ((1, 8.0), (-1, -8.0), (2, -1.0), (-2, 1.0))
    )
    slopes = [float(np.sum(each * direction)) for each in (found.length_slope, found.action_slope)]
    close(slopes, expected, 1e-8)


def test_polygon_gait_has_no_coefficients() -> None:
    """A polygon is refused."""
    A = pinred.Connection.mechanical(pinred.load("three_rods"))
    with pytest.raises(pinred.InputError, match="one Fourier series"):
        pinred.phase_slopes(A, pinred.Gait.waypoints([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))


@pytest.mark.by_hand
@pytest.mark.parametrize(
    "name", ["three_rods", pytest.param("falling_cat", marks=pytest.mark.slow)]
)
def test_lift_derivative_with_momentum_matches_differences(name: str) -> None:
    """Two turns from rest to rest match differences of SciPy's lift over Pinocchio."""
    system = pinred.load(name)
    red, group, rng = pinred.Reduction(system), system.group, np.random.default_rng(1)
    c, along = 0.4 * rng.normal(size=(2, 5, system.m))
    J = red.locked_inertia(c[0]) @ (2.0 * rng.normal(size=system.r))
    A = pinred.Connection.mechanical(system)
    lift = path_lift(A, cycloid_basis(2, 40, 2), c, Drift(A.code, J))

    def end(coefficients: Array) -> Array:
        def rate(t: float, y: Array) -> Array:
            g, a = group.normalize(y), 2.0 * np.pi * t
            phi, speed = 2.0 * (a - np.sin(a)), 4.0 * np.pi * (1.0 - np.cos(a))
            rows = np.array([1.0, *(f(k * phi) for f in (np.cos, np.sin) for k in (1, 2))])
            slopes = np.array([0.0, -np.sin(phi), -2.0 * np.sin(2.0 * phi), np.cos(phi),
                               2.0 * np.cos(2.0 * phi)])  # fmt: skip
            split = red.split(rows @ coefficients)
            drift = np.linalg.solve(split.locked_inertia, group.Ad(g).T @ J)
            return group.rate(g, drift - split.local_connection @ (speed * slopes @ coefficients))

        start = group.identity()
        y = solve_ivp(rate, (0.0, 1.0), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        return group.normalize(y)

    error = group.error(end(c), lift.pose)
    assert max(float(error.rotation), float(error.translation)) < 1e-9
    h, back = 1e-5, group.inverse(lift.pose)
    steps = [group.log(group.compose(back, end(c + s * h * along))) for s in (1.0, -1.0)]
    expected = (steps[0] - steps[1]) / (2.0 * h)
    close(np.tensordot(lift.twist, along, 2), expected, 1e-7 * (1.0 + np.abs(expected).max()))
