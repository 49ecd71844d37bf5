"""Reports with artificial numbers: properties, texts, and the worst check."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from pinred.common.arrays import Array
from pinred.judge.verdict import Report, _closest

BOUND = 1e-3


def report(errors: Array, **more: object) -> Report:
    """Build a report with given shape errors (T, M) and bounds of 1e-3."""
    times = np.arange(float(len(errors)))
    bounds = np.full(len(errors), BOUND)
    sample = Report(
        robot="arm", engine="compiled", group="SE3", joints=errors.shape[1], duration=2.0,
        rtol=1e-6, atol=1e-8, t=times, shape_errors=errors, rotation_errors=0.1 * bounds,
        position_errors=0.2 * bounds, shape_bounds=np.full(errors.shape, BOUND),
        rotation_bounds=bounds.copy(), position_bounds=bounds.copy(), equations=0.0, defect=0.0,
        energy_drift=0.0, momentum_drift=0.0, field_error=0.0, reference_error=0.0,
        equations_bound=BOUND, defect_bound=BOUND, drift_bound=BOUND, field_bound=BOUND,
        reference_bound=BOUND, growth=np.linspace(1.0, 345.0, len(errors)), told=len(errors),
        reasons=(), wall_reduced=0.125, wall_full=7.25,
    )  # fmt: skip
    return replace(sample, **more)  # type: ignore[arg-type]


ERRORS = np.array([[0.0, 1e-5], [3e-4, 2e-5], [1e-4, 4e-5]])


def test_largest_errors_over_times_and_joints() -> None:
    """A robot without joints has none."""
    rotation, position = np.array([1e-6, 5e-6, 2e-6]), np.array([0.0, 1e-7, 8e-7])
    sample = report(ERRORS, rotation_errors=rotation, position_errors=position)
    assert (sample.shape_error, sample.rotation_error, sample.position_error) == (
        3e-4,
        5e-6,
        8e-7,
    )
    bare = report(np.empty((3, 0)))
    assert bare.shape_error == 0.0
    assert bare.passed
    assert bare.checks["shape error [rad | m]"] == (0.0, 0.0)


def test_report_arrays_are_read_only() -> None:
    """All arrays are read-only."""
    sample = report(ERRORS.copy())
    arrays = [getattr(sample, item.name) for item in fields(sample) if item.type == "Array"]
    assert len(arrays) == 8
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_report_text_contains_all_parts() -> None:
    """Growth, wall times, reasons and left-out forces are in the text."""
    more = {"reasons": ("chaos from t = 1 s",), "left_out": "left out: a spring"}
    text = str(report(ERRORS, **more))
    lines = [" ".join(line.split()) for line in text.splitlines()]
    assert "growth of perturbations 3.45e+02" in lines
    assert "wall time [s] 0.12500 reduced (compiled), 7.250 full (ABA called from Python)" in lines
    assert lines[2] == "left out: a spring"
    assert lines[-2:] == ["chaos from t = 1 s", "verdict: CANNOT TELL"]
    assert "left out" not in str(report(ERRORS))


def test_nan_is_the_worst_check() -> None:
    """The one-line summary names it, however close others are to their bounds."""
    for name, words in (("equations", "equations of motion"), ("field_error", "fields against")):
        sample = report(ERRORS, energy_drift=0.9 * BOUND, **{name: np.nan})
        assert not sample.passed
        assert f"closest to its bound: {words}" in repr(sample)
        assert "nan of 1.0e-03" in repr(sample)


@pytest.mark.parametrize("part", [0.05, 3.0])
def test_zero_error_with_zero_bound_does_not_hide_others(part: float) -> None:
    """The error next to it determines the ratio."""
    errors, bounds = np.array([0.0, part * BOUND]), np.array([0.0, BOUND])
    assert _closest(errors, bounds) == (part * BOUND, BOUND)
