"""The example of attitude control, as a user runs it, and its numbers by other routes."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

import pinred

pytestmark = pytest.mark.by_hand

EXAMPLE = Path(__file__).parents[2] / "examples/04_attitude_control.py"


@pytest.fixture(scope="module")
def told() -> tuple[str, dict[str, object]]:
    """What the example prints, and the names in it."""
    from contextlib import redirect_stdout
    from io import StringIO

    with redirect_stdout(StringIO()) as out:
        names = runpy.run_path(str(EXAMPLE), run_name="__main__")
    return out.getvalue(), names


def test_both_ways_reach_the_goal(told: tuple[str, dict[str, object]]) -> None:
    """Within a degree, when they say so; compare passes for both."""
    text, names = told
    assert text.count("verdict: PASSED") == 2
    assert "seen by forces: attitude of the base" in text
    assert "constant: momentum" in text
    for name in ("by_wheels", "by_thrusters"):
        traj = names[name]
        assert isinstance(traj, pinred.Trajectory)
        (time,) = traj.events["settled"].t
        angle = 2.0 * np.arccos(np.abs(traj(float(time)).pose[6]))
        assert angle == pytest.approx(np.radians(1.0), rel=1e-6)
        assert 2.0 * np.arccos(np.abs(traj.pose[-1, 6])) < np.radians(1.0)


def test_impulses_are_those_of_the_pulses(told: tuple[str, dict[str, object]]) -> None:
    """Σ width · moment turned to space, and sunlight, is what the momentum has gained."""
    traj = told[1]["by_thrusters"]
    assert isinstance(traj, pinred.Trajectory)
    np.testing.assert_allclose(traj.momentum_balance.residual, 0.0, atol=1e-7)
    # Sunlight pushes with 1e-3 N for 20 s; thrusters give moments, and no force.
    np.testing.assert_allclose(traj.spatial_momentum[-1, :3], [0.0, 0.0, -0.02], atol=1e-9)
    wheels = told[1]["by_wheels"]
    assert isinstance(wheels, pinred.Trajectory)
    np.testing.assert_allclose(wheels.spatial_momentum, 0.0, atol=1e-12)
