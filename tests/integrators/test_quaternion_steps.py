"""Compiled steps of quaternions, run as Python and compared with Pinocchio's quaternions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pinred.common.arrays import Array
from pinred.integrators.explicit import munthe_kaas
from pinred.integrators.implicit import lagrange_poincare
from pinred.integrators.stepping.run_state import first_entries


def python_of(function: Any) -> Callable[..., None]:
    """Return the Python function of a compiled one."""
    return getattr(function, "py_func", function)  # type: ignore[no-any-return]


def unit_quaternion(rng: np.random.Generator) -> Array:
    """Return a random quaternion (x, y, z, w)."""
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


@pytest.mark.parametrize("seed", range(3))
def test_rate_of_quaternion_becomes_the_body_rate(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rate q̇ = q ω / 2 is replaced by ω; other entries are unchanged."""
    rng = np.random.default_rng(seed)
    q, omega = unit_quaternion(rng), rng.normal(size=3)
    rate = 0.5 * (pin.Quaternion(q) * pin.Quaternion(np.append(omega, 0.0))).coeffs()

    def write(_address: int, _y: Array, _params: Array, out: Array) -> None:
        out[:] = [7.0, *rate, 8.0]

    monkeypatch.setattr(munthe_kaas, "call", write)
    monkeypatch.setattr(munthe_kaas, "first_entries", python_of(first_entries))
    work = np.full((2, 6), np.nan)
    y = np.array([0.1, *q, 0.2])
    python_of(munthe_kaas._rate)(0, np.zeros(0), work, y, 1, (1, 1))
    np.testing.assert_allclose(work[1], [7.0, *omega, 0.0, 8.0], rtol=0, atol=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_stage_quaternion_lifts_the_momentum(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lift q̄ J q is (μ − ½ u × μ) / (1 + ¼ |u|²) with μ = Rᵀ J, with the shortest rotation."""
    rng = np.random.default_rng(seed)
    q, u, J = unit_quaternion(rng), rng.normal(size=3), rng.normal(size=3)
    monkeypatch.setattr(lagrange_poincare, "_multiply", python_of(lagrange_poincare._multiply))
    y, out = np.array([0.1, *q]), np.zeros(5)
    python_of(lagrange_poincare._write_stage_quaternion)(y, u, J, out, 1)
    mu = pin.Quaternion(q).matrix().T @ J
    m = (mu - 0.5 * np.cross(u, mu)) / (1.0 + 0.25 * u @ u)
    stage = pin.Quaternion(out[1:])
    lift = stage.conjugate() * pin.Quaternion(np.append(J, 0.0)) * stage
    np.testing.assert_allclose(lift.coeffs(), [*m, 0.0], rtol=0, atol=1e-13)
    # The rotation from m to μ has the axis m × μ and the angle between m and μ.
    between = (pin.Quaternion(q).conjugate() * stage.normalized()).matrix()
    angle = np.arccos(mu @ m / np.linalg.norm(mu) / np.linalg.norm(m))
    np.testing.assert_allclose(np.trace(between), 1.0 + 2.0 * np.cos(angle), rtol=0, atol=1e-13)
