"""Equality of arrays to an absolute tolerance, in few words."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def close(found: ArrayLike, expected: ArrayLike, tolerance: float = 1e-12) -> None:
    """Assert that two arrays agree to a tolerance."""
    np.testing.assert_allclose(np.asarray(found), np.asarray(expected), rtol=0.0, atol=tolerance)
