"""Sines and cosines of large angles without libm, against exact arithmetic."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from decimal import Decimal, localcontext

import llvmlite.binding as llvm
import numpy as np
import pytest

from pinred.common.machine_code import create_machine, load_objects
from pinred.kernels.device.device_code import large_angles_ir

_DIGITS = 400  # number of decimal digits, more than those of the largest angle and its fraction
# The number whose quotient by π/2 is closest to an integer, of all numbers (J.-M. Muller).
_WORST = 6381956970095103.0 * 2.0**797


def test_large_angles_are_accurate_to_one_ulp() -> None:
    """Angles of all sizes and signs, with the largest and the most cancelling one."""
    sine, cosine, keep = _compiled()
    rng = np.random.default_rng(3)
    sizes = 2.0 ** rng.uniform(20, 1024, 300)
    angles = [*(sizes * rng.choice([-1, 1], 300)), 2.0**20, -(2.0**20), np.finfo(float).max, _WORST]
    with localcontext(prec=_DIGITS):
        turn = 2 * _pi()
        for angle in map(float, angles):
            rest = Decimal(angle) % turn
            for value, power in ((sine(angle), 1), (cosine(angle), 0)):
                exact = _series(rest, power)
                assert abs(Decimal(value) - exact) <= Decimal(math.ulp(float(exact))), angle
    assert keep


@pytest.mark.parametrize("angle", [math.inf, -math.inf, math.nan])
def test_sine_of_infinity_is_nan(angle: float) -> None:
    """As in libm; the step control then rejects the step."""
    sine, cosine, _ = _compiled()
    assert math.isnan(sine(angle))
    assert math.isnan(cosine(angle))


def _compiled() -> tuple[Callable[[float], float], Callable[[float], float], object]:
    machine, ir = create_machine(1), large_angles_ir()
    codes = {}
    for name in ("sin", "cos"):
        text = ir.replace("double @sin(", "double @own_sin(").replace("@cos(", "@own_cos(")
        codes[f"own_{name}"] = machine.emit_object(llvm.parse_assembly(text))
    (one,) = load_objects({"own_sin": codes["own_sin"]})
    (other,) = load_objects({"own_cos": codes["own_cos"]})
    kind = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)
    return kind(one.address), kind(other.address), (one, other)


def _pi() -> Decimal:
    """Compute π by the arithmetic–geometric mean (Gauss and Legendre)."""
    a, b, t, p = Decimal(1), 1 / Decimal(2).sqrt(), Decimal("0.25"), 1
    for _ in range(10):
        mean = (a + b) / 2
        b, t, p = (a * b).sqrt(), t - p * (a - mean) ** 2, 2 * p
        a = mean
    return (a + b) ** 2 / (4 * t)


def _series(x: Decimal, power: int) -> Decimal:
    """Sum the Taylor series of the sine (power 1) or the cosine (power 0)."""
    with localcontext(prec=80):
        x = +x
        term = x if power else Decimal(1)
        total, k = Decimal(0), power
        while abs(term) > Decimal(10) ** -70:
            total += term
            term *= -x * x / ((k + 1) * (k + 2))
            k += 2
        return total
