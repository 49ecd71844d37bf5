"""Singular shapes of trees with balls: attitudes at which a joint moves no mass."""

from __future__ import annotations

import warnings

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.system.coordinates import tree_space
from pinred.system.coupling import Coupled, coupled
from pinred.system.robot_file_contents import Coupling
from pinred.system.singular_mass_matrix import SingularShape, singular_shapes

ROD = np.diag([0.2, 0.2, 0.0])
NONE = np.zeros(3)


def body(mass: float, moments: Array) -> pin.Inertia:
    """Return a body whose centre of mass is on its joint."""
    return pin.Inertia(mass, NONE, moments)


def chain(joints: list[tuple[str, pin.JointModel, pin.Inertia]], parents: list[int]) -> pin.Model:
    """Return joints at one point behind a free body with mass."""
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, body(2.0, np.eye(3)), pin.SE3.Identity())
    added = [root]
    for (name, kind, inertia), parent in zip(joints, parents, strict=True):
        at = model.addJoint(added[parent], kind, pin.SE3.Identity(), name)
        model.appendBodyToJoint(at, inertia, pin.SE3.Identity())
        added.append(at)
    return model


def rod_on_a_ball() -> pin.Model:
    """Return a rod without thickness on a ball with armature, behind a massless hinge about z."""
    nothing = pin.Inertia.Zero()
    model = chain(
        [("yaw", pin.JointModelRZ(), nothing), ("neck", pin.JointModelSpherical(), body(1.0, ROD))],
        [0, 1],
    )
    model.armature[model.idx_vs[3] : model.idx_vs[3] + 3] = 0.1
    return model


def least(model: pin.Model, values: dict[str, float], constraints: Coupled | None = None) -> float:
    """Return the least eigenvalue of the mass matrix where slides and balls have values."""
    space = tree_space(model)
    rng = np.random.default_rng(4)
    w = rng.uniform(-1.0, 1.0, space.m)
    for k, name in enumerate(space.names):
        w[k] = values.get(name, w[k])
    x = space.integrate(space.neutral, w)
    q = np.concatenate([pin.neutral(model)[:7], x])
    H = pin.crba(model, model.createData(), q)
    H = np.triu(H) + np.triu(H, 1).T
    return float(np.linalg.eigvalsh(H if constraints is None else constraints.matrix(H, 6))[0])


def test_rod_along_the_hinge_is_found() -> None:
    """The hinge moves no mass where the rod is on its axis: R e_z = ± e_z."""
    model = rod_on_a_ball()
    shapes = singular_shapes(model).isolated
    assert shapes
    assert {shape.joint for shape in shapes} == {"yaw"}
    for shape in shapes:
        vector = np.array([shape.at.get(f"neck.{axis}", 0.3) for axis in "xyz"])
        np.testing.assert_allclose(np.abs(pin.exp3(vector)[2, 2]), 1.0, atol=1e-9)
        assert least(model, {f"neck.{a}": v for a, v in zip("xyz", vector, strict=True)}) <= 1e-9
    assert least(model, {}) >= 1e-4
    with pytest.warns(pinred.ModelWarning, match=r"'yaw'.*neck\.x"):
        pinred.load(model)


def test_masses_on_slides_of_a_ball_are_found() -> None:
    """A ball with point masses on two slides loses an axis where one mass is at its centre."""
    point = body(1.0, np.zeros((3, 3)))
    model = chain(
        [
            ("neck", pin.JointModelSpherical(), pin.Inertia.Zero()),
            ("left", pin.JointModelPX(), point),
            ("up", pin.JointModelPY(), point),
        ],
        [0, 1, 1],
    )
    shapes = singular_shapes(model).isolated
    assert shapes
    for shape in shapes:
        assert set(shape.at) <= {"left", "up"}
        assert min(abs(value) for value in shape.at.values()) <= 1e-5
        assert least(model, dict(shape.at)) <= 1e-9
    assert least(model, {}) >= 1e-4


def test_regular_trees_with_balls_have_no_singular_shapes() -> None:
    """With a thick rod, nothing is found."""
    model = rod_on_a_ball()
    model.inertias[3] = body(1.0, np.diag([0.2, 0.2, 0.05]))
    assert singular_shapes(model) == singular_shapes(chain([], []))


def test_coupled_trees_with_balls_are_searched() -> None:
    """A follower of the hinge does not change the shapes; the offset of the follower is used."""
    model = rod_on_a_ball()
    at = model.addJoint(1, pin.JointModelRX(), pin.SE3.Identity(), "rest")
    model.appendBodyToJoint(at, pin.Inertia.Zero(), pin.SE3.Identity())
    constraints = coupled(tree_space(model), [Coupling("rest", {"yaw": 0.5}, 0.2)])
    verdict = singular_shapes(model, constraints)
    assert verdict.isolated
    for shape in verdict.isolated:
        assert isinstance(shape, SingularShape)
        assert least(model, dict(shape.at), constraints) <= 1e-9
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert least(model, {}, constraints) >= 1e-5
