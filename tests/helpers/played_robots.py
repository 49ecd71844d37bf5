"""Robots whose motions the browser tests of players and films draw."""

from __future__ import annotations

from typing import Any

import pytest

# Options of `simulate` by robot; the first one is small.
ROBOTS: dict[str, dict[str, Any]] = {
    "falling_cat": {"duration": 4.0},
    "satellite_two_arms": {"duration": 4.0},
    "solo12": {"seed": 0, "duration": 2.0},
    "talos": {"seed": 0, "duration": 1.0},
}
BY_HAND = pytest.mark.by_hand  # it takes long
OTHERS = [pytest.param(name, marks=BY_HAND) for name in ROBOTS if name != "falling_cat"]
