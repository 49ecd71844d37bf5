"""Derivatives of phases by coefficients, against differences of phases by SciPy and Pinocchio."""

from __future__ import annotations

import numpy as np
import pytest
from lifts import by_pinocchio, random_gait
from nearness import close
from strategies import make_case

import pinred
from pinred.analysis.gaits.arcs import FourierArc
from pinred.common.arrays import Array


def rebuilt(gait: pinred.Gait, coefficients: Array) -> pinred.Gait:
    """The gait with other coefficients."""
    (arc,) = gait.arcs
    assert isinstance(arc, FourierArc)
    half = len(arc.cos)
    mean, cos, sin = np.split(coefficients, [1, 1 + half])
    return pinred.Gait.fourier(mean[0], cos, sin, period=gait.period)


def coefficients_of(gait: pinred.Gait) -> Array:
    """Mean, cosines and sines, (1 + 2 harmonics, m)."""
    (arc,) = gait.arcs
    assert isinstance(arc, FourierArc)
    return np.vstack([arc.mean[None], arc.cos, arc.sin])


@pytest.mark.by_hand
@pytest.mark.parametrize("group", ["SE2", "SO3", "SE3"])
def test_slopes_of_the_phase(group: str) -> None:
    """Along a random direction of all coefficients, by differences."""
    case = make_case(group, 3, 11)
    gait = random_gait(case.rng, 3)
    found = pinred.phase_slopes(pinred.Connection.mechanical(case.system), gait)
    start = coefficients_of(gait)
    along = case.rng.normal(size=start.shape)
    zero, G = np.zeros(case.system.r), case.system.group
    close(G.error(by_pinocchio(case.system, gait, zero), found.pose).rotation, 0.0, 1e-9)
    h, expected = 1e-4, np.zeros(case.system.r)
    for step in (1, -1):
        moved = by_pinocchio(case.system, rebuilt(gait, start + step * h * along), zero)
        expected += 0.5 * step / h * G.log(G.compose(G.inverse(found.pose), moved))
    close(np.tensordot(found.twist, along, 2), expected, 1e-6)


def test_slopes_of_the_effort() -> None:
    """Length and action and their slopes, by differences of quadrature over Pinocchio's metric."""
    system = pinred.load("three_rods")
    red = pinred.Reduction(system)
    gait = random_gait(np.random.default_rng(3), 2)
    start = coefficients_of(gait)
    along = np.random.default_rng(4).normal(size=start.shape)

    def effort(coefficients: Array) -> Array:
        x, xdot = rebuilt(gait, coefficients).samples(200)
        square = np.array([v @ red.reduced_metric(y) @ v for y, v in zip(x, xdot, strict=True)])
        return gait.period * np.array([np.sqrt(square).mean(), square.mean()])

    found = pinred.phase_slopes(pinred.Connection.mechanical(system), gait)
    close([found.length, found.action], effort(start), 1e-9)
    h = 1e-3
    expected = sum(
        weight / (12.0 * h) * effort(start + step * h * along)
        for step, weight in ((1, 8.0), (-1, -8.0), (2, -1.0), (-2, 1.0))
    )
    slopes = [float(np.sum(each * along)) for each in (found.length_slope, found.action_slope)]
    close(slopes, expected, 1e-8)


def test_only_fourier_gaits_have_coefficients() -> None:
    """A polygon has none."""
    A = pinred.Connection.mechanical(pinred.load("three_rods"))
    with pytest.raises(pinred.InputError, match="one Fourier series"):
        pinred.phase_slopes(A, pinred.Gait.waypoints([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
