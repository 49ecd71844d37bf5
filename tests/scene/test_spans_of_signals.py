"""The last time of a signal and the end of the scene, up to round-off."""

from __future__ import annotations

import numpy as np
import pytest

import pinred
from pinred.common.errors import InputError
from pinred.forces.signals import Spline

END = 0.6498
TIMES, VALUES = [0.0, 0.2, 0.4, END], [0.0, 0.1, 0.3, 0.5]


def test_signal_covers_scene_that_ends_an_ulp_later() -> None:
    """The scene is simulated to its end; there the shape is that of the signal."""
    signal = Spline(TIMES, VALUES)
    end = float(np.nextafter(END, 1.0))
    cat = pinred.load("falling_cat")
    joint = cat.shape_names[0]
    traj = pinred.simulate(
        cat, prescribed={joint: signal}, duration=end, times=[end], seed=1, engine="pinocchio"
    )
    assert traj.x[-1, 0] == pytest.approx(0.5, rel=1e-12)


def test_message_distinguishes_nearly_equal_times() -> None:
    """Six digits would show the same number twice."""
    cat = pinred.load("falling_cat")
    prescribed = {cat.shape_names[0]: Spline(TIMES, VALUES)}
    with pytest.raises(InputError, match=r"to 0\.6498\d+ s, but the scene goes from 0 to 0\.64980"):
        pinred.Scene(system=cat, prescribed=prescribed, duration=END + 1e-12, seed=1).start  # noqa: B018
