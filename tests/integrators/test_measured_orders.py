"""Orders of integrators in `simulate`, measured on robots against ABA."""

from __future__ import annotations

import numpy as np
import pytest
from orders import ROBOTS, errors_at_the_end, fit_order

import pinred
from pinred import DOP853, RKMK4, Tsit5
from pinred.common.arrays import Array


def fixed(step: float) -> DOP853:
    """DOP853 with fixed steps, because the tolerance is never reached."""
    return DOP853(rtol=1e3, atol=1e3, max_step=step)


def fixed_tsit5(step: float) -> Tsit5:
    """Tsitouras's method with fixed steps, because the tolerance is never reached."""
    return Tsit5(rtol=1e3, atol=1e3, max_step=step)


@pytest.mark.parametrize("robot", ROBOTS)
def test_rkmk4_has_order_4(robot: str) -> None:
    """Order 4 in shape and attitude."""
    counts = [60, 85, 120, 170, 240]
    for errors in errors_at_the_end(robot, RKMK4, counts):
        order = fit_order(errors, [1 / count for count in counts])
        assert order == pytest.approx(RKMK4.order, abs=0.2)


# A planar chain's eighth-order errors reach round-off before they are in the asymptotic range.
@pytest.mark.parametrize("robot", [name for name in ROBOTS if name != "planar_chain5"])
def test_dop853_has_order_8(robot: str) -> None:
    """Order 8 in shape and attitude together, above the plateau of round-off."""
    counts = [8, 9, 10, 11, 12, 13, 15, 18]
    errors = np.hypot(*errors_at_the_end(robot, fixed, counts)).tolist()
    kept = [(e, 1 / n) for e, n in zip(errors, counts, strict=True) if e > 3e-13]
    assert len(kept) >= 5
    order = fit_order([e for e, _ in kept], [h for _, h in kept])
    assert order == pytest.approx(DOP853.order, abs=0.2)


@pytest.mark.parametrize("robot", ROBOTS)
def test_tsit5_has_order_5(robot: str) -> None:
    """Order 5 in shape and attitude together, above the plateau of round-off."""
    counts = [57, 68, 80, 95, 113, 135, 160, 190]
    errors = np.hypot(*errors_at_the_end(robot, fixed_tsit5, counts)).tolist()
    kept = [(e, 1 / n) for e, n in zip(errors, counts, strict=True) if e > 1.5e-13]
    assert len(kept) >= 5
    order = fit_order([e for e, _ in kept], [h for _, h in kept])
    assert order == pytest.approx(Tsit5.order, abs=0.2)


def test_method_tolerance_replaces_scene_tolerance() -> None:
    """A looser DOP853 takes fewer steps than the scene's, and its error fits its tolerance."""
    system = pinred.load("falling_cat")
    loose = pinred.simulate(system, duration=2.0, method=DOP853(rtol=1e-5, atol=1e-7))
    tight = pinred.simulate(system, duration=2.0)
    assert loose.run.steps < tight.run.steps
    errors: Array = np.abs(loose.x - tight.x).max(axis=0)
    assert 1e-9 < errors.max() < 1e-3


def test_invalid_methods_are_rejected() -> None:
    """A number is not a method, and the SciPy engine supports DOP853 only."""
    system = pinred.load("falling_cat")
    with pytest.raises(
        pinred.InputError, match=r"method must be 'auto' or AdaptiveGauss\(…\) or DOP853\("
    ):
        pinred.simulate(system, method=3)  # type: ignore[arg-type]
    with pytest.raises(pinred.InputError, match="pinocchio"):
        pinred.simulate(system, method=RKMK4(0.01), engine="pinocchio")
