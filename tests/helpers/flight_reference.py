"""Flights of least torque by another transcription, in CasADi with its own derivatives.

States are shape, rate and angle of the base; controls are accelerations, which are linear in each
step.  Torques and momenta are those of the Lagrangian in world coordinates.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

import pinred
from pinred.common.arrays import Array


def least_torque(
    system: pinred.System,
    plan: pinred.FlightPlan,
    *,
    limit: float,
    torque: float,
    starts: int,
    steps: int = 32,
) -> Array:
    """Solve the flight of a plan from random starts, for a robot in the plane.

    Args:
        system: The robot.
        plan: The plan, of which only the request is used.
        limit: Largest size of the joint angles [rad].
        torque: Largest torque [N·m].
        starts: Number of starts.
        steps: Number of steps of the trapezoidal rule for torques and of Simpson's for the angle.
    Returns:
        Means over time of the sum of squared torques; NaN for starts that failed, (starts,).
    """
    node, m = _node(system), system.m
    nodes, h = 2 * steps + 1, plan.duration / steps
    inertia = pinred.Reduction(system).locked_inertia(plan.shapes[0])
    lever = np.linalg.solve(inertia[:2, :2], plan.momentum[:2])
    L = float(plan.momentum[2] - inertia[2, :2] @ lever)
    opti = ca.Opti()
    x, u, theta = opti.variable(m, steps + 1), opti.variable(m, steps + 1), opti.variable(steps + 1)
    a = opti.variable(m, steps + 1)
    weights = np.tile([2.0, 4.0], nodes)[:nodes] / (6 * steps)
    weights[[0, -1]] = 1.0 / (6 * steps)
    cost, rates = ca.MX(0), []
    opti.subject_to(theta[0] == 0.0)
    for k in range(nodes):
        i = k // 2
        if k % 2:  # the middle of a step with linear acceleration
            xk = (
                x[:, i] + h / 2 * u[:, i] + h**2 / 8 * a[:, i] + h**2 / 48 * (a[:, i + 1] - a[:, i])
            )
            uk = u[:, i] + h / 2 * a[:, i] + h / 8 * (a[:, i + 1] - a[:, i])
            tau, rate = node(xk, uk, 0.5 * (a[:, i] + a[:, i + 1]), L)
        else:
            tau, rate = node(x[:, i], u[:, i], a[:, i], L)
            xk = x[:, i]
        cost += float(weights[k]) * ca.sumsqr(tau)
        rates.append(rate)
        opti.subject_to(opti.bounded(-torque, tau, torque))
        if 0 < k < nodes - 1:
            opti.subject_to(opti.bounded(-limit, xk, limit))
    for i in range(steps):
        opti.subject_to(u[:, i + 1] == u[:, i] + h / 2 * (a[:, i] + a[:, i + 1]))
        end = x[:, i] + h * u[:, i] + h**2 / 3 * a[:, i] + h**2 / 6 * a[:, i + 1]
        opti.subject_to(x[:, i + 1] == end)
        r0, r1, r2 = rates[2 * i : 2 * i + 3]
        opti.subject_to(theta[i + 1] == theta[i] + h / 6 * (r0 + 4 * r1 + r2))
    for k, shape in ((0, plan.shapes[0]), (steps, plan.shapes[-1])):
        opti.subject_to(x[:, k] == shape)
        opti.subject_to(u[:, k] == 0.0)
    opti.subject_to(theta[steps] == float(plan.aim.attitude[0]))
    opti.minimize(cost)
    opti.solver(
        "ipopt", {"print_time": False, "expand": False}, {"print_level": 0, "max_iter": 300}
    )
    costs = []
    s = np.linspace(0.0, 1.0, steps + 1)
    for seed in range(starts):
        rng = np.random.default_rng(seed + 100)
        wave = sum(np.outer(rng.uniform(-1, 1, m), np.sin(np.pi * k * s)) for k in (1, 2, 3))
        opti.set_initial(x, np.clip(plan.shapes[0][:, None] + 0.3 * wave, -limit, limit))
        opti.set_initial(u, 0.0)
        opti.set_initial(a, 0.0)
        opti.set_initial(theta, s * float(plan.aim.attitude[0]))
        try:
            costs.append(float(opti.solve().value(cost)))
        except RuntimeError:
            costs.append(np.nan)
    return np.array(costs)


def _node(system: pinred.System) -> ca.Function:
    """Return torques and base rate of a robot in the plane for (x, ẋ, ẍ, L)."""
    m = system.m
    y, v, a = (ca.SX.sym(name, 3 + m) for name in "yva")  # (position, angle, shape), rates
    energy = _kinetic_energy(system, y, v)
    momenta = ca.gradient(energy, v)
    forces = ca.jtimes(momenta, ca.vertcat(y, v), ca.vertcat(v, a)) - ca.gradient(energy, y)
    x, u, w = (ca.SX.sym(name, m) for name in "xuw")
    L, at, none = ca.SX.sym("L"), ca.vertcat(0, 0, 0, x), ca.SX.zeros(3)
    function = ca.Function("equations", [y, v, a], [momenta, forces])
    H = ca.Function("H", [y], [ca.hessian(energy, v)[0]])(at)[:3, :3]
    rates = ca.solve(H, ca.vertcat(0, 0, L) - function(at, ca.vertcat(none, u), 0)[0][:3])
    v = ca.vertcat(rates, u)
    base = -ca.solve(H, function(at, v, ca.vertcat(none, w))[1][:3])
    tau = function(at, v, ca.vertcat(base, w))[1][3:]
    return ca.Function("node", [x, u, w, L], [tau, rates[2]])


def _kinetic_energy(system: pinred.System, y: ca.SX, v: ca.SX) -> ca.SX:
    """Return the kinetic energy of planar bodies in a chain of revolute joints."""
    model, energy = system.sorted_model, ca.SX(0)
    places, angles = {1: y[:2]}, {1: y[2]}
    for i in range(1, model.njoints):
        if i > 1:
            parent, place = int(model.parents[i]), model.jointPlacements[i]
            assert np.allclose(place.rotation, np.eye(3))
            places[i] = places[parent] + _turned(angles[parent], place.translation)
            angles[i] = angles[parent] + y[3 + i - 2]
        body = model.inertias[i]
        centre = places[i] + _turned(angles[i], body.lever)
        speed = ca.jtimes(centre, y, v)
        turn = ca.jtimes(angles[i], y, v)
        energy += 0.5 * body.mass * ca.sumsqr(speed) + 0.5 * float(body.inertia[2, 2]) * turn**2
    return energy


def _turned(angle: ca.SX, point: Array) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    column: ca.SX = ca.vertcat(c * point[0] - s * point[1], s * point[0] + c * point[1])
    return column
