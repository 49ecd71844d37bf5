"""The root joint of the full simulation, against Pinocchio's integration of configurations."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from trees import random_model

from pinred.judge.full_coordinates import Configuration, root_motion
from pinred.lie import GROUPS


@pytest.mark.parametrize("group", GROUPS)
def test_rates(group: str) -> None:
    """As a configuration moves in a short time, by differences of order four."""
    model, rng = random_model(group, 0, 3), np.random.default_rng(0)
    root = root_motion(model)
    at = rng.normal(size=root.size)
    if root.turns == 3:
        at[-4:] /= np.linalg.norm(at[-4:])
    v, h = rng.normal(size=model.nv), 1e-3
    slope = np.zeros(model.nq)
    for k, weight in ((1, 2 / 3), (2, -1 / 12)):
        there, back = (pin.integrate(model, root.q(at), s * k * h * v) for s in (1.0, -1.0))
        slope += weight * (there - back) / h
    rate, step = root.rate(at, v), 1e-6
    found = (root.q(at + step * rate) - root.q(at - step * rate)) / (2.0 * step)
    np.testing.assert_allclose(found, slope, atol=1e-8)
    if root.turns == 3:
        assert rate[-4:] @ at[-4:] == pytest.approx(0.0, abs=1e-15)  # its length stays
    assert root.is_pivoted == (group in ("SO2", "SO3"))


@pytest.mark.parametrize("group", ["SO3", "SE3"])
def test_quaternions_that_have_grown(group: str) -> None:
    """Integration changes their length a little; Pinocchio is given one of length one."""
    model, rng = random_model(group, 0, 3), np.random.default_rng(0)
    root = root_motion(model)
    at = rng.normal(size=root.size)
    longer = at.copy()
    longer[-4:] *= 1.7
    assert np.linalg.norm(root.q(at)[-4:]) == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_allclose(root.q(longer), root.q(at), atol=1e-15)
    v = rng.normal(size=model.nv)
    slides = root.linear  # a longer one turns faster in its own numbers, and slides no faster
    np.testing.assert_allclose(root.rate(longer, v)[:slides], root.rate(at, v)[:slides], atol=1e-14)
    np.testing.assert_allclose(root.rate(longer, v)[slides:], 1.7 * root.rate(at, v)[slides:])


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
