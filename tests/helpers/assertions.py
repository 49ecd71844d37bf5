"""Assertions that tests of several packages use."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def close(actual: ArrayLike, expected: ArrayLike, tolerance: float = 1e-12) -> None:
    """Assert that two arrays agree to an absolute tolerance."""
    np.testing.assert_allclose(np.asarray(actual), np.asarray(expected), rtol=0.0, atol=tolerance)
