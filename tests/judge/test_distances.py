"""Distances of motions in units of their size."""

from __future__ import annotations

import numpy as np
import pytest

from pinred.judge.distances import Distance, Size

SIZE = Size(joints=np.array([2.0, 5.0]), position=4.0, away=1e3)


@pytest.mark.parametrize(
    ("joints", "rotation", "position"),
    [
        ((6.0, 5.0), 1.0, 4.0),
        ((2.0, 15.0), 1.0, 4.0),
        ((2.0, 5.0), 3.0, 4.0),
        ((2.0, 5.0), 1.0, 12.0),
    ],
)
def test_relative_distance_is_largest_of_all_kinds(
    joints: tuple[float, float], rotation: float, position: float
) -> None:
    """Joints, rotation and position have separate units; NaN stays NaN."""
    result = Distance(
        joints=np.array([[0.0, 0.0], joints]),
        rotation=np.array([0.0, rotation]),
        position=np.array([0.0, position]),
    )
    assert result.relative(SIZE).tolist() == [0.0, 3.0]
    assert result.worst(SIZE) == 3.0
    assert result.shape.tolist() == [0.0, max(joints)]
    assert np.isnan(Distance(result.joints, result.rotation * np.nan, result.position).worst(SIZE))
