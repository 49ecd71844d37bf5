"""Inverse dynamics with two derivatives, against Pinocchio's RNEA and central differences."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from assertions import close

import pinred
from pinred.common.arrays import Array
from pinred.planning.reorientation.flight_program import FlightDynamics, Instants
from pinred.reduction.tree.second_derivatives import InverseDynamics, Motion

ROBOTS = ["planar_chain5", "solo12", "gripper", "reaction_wheel_satellite", "elroys_beanie"]


def differences(values: object, z: Array, step: float = 1e-6) -> Array:
    """Return central differences of a function of (N, k) by its arguments, last axis."""
    columns = []
    for k in range(z.shape[1]):
        shift = np.zeros_like(z)
        shift[:, k] = step
        columns.append((values(z + shift) - values(z - shift)) / (2.0 * step))  # type: ignore[operator]
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.sampled
def test_inverse_dynamics_agrees_with_pinocchio_and_differences(robot: str) -> None:
    """Torques are RNEA's; derivatives are those of torques, and those of first derivatives."""
    system = pinred.load(robot)
    inverse, r, m = InverseDynamics(system), system.r, system.m
    random = np.random.default_rng(0)
    z = random.standard_normal((2, 2 * r + 3 * m))
    Y, y = random.standard_normal((2, r)), random.standard_normal((2, m))

    def at(z: Array) -> Motion:
        V, A, x, u, w = np.split(z, np.cumsum([r, r, m, m]), axis=1)
        return inverse.motion(inverse.bodies(x), V, A, u, w)

    def forces(z: Array) -> Array:
        motion = at(z)
        return np.hstack([motion.wrench, motion.torque])

    def gradient(z: Array) -> Array:
        weights = np.hstack([Y, y])
        return np.asarray(np.einsum("ni,nij->nj", weights, inverse.first(at(z))))

    model = system.model.copy()
    model.gravity = pin.Motion.Zero()
    data = model.createData()
    V, A, x, u, w = np.split(z, np.cumsum([r, r, m, m]), axis=1)
    for k in range(2):
        q = system.q(system.group.identity(), x[k])
        tau = pin.rnea(model, data, q, system.v(V[k], u[k]), system.v(A[k], w[k]))
        close(forces(z)[k], system.on_shape(system.sort_v(tau)), 1e-12)
    first, (by_twist, second) = inverse.first(at(z)), inverse.second(at(z), Y, y)
    scale = 1.0 + np.abs(first).max()
    close(first / scale, differences(forces, z) / scale, 1e-7)
    scale = 1.0 + np.abs(second).max()
    close(second / scale, differences(gradient, z) / scale, 1e-7)
    close(by_twist, gradient(z)[:, :r], 1e-12 * (1.0 + np.abs(by_twist).max()))


@pytest.mark.parametrize("robot", ["planar_chain5", "solo12", "elroys_beanie"])
def test_flight_dynamics_conserves_momentum_and_agrees_with_differences(robot: str) -> None:
    """The momentum is the stated one, the base has no wrench, and derivatives are exact."""
    system = pinred.load(robot)
    dynamics, m = FlightDynamics(system), system.m
    random = np.random.default_rng(1)
    x, u, w = random.standard_normal((3, 2, m))
    q = random.standard_normal((2, dynamics.size))
    q = q / np.linalg.norm(q, axis=1, keepdims=True) if dynamics.size == 4 else q
    L = random.standard_normal(dynamics.turns)
    on_rate = random.standard_normal((2, dynamics.size))
    on_torque = random.standard_normal((2, m))
    z = np.hstack([x, u, w, q])

    def at(z: Array) -> Instants:
        x, u, w, q = np.split(z, [m, 2 * m, 3 * m], axis=1)
        return dynamics.at(x, u, w, q, L)

    def outputs(z: Array) -> Array:
        state = at(z)
        return np.hstack([state.rate, state.torque])

    def gradient(z: Array) -> Array:
        slopes = dynamics.first(at(z))
        pulled = np.einsum("ni,nij->nj", on_rate, slopes.rate)
        return np.asarray(pulled + np.einsum("ni,nij->nj", on_torque, slopes.torque))

    state = dynamics.at(x, u, w, q, L)
    assert np.abs(state.motion.wrench).max() < 1e-11 * (1.0 + np.abs(state.torque).max())
    reduction = pinred.Reduction(system)
    for k in range(2):
        momentum = reduction.body_momentum(x[k], u[k], state.twist[k])
        close(np.linalg.norm(momentum[system.group.linear :]), np.linalg.norm(L), 1e-12)
        close(momentum[: system.group.linear], 0.0, 1e-12)
    slopes = dynamics.first(state)
    first = np.concatenate([slopes.rate, slopes.torque], axis=1)
    second = dynamics.second(state, slopes, on_rate, on_torque)
    for exact, values in ((first, outputs), (second, gradient)):
        scale = 1.0 + np.abs(exact).max()
        close(exact / scale, differences(values, z) / scale, 1e-7)
