"""Reports made by hand: what their numbers, their words and their line say, whatever was judged."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from pinred.common.arrays import Array
from pinred.judge.report import Report, _closest

BOUND = 1e-3


def report(errors: Array, **more: object) -> Report:
    """One whose errors of shape (T, M) were these, and a bound of a thousandth for everything."""
    times = np.arange(float(len(errors)))
    bounds = np.full(len(errors), BOUND)
    made = Report(
        robot="arm", engine="compiled", group="SE3", joints=errors.shape[1], duration=2.0,
        rtol=1e-6, atol=1e-8, t=times, shape_errors=errors, rotation_errors=0.1 * bounds,
        position_errors=0.2 * bounds, shape_bounds=np.full(errors.shape, BOUND),
        rotation_bounds=bounds.copy(), position_bounds=bounds.copy(), equations=0.0, defect=0.0,
        energy_drift=0.0, momentum_drift=0.0, field_error=0.0, reference_error=0.0,
        equations_bound=BOUND, defect_bound=BOUND, drift_bound=BOUND, field_bound=BOUND,
        reference_bound=BOUND, growth=np.linspace(1.0, 345.0, len(errors)), told=len(errors),
        reasons=(), wall_reduced=0.125, wall_full=7.25,
    )  # fmt: skip
    return replace(made, **more)  # type: ignore[arg-type]


ERRORS = np.array([[0.0, 1e-5], [3e-4, 2e-5], [1e-4, 4e-5]])


def test_the_largest_errors() -> None:
    """Over all times and joints; of a robot without joints, none."""
    rotation, position = np.array([1e-6, 5e-6, 2e-6]), np.array([0.0, 1e-7, 8e-7])
    made = report(ERRORS, rotation_errors=rotation, position_errors=position)
    assert (made.shape_error, made.rotation_error, made.position_error) == (3e-4, 5e-6, 8e-7)
    bare = report(np.empty((3, 0)))
    assert bare.shape_error == 0.0
    assert bare.passed
    assert bare.checks["shape error [rad | m]"] == (0.0, 0.0)


def test_numbers_stay() -> None:
    """Arrays are read-only, each of them."""
    made = report(ERRORS.copy())
    arrays = [getattr(made, each.name) for each in fields(made) if each.type == "Array"]
    assert len(arrays) == 8
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_the_text_tells_all() -> None:
    """Growth at the end, wall times, reasons and what was left out stand there with the checks."""
    more = {"reasons": ("chaos from t = 1 s",), "left_out": "left out: a spring"}
    text = str(report(ERRORS, **more))
    lines = [" ".join(line.split()) for line in text.splitlines()]
    assert "growth of perturbations 3.45e+02" in lines
    assert "wall time [s] 0.12500 reduced (compiled), 7.250 full (ABA called from Python)" in lines
    assert lines[2] == "left out: a spring"
    assert lines[-2:] == ["chaos from t = 1 s", "verdict: CANNOT TELL"]
    assert "left out" not in str(report(ERRORS))


def test_what_is_no_number_is_the_worst() -> None:
    """The line names it, whichever check it is, and however close others are to their bounds."""
    for name, words in (("equations", "equations of motion"), ("field_error", "fields against")):
        made = report(ERRORS, energy_drift=0.9 * BOUND, **{name: np.nan})
        assert not made.passed
        assert f"closest to its bound: {words}" in repr(made)
        assert "nan of 1.0e-03" in repr(made)


@pytest.mark.parametrize("part", [0.05, 3.0])
def test_no_error_where_nothing_passes_hides_none(part: float) -> None:
    """At a bound of zero; what counts is the error beside it, which is some part of its own."""
    errors, bounds = np.array([0.0, part * BOUND]), np.array([0.0, BOUND])
    assert _closest(errors, bounds) == (part * BOUND, BOUND)
