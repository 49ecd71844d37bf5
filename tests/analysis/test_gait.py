"""Gaits: closed paths in shape space."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from assertions import close

import pinred
from pinred.analysis.phases.gait import PolynomialArc
from pinred.common.arrays import Array

Gait = pinred.Gait
ELLIPSE = Gait.fourier([0.2, -0.1], [[0.8, 0.0]], [[0.0, 0.5]], period=2.0)
WAVES = Gait.fourier([0.2, -0.1], [[0.8, 0.1], [0.1, -0.3]], [[0.2, 0.5], [0.0, 0.2]], period=2.0)
SQUARE = Gait.waypoints([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]], period=2.0)
SPLINE = Gait.spline([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.3], [0.2, -1.0]], period=2.0)
ALL = pytest.mark.parametrize("gait", [ELLIPSE, WAVES, SQUARE, SPLINE])


def test_fourier_gait_equals_its_series() -> None:
    """Shape and rate equal the sums of the series."""
    t = np.array([0.0, 0.3, 1.7])
    x, xdot = ELLIPSE.at(t)
    close(x, np.stack([0.2 + 0.8 * np.cos(np.pi * t), -0.1 + 0.5 * np.sin(np.pi * t)], axis=1))
    close(xdot[:, 0], -0.8 * np.pi * np.sin(np.pi * t))
    assert ELLIPSE.is_smooth
    assert ELLIPSE.m == 2


@ALL
def test_gait_rate_is_derivative(gait: Gait) -> None:
    """Between breaks the rate equals differences, and the gait closes."""
    t, h = np.array([0.11, 0.77, 1.31]), 1e-5
    x = [gait.at(t + k * h)[0] for k in (-2, -1, 1, 2)]
    close(gait.at(t)[1], (x[0] - 8.0 * x[1] + 8.0 * x[2] - x[3]) / (12.0 * h), 1e-9)
    close(gait.at(0.0)[0], gait.at(gait.period)[0])
    close(gait.at(2.5)[0], gait.at(0.5)[0])


@ALL
def test_gait_operations_match_definitions(gait: Gait) -> None:
    """Shift, reversal, amplitude, period and concatenation follow their definitions."""
    t = np.linspace(0.01, 1.97, 23)
    x, xdot = gait.at(t)
    close(gait.shifted(0.3).at(t)[0], gait.at(t + 0.6)[0])
    back = gait.reversed()
    close(back.at(2.0 - t)[0], x)
    close(back.at(2.0 - t)[1], -xdot)
    close(gait.scaled(0.5).at(t)[0], gait.centre + 0.5 * (x - gait.centre))
    close(gait.scaled([2.0, 1.0], about=[0.0, 0.0]).at(t)[0], x * [2.0, 1.0])
    close(gait.lasting(5.0).at(2.5 * t)[0], x)
    close(gait.lasting(5.0).at(2.5 * t)[1], xdot / 2.5)
    both = gait.then(back)
    assert both.period == pytest.approx(4.0)
    close(both.at(t)[0], x)
    close(both.at(4.0 - t)[0], x)


def test_winding_gait_operations_keep_turns() -> None:
    """x(T) = x(0) + 2π n for series and lines, also of shifted, reversed and joined gaits."""
    series = Gait.fourier([0.2, -0.1], [[0.8, 0.0]], [[0.0, 0.5]], period=2.0, turns=[2, -1])
    lines = Gait.waypoints([[0.2, 0.1], [1.0, 3.0]], period=2.0, turns=[2, -1])
    rise = 2.0 * np.pi * np.array([2.0, -1.0])
    for gait in (series, lines):
        for moved, factor in (
            (gait, 1.0), (gait.shifted(0.3), 1.0), (gait.reversed(), -1.0), (gait.then(gait), 2.0),
            (gait.lasting(5.0), 1.0), (gait.scaled(1.0), 1.0), (gait.then(gait.reversed()), 0.0),
        ):  # fmt: skip
            t = np.array([0.1, 0.7])
            change = moved.at(t + moved.period)[0] - moved.at(t)[0]
            close(change, [factor * rise] * 2, 1e-13)
        close(gait.shifted(0.3).at(0.2)[0], gait.at(0.8)[0], 1e-13)
        close(gait.reversed().at(0.2)[0], gait.at(1.8)[0] - rise, 1e-13)
        x = gait.at(np.linspace(0.0, gait.period * (1.0 - 1e-15), 2001))[0]
        close(gait.limits, np.stack([x.min(axis=0), x.max(axis=0)], axis=1), 1e-2)
        with pytest.raises(pinred.InputError, match="expected 1 for joints that turn"):
            gait.scaled(0.5)
        with pytest.raises(pinred.InputError, match="do not turn"):
            gait.winding()
        with pytest.raises(pinred.InputError, match="gait: expected"):
            gait.signals(["a", "b"])
    for turns in ([0.5, 0.0], [1.0], [np.nan, 0.0], "ab"):
        with pytest.raises(pinred.InputError, match="turns"):
            Gait.waypoints([[0.2, 0.1]], turns=turns)


@ALL
def test_gait_limits_bound_all_samples(gait: Gait) -> None:
    """Finer samples approach the limits and never exceed them."""
    dense = gait.at(np.linspace(0.0, 2.0, 20001))[0]
    assert (dense <= gait.limits[:, 1] + 1e-12).all()
    assert (dense >= gait.limits[:, 0] - 1e-12).all()
    close(np.stack([dense.min(axis=0), dense.max(axis=0)], axis=1), gait.limits, 1e-6)
    close(gait.amplitude, 0.5 * np.ptp(gait.limits, axis=1))
    some = gait.shifted(0.37).limits
    close(some, gait.limits)


def test_winding_number_of_circles() -> None:
    """The winding number counts signed turns about a centre."""
    assert ELLIPSE.winding() == 1.0
    assert ELLIPSE.reversed().winding() == -1.0
    assert ELLIPSE.winding(joints=(1, 0)) == -1.0
    assert ELLIPSE.then(ELLIPSE).winding() == 2.0
    assert ELLIPSE.winding(centre=[5.0, 0.0]) == 0.0
    third = Gait.fourier(
        [0.0, 0.0], [[0.0, 0.0]] * 2 + [[1.0, 0.0]], [[0.0, 0.0]] * 2 + [[0.0, 1.0]]
    )
    assert third.winding() == 3.0
    with pytest.raises(pinred.InputError, match="passes through the centre"):
        SQUARE.winding(centre=[1.0, 0.0])


def test_polygon_has_constant_speed() -> None:
    """The norm of ẋ is the length of the polygon divided by the period."""
    rates = np.linalg.norm(SQUARE.at(np.array([0.1, 0.6, 1.2, 1.8]))[1], axis=1)
    close(rates, np.full(4, 4.0))
    assert not SQUARE.is_smooth


def test_spline_passes_through_points_smoothly() -> None:
    """Its rate is continuous at the points and where the gait closes."""
    close(SPLINE.at([0.0, 0.5, 1.0, 1.5])[0], [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.3], [0.2, -1.0]])
    for t in (0.5, 1.0, 1.5, 2.0):
        close(SPLINE.at(t - 1e-9)[1], SPLINE.at(t + 1e-9)[1], 1e-6)
    uneven = Gait.spline([[1.0], [0.0], [-1.0]], times=[0.0, 0.2, 0.9], period=2.0)
    close(uneven.at([0.2, 0.9])[0], [[0.0], [-1.0]])


def test_strokes_move_joints_by_name_and_must_close() -> None:
    """Strokes move one joint after another and must close."""
    moves = [{"a": 1.0}, {"b": 0.5}, {"a": -1.0}, {"b": -0.5}]
    gait = Gait.strokes([0.0, 0.0], moves, ["a", "b"], period=4.0)
    close(gait.at([0.5, 1.5, 2.5, 3.5])[0], [[0.5, 0.0], [1.0, 0.25], [0.5, 0.5], [0.0, 0.25]])
    with pytest.raises(pinred.InputError, match="does not close"):
        Gait.strokes([0.0, 0.0], moves[:3], ["a", "b"])
    with pytest.raises(pinred.InputError, match="no shape joint 'c'"):
        Gait.strokes([0.0, 0.0], [{"c": 1.0}], ["a", "b"])


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_recorded_cycle_becomes_spline(suffix: str, tmp_path: Path) -> None:
    """A recorded cycle of joint data becomes a spline through its points."""
    t = np.linspace(3.0, 5.0, 41)
    x = ELLIPSE.at(t - 3.0)[0]
    path = write_joint_data(tmp_path / f"motion{suffix}", t, x)
    gait = Gait.read(path)
    assert gait.period == pytest.approx(2.0)
    close(gait.at(t[:-1] - 3.0)[0], x[:-1])
    close(gait.at(0.333)[0], ELLIPSE.at(0.333)[0], 1e-5)
    assert Gait.read(path, period=1.0).period == pytest.approx(1.0)
    x[-1] += 1e-3
    with pytest.raises(pinred.InputError, match="not a closed path"):
        Gait.read(write_joint_data(path, t, x))


def write_joint_data(path: Path, t: Array, x: Array) -> Path:
    """Write joint data to a file."""
    if path.suffix == ".npz":
        np.savez(path, t=t, x=x)
    else:
        rows = "\n".join(
            ",".join(repr(float(v)) for v in [a, *b]) for a, b in zip(t, x, strict=True)
        )
        path.write_text("t,a,b\n" + rows, "utf-8")
    return path


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Gait.fourier([0.0], [[1.0]], [[1.0, 2.0]]), "sin must have shape"),
        (lambda: Gait.fourier([0.0], np.zeros((0, 1)), np.zeros((0, 1))), "must both be"),
        (lambda: Gait.fourier([0.0], [[np.nan]], [[0.0]]), "finite"),
        (lambda: Gait.fourier([0.0], [[1.0]], [[0.0]], period=0.0), "above zero"),
        (lambda: Gait.waypoints([[0.0, 0.0], [0.0, 0.0]]), "two different points"),
        (lambda: Gait.waypoints([[0.0, 0.0]]), "at least 2"),
        (lambda: Gait.spline([[0.0], [1.0], [2.0]], times=[0.0, 2.0, 1.0]), "increasing"),
        (lambda: ELLIPSE.then(SQUARE), "jumps after arc 0|does not close"),
        (lambda: Gait.read("gait.txt"), ".csv or .npz"),
        (lambda: Gait.read("nowhere.csv"), "cannot read"),
        (lambda: ELLIPSE.scaled([1.0, 2.0, 3.0]), "factor"),
    ],
)
def test_invalid_gaits_are_refused(make: object, message: str) -> None:
    """Invalid gaits are refused with the reason."""
    with pytest.raises(pinred.PinredError, match=message):
        make()  # type: ignore[operator]


def test_limits_include_flat_tops() -> None:
    """The second derivative of cos φ − ¼ cos 2φ is zero at its maximum, 3/4, a triple root."""
    k = np.arange(1, 3)
    for shift in np.linspace(0.0, 6.0, 25):
        waves = np.array([1.0, -0.25]) * np.exp(1j * k * shift)
        gait = Gait.fourier([0.0], waves.real[:, None], waves.imag[:, None])
        assert gait.limits[0, 1] == pytest.approx(0.75, abs=1e-15)
    quartic = PolynomialArc(1.0, np.array([[-1.0 / 81], [4.0 / 27], [-2.0 / 3], [4.0 / 3], [-1.0]]))
    shapes = quartic.at(quartic.extremes())[0]  # −(s − 1/3)⁴
    assert shapes.max() == pytest.approx(0.0, abs=1e-17)
