"""Trees with ball joints: the symbolic sweep, curvature and couplings against Pinocchio."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree, random_body

import pinred
from pinred import InputError, ModelError
from pinred.common.arrays import Array
from pinred.kernels.kernel import Structure
from pinred.kernels.reduced_graph import ReducedGraph
from pinred.reduction.pointwise_reduction import mass_matrix
from pinred.reduction.tree.identical_branches import Lanes
from pinred.reduction.tree.momenta import momenta
from pinred.system.robot_file_contents import Contents, Coupling
from pinred.system.system import System

EPS = float(np.finfo(float).eps)


def velocity_and_force(system: System, x: Array, momentum: Array) -> tuple[Array, Array]:
    """Return the velocity (ξ, σ) and π̇ of the sweep for momenta (μ, π) about the centre of mass."""
    graph = ReducedGraph(system, Structure(zero_momentum=False, base=False))
    base = graph.base
    value = ca.vertcat(*graph.xi, *graph.xdot, *graph.pidot)
    inputs = [ca.vertcat(*graph.x), ca.vertcat(*graph.pi), ca.vertcat(*base.b, *base.spin)]
    function = ca.Function("f", inputs, [value])
    r, k = system.r, system.group.linear
    found = np.array(function(x, momentum[r:], momentum[k:r])).ravel()
    return found[: system.n], found[system.n :]


def random_motion(system: System, seed: int) -> tuple[Array, Array]:
    """Return a shape, and a velocity (ξ, σ) without linear momentum."""
    rng = np.random.default_rng(seed)
    x, v, k = system.space.random(rng, 2.0), rng.normal(size=system.n), system.group.linear
    H = mass_matrix(system, x)
    v[:k] = -np.linalg.solve(H[:k, :k], H[:k, k:] @ v[k:])
    return x, v


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.sampled(4)
def test_sweep_with_balls_equals_aba(seed: int) -> None:
    """Velocities solve H v = (μ, π), and π̇ gives ABA's accelerations, to 1e-14 of the terms."""
    system = ball_tree(seed, 6)
    r, model, data = system.r, system.sorted_model, system.sorted_model.createData()
    x, v = random_motion(system, seed)
    H = mass_matrix(system, x)
    momentum = H @ v
    momentum[: system.group.linear] = 0.0
    found, pidot = velocity_and_force(system, x, momentum)
    terms = np.abs(np.linalg.inv(H)) @ np.abs(H) @ np.abs(v)
    assert (np.abs(found - v) <= 1e-14 * terms).all()
    q, v = system.sorted_q(system.group.identity(), x), found  # its round-off is tested above
    a = np.array(pin.aba(model, data, q, v, np.zeros(system.n)))
    C = np.array(pin.computeCoriolisMatrix(model, data, q, v))
    expected = (H @ a + (C + C.T) @ v)[r:]
    size = (np.abs(H) @ np.abs(a) + np.abs(C + C.T) @ np.abs(v))[r:]
    assert (np.abs(pidot - expected) <= 1e-14 * size.max()).all()


@pytest.mark.parametrize("seed", [0, 1])
def test_momenta_of_balls_equal_mass_matrix(seed: int) -> None:
    """The momenta from one sweep over the twists are H v."""
    system = ball_tree(seed, 5)
    x, v = ca.SX.sym("x", system.nx), ca.SX.sym("v", system.n)
    function = ca.Function("p", [x, v], [momenta(system, x, v)])
    at, velocity = random_motion(system, seed)
    H = mass_matrix(system, at)
    found = np.array(function(at, velocity)).ravel()
    assert (np.abs(found - H @ velocity) <= 1e-14 * (np.abs(H) @ np.abs(velocity)).max()).all()


def test_equal_limbs_with_balls_share_simd_lanes() -> None:
    """Two arms that hang on balls are computed together, one on the torso's other side apart."""
    model = pin.Model()
    model.gravity.setZero()
    rng = np.random.default_rng(0)
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, *random_body(rng))
    for side in (-1.0, 1.0):
        place = pin.SE3(np.eye(3), np.array([0.0, side * 0.3, 0.4]))
        shoulder = model.addJoint(root, pin.JointModelSpherical(), place, f"shoulder{side:g}")
        model.appendBodyToJoint(shoulder, *random_body(rng))
        below = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3]))
        elbow = model.addJoint(shoulder, pin.JointModelRY(), below, f"elbow{side:g}")
        model.appendBodyToJoint(elbow, *random_body(rng))
    system, lanes = System(model), Lanes()
    packed = ReducedGraph(system, Structure(zero_momentum=False), None, lanes).rate()
    plain = ReducedGraph(system, Structure(zero_momentum=False)).rate()
    assert any(mark.kind == "pack" for mark in lanes.marks["rate"])
    assert packed.n_instructions() < 0.75 * plain.n_instructions()


@pytest.mark.parametrize("group", ["SE3", "SO3", "SE2"])
def test_curvature_in_frame_equals_differences_of_connection(group: str) -> None:
    """B = e_αA_β − e_βA_α − [A_α, A_β] − c^γ_αβ A_γ with differences along the frame."""
    system = ball_tree(3, 4, group)
    red, space = pinred.Reduction(system), system.space
    x = space.random(np.random.default_rng(1), 1.5)
    m, h = system.m, 1e-4
    A = red.local_connection(x)
    dA = np.empty((system.r, m, m))
    for k, unit in enumerate(np.eye(m)):
        along = [red.local_connection(space.integrate(x, s * h * unit)) for s in (-2, -1, 1, 2)]
        dA[:, :, k] = (along[0] - 8.0 * along[1] + 8.0 * along[2] - along[3]) / (12.0 * h)
    expected = np.swapaxes(dA, 1, 2) - dA
    for a in range(m):
        expected[:, a] -= system.group.ad(A[:, a]) @ A
    for ball in space.balls:
        for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            i, j, k = (ball.v.start + n for n in (a, b, c))
            expected[:, i, j] -= A[:, k]
            expected[:, j, i] += A[:, k]
    B = red.curvature(x)
    size = max(np.abs(dA).max(), np.abs(A).max(), np.abs(B).max())
    np.testing.assert_allclose(B, expected, rtol=0.0, atol=2e-10 * size)
    np.testing.assert_allclose(red.at(x).dA, dA, rtol=0.0, atol=2e-10 * size)


def test_body_on_ideal_ball_has_flat_connection_about_its_axes() -> None:
    """A ball at the common centre of mass: A = (0; I⁻¹ R J), and B from the closed form."""
    model = pin.Model()
    model.gravity.setZero()
    I, J = np.diag([2.0, 2.0, 2.0]), np.diag([1.0, 1.0, 1.0])
    root = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, pin.Inertia(1.0, np.zeros(3), I), pin.SE3.Identity())
    ball = model.addJoint(root, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(ball, pin.Inertia(1.0, np.zeros(3), J), pin.SE3.Identity())
    system = System(model)
    red = pinred.Reduction(system)
    x = system.space.random(np.random.default_rng(0), 1.0)
    R = pin.Quaternion(x).toRotationMatrix()
    # Both bodies are spherical: A = s R with s = J/(I + J), so e_αA_β − e_βA_α = 2 s R (α × β)
    # and B(α, β) = 2 s R (α × β) − s² R (α × β) − s R (α × β) = s (1 − s) R (α × β).
    s = 1.0 / 3.0
    np.testing.assert_allclose(red.local_connection(x), s * R, atol=1e-15)
    expected = np.array(
        [[s * (1.0 - s) * R @ np.cross(a, b) for b in np.eye(3)] for a in np.eye(3)]
    )
    np.testing.assert_allclose(red.curvature(x), expected.transpose(2, 0, 1), atol=1e-15)


def test_couplings_beside_and_behind_balls_equal_constrained_dynamics() -> None:
    """Hinges behind a ball follow hinges before it; velocities solve GᵀHG v = (μ, π)."""
    rng = np.random.default_rng(4)
    model = pin.Model()
    model.gravity.setZero()
    parent = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(parent, *random_body(rng))
    kinds = (pin.JointModelRX, pin.JointModelSpherical, pin.JointModelRY, pin.JointModelPZ)
    for k, kind in enumerate(kinds):
        place = pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * rng.normal(size=3))
        parent = model.addJoint(parent, kind(), place, f"j{k}")
        model.appendBodyToJoint(parent, *random_body(rng))
    couplings = (Coupling("j2", {"j0": 0.7}, 0.2), Coupling("j3", {"j0": -0.3}, 0.1))
    system = System(model, contents=Contents(couplings=couplings))
    assert system.shape_names == ("j0", "j1.x", "j1.y", "j1.z")
    assert system.x_names == ("j0", "j1.qx", "j1.qy", "j1.qz", "j1.qw")
    x, v = random_motion(system, 2)
    q = system.sorted_q(system.group.identity(), x)
    assert q[12] == pytest.approx(0.7 * x[0] + 0.2)
    H = mass_matrix(system, x)
    momentum = H @ v
    momentum[:3] = 0.0
    found, pidot = velocity_and_force(system, x, momentum)
    np.testing.assert_allclose(found, v, rtol=0.0, atol=1e-13 * np.abs(v).max())
    full, data = system.joint_rates(v), model.createData()
    C = np.array(pin.computeCoriolisMatrix(system.sorted_model, data, q, full))
    expected = system.on_shape(full @ C)[6:]
    np.testing.assert_allclose(pidot, expected, rtol=0.0, atol=1e-13 * np.abs(expected).max())


def test_unequal_armature_of_ball_is_refused() -> None:
    """The message names the joint and its armature."""
    model = ball_tree(0, 1).model.copy()
    rotors = np.array(model.armature)
    rotors[6:9] = (0.1, 0.1, 0.2)
    model.armature = rotors
    with pytest.raises(ModelError, match=r"'j0' has armature \[0.1 0.1 0.2\].*equal about all"):
        System(model)


@pytest.mark.parametrize("length", [0.0, 0.5, np.nan])
def test_shape_with_invalid_quaternion_is_refused(length: float) -> None:
    """A zero, short or non-finite quaternion is not a shape."""
    system = ball_tree(0, 1)
    with pytest.raises(InputError if length == length else pinred.ShapeError):
        pinred.Reduction(system).at([0.0, 0.0, 0.0, length])
