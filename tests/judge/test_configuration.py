"""Configurations of the full simulation, against Pinocchio's integration of velocities."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from trees import random_model

from pinred.judge.configuration import Configuration
from pinred.judge.root_motion import root_motion
from pinred.lie import GROUPS


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("joints", [0, 1, 9])
@pytest.mark.parametrize("group", GROUPS)
def test_angles_beyond_a_turn(group: str, joints: int, seed: int) -> None:
    """From where all is zero at constant rates for a second, some of several turns."""
    model, rng = random_model(group, joints, seed), np.random.default_rng(seed)
    root = root_motion(model)
    v = np.concatenate([rng.normal(size=root.axes.shape[1]), rng.uniform(-20.0, 20.0, joints)])
    q = pin.integrate(model, pin.neutral(model), v)
    place = q[: model.joints[1].nq].copy()
    if root.circle:
        *slide, c, s = place.tolist()
        place = np.array([*slide, np.arctan2(s, c)])
    found = Configuration(model, root)(place, v[len(v) - joints :])
    np.testing.assert_allclose(found, q, rtol=1e-13, atol=1e-13)


def test_both_ways_of_keeping_angles_are_tried() -> None:
    """Of the trees above some have angles, some cosines and sines, and some both."""
    kinds = {
        frozenset(joint.nq for joint in list(random_model(group, joints, seed).joints)[2:])
        for group in GROUPS
        for joints in (1, 9)
        for seed in range(3)
    }
    assert kinds == {frozenset({1}), frozenset({2}), frozenset({1, 2})}
