"""Locked inertia, connection, reduced metric and curvature against their definitions."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any
from unittest.mock import patch

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from strategies import Case, cases, make_case

import pinred
from pinred.common.arrays import Array

EPS = np.finfo(float).eps


def joint_space_inertia(case: Case, q: Array) -> Array:
    """H by the definition of the mass matrix: torques at rest of unit accelerations (RNEA)."""
    model = case.system.model
    data, zero = model.createData(), np.zeros(model.nv)
    return np.column_stack([pin.rnea(model, data, q, zero, e) for e in np.eye(model.nv)])


def close(a: Array, b: Array, tolerance: float) -> bool:
    """Whether two arrays agree to `tolerance` of the larger one's norm."""
    scale = max(1.0, float(np.linalg.norm(b)))
    return bool(np.abs(a - b).max(initial=0.0) <= tolerance * scale)


@settings(max_examples=8)
@given(cases(0))
def test_split_equals_blocks_of_mass_matrix(case: Case) -> None:
    """I, A and M are the blocks of H by definition, at any pose of the base."""
    red, r = pinred.Reduction(case.system), case.system.r
    H = joint_space_inertia(case, case.q)
    I, Hbs, Hss = H[:r, :r], H[:r, r:], H[r:, r:]
    assert close(red.mass_matrix(case.x), H, 1e-13)
    assert close(red.locked_inertia(case.x), I, 1e-13)
    A = np.asarray(np.linalg.solve(I, Hbs))
    assert close(red.local_connection(case.x), A, 1e-12)
    assert close(red.reduced_metric(case.x), Hss - A.T @ I @ A, 1e-12)


@settings(max_examples=8)
@given(cases())
def test_energy_and_momentum_equal_sums_over_bodies(case: Case) -> None:
    """Kinetic energy, momentum and locked velocity against body-by-body sums."""
    red, system = pinred.Reduction(case.system), case.system
    model, data = system.model, system.model.createData()
    x, xdot, xi = case.x, case.xdot, case.xi
    pin.forwardKinematics(model, data, case.q, case.v)
    energy = 0.5 * float(model.armature @ case.v**2)
    momentum = pin.Force.Zero()  # of all bodies, in the root joint's fixed frame
    for i in range(1, model.njoints):
        h = model.inertias[i] * data.v[i]
        energy += 0.5 * data.v[i].dot(h)
        momentum += (model.jointPlacements[1].inverse() * data.oMi[i]).act(h)
    # A root joint sees the components of the wrench along its motion subspace.
    neutral = pin.neutral(model)
    pin.computeJointJacobians(model, data, neutral)
    S = np.array(data.joints[1].S).reshape(6, system.r)
    assert red.kinetic_energy(x, xdot, xi) == pytest.approx(energy, rel=1e-13)
    mu = red.body_momentum(x, xdot, xi)
    assert close(red.spatial_momentum(case.pose, mu), S.T @ momentum.vector, 1e-13)
    omega = red.locked_velocity(x, xdot, xi)
    assert close(red.locked_inertia(x) @ omega, mu, 1e-12)
    split = 0.5 * xdot @ red.reduced_metric(x) @ xdot + 0.5 * omega @ red.locked_inertia(x) @ omega
    assert split == pytest.approx(energy, rel=1e-12)


@settings(max_examples=8)
@given(cases())
def test_connection_equals_centroidal_map(case: Case) -> None:
    """For SE(3), A = A_g,b⁻¹ A_g,s with Pinocchio's centroidal momentum map at any pose."""
    if case.system.group is not pinred.lie.SE3:
        case = make_case("SE3", case.system.m, int(case.rng.integers(2**32)))
    model = case.system.model
    Ag = pin.computeCentroidalMap(model, model.createData(), case.q)
    expected = np.linalg.solve(Ag[:, :6], Ag[:, 6:])
    assert close(pinred.Reduction(case.system).local_connection(case.x), expected, 1e-11)


def difference(f: object, x: Array, step: float = 1e-3) -> Array:
    """Central differences of order six along each coordinate, derivative last."""
    assert callable(f)
    weights = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
    columns = []
    for e in np.eye(len(x)):
        parts = [w * (f(x + k * step * e) - f(x - k * step * e)) for k, w in weights.items()]
        columns.append(np.sum(parts, axis=0) / step)
    return np.stack(columns, axis=-1)


@settings(max_examples=8)
@given(cases(1, 6))
def test_derivatives_and_curvature_equal_differences(case: Case) -> None:
    """dI, dA, dM and B against central differences of I, A and M."""
    red, group, x = pinred.Reduction(case.system), case.system.group, case.x
    at = red.at(x)
    assert close(at.dI, difference(red.locked_inertia, x), 1e-9)
    assert close(at.dM, difference(red.reduced_metric, x), 1e-9)
    dA, A = difference(red.local_connection, x), red.local_connection(x)
    assert close(at.dA, dA, 1e-9)
    B = np.empty((case.system.r, case.system.m, case.system.m))
    for a in range(case.system.m):
        for b in range(case.system.m):
            B[:, a, b] = dA[:, b, a] - dA[:, a, b] - group.bracket(A[:, a], A[:, b])
    assert close(at.curvature, B, 1e-9)
    assert close(at.curvature, -np.swapaxes(at.curvature, 1, 2), 1e-12)


@settings(max_examples=8)
@given(cases(0, 6))
def test_at_agrees_with_single_methods(case: Case) -> None:
    """`at` agrees with the single methods, is frozen, and its arrays are read-only."""
    case.system.model.gravity.linear = np.zeros(3)
    springs = dict.fromkeys(case.system.shape_names[:2], (2.0, 0.3))
    red = pinred.Reduction(case.system, springs=springs)
    x, mu = case.x, case.xi
    at = red.at(x)
    for name in ("mass_matrix", "locked_inertia", "local_connection", "reduced_metric"):
        np.testing.assert_array_equal(getattr(at, name), getattr(red, name)(x))
        with pytest.raises(ValueError, match="read-only"):
            getattr(at, name)[...] = 0.0
    np.testing.assert_array_equal(at.curvature, red.curvature(x))
    assert at.potential == red.potential(x)
    assert at.amended_potential(mu) == red.amended_potential(x, mu)
    assert at.kinetic_energy(case.xdot, case.xi) == red.kinetic_energy(x, case.xdot, case.xi)
    with pytest.raises(AttributeError):
        at.x = x  # type: ignore[misc]


def test_at_calls_crba_once_and_rnea_derivatives_n_times() -> None:
    """`at` makes one CRBA and n RNEA-derivative calls, and no other call into Pinocchio."""
    system = pinred.load("cartpole")
    red = pinred.Reduction(system)
    calls: list[str] = []
    algorithms = [name for name in dir(pin) if callable(getattr(pin, name)) and name[0].islower()]

    def counted(name: str) -> object:
        original = getattr(pin, name)

        def call(*arguments: object) -> object:
            calls.append(name)
            return original(*arguments)

        return call

    with ExitStack() as stack:
        for name in algorithms:
            stack.enter_context(patch.object(pin, name, counted(name)))
        red.at(np.zeros(system.m))
    assert sorted(calls) == ["computeRNEADerivatives"] * system.n + ["crba"]


def test_changed_shape_array_gives_new_values() -> None:
    """The same shape array, changed in place, gives the values at its new entries."""
    system = pinred.load("coupled_spatial")
    red, x = pinred.Reduction(system), np.zeros(system.m)
    before = red.at(x)
    x[:] = 0.7
    after = red.at(x)
    fresh = pinred.Reduction(system).at(np.full(system.m, 0.7))
    assert np.abs(after.local_connection - before.local_connection).max() > 1e-3
    np.testing.assert_array_equal(after.local_connection, fresh.local_connection)


def test_singular_mass_matrix_raises_and_names_joint() -> None:
    """A mass matrix without full rank is refused, and the singular joint is named."""
    system = pinred.load("coupled_planar")
    for i in range(1, 3):  # after loading, past the checks: bodies without rotational inertia
        inertia = system.model.inertias[i]
        system.model.inertias[i] = pin.Inertia(inertia.mass, np.zeros(3), np.zeros((3, 3)))
    with pytest.raises(pinred.SingularInertiaError, match="hinge"):
        pinred.Reduction(system).local_connection([0.3])


@pytest.mark.parametrize(
    ("x", "words"),
    [
        ([0.1, 0.2], "expected 1 number: hinge, got 2"),
        ([[0.1]], r"got shape \(1, 1\)"),
        ([np.nan], "finite.*hinge.*nan"),
        ([np.inf], "finite.*inf"),
        (["a"], "numbers"),
    ],
)
def test_invalid_shape_raises_shape_error(x: Any, words: str) -> None:
    """A wrong length or a number that is not finite is refused by every method."""
    red = pinred.Reduction(pinred.load("coupled_planar"))
    for method in (red.mass_matrix, red.curvature, red.potential, red.at):
        with pytest.raises(pinred.ShapeError, match=words):
            method(x)
