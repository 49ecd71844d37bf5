"""Reaction-free paths of space arms, against Pinocchio's mass matrix and simulations."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from assertions import close

import pinred
from pinred import InputError
from pinred.analysis import reaction_free_path
from pinred.common.arrays import Array

START = np.array([0.3, -0.5, 0.4, -0.2, 0.6, 0.3])
FIRST = np.eye(6)[0]


@cache
def satellite() -> pinred.FloatingArm:
    """Two arms of three joints on a satellite: three directions are free of reactions."""
    return pinred.FloatingArm(pinred.load("satellite_two_arms"), "left_hand")


@cache
def free_path() -> pinred.ReactionFreePath:
    """Return a path of the satellite without limits."""
    return satellite().reaction_free_path(START, FIRST, length=1.0)


@cache
def planar() -> pinred.FloatingArm:
    """Two links in the plane: one direction is free of reactions."""
    return pinred.FloatingArm(pinred.load("floating_arm"), "hand")


def base_twist(system: pinred.System, x: Array, xdot: Array) -> Array:
    """Compute the body twist of a base without momentum by Pinocchio's mass matrix."""
    model, data = system.model, system.model.createData()
    H = pin.crba(model, data, system.q(system.group.identity(), x))
    H = np.triu(H) + np.triu(H, 1).T
    r = system.r
    return np.asarray(-np.linalg.solve(H[:r, :r], H[:r, r:] @ xdot))


@pytest.mark.parametrize(
    ("arm", "start", "direction", "length"),
    [
        (satellite, START, FIRST, 0.3),
        pytest.param(planar, [0.7, -0.9], None, 2.0, marks=pytest.mark.by_hand),
    ],
)
def test_base_keeps_its_attitude_along_the_path(
    arm: Any, start: Any, direction: Any, length: float
) -> None:
    """A simulation of the path turns the base by less than 2e-13 rad, and `compare` agrees."""
    system = arm().system
    path = arm().reaction_free_path(start, direction, length=length)
    assert path.stop == "length"
    assert path.reaction < 2e-13
    assert path.length == pytest.approx(length, rel=1e-12)
    x, slopes = path.at(np.linspace(0.0, 1.0, 300))
    close(x[0], start, 1e-14)
    for shape, slope in zip(x, slopes, strict=True):
        turning = base_twist(system, shape, slope)[system.group.linear :]
        assert np.abs(turning).max() < 2e-12
    # The length is that of the polygon, whose error is of the second order.
    polygon = np.linalg.norm(np.diff(path.at(np.linspace(0, 1, 4000))[0], axis=0), axis=1).sum()
    assert polygon == pytest.approx(length, rel=1e-5)
    traj = pinred.simulate(
        system, x0=x[0], momentum=0, duration=1.5, prescribed=path.prescribed(1.5),
        rtol=1e-12, atol=1e-14,
    )  # fmt: skip
    close(traj.x[-1], x[-1], 1e-12)
    assert system.group.error(traj.pose[0], traj.pose).rotation.max() < 2e-13
    assert pinred.compare(traj).passed
    # The few steps of the motion do not resolve the power of its joints.
    assert np.abs(traj.energy_balance.residual).max() < 2e-14 * traj.energy.max()
    assert max(np.abs(traj.xdot[[0, -1]]).ravel()) < 1e-12


def test_path_is_the_straightest() -> None:
    """The change of the direction is orthogonal to the null space, by differences to 1e-5."""
    arm = satellite()
    path = free_path()
    free = arm.null_space(START, of="attitude")
    _, slope = path.at(0.0)
    close(
        slope / np.linalg.norm(slope),
        free @ (free.T @ FIRST) / np.linalg.norm(free.T @ FIRST),
        1e-10,
    )
    h = 1e-4
    for f in (0.2, 0.7):
        units = [u / np.linalg.norm(u) for u in path.at([f - h, f + h])[1]]
        change = (units[1] - units[0]) / (2 * h)
        kept = arm.null_space(path.at(f)[0], of="attitude").T @ change
        assert np.abs(change).max() > 0.1
        assert np.abs(kept).max() < 1e-5 * np.abs(change).max()


def test_path_on_which_the_base_stays_in_place() -> None:
    """A longer arm on the base has a direction without any motion of the base."""
    ur5 = pinred.load("ur5", gravity=[0.0, 0.0, 0.0])
    arm = pinred.FloatingArm(ur5, "tool0")
    with pytest.raises(InputError, match="6 joints have 6 conditions"):
        arm.reaction_free_path([0.1, -1, 1, 0.2, 0.5, 0.3], of="base")
    plane = pinred.FloatingArm(pinred.load("planar_chain5"), "link5")
    path = plane.reaction_free_path([0.4, -0.7, 0.5, 0.6, 0.3], np.eye(5)[0], length=0.5, of="base")
    for shape, slope in zip(*path.at(np.linspace(0.0, 1.0, 50)), strict=True):
        assert np.abs(base_twist(plane.system, shape, slope)).max() < 1e-12


def test_path_ends_at_the_limits_of_the_file_or_stated_ones() -> None:
    """The joint that reaches its limit is named."""
    arm = satellite()
    k = int(np.argmax(free_path().at(1.0)[0] - START))
    limits = [(-9.0, 9.0)] * 6
    limits[k] = -9.0, START[k] + 0.2
    path = arm.reaction_free_path(START, FIRST, length=1.0, limits=limits)
    assert path.stop == f"limit of {arm.system.shape_names[k]}"
    assert path.at(1.0)[0][k] == pytest.approx(START[k] + 0.2, abs=1e-10)
    assert path.length < 1.0
    limits[k] = START[k] + 0.1, 9.0
    with pytest.raises(InputError, match=f"x0: joint '{arm.system.shape_names[k]}' must lie"):
        arm.reaction_free_path(START, FIRST, limits=limits)
    ur5 = pinred.FloatingArm(pinred.load("ur5", gravity=[0.0, 0.0, 0.0]), "tool0")
    path = ur5.reaction_free_path([0.1, -1, 2.5, 0.2, 0.5, 0.3], FIRST)
    assert path.stop == "limit of elbow_joint"
    assert abs(path.at(1.0)[0][2]) == pytest.approx(3.141593, abs=1e-6)


def singular_shape() -> Array:
    """Find a shape of the satellite at which the angular rows of A lose rank."""
    from scipy.optimize import minimize

    rows = satellite()._reduction.local_connection

    def least(x: Array) -> float:
        return float(np.linalg.det(rows(x)[3:] @ rows(x)[3:].T))

    shape = minimize(least, START, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-22})
    return np.asarray(shape.x)


def test_path_ends_before_a_singular_shape() -> None:
    """At its end the least singular value is 1e-3 of the largest at the start."""
    arm, at = satellite(), singular_shape()
    rows = arm._reduction.local_connection
    free = np.linalg.svd(rows(at)[3:])[2][2:]
    u = max(free, key=lambda v: np.linalg.svd(rows(at - 0.01 * v)[3:], compute_uv=False)[-1])
    start = at - 0.01 * u
    path = arm.reaction_free_path(start, u, length=1.0)
    assert path.stop == "singularity"
    values = np.linalg.svd(rows(path.at(1.0)[0])[3:], compute_uv=False)
    largest = np.linalg.svd(rows(start)[3:], compute_uv=False)[0]
    assert values[-1] == pytest.approx(1e-3 * largest, rel=1e-6)
    with pytest.raises(InputError, match="x0 is a singular shape"):
        arm.reaction_free_path(at, u)


def test_path_that_no_series_resolves_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """With degree 12 alone, the base would turn visibly."""
    monkeypatch.setattr(reaction_free_path, "_DEGREES", (12,))
    with pytest.raises(InputError, match="degree 12 still moves the base by"):
        satellite().reaction_free_path(START, FIRST, length=2.0)


def test_path_refuses_arguments_without_a_path() -> None:
    """Each message says what to state."""
    arm = satellite()
    for options, reason in (
        ({}, "3 directions are free"),
        ({"direction": arm._reduction.local_connection(START)[3]}, "no part that is free"),
        ({"direction": FIRST, "length": 0.0}, "length"),
        ({"direction": FIRST, "of": "hand"}, "expected 'base' or 'attitude'"),
        ({"direction": FIRST, "limits": [(0.0, 1.0)]}, "limits must be"),
    ):
        with pytest.raises(InputError, match=reason):
            arm.reaction_free_path(START, **options)
    cat = pinred.FloatingArm(pinred.load("falling_cat_ball"), "back")
    with pytest.raises(InputError, match="ball joint"):
        cat.reaction_free_path(cat.system.space.neutral, of="attitude")
    path = arm.reaction_free_path(START, FIRST, length=0.1)
    with pytest.raises(InputError, match="fraction: expected numbers from 0 to 1"):
        path.at(1.1)
