"""Linear systems in expressions are solved with the same accuracy for robots in all units.

Entries of mass matrices, loop equations, slips and momenta have different units.  Their sizes
differ by 1e-9 for a robot of a millimetre and a gram.  Errors are in the robot's own units.
"""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from scaled_robots import Units, scaled, weld

import pinred
from pinred import poisson
from pinred.analysis.connections.drag_fluid_and_wheels import slip_matrix, slips_of
from pinred.common.arrays import Array
from pinred.forces.force_model import loop_motion
from pinred.kernels.connection.connection_form import velocity_graph
from pinred.kernels.reference_state import length_of, steps_of
from pinred.reduction.pointwise_reduction import mass_matrix
from pinred.system.loops.kinematics import loop_jacobian
from pinred.system.system import System

UNITS = [Units(1e-3, 1e-3), Units(1e3, 1e-3), Units(1.0, 1e3)]
EXACT = 1e-12  # largest error relative to the largest entry, in own units


def robot(kind: str, units: Units) -> tuple[System, Array, Array]:
    """Return a robot, its own unit of each velocity, (n,), and a shape near the neutral one."""
    system, _ = scaled(kind, units)
    steps, rng = steps_of(system, length_of(system)), np.random.default_rng(2)
    displacement = steps[system.r :] * rng.uniform(-0.5, 0.5, system.m)
    return system, steps, system.space.integrate(system.space.neutral, displacement)


def error(values: Any, expected: Array) -> float:
    """Return the largest difference relative to the largest expected entry."""
    return float(np.abs(np.asarray(values) - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("units", UNITS, ids=str)
@pytest.mark.parametrize("kind", ["tree", "balls"])
@pytest.mark.sampled(4)
def test_reduction_is_accurate_in_all_units(kind: str, units: Units) -> None:
    """Connection, metric and both Hamiltonians against the mass matrix without units."""
    system, steps, x = robot(kind, units)
    functions, r = pinred.casadi_functions(system), system.r
    H: Array = np.asarray(mass_matrix(system, x) * np.outer(steps, steps))
    A = np.asarray(np.linalg.solve(H[:r, :r], H[:r, r:]), dtype=np.float64)
    local = np.array(functions.local_connection(x)) / steps[:r, None] * steps[r:]
    assert error(local, A) < EXACT
    metric = np.array(functions.reduced_metric(x)) * np.outer(steps[r:], steps[r:])
    reduced: Array = np.asarray(H[r:, r:] - H[r:, :r] @ A)
    assert error(metric, reduced) < EXACT
    v = np.random.default_rng(3).normal(size=system.n)
    mu, pi = np.split(H @ v / steps, [r])
    energies = []
    shape_momentum = pi - np.array(functions.local_connection(x)).T @ mu
    for form, p in (("canonical", pi), ("connection", shape_momentum)):
        space = poisson.phase_space(system, form=form)  # type: ignore[arg-type]
        potential = ca.Function("h", [space.z], [space.hamiltonian])
        z, rest = np.concatenate([x, p, mu]), np.append(x, np.zeros(system.n))
        energies.append(float(potential(z) - potential(rest)))
    assert error(energies, np.full(2, 0.5 * v @ H @ v)) < EXACT


@pytest.mark.parametrize("length", [1e-3, 1e3])
def test_loop_motion_is_accurate_in_all_units(length: float) -> None:
    """Rates of dependent joints against loop equations, three lengths and angles, without units."""
    text = re.sub(
        'pos="([^"]*)"',
        lambda found: f'pos="{" ".join(repr(length * float(n)) for n in found[1].split())}"',
        weld(1),
    )
    system = pinred.load(text=text)
    assert system.closure is not None
    x, xdot = ca.SX.sym("x", system.nx), ca.SX.sym("xdot", system.m)
    symbols: Any = SimpleNamespace(x=x, xdot=xdot)
    G, _ = loop_motion(system, symbols, [0, 1])
    rates = np.ones(system.m)
    values = np.array(ca.Function("G", [x, xdot], [G])(system.closure.x, rates))
    J = loop_jacobian(system, system.closure.x)[system.closure.rows]
    J /= np.abs(J).max(axis=1)[:, None]
    assert error(values[2:], -np.linalg.solve(J[:, 2:], J[:, :2])) < EXACT


@pytest.mark.sampled(4)
@pytest.mark.parametrize("units", UNITS, ids=str)
@pytest.mark.parametrize("count", [1, 2, 5, 6])
def test_wheels_are_accurate_in_all_units(count: int, units: Units) -> None:
    """Twists and accelerations on wheels against multipliers of slips, without units.

    With p = Sᵀ μ = 0 the body momentum is Wᵀ λ; from rest, H v̇ = τ + Wᵀ λ.
    """
    system, steps, x = robot("tree", units)
    model, r, rng = system.model.copy(), system.r, np.random.default_rng(3)
    for i in range(1, model.njoints):
        model.addBodyFrame(f"leg{i}", i, pin.SE3.Identity(), 0)
    model.gravity.setZero()
    system = pinred.load(model)
    legs = [f"leg{1 + k % (model.njoints - 1)}" for k in range(count)]
    wheels = [
        pinred.Wheel(leg, units.length * rng.normal(size=3), rng.normal(size=3)) for leg in legs
    ]
    W = slip_matrix(system, slips_of(system, wheels), x) * steps
    W /= np.abs(W).max(axis=1)[:, None]
    H = mass_matrix(system, x) * np.outer(steps, steps)
    unit = H[0, 0]
    H, none = H / unit, np.zeros((count, count))
    on_base = np.block([[H[:r, :r], W[:, :r].T], [W[:, :r], none]])
    A = np.linalg.solve(on_base, np.vstack([H[:r, r:], W[:, r:]]))[:r]
    if count == r:
        form = pinred.Connection.kinematic(system, wheels).form
    else:
        mixed = pinred.mixed_connection(system, wheels)
        form = mixed.connection.form
        assert np.abs(W[:, :r] @ (mixed.free_motions(x) / steps[:r, None])).max() < EXACT
        torque = rng.normal(size=system.m)
        still = np.concatenate([x, np.zeros(system.m + mixed.size)])
        outputs = np.array(mixed._graph()(still, unit * torque / steps[r:])).ravel()
        forces = np.concatenate([np.zeros(r), torque, np.zeros(count)])
        expected = np.linalg.solve(np.block([[H, W.T], [W, none]]), forces)[r : system.n]
        accelerations = outputs[1 + r + mixed.size : -1] / steps[r:]
        assert error(accelerations, expected) < EXACT
    rates = rng.normal(size=system.m)
    outputs = np.array(velocity_graph(form)(np.append(x, steps[r:] * rates), 0.0)).ravel()
    assert error(outputs[:r] / steps[:r], -A @ rates) < EXACT
    assert np.abs(outputs[r]) > 1e-4  # health


def test_free_motions_have_the_units_of_the_robot() -> None:
    """Twists on a wheel of a scaled robot are those of the robot, times its units."""
    motions = []
    for length in (1.0, 2.0**-10):
        system, _, _ = robot("tree", Units(length))
        model = system.model.copy()
        model.addBodyFrame("leg", 2, pin.SE3.Identity(), 0)
        wheel = pinred.Wheel("leg", (0.1 * length, 0.0, 0.2 * length))
        mixed = pinred.mixed_connection(pinred.load(model), [wheel])
        motions.append(mixed.free_motions(system.space.neutral))
    np.testing.assert_allclose(motions[1][:3], 2.0**-10 * motions[0][:3], rtol=0, atol=1e-15)
    np.testing.assert_allclose(motions[1][3:], motions[0][3:], rtol=0, atol=1e-12)


def test_wheels_of_a_millimetre_are_accepted() -> None:
    """The machine code of a small robot on two wheels agrees with Pinocchio."""
    system, _, _ = robot("tree", UNITS[0])
    model = system.model.copy()
    model.addBodyFrame("leg", 2, pin.SE3.Identity(), 0)
    model.gravity.setZero()
    wheels = [pinred.Wheel("leg", 1e-3 * np.eye(3)[k], np.eye(3)[k - 1]) for k in range(2)]
    mixed = pinred.mixed_connection(pinred.load(model), wheels)
    assert np.isfinite(mixed.local(system.space.neutral)).all()
