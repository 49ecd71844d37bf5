"""Relative equilibria of robots with ball joints, against Pinocchio, SciPy and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import scipy.optimize
from ball_trees import joined_bodies

import pinred
from pinred.analysis.equilibria.amended_potential import AmendedEnergy
from pinred.analysis.equilibria.distinct_points import symmetries_of
from pinred.analysis.equilibria.equilibrium_problem import Problem, problem_of
from pinred.common.arrays import Array
from pinred.forces import BallSpring

STIFFNESS = 0.3  # of the springs at balls [N m/rad]
KINDS = {
    "axis": pin.JointModelRZ, "free": pin.JointModelFreeFlyer, "heavy": pin.JointModelSpherical,
}  # fmt: skip
FIRST = np.array([1, -8, 0, 8, -1]) / 12.0
SECOND = np.array([-1, 16, -30, 16, -1]) / 12.0


def sprung(joint: str = "joint", law: str = "cosine") -> list[Any]:
    """Return a spring at a ball, at rest in an attitude without symmetry."""
    return [BallSpring(joint, STIFFNESS, rest=(0.3, -0.2, 0.5), law=law)]


def limbs(kind: str) -> pinred.System:
    """Return a base with a hinge, a ball behind the hinge, and a ball on the base."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, 0.0 if kind == "free" else -9.0])
    model.addJoint(0, KINDS[kind](), pin.SE3.Identity(), "root")
    body = pin.Inertia(1.1, np.array([0.1, 0.2, -0.3]), np.diag([0.3, 0.4, 0.35]))
    model.appendBodyToJoint(1, body, pin.SE3.Identity())
    links = [
        (1, pin.JointModelRX(), "hinge", (0.1, 0.2, 0.3), (0.3, 0.1, 0.0)),
        (2, pin.JointModelSpherical(), "elbow", (0.5, -0.4, 0.2), (0.2, 0.3, 0.1)),
        (1, pin.JointModelSpherical(), "neck", (0.7, 0.1, 0.4), (-0.2, 0.0, 0.3)),
    ]
    for parent, joint, name, turn, place in links:
        i = model.addJoint(parent, joint, pin.SE3(pin.exp3(np.array(turn)), np.array(place)), name)
        inertia = pin.Inertia(0.6, np.array([0.1, 0.05 * i, 0.2]), np.diag([0.1, 0.05 * i, 0.12]))
        model.appendBodyToJoint(i, inertia, pin.SE3.Identity())
    return pinred.load(model)


def problem(kind: str) -> Problem:
    """Return the problem of a base with sprung balls."""
    return problem_of(
        limbs(kind), cyclic=None, springs={"hinge": (0.7, 0.4)}, passive=False, prescribed=None,
        forces=[*sprung("elbow"), BallSpring("neck", STIFFNESS, law="angle")],
    )  # fmt: skip


def by_pinocchio(made: Problem, x: Array, n: Array, J: float) -> float:
    """Return the amended potential V + ½ s·K⁻¹ s, from Pinocchio's mass matrix and potential."""
    system, model = made.system, made.system.sorted_model
    pose, data, r = system.group.identity(), model.createData(), system.r
    base = {"axis": np.eye(r)[:, -1:], "free": np.eye(r), "heavy": n[:, None]}[made.kind]
    s = np.append(np.zeros(3), J * n) if made.kind == "free" else np.array([J])
    if made.kind == "heavy":
        pose = pin.Quaternion.FromTwoVectors(n, np.array([0.0, 0.0, 1.0])).coeffs()
    q = system.sorted_q(pose, x)
    H = np.triu(pin.crba(model, data, q))[:r, :r]
    K = base.T @ (H + np.triu(H, 1).T) @ base
    V = pin.computePotentialEnergy(model, data, q) + 0.5 * 0.7 * (x[0] - 0.4) ** 2
    elbow = pin.exp3(np.array([0.3, -0.2, 0.5])).T @ pin.Quaternion(x[1:5]).matrix()
    V += STIFFNESS * (1.0 - np.cos(np.linalg.norm(pin.log3(elbow))))
    V += 0.5 * STIFFNESS * float(np.sum(pin.log3(pin.Quaternion(x[5:]).matrix()) ** 2))
    return float(V + 0.5 * s @ np.linalg.solve(K, s))


@pytest.mark.parametrize("kind", KINDS)
def test_amended_potential_and_derivatives_equal_those_by_pinocchio(kind: str) -> None:
    """Gradient along the frame, and the symmetric Hessian of w → U(x exp(w))."""
    made, J, h = problem(kind), 1.3, 0.01
    rng = np.random.default_rng(5)
    x = made.space.integrate(np.tile(made.space.neutral, (2, 1)), rng.uniform(-1, 1, (2, 7)))
    n = rng.normal(size=(2, 3 * made.directional))
    points = made.points(x, n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9))
    energy = AmendedEnergy(made)
    e = energy(points, J)
    for k in range(2):
        expected = by_pinocchio(made, points.x[k], points.n[k], J)
        assert e.U[k] == pytest.approx(expected, rel=1e-12)
    for _ in range(3):
        w = rng.normal(size=made.unknowns)
        w /= np.linalg.norm(w)
        U = np.array([energy(points.moved(s * h * w[None]), J).U for s in range(-2, 3)])
        np.testing.assert_allclose(e.gradient @ w, FIRST @ U / h, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(
            np.einsum("nij,i,j->n", e.hessian, w, w), SECOND @ U / h**2, rtol=1e-4, atol=1e-5
        )
    np.testing.assert_allclose(e.hessian, np.swapaxes(e.hessian, 1, 2), atol=1e-14)


def test_springs_of_balls_have_finite_curvature_at_rest() -> None:
    """½ k θ² has the curvature k in all directions."""
    made = problem_of(
        joined_bodies(), cyclic=None, springs=None, passive=False, prescribed=None,
        forces=[BallSpring("joint", STIFFNESS, law="angle")],
    )  # fmt: skip
    still = AmendedEnergy(made.at_rest())
    e = still(made.at_rest().points(made.space.neutral[None], np.zeros((1, 0))), 0.0)
    np.testing.assert_allclose(e.hessian[0], STIFFNESS * np.eye(3), rtol=1e-12)


def accelerations(found: Any, torque: Array) -> Array:
    """Return Pinocchio's accelerations at a relative equilibrium, (nv,)."""
    system, model = found.system, found.system.sorted_model
    scene = found.scene(duration=1.0)
    q = system.sorted_q(scene.pose0, found.x)
    v = np.concatenate([found.xi, found.xdot])
    return np.asarray(pin.aba(model, model.createData(), q, v, torque))


# The amended potential and its derivatives are compared with Pinocchio by default.
@pytest.mark.by_hand
def test_sprung_bodies_rotate_uniformly_and_include_minimum_by_scipy() -> None:
    """Pinocchio's accelerations vanish, and SciPy minimises the same amended potential."""
    system, J = joined_bodies(), 1.0
    equilibria = pinred.relative_equilibria(system, momentum=J, forces=sprung(), starts=50)
    assert len(equilibria) >= 8
    rest = pin.exp3(np.array([0.3, -0.2, 0.5]))
    for found in equilibria:
        R = rest.T @ pin.Quaternion(found.x).matrix()
        torque = (
            -STIFFNESS * 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        )
        a = accelerations(found, np.concatenate([np.zeros(6), torque]))
        assert np.abs(a).max() <= 1e-11

    def amended(z: Array) -> float:
        n, R = z[3:] / np.linalg.norm(z[3:]), pin.exp3(z[:3])
        q = system.sorted_q(system.group.identity(), pin.Quaternion(R).coeffs())
        H = np.triu(pin.crba(system.sorted_model, system.sorted_model.createData(), q))[:6, :6]
        s = np.append(np.zeros(3), J * n)
        spring = STIFFNESS * 0.5 * (3.0 - np.trace(rest.T @ R))
        return float(0.5 * s @ np.linalg.solve(H + np.triu(H, 1).T, s) + spring)

    starts = np.random.default_rng(0).normal(size=(3, 6))
    least = min(scipy.optimize.minimize(amended, z, tol=1e-10).fun for z in starts)
    assert equilibria[0].amended_potential == pytest.approx(least, rel=1e-9)
    assert (equilibria[0].verdict, equilibria[0].stability.index) == ("stable", 0)


def test_bodies_joined_at_centres_of_mass_rotate_about_principal_axes() -> None:
    """Both bodies rotate about principal axes: U = J²/(2 (I₁ + I₂)), with Euler's frequencies."""
    moments, J = np.array([[0.4, 0.53, 0.7], [0.2, 0.31, 0.45]]), 1.0
    system = joined_bodies(moments, np.zeros((2, 3)))
    equilibria = pinred.relative_equilibria(system, momentum=J, starts=80)
    pairs = sorted(
        (J / float(a + b), i, j) for i, a in enumerate(moments[0]) for j, b in enumerate(moments[1])
    )
    assert [e.dimension for e in equilibria] == [1] * 9
    assert (equilibria.census.expected, equilibria.census.morse_sum) == (0, 0)
    for found, (rate, i, j) in zip(equilibria, pairs, strict=True):
        assert found.amended_potential == pytest.approx(0.5 * J * rate, rel=1e-12)
        squares = [
            rate**2 * (I[k] - I[k - 1]) * (I[k] - I[k - 2]) / (I[k - 1] * I[k - 2])
            for k, I in ((i, moments[0]), (j, moments[1]))
        ]
        frequencies = sorted([rate, *np.sqrt([s for s in squares if s > 0.0])])
        np.testing.assert_allclose(found.frequencies, frequencies, rtol=1e-8)
        growth = max([np.sqrt(-s) for s in squares if s < 0.0], default=0.0)
        assert found.growth == pytest.approx(growth, rel=1e-8)
        stable = i == j == 2
        assert found.verdict == ("stable" if stable else "unstable" if growth else "undecided")


def carousel(arm: float, length: float, inertia: Array) -> pinred.System:
    """Return a carousel about the vertical with a ball pendulum of 0.5 kg."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(1, pin.Inertia(1.0, np.zeros(3), 0.8 * np.eye(3)), pin.SE3.Identity())
    place = pin.SE3(np.eye(3), np.array([arm, 0.0, 0.0]))
    model.addJoint(1, pin.JointModelSpherical(), place, "pendulum")
    bob = pin.Inertia(0.5, np.array([0.0, 0.0, -length]), inertia)
    model.appendBodyToJoint(2, bob, pin.SE3.Identity())
    return pinred.load(model)


def test_pendulum_on_carousel_hangs_at_angle_of_centrifugal_balance() -> None:
    """The slope is tan θ = ω² (b + l sin θ)/g; the pendulum can rotate about its rod."""
    arm, length, J = 0.3, 0.6, 2.0
    equilibria = pinred.relative_equilibria(
        carousel(arm, length, 1e-3 * np.eye(3)), momentum=J, starts=80
    )
    for found in equilibria:
        rate = found.xi[-1]
        R = pin.Quaternion(found.x).matrix()
        bob = R @ np.array([0.0, 0.0, -length])
        assert abs(bob[1]) <= 1e-10
        assert 9.81 * bob[0] == pytest.approx(-(rate**2) * (arm + bob[0]) * bob[2], rel=1e-9)
        inertia = 0.8 + 0.5 * (arm + bob[0]) ** 2 + 1e-3
        assert inertia * rate == pytest.approx(J, rel=1e-12)
    assert {found.dimension for found in equilibria} == {1}
    assert (equilibria[0].verdict, equilibria[0].stability.index) == ("stable", 0)


@pytest.mark.by_hand
def test_branches_of_hanging_brick_have_pitchforks_at_critical_momenta() -> None:
    """U'' = m g l + k − ω² (B − C) about x, for moments of inertia A, B, C about the ball."""
    A, B, C, length = 0.05, 0.04, 0.01, 0.2
    inertia = np.diag([A, B, C]) - 0.5 * length**2 * np.diag([1.0, 1.0, 0.0])
    system = carousel(0.0, length, inertia)
    forces = [BallSpring("pendulum", STIFFNESS, law="cosine")]
    critical = [
        (0.8 + C) * np.sqrt((0.5 * 9.81 * length + STIFFNESS) / (moment - C)) for moment in (A, B)
    ]
    result = pinred.branches(system, momentum=(4.4, 5.5), forces=forces, starts=6, step=0.4)
    hanging = [p for p in result.pitchforks if np.abs(p.x[:3]).max() <= 1e-6]
    np.testing.assert_allclose(sorted(p.momentum for p in hanging), critical, rtol=1e-9)
    for point in result.points[::10]:
        n = pin.Quaternion(point.x).matrix().T @ np.array([0.0, 0.0, 1.0])
        moment = 0.8 + n @ np.diag([A, B, C]) @ n
        spring = STIFFNESS * 2.0 * float(point.x[:3] @ point.x[:3])
        V = -0.5 * 9.81 * length * n[2] + spring + 0.5 * point.momentum**2 / moment
        assert point.amended_potential == pytest.approx(V, rel=1e-12)
    assert max(p.residual for p in result.points) <= 1e-9


def test_motion_along_mode_of_ball_has_frequency_of_mode() -> None:
    """The attitude after a small perturbation is x exp(Re(a e^{λt})) up to its square."""
    system = joined_bodies()
    found = pinred.relative_equilibria(system, momentum=1.0, forces=sprung(), starts=60)[0]
    mode, size = found.modes[0], 1e-5
    traj = pinred.simulate(found.scene(0, amplitude=size, times=np.linspace(0.0, 3.0, 7)))
    value = mode.growth + 1j * mode.frequency
    expected = size * np.real(np.exp(value * traj.t)[:, None] * mode.shape)
    displacement = system.space.difference(np.tile(found.x, (7, 1)), traj.x)
    np.testing.assert_allclose(displacement, expected, atol=1e-3 * size)


def test_half_turns_of_child_are_coverings() -> None:
    """A brick on a ball looks the same after half turns about its principal axes."""
    made = problem_of(
        joined_bodies(offset=np.zeros((2, 3))), cyclic=None, springs=None, forces=(),
        passive=False, prescribed=None,
    )  # fmt: skip
    coverings = [s for s in symmetries_of(AmendedEnergy(made), 1.0) if s.is_covering]
    rotations = {tuple(np.round(np.abs(s.balls[0].right), 9)) for s in coverings}
    assert len(rotations) == 4
    assert all(np.ptp(np.abs(s.balls[0].left)) == pytest.approx(1.0) for s in coverings)


# Two bodies at one centre of mass have Euler's frequencies by default.
@pytest.mark.by_hand
def test_body_with_spherical_rotor_is_as_stable_as_without() -> None:
    """The body moves as if alone, and the momentum of the rotor precesses at the spin ω."""
    moments, masses, rotor = np.array([[0.4, 0.5, 0.7], [0.2, 0.2, 0.2]]), (2.0, 1.0), 0.2
    d = np.array([0.1, 0.2, -0.3])
    system = joined_bodies(moments, np.array([-d, np.zeros(3)]))
    reduced = masses[0] * masses[1] / sum(masses)
    alone = np.diag(moments[0]) + reduced * (d @ d * np.eye(3) - np.outer(d, d))
    principal = np.linalg.eigvalsh(alone)
    found = pinred.relative_equilibria(system, momentum=1.0, starts=30)
    assert len(found) == 3
    for own, point in zip(principal[::-1], found, strict=True):
        first, last = (I for I in principal if own != I)
        spin = 1.0 / (own + rotor)
        square = (own - first) * (own - last) / (first * last) * spin**2
        if square > 0.0:
            np.testing.assert_allclose(point.stability.frequencies, sorted([spin, square**0.5]))
        else:
            assert point.stability.verdict == "unstable"
            assert point.stability.growth == pytest.approx((-square) ** 0.5, rel=1e-9)
