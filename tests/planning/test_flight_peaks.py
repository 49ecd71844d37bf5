"""Largest torques between the points of a flight."""

from __future__ import annotations

import numpy as np

from pinred.common.arrays import Array
from pinred.planning.reorientation import flight_search


def test_peaks_between_points_of_segments_are_found() -> None:
    """Waves that turn back at the ends of segments, against a fine grid."""
    size, phase = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 40))

    def torque(t: Array) -> Array:
        folded = 1.0 - np.abs(1.0 - t % 2.0)
        return np.asarray(size * np.cos(3.0 * folded[:, None] + 3.0 * phase))

    points = np.linspace(0.0, 6.0, 6 * flight_search._INSIDE + 1)
    fine = np.abs(torque(np.linspace(0.0, 6.0, 60_001))).max(axis=0)
    np.testing.assert_allclose(flight_search._peaks(torque(points)), fine, rtol=0, atol=3e-6)
    beside = fine - np.abs(torque(points)).max(axis=0)
    assert beside.max() > 1e-3
