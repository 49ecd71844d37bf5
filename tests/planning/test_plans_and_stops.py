"""Plans respect the limits of the robot's file, so they do not reach its stops."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import pinred


def test_plans_within_limits_of_the_file_hit_no_stop() -> None:
    """A reorientation and a best gait, whose limits are those of the file by default."""
    cat = pinred.load("falling_cat")
    turn = pinred.reorient(cat, [0.3, 0.0, 0.0]).trajectory
    gait = pinred.optimise_gait(
        cat, objective="rotation", axis="x", harmonics=2, starts=1
    ).trajectory
    reached = np.abs(gait.x).max()
    assert 1.59 < reached <= 1.6  # the gait uses the limits
    for traj in (turn, gait):
        stopped = pinred.simulate(replace(traj.scene, stops="file"))
        assert len(stopped.impacts) == 0
        np.testing.assert_array_equal(stopped.x, traj.x)


def test_plan_beyond_the_limits_of_the_file_runs_into_a_stop() -> None:
    """The error names the joint."""
    cat = pinred.load("falling_cat")
    plan: dict[str, Any] = {"bend": "1.7*sin(t)", "sway": 0.0, "twist": 0.0}
    with pytest.raises(pinred.InputError, match="'bend' runs into its upper stop"):
        pinred.simulate(cat, prescribed=plan, momentum=0, duration=3.0, stops="file")
