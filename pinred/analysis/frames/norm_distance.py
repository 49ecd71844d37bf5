"""Distance of the norms of polynomial frames from their limit, by extrapolation in the degree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_ROUND_OFF = 1e-13  # changes below this part of the scale are round-off
# Range of the power with which norms converge. On a box it tends to 8 by the singularities at the
# corners, also if the first changes decrease faster.
_POWERS = (1.0, 8.0)


def norm_distance(degrees: Sequence[int], norms: Sequence[float], scale: float) -> float:
    """Estimate the distance of a norm from its limit, relative to a scale.

    Least norms decrease with the degree d like limit + C d^−q. The power q is that of the last two
    changes. If they do not decrease, it is the least power, so that the estimate is large. The
    distance of a norm is at most the norm itself.

    Args:
        degrees: Three increasing degrees.
        norms: Least norms of these degrees.
        scale: Scale of the result; if it is 0, so are the norms.
    Returns:
        The distance of the last norm, or inf if the degrees do not increase.
    """
    if not degrees[0] < degrees[1] < degrees[2]:
        return np.inf
    first, second = norms[0] - norms[1], norms[1] - norms[2]
    if not scale > 0.0 or max(abs(first), abs(second)) <= _ROUND_OFF * scale:
        return _ROUND_OFF
    second = max(abs(second), _ROUND_OFF * scale)
    a, b, c = np.asarray(degrees, dtype=float) / degrees[2]

    def ratio(q: float) -> float:
        """Return the first change divided by the second, which increases with q."""
        return float((a**-q - b**-q) / (b**-q - c**-q))

    low, high = _POWERS
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if ratio(middle) < first / second else (low, middle)
    return float(min(second / (b**-low - 1.0), norms[2]) / scale)
