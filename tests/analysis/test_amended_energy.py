"""The amended potential and its derivatives, against Pinocchio's energies and differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.analysis.equilibria.amended_potential import AmendedEnergy, Energies
from pinred.analysis.equilibria.equilibrium_problem import Points, Problem, problem_of
from pinred.common.arrays import Array

SPRING = (3.0, 0.4)  # stiffness and rest position
KINDS = ["axis", "free", "heavy"]


def body(mass: float, lever: tuple[float, ...], moments: tuple[float, ...]) -> pin.Inertia:
    """Return a body with principal axes along those of its link."""
    return pin.Inertia(mass, np.array(lever), np.diag(moments))


def tree(root: pin.JointModel, links: list[tuple[Any, ...]], gravity: tuple[float, ...]) -> Any:
    """Return a system of links (parent, joint, name, rotation vector, place, body)."""
    model = pin.Model()
    model.gravity.linear = np.array(gravity)
    numbers = [model.addJoint(0, root, pin.SE3(np.eye(3), np.array([0.3, -0.2, 0.5])), "root")]
    model.appendBodyToJoint(1, body(1.1, (0.1, 0.2, -0.1), (0.3, 0.4, 0.35)), pin.SE3.Identity())
    for parent, joint, name, turn, place, inertia in links:
        where = pin.SE3(pin.exp3(np.array(turn)), np.array(place))
        numbers.append(model.addJoint(numbers[parent], joint, where, name))
        model.appendBodyToJoint(numbers[-1], inertia, pin.SE3.Identity())
    return pinred.load(model)


def problem(kind: str) -> Problem:
    """Return a problem of a kind with a free rotor, a driven joint, two arms and a spring.

    The driven joint of kind "axis" carries the arms, so its inertia depends on them. Those of the
    other kinds are rotors on an arm, so their coupling to the base depends on the arms.
    """
    rotor = body(0.6, (0.0, 0.0, 0.0), (0.02, 0.02, 0.035))
    first, second = (0.8, (0.2, 0.3, 0.1), (0.1, 0.05, 0.12)), (0.5, (0.1, -0.2, 0.2), (0.03,) * 3)
    arms = [body(*first), body(*second)]
    if kind == "axis":
        table = body(0.9, (0.1, 0.0, 0.2), (0.2, 0.1, 0.3))
        system = tree(pin.JointModelRZ(), [
            (0, pin.JointModelRZ(), "rotor", (0.0,) * 3, (0.0, 0.0, 0.3), rotor),
            (0, pin.JointModelRZ(), "driven", (0.0,) * 3, (0.0, 0.0, 0.4), table),
            (2, pin.JointModelRX(), "one", (0.1, 0.2, 0.3), (0.3, 0.1, 0.0), arms[0]),
            (3, pin.JointModelPY(), "two", (0.5, -0.4, 0.2), (0.2, 0.3, 0.1), arms[1]),
        ], (0.0, 0.0, -9.0))  # fmt: skip
    else:
        system = tree(pin.JointModelSpherical(), [
            (0, pin.JointModelRX(), "one", (0.1, 0.2, 0.3), (0.3, 0.1, 0.0), arms[0]),
            (1, pin.JointModelRY(), "two", (0.5, -0.4, 0.2), (0.2, 0.3, 0.1), arms[1]),
            (2, pin.JointModelRZ(), "driven", (0.3, 0.9, 0.0), (0.1, 0.1, 0.2), rotor),
            (1, pin.JointModelRZ(), "rotor", (0.7, 0.1, 0.4), (0.2, 0.0, 0.3), rotor),
        ], (1.0, 2.0, -9.0) if kind == "heavy" else (0.0,) * 3)  # fmt: skip
    made = problem_of(
        system, cyclic={"rotor": 0.3}, springs={"one": SPRING}, forces=(), passive=False,
        prescribed={"driven": "5*t + 0.3"},
    )  # fmt: skip
    assert (made.kind, len(made.active), len(made.driven)) == (kind, 2, 1)
    assert len(made.cyclic) == 1
    return made


def random_points(made: Problem, count: int) -> Points:
    """Return random shapes, and directions if the problem has any."""
    rng = np.random.default_rng(3)
    n = rng.normal(size=(count, 3 * made.directional))
    if made.directional:
        n /= np.linalg.norm(n, axis=1, keepdims=True)
    return Points(rng.uniform(-1.5, 1.5, (count, len(made.active))), n)


def by_pinocchio(made: Problem, x: Array, n: Array, J: float) -> tuple[float, Array]:
    """Return minus Routh's function V + s·η − T, and η, with T and V by Pinocchio."""
    system, model = made.system, made.system.model
    data, r = model.createData(), system.r
    shape = np.zeros(system.m)
    shape[list(made.active)], shape[list(made.driven)] = x, 0.3
    pose = system.group.identity()
    base = np.eye(r)[:, -1:] if made.kind == "axis" else np.eye(r)
    momenta = np.append(J * np.ones(1) if made.kind != "free" else J * n, 0.3)
    if made.kind == "heavy":
        up = -system.gravity / np.linalg.norm(system.gravity)
        pose = pin.Quaternion.FromTwoVectors(n, up).coeffs()
        base = n[:, None]
    q = system.q(pose, shape)
    H = np.triu(pin.crba(model, data, q))
    H = H + np.triu(H, 1).T
    free = np.zeros((system.n, base.shape[1] + 1))
    free[:r, :-1] = base
    free[r + made.cyclic[0], -1] = 1.0
    driven = np.zeros(system.n)
    driven[r + made.driven[0]] = 5.0
    eta = np.linalg.solve(free.T @ H @ free, momenta - free.T @ H @ driven)
    v = free @ eta + driven
    kinetic = pin.computeKineticEnergy(model, data, q, v)
    potential = pin.computePotentialEnergy(model, data, q)
    one = shape[system.shape_names.index("one")]
    potential += 0.5 * SPRING[0] * (one - SPRING[1]) ** 2
    return float(potential + momenta @ eta - kinetic), eta


@pytest.mark.parametrize("kind", KINDS)
def test_amended_potential_is_minus_routhian_by_pinocchio(kind: str) -> None:
    """U = V + s·η − T at the rates η that the momenta determine."""
    made, J = problem(kind), 1.7
    points = random_points(made, 6)
    found = AmendedEnergy(made)(points, J)
    for k in range(len(points)):
        U, eta = by_pinocchio(made, points.x[k], points.n[k], J)
        assert found.U[k] == pytest.approx(U, rel=1e-12)
        np.testing.assert_allclose(found.rates[k], eta, rtol=1e-11, atol=1e-11)


def moved(energy: AmendedEnergy, points: Points, direction: Array, J: float) -> Array:
    """Return U, (9, N), at steps of 0.01 along a direction."""
    steps = 0.01 * np.arange(-4, 5)
    return np.array([energy(points.moved(s * direction[None]), J).U for s in steps])


FIRST = np.array([3, -32, 168, -672, 0, 672, -168, 32, -3]) / 840.0 / 0.01
SECOND = np.array([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9]) / 5040.0 / 0.01**2


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.sampled
def test_gradient_and_hessian_agree_with_differences(kind: str) -> None:
    """Along all unknowns and all sums of two of them, by differences of order 8."""
    made, J = problem(kind), 1.7
    energy, points = AmendedEnergy(made), random_points(made, 3)
    found: Energies = energy(points, J)
    units = np.eye(made.unknowns)
    directions = [*units, *(a + b for i, a in enumerate(units) for b in units[:i])]
    size = np.abs(found.U).max()
    for d in directions:
        U = moved(energy, points, d, J)
        np.testing.assert_allclose(found.gradient @ d, FIRST @ U, rtol=0, atol=1e-9 * size)
        np.testing.assert_allclose(
            np.einsum("nij,i,j->n", found.hessian, d, d), SECOND @ U, rtol=0, atol=1e-7 * size
        )
    np.testing.assert_allclose(found.hessian, np.swapaxes(found.hessian, 1, 2), atol=1e-12 * size)


@pytest.mark.parametrize("kind", KINDS)
def test_gradient_by_momentum_agrees_with_differences(kind: str) -> None:
    """The gradient is quadratic in J, so central differences are exact."""
    made = problem(kind)
    energy, points = AmendedEnergy(made), random_points(made, 3)
    low, high = (energy(points, J).gradient for J in (1.2, 2.2))
    found = energy(points, np.full(3, 1.7)).by_momentum
    np.testing.assert_allclose(found, high - low, rtol=0, atol=1e-11 * np.abs(high).max())


def test_scale_is_sum_of_magnitudes_of_terms() -> None:
    """½ |s|·|η| + |weight| |c| + |V|, with s = σ by Pinocchio's mass matrix."""
    made, J = problem("heavy"), 1.7
    points = random_points(made, 3)
    found = AmendedEnergy(made)(points, J)
    system, model = made.system, made.system.model
    for k, (x, n) in enumerate(zip(points.x, points.n, strict=True)):
        shape = made.shapes(x[None])[0]
        q = system.q(system.group.identity(), shape)
        H = np.triu(pin.crba(model, model.createData(), q))
        H = H + np.triu(H, 1).T
        com = pin.centerOfMass(model, model.createData(), q) - model.jointPlacements[1].translation
        driven, cyclic = 3 + made.driven[0], 3 + made.cyclic[0]
        sigma = np.array([J - n @ H[:3, driven] * 5.0, 0.3 - H[cyclic, driven] * 5.0])
        terms = 0.5 * np.abs(sigma) @ np.abs(found.rates[k])
        terms += system.mass * np.linalg.norm(system.gravity) * np.linalg.norm(com)
        terms += 0.5 * SPRING[0] * (shape[system.shape_names.index("one")] - SPRING[1]) ** 2
        assert found.scale[k] == pytest.approx(terms, rel=1e-12)


@pytest.mark.parametrize(("least", "regular"), [(2e-13, True), (5e-14, False)])
def test_mass_matrix_beyond_condition_1e13_has_no_amended_potential(
    least: float, regular: bool
) -> None:
    """A rod that turns about its second axis: U = J²/2, whatever the moment about its line."""
    model = pin.Model()
    model.gravity.setZero()
    root = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, body(1.0, (0.0,) * 3, (least, 1.0, 1.0)), pin.SE3.Identity())
    made = problem_of(
        pinred.load(model), cyclic=None, springs=None, forces=(), prescribed=None, passive=False
    )
    (U,) = AmendedEnergy(made)(Points(np.zeros((1, 0)), np.array([[0.0, 1.0, 0.0]])), 0.6).U
    assert np.isnan(U) != regular
    assert not regular or pytest.approx(0.18, rel=1e-14) == U
