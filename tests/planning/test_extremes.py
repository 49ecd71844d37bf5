"""Tests of peak torques and speeds between samples, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from assertions import close

import pinred
from pinred.common.arrays import Array
from pinred.planning.optimisation import limits as loop_limits
from pinred.planning.optimisation.limits import LimitedLoop, limits_of
from pinred.planning.reorientation.turning_loop import peaks_of

T = 1.7  # s
WHEEL = 1


def wheels(shift: float = 0.37) -> tuple[pinred.Connection, pinred.Gait, Array]:
    """Return the connection, a gait of one wheel about its symmetry axis, and the constant M."""
    system = pinred.load("reaction_wheel_satellite")
    M = pinred.Reduction(system).reduced_metric(np.zeros(system.m))
    cos, sin = np.zeros((2, 1, system.m))
    delta = 2.0 * np.pi * shift / 1024.0  # between two samples
    cos[0, WHEEL], sin[0, WHEEL] = np.cos(delta), np.sin(delta)
    gait = pinred.Gait.fourier(np.zeros(system.m), cos, sin, period=T)
    return pinred.Connection.mechanical(system), gait, M


def test_peak_torques_between_samples_equal_closed_form() -> None:
    """M is constant: the peak is M (2π/T)², at a third of a sample interval."""
    A, gait, M = wheels()
    at, most = loop_limits.peak_torques(A, gait)
    close(most, np.abs(M[:, WHEEL]) * (2.0 * np.pi / T) ** 2, 1e-12)
    assert at[WHEEL] * 1024.0 % 512.0 == pytest.approx(0.37, abs=1e-4)


def test_peak_torques_without_refinement_are_too_small(monkeypatch: pytest.MonkeyPatch) -> None:
    """The samples alone underestimate the peak."""
    A, gait, M = wheels()
    monkeypatch.setattr(loop_limits, "_ROUNDS", 0)
    most = loop_limits.peak_torques(A, gait)[1][WHEEL]
    assert most < M[WHEEL, WHEEL] * (2.0 * np.pi / T) ** 2 * (1.0 - 1e-7)


def test_torque_limit_near_peak_is_detected() -> None:
    """A limit just below the peak is violated at the peak's time; one just above is not."""
    A, gait, M = wheels()
    peak = M[WHEEL, WHEEL] * (2.0 * np.pi / T) ** 2
    for factor in (1.0 - 1e-9, 1.0 + 1e-9):
        limits = limits_of(A, 9.0, None, {A.joints[WHEEL]: factor * peak})
        margin = loop_limits.margins(A, gait, limits)["torques"]
        assert margin == pytest.approx((factor - 1.0) * peak, rel=1e-3)
        c = gait.series.coefficients()
        beyond = LimitedLoop(A, limits, c, T).peaks_beyond()
        assert (len(beyond.s) > 0) == (factor < 1.0)


def test_peaks_from_rest_to_rest_equal_fine_grid() -> None:
    """Peaks of sin φ, φ = a − sin a, equal those on a grid of a million points."""
    A, _, M = wheels()
    mean, cos, sin = np.zeros(A.m), np.zeros((1, A.m)), np.zeros((1, A.m))
    sin[0, WHEEL] = 1.0
    for cycles in (1, 3):
        peaks = peaks_of(A, pinred.Gait.fourier(mean, cos, sin), cycles)
        a = np.linspace(0.0, 2.0 * np.pi, 1_000_001)
        phi, rate, bend = cycles * (a - np.sin(a)), cycles * (1.0 - np.cos(a)), cycles * np.sin(a)
        w = 2.0 * np.pi
        speed = np.abs(w * rate * np.cos(phi)).max()
        torque = M[WHEEL, WHEEL] * np.abs(w**2 * (bend * np.cos(phi) - rate**2 * np.sin(phi))).max()
        assert peaks.speed[WHEEL] == pytest.approx(speed, rel=1e-9)
        assert peaks.torque[WHEEL] == pytest.approx(torque, rel=1e-9)
        assert peaks.speed[WHEEL] >= speed * (1.0 - 1e-14)


def test_peaks_of_flat_tops_are_exact() -> None:
    """Between two maxima at a flat top the shape hardly bends; samples lead beside the larger."""
    mean, cos, sin = -0.17540632, [0.54156227, 0.03457352], [-0.44351885, -0.17196621]
    A = wheels()[0]
    series = np.zeros((5, A.m))
    series[:, WHEEL] = [mean, *cos, *sin]
    a = 2.0 * np.pi * np.linspace(0.37, 0.41, 2_000_001)
    x = mean + np.cos(np.outer(a, [1, 2])) @ cos + np.sin(np.outer(a, [1, 2])) @ sin
    top = float(np.abs(x).max())
    for factor in (1.0 - 1e-12, 1.0 + 1e-8):
        limits = limits_of(A, {A.joints[WHEEL]: factor * top}, None, None)
        loop = LimitedLoop(A, limits, series, T)
        assert (len(loop.peaks_beyond(1.0).s) > 0) == (factor < 1.0)


def test_peaks_are_relative_to_the_middle_of_the_range() -> None:
    """A joint that stays above zero is limited from below."""
    A = wheels()[0]
    limits = limits_of(A, {A.joints[WHEEL]: [1.0, 3.0]}, None, None)
    c = np.zeros((3, A.m))
    c[0, WHEEL], c[1, WHEEL] = 1.9, 1.0
    (kind,), (joint,), (sign,), (s,) = LimitedLoop(A, limits, c, T).peaks_beyond()
    assert (kind, joint, sign, s) == (0, WHEEL, -1.0, 0.5)


def test_largest_of_many_equal_peaks_is_found() -> None:
    """The largest of nine peaks lies between samples, all of which are below other peaks."""
    s = np.arange(512) / 512.0

    def waves(s: Array) -> Array:
        shift = 0.5 + 2e-4 * np.cos(2.0 * np.pi * (s - 0.5 / 512.0))
        return (np.cos(18.0 * np.pi * (s - 0.5 / 512.0)) * shift)[:, None]

    position, size = loop_limits.find_extremes(waves, s)
    assert np.abs(waves(s)).argmax() not in (0, 1)
    assert float(position[0]) == pytest.approx(0.5 / 512.0, abs=1e-7)
    assert float(size[0]) == pytest.approx(0.5002, rel=1e-12)
