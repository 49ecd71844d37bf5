"""Root joint and configurations of the full state, against Pinocchio's integration."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from trees import random_model

from pinred.common.arrays import Array
from pinred.judge.full_system import Configuration, RootMotion, root_motion
from pinred.lie import GROUPS


def rate_of(root: RootMotion, at: Array, v: Array) -> Array:
    """Return the time derivative of root coordinates as an array."""
    return np.array(root.rate(at, v))


@pytest.mark.parametrize("group", GROUPS)
def test_root_rate_equals_differences_of_integration(group: str) -> None:
    """Compared with fourth-order differences of pin.integrate."""
    model, rng = random_model(group, 0, 3), np.random.default_rng(0)
    root = root_motion(model)
    at = rng.normal(size=root.size)
    if root.turns == 3:
        at[-4:] /= np.linalg.norm(at[-4:])
    v, h = rng.normal(size=model.nv), 1e-3
    slope = np.zeros(model.nq)
    for k, weight in ((1, 2 / 3), (2, -1 / 12)):
        second, back = (pin.integrate(model, root.q(at), s * k * h * v) for s in (1.0, -1.0))
        slope += weight * (second - back) / h
    rate, step = rate_of(root, at, v), 1e-6
    result = (root.q(at + step * rate) - root.q(at - step * rate)) / (2.0 * step)
    np.testing.assert_allclose(result, slope, atol=1e-8)
    if root.turns == 3:
        assert rate[-4:] @ at[-4:] == pytest.approx(0.0, abs=1e-15)  # keeps the norm
    assert root.is_pivoted == (group in ("SO2", "SO3"))


@pytest.mark.parametrize("group", ["SO3", "SE3"])
def test_root_normalises_quaternions(group: str) -> None:
    """Pinocchio gets unit quaternions although integration changes their length."""
    model, rng = random_model(group, 0, 3), np.random.default_rng(0)
    root = root_motion(model)
    at = rng.normal(size=root.size)
    longer = at.copy()
    longer[-4:] *= 1.7
    assert np.linalg.norm(root.q(at)[-4:]) == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_allclose(root.q(longer), root.q(at), atol=1e-15)
    v = rng.normal(size=model.nv)
    slides = root.linear  # a scaled quaternion has a scaled rate but the same translation
    long_rate, rate = rate_of(root, longer, v), rate_of(root, at, v)
    np.testing.assert_allclose(long_rate[:slides], rate[:slides], atol=1e-14)
    np.testing.assert_allclose(long_rate[slides:], 1.7 * rate[slides:])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("joints", [0, 1, 9])
@pytest.mark.parametrize("group", GROUPS)
def test_configuration_of_angles_beyond_full_rotations(group: str, joints: int, seed: int) -> None:
    """Constant rates for one second from zero, including several full rotations."""
    model, rng = random_model(group, joints, seed), np.random.default_rng(seed)
    root = root_motion(model)
    v = np.concatenate([rng.normal(size=root.axes.shape[1]), rng.uniform(-20.0, 20.0, joints)])
    q = pin.integrate(model, pin.neutral(model), v)
    place = q[: model.joints[1].nq].copy()
    if root.circle:
        *slide, c, s = place.tolist()
        place = np.array([*slide, np.arctan2(s, c)])
    result = Configuration(model, root)(place, v[len(v) - joints :])
    np.testing.assert_allclose(result, q, rtol=1e-13, atol=1e-13)


def test_cases_include_angles_and_cosines() -> None:
    """The random trees include both representations of angles."""
    kinds = {
        frozenset(joint.nq for joint in list(random_model(group, joints, seed).joints)[2:])
        for group in GROUPS
        for joints in (1, 9)
        for seed in range(3)
    }
    assert kinds == {frozenset({1}), frozenset({2}), frozenset({1, 2})}
