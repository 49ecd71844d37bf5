"""Connections seen from other frames: conjugate phases, and A′ and B′ by their formulas."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from assertions import close
from hypothesis import given, settings
from hypothesis import strategies as st
from lifts import random_gait
from link_poses import link_pose
from strategies import groups, make_case, seeds
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.lie import Group


def conjugate(group: Group, g: Array, h: Array) -> Array:
    """h⁻¹ g h."""
    return group.compose(group.compose(group.inverse(h), g), h)


def agree(group: Group, found: Array, expected: Array, tolerance: float) -> None:
    """Assert that two poses agree."""
    error = group.error(expected, found)
    size = 1.0 + float(np.abs(expected).max())
    assert error.rotation <= tolerance
    assert error.translation <= tolerance * size


@pytest.mark.by_hand
@settings(max_examples=2)
@given(joints=st.integers(1, 2), seed=seeds)
def test_other_base_link_has_conjugate_phase(joints: int, seed: int) -> None:
    """On random trees in space: the phase is conjugate, and B′ = Ad_{h⁻¹} B."""
    model = random_model("SE3", joints, seed)
    rng = np.random.default_rng(seed)
    for i in range(2, model.njoints):
        place = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        model.addBodyFrame(f"link{i}", i, place, 0)
    system = pinred.load(model)
    name = f"link{rng.integers(2, model.njoints)}"
    A = pinred.Connection.mechanical(system)
    B = A.seen_from(name)
    gait = random_gait(rng, joints, harmonics=1)
    p, q = (pinred.phase(each, gait, tolerance=1e-12) for each in (A, B))
    h = link_pose(system, name, gait.at(0.0)[0])
    agree(A.group, q.pose, conjugate(A.group, p.pose, h), 1e-12)
    x = gait.at(0.3)[0]
    there = A.group.Ad(A.group.inverse(link_pose(system, name, x)))
    size = 1.0 + float(np.abs(A.curvature(x)).max())
    close(B.curvature(x), np.tensordot(there, A.curvature(x), 1), 1e-11 * size)
    close(B.metric(x), A.metric(x), 1e-11 * size)


@settings(max_examples=4)
@given(group=groups, joints=st.integers(1, 2), seed=seeds)
def test_other_section_has_conjugate_phase(group: str, joints: int, seed: int) -> None:
    """On all groups, in a random frame h(x): conjugate phases, A′ = Ad_{h⁻¹}A − h⁻¹∂h."""
    case = make_case(group, joints, seed)
    A, G = pinred.Connection.mechanical(case.system), case.system.group
    slopes = case.rng.uniform(-0.5, 0.5, (G.size, joints))
    start = case.rng.uniform(-0.5, 0.5, G.size)

    def pose(x: ca.SX) -> ca.SX:
        out = ca.DM(start) + ca.sin(ca.DM(slopes) @ x)
        if G.turns == 3:
            q = ca.vertcat(out[-4:-1], 1.5)
            out = ca.vertcat(out[:-4], q / ca.norm_2(q))
        return out

    def at(x: Array) -> Array:
        out = start + np.sin(slopes @ x)
        if G.turns == 3:
            out[-1] = 1.5
            out = G.normalize(out)
        return np.asarray(out)

    B = A.in_section(pose)
    gait = random_gait(case.rng, joints, harmonics=1)
    p, q = (pinred.phase(each, gait, tolerance=1e-12) for each in (A, B))
    agree(G, q.pose, conjugate(G, p.pose, at(gait.at(0.0)[0])), 1e-12)
    x, h = case.x, 1e-3
    back = G.inverse(at(x))
    expected = G.Ad(back) @ A.local(x)
    for k in range(joints):
        for step, weight in ((1, 8.0), (-1, -8.0), (2, -1.0), (-2, 1.0)):
            to = x + step * h * np.eye(joints)[k]
            expected[:, k] -= weight / (12.0 * h) * G.log(G.compose(back, at(to)))
    close(B.local(x), expected, 1e-9 * (1.0 + np.abs(expected).max()))


def test_other_base_link_of_drag_and_wheels() -> None:
    """Any connection of a robot can be seen from another of its links."""
    system = pinred.load("purcell_swimmer")
    wheels = [pinred.Wheel(name, (c, 0, 0)) for name, c in (("rear", -0.1), ("front", 0.2))]
    gait = pinred.Gait.fourier([1.0, -0.5], [[0.3, 0.0]], [[0.0, 0.4]])
    for A in (
        pinred.Connection.viscous(system, {"rear": pinred.Rod(0.3, 2.0, 1.0), "front": np.eye(6)}),
        pinred.Connection.kinematic(system, [*wheels, pinred.Wheel("middle")]),
    ):
        p, q = (pinred.phase(each, gait, tolerance=1e-12) for each in (A, A.seen_from("front")))
        h = link_pose(system, "front", gait.at(0.0)[0])
        agree(A.group, q.pose, conjugate(A.group, p.pose, h), 1e-11)


def test_invalid_base_links_raise() -> None:
    """A link with motions outside the group, and an unknown one."""
    system = pinred.load("double_spherical_pendulum")
    A = pinred.Connection.mechanical(system)
    frames = [frame.name for frame in system.model.frames]
    with pytest.raises(pinred.InputError, match="not in SO2"):
        A.seen_from(frames[-1])
    with pytest.raises(pinred.InputError, match="no moving link 'nope'"):
        A.seen_from("nope")
    with pytest.raises(pinred.InputError, match="gives 1 pose coordinates"):
        A.in_section(lambda x: ca.vertcat(x[0], x[1]))
