"""Rows of the Jacobian of loops and their time derivatives, against Pinocchio's frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from ball_trees import joined_bodies
from loop_robots import five_bar, gripper, random_loops

import pinred
from pinred.reduction.tree.all_joints import joint_rates, joint_values, on_shape
from pinred.reduction.tree.body_frames import bodies_of
from pinred.reduction.tree.loop_constraints import LoopRows, PolynomialRow, SurfaceRow
from pinred.system.loops.kinematics import (
    loop_jacobian,
    loop_jacobian_rate,
    loop_kinematics,
    loop_values,
)
from pinred.system.loops.loop import BallSurface, JointPolynomial, Loop

ROBOTS: dict[str, Callable[[], tuple[pin.Model, list[Loop]]]] = {
    "points": five_bar,
    "welds, with slides": lambda: random_loops(2, ("6d", "6d"), 5),
    "hinges": lambda: random_loops(3, ("x", "y", "z"), 4),
    "balls": lambda: random_loops(4, ("3d", "6d"), 3, balls=True),
}


def check(system: pinred.System) -> None:
    """Compare all rows, and derivatives along random multipliers, at shapes with open loops."""
    rng, tree = np.random.default_rng(0), system.tree
    for _ in range(3):
        x = system.space.integrate(system.space.neutral, rng.normal(size=system.m))
        xdot = rng.normal(size=system.m)
        joints, rates = joint_values(system, x.tolist()), joint_rates(system, xdot.tolist())
        J, Jdot = loop_jacobian(system, x), loop_jacobian_rate(system, x, xdot)
        for loop, place in zip(system.loops, loop_kinematics(system).rows, strict=True):
            rows: LoopRows | PolynomialRow | SurfaceRow
            if isinstance(loop, Loop):
                rows = LoopRows.at(system.model, bodies_of(system), loop, joints)
            elif isinstance(loop, BallSurface):
                rows = SurfaceRow(tree, loop, joints)
            else:
                assert isinstance(loop, JointPolynomial)
                rows = PolynomialRow(tree, loop, joints)
            own, nu = range(place.stop - place.start), rng.normal(size=loop.equations)
            columns = [rows.row(n) for n in own]
            columns.append(rows.turning(dict(enumerate(nu.tolist())), rates))
            *found, turned = (
                on_shape(system, [entries.get(k, 0.0) for k in range(tree.m)])
                for entries in columns
            )
            np.testing.assert_allclose(found, J[place], rtol=0.0, atol=1e-13 * np.abs(J).max())
            size = np.abs(Jdot).max() * np.abs(nu).sum()
            np.testing.assert_allclose(turned, Jdot[place].T @ nu, rtol=0.0, atol=1e-13 * size)


@pytest.mark.parametrize("robot", ROBOTS)
def test_rows_and_derivatives_equal_those_of_pinocchio(robot: str) -> None:
    """Each kind of loop, over hinges, slides and balls."""
    model, loops = ROBOTS[robot]()
    check(pinred.load(model, loops=loops))


def test_rows_with_followers_and_polynomials_equal_those_of_pinocchio(tmp_path: Path) -> None:
    """Rates of followers are those of their leaders."""
    path = tmp_path / "gripper.xml"
    law = '<joint name="bent" joint1="left_finger" joint2="left_driver" polycoef="0 -1 0.2 0.1 0"/>'
    text = gripper()
    left = text.index('<connect name="left"')
    path.write_text(text[:left] + law + text[text.index("/>", left) + 2 :])
    system = pinred.load(path)
    assert system.coupled is not None
    assert any(isinstance(loop, JointPolynomial) for loop in system.loops)
    check(system)


@pytest.mark.parametrize("kind", ["angle", "swing", "twist"])
def test_rows_of_surfaces_of_balls_equal_differences_of_their_values(kind: str) -> None:
    """Rows of CasADi, rows in NumPy, and central differences along the rates of the ball."""
    axis = tuple((np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)).tolist())
    system = joined_bodies().on_surfaces((BallSurface("joint", kind, 0.7, axis),))
    check(system)
    rng, h = np.random.default_rng(1), 1e-5
    x = system.space.integrate(system.space.neutral, rng.normal(size=3))
    ends = [
        [loop_values(system, system.space.integrate(x, s * h * unit)) for s in (-1.0, 1.0)]
        for unit in np.eye(3)
    ]
    differences = [(after - before)[0] / (2.0 * h) for before, after in ends]
    np.testing.assert_allclose(loop_jacobian(system, x)[0], differences, atol=1e-9)
