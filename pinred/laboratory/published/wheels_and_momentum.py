"""Robots on wheels that keep a momentum: sleigh, roller racer and snakeboard."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from ...common.arrays import Array
from .public_names import Gait, Model, Wheel, follow_mixed, load, mixed_connection, simulate_mixed
from .row import Numbers, numbers, row


@row(
    "chaplygin-sleigh",
    "Chaplygin's sleigh from a spin on the spot: speed [m/s] and heading [rad] after 3 s",
    "Ju. I. Neimark, N. A. Fufaev, Dynamics of Nonholonomic Systems (1972); A. M. Bloch, "
    "Nonholonomic Mechanics and Control (2003)",
    relative=1e-10,
)
def chaplygin_sleigh() -> Numbers:
    """Compare c tanh κt and the Gudermannian with a simulation; a rotor stays at rest in space."""
    mass, moment, a, c, t = 3.0, 0.5, 0.4, 0.9, 3.0
    robot = (
        Model("sleigh").body("sleigh", mass=mass - 1.0, inertia=moment, com=[a, 0.0, 0.0])
        .hinge("rotor", parent="sleigh", axis="z", at=[a, 0.0, 0.0], mass=1.0, inertia=0.1)
    )  # fmt: skip
    kappa = mass * a * c / (moment + mass * a**2)
    spin = np.sqrt(c * kappa / a)
    expected = [c * np.tanh(kappa * t), 2.0 * spin / kappa * np.arctan(np.tanh(0.5 * kappa * t))]
    mixed = mixed_connection(load(robot, group="SE2"), [Wheel("sleigh")])
    rest = [0.0], [-spin]
    p0 = mixed.momentum(*rest, [0.0, 0.0, spin])
    motion = simulate_mixed(mixed, *rest, p0, times=[0.0, t])
    speed = mixed.velocity(motion.x[-1], motion.xdot[-1], motion.p[-1])[0]
    return numbers(expected, [speed, motion.pose[-1, 2]])


def planar_rate(heading: float, speed: float, turn: float) -> list[float]:
    """Return the rates of place and heading of a body that does not slip sideways."""
    return [np.cos(heading) * speed, np.sin(heading) * speed, turn]


@row(
    "roller-racer",
    "roller racer, steered by 0.6 sin 2πt rad: pose after 2 s [m, m, rad]",
    "P. S. Krishnaprasad, D. P. Tsakiris, Dyn. Syst. 16 (2001) 347",
    relative=1e-10,
)
def roller_racer() -> Numbers:
    """Compare one equation for the forward speed, by SciPy, with the mixed connection."""
    front, back = 0.5, 0.2  # from the rear axle to the hinge, and to the steered axle [m]
    mass, moment, arm_mass, arm = 3.0, 0.4, 0.5, 0.02
    robot = (
        Model("racer").body("seat", mass=mass, inertia=moment)
        .hinge("steer", parent="seat", axis="z", at=[front, 0.0, 0.0], mass=arm_mass, inertia=arm)
    )  # fmt: skip
    gait = Gait.fourier([0.0], [[0.0]], [[0.6]])

    def rate(t: float, y: Array) -> list[float]:
        phi, dphi = (float(each[0]) for each in gait.at(t))
        ddphi = -((2.0 * np.pi) ** 2) * phi
        s, b = np.sin(phi), front * np.cos(phi) + back
        ds, db = np.cos(phi) * dphi, -front * s * dphi
        turn = (s * y[3] - back * dphi) / b
        # The rate of the turn is (s/b) v̇ + bias.
        bias = (ds * y[3] - back * ddphi - db * turn) / b
        total = moment + arm + arm_mass * front**2
        push = s * (total * bias + arm * ddphi) + arm_mass * front * back * turn * dphi
        speed_rate = -push / (b * (mass + arm_mass) + total * s**2 / b)
        return [*planar_rate(y[2], y[3], turn), speed_rate]

    expected = solve_ivp(rate, (0.0, 2.0), np.zeros(4), "DOP853", rtol=1e-13, atol=1e-14).y[:3, -1]
    wheels = [Wheel("seat"), Wheel("steer", (back, 0.0, 0.0))]
    mixed = mixed_connection(load(robot, group="SE2"), wheels)
    return numbers(expected, follow_mixed(mixed, gait, times=[0.0, 2.0]).pose[-1])


def snakeboard(steering: int, spinning: int) -> Numbers:
    """Return the pose after two cycles: v = −(J_r/(m l)) cos φ ∫ sin φ ψ̈ dt, and the motion.

    Args:
        steering: Periods of the axles φ per cycle.
        spinning: Periods of the rotor ψ per cycle.
    Returns:
        The pose by SciPy and by the mixed connection.
    """
    l, mass, rotor = 0.5, 8.0, 0.1
    board = mass * l**2 - rotor - 2.0 * (0.01 + l**2)  # so that the whole moment is m l²
    model = Model("snakeboard").body("board", mass=4.0, inertia=board)
    model = model.hinge("rotor", parent="board", axis="z", mass=2.0, inertia=rotor)
    for name, at in (("rear", -l), ("front", l)):
        model = model.hinge(name, parent="board", axis="z", at=[at, 0.0, 0.0], mass=1.0,
                            inertia=0.01)  # fmt: skip
    mixed = mixed_connection(load(model, group="SE2"), [Wheel("rear"), Wheel("front")])
    sin = np.zeros((3, 3))
    parts = ("rotor", 0.9, spinning), ("rear", -0.5, steering), ("front", 0.5, steering)
    for name, amplitude, harmonic in parts:
        sin[harmonic - 1, mixed.system.shape_names.index(name)] = amplitude
    gait = Gait.fourier([0.0] * 3, np.zeros((3, 3)), sin)

    def rate(t: float, y: Array) -> list[float]:
        steer = 0.5 * np.sin(2.0 * np.pi * steering * t)
        turns = 2.0 * np.pi * spinning
        speed = -rotor / (mass * l) * np.cos(steer) * y[3]
        push = -0.9 * turns**2 * np.sin(turns * t) * np.sin(steer)
        return [*planar_rate(y[2], speed, np.tan(steer) * speed / l), push]

    solution = solve_ivp(rate, (0.0, 2.0), np.zeros(4), "DOP853", rtol=1e-13, atol=1e-14)
    return numbers(solution.y[:3, -1], follow_mixed(mixed, gait, times=[0.0, 2.0]).pose[-1])


SNAKEBOARD = (
    "J. P. Ostrowski, A. Lewis, R. Murray, J. Burdick, Proc. IEEE Int. Conf. Robotics and "
    "Automation (1994) 2391"
)


@row(
    "snakeboard-drive",
    "snakeboard, axles and rotor at 1:1 (drive gait): pose after 2 cycles [m, m, rad]",
    SNAKEBOARD,
    relative=1e-10,
)
def snakeboard_drive() -> Numbers:
    """Compare the pose after two cycles of the drive gait."""
    return snakeboard(steering=1, spinning=1)


@row(
    "snakeboard-rotate",
    "snakeboard, axles and rotor at 1:2 (rotate gait): pose after 2 cycles [m, m, rad]",
    SNAKEBOARD,
    relative=1e-10,
)
def snakeboard_rotate() -> Numbers:
    """Compare the pose after two cycles of the rotate gait."""
    return snakeboard(steering=1, spinning=2)


@row(
    "snakeboard-park",
    "snakeboard, axles and rotor at 2:3 (parking gait): pose after 2 cycles [m, m, rad]",
    SNAKEBOARD,
    relative=1e-10,
)
def snakeboard_park() -> Numbers:
    """Compare the pose after two cycles of the parking gait."""
    return snakeboard(steering=2, spinning=3)


ROWS = (chaplygin_sleigh, roller_racer, snakeboard_drive, snakeboard_rotate, snakeboard_park)
