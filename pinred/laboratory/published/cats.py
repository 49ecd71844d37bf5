"""Turns at zero angular momentum: the beanie, the falling cat, the hopper and the diver."""

from __future__ import annotations

import casadi
import numpy as np
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

from ...common.arrays import Array
from ...forces.kinds import PotentialEnergy
from .public_names import Connection, Event, Gait, Model, load, phase, simulate
from .row import Numbers, numbers, row

BEANIE = "J. E. Marsden, R. Montgomery, T. S. Ratiu, Memoirs AMS 436 (1990)"
CAT = "T. R. Kane, M. P. Scher, Int. J. Solids Structures 5 (1969) 663"
RATIO = 0.4  # axial over transverse moment of half a cat, robots/falling_cat_ball


@row(
    "beanie-turn",
    "Elroy's beanie: rotation of the boy by one turn of the propeller [rad]",
    BEANIE,
    relative=1e-13,
)
def beanie_turn() -> Numbers:
    """Compare −2π I₂/(I₁ + I₂), for I₁ = 2 and I₂ = 1, with the phase of one turn."""
    connection = Connection.mechanical(load("elroys_beanie"))
    turn = phase(connection, Gait.waypoints([[0.0]], turns=[1]))
    return numbers(-2.0 * np.pi / 3.0, turn.pose[0])


@row(
    "beanie-swing",
    "Elroy's beanie with V = −3 cos θ₂, amplitude 2 rad: period [s]",
    BEANIE,
    relative=1e-11,
)
def beanie_swing() -> Numbers:
    """Compare 4 K(sin² 1)/ω₀, with ω₀² = k (I₁ + I₂)/(I₁ I₂), with a simulation."""
    period = 4.0 * ellipk(np.sin(1.0) ** 2) / np.sqrt(3.0 * 3.0 / 2.0)
    robot = load("elroys_beanie")
    well = PotentialEnergy(lambda x: -3.0 * casadi.cos(x[0]))
    middle = Event(lambda _t, x, _xdot, _mu: x[0], "middle", direction=-1)
    traj = simulate(robot, x0=[2.0], xdot0=[0.0], xi0=[0.4], duration=2.0 * period, forces=[well],
                    events=[middle], rtol=1e-13, atol=1e-15)  # fmt: skip
    times = traj.events["middle"].t
    return numbers(period, times[1] - times[0])


def rolling(bend: Array, heading: Array) -> Gait:
    """Return the gait of a cat whose bend rolls without twist, from samples over one cycle."""
    samples = bend[:, None] * np.stack([0.0 * heading, np.cos(heading), np.sin(heading)], axis=1)
    modes = np.fft.rfft(samples, axis=0)[: len(samples) // 4] / len(samples)
    return Gait.fourier(modes[0].real, 2.0 * modes[1:].real, -2.0 * modes[1:].imag)


def roll_rate(bend: float) -> float:
    """Return the turn of the bisector per radian of heading: k c/(k c² + s²)."""
    c, s = np.cos(0.5 * bend), np.sin(0.5 * bend)
    return float(RATIO * c / (RATIO * c**2 + s**2))


@row(
    "cat-equal-bends",
    "falling cat, bent by 76.3° to all sides in turn: rotation, half a turn [rad]",
    "R. Montgomery, Fields Inst. Commun. 1 (1993) 193",
    relative=1e-12,
)
def cat_equal_bends() -> Numbers:
    """Compare π, for cos(b) = (√(k² − k + 1) − k)/(1 − k), with the phase of the circle."""
    half = np.arccos((np.sqrt(RATIO**2 - RATIO + 1.0) - RATIO) / (1.0 - RATIO))
    heading = 2.0 * np.pi * np.arange(16) / 16
    gait = rolling(np.full(16, 2.0 * half), heading)
    connection = Connection.mechanical(load("falling_cat_ball"))
    return numbers(np.pi, phase(connection, gait).screw.angle)


@row(
    "kane-scher-cat",
    "Kane and Scher's cat, bent by 100° forward and 20° backward: rotation [rad]",
    CAT,
    relative=1e-10,
)
def kane_scher_cat() -> Numbers:
    """Compare ∫ (1 − k c/(k c² + s²)) dφ over a cone with the phase of pinred."""
    tilt, cone = np.radians(40.0), np.radians(60.0)

    def spine(theta: Array) -> tuple[Array, Array]:
        """Return bend and heading of the rear axis on its cone."""
        across = np.sin(cone) * np.sin(theta)
        ahead = np.sin(tilt) * np.cos(cone) + np.cos(tilt) * np.sin(cone) * np.cos(theta)
        along = np.cos(tilt) * np.cos(cone) - np.sin(tilt) * np.sin(cone) * np.cos(theta)
        return np.arctan2(np.hypot(ahead, across), along), np.arctan2(across, ahead)

    def slope(theta: float) -> float:
        step = 1e-3 * np.array([-3, -2, -1, 1, 2, 3])
        heading = np.unwrap(spine(theta + step)[1])
        return float(np.dot([-1, 9, -45, 45, -9, 1], heading)) / 0.06

    expected = quad(
        lambda t: (1.0 - roll_rate(float(spine(np.array(t))[0]))) * slope(t), 0.0, 2.0 * np.pi,
        epsabs=1e-12, epsrel=1e-12, limit=200,
    )[0]  # fmt: skip
    theta = 2.0 * np.pi * np.arange(400) / 400
    connection = Connection.mechanical(load("falling_cat_ball"))
    angle = phase(connection, rolling(*spine(theta))).screw.angle
    return numbers(expected, angle)


@row(
    "hopper",
    "hopper in flight: rotation of the body by a rectangle of hip angle and leg length [rad]",
    "Z. Li, R. Montgomery, Proc. IEEE Int. Conf. Robotics and Automation (1990)",
    relative=1e-12,
)
def hopper() -> Numbers:
    """Compare −Δψ (A(l₁) − A(l₂)) with the phase of four strokes."""
    robot = (
        Model("hopper").body("trunk", mass=10.0, inertia=1.0)
        .hinge("hip", parent="trunk", axis="z", mass=0.5, inertia=0.02)
        .slide("leg", parent="hip", axis="x", at=[0.5, 0.0, 0.0], mass=1.0, inertia=0.01)
    )  # fmt: skip

    def share(length: float) -> float:
        leg = 0.03 + 1.0 * 10.5 / 11.5 * length**2
        return leg / (1.0 + leg)

    connection = Connection.mechanical(load(robot, group="SE2"))
    moves = [{"hip": 1.5}, {"leg": 0.4}, {"hip": -1.5}, {"leg": -0.4}]
    gait = Gait.strokes([0.0, 0.0], moves, connection.joints)
    return numbers(1.5 * (share(0.9) - share(0.5)), phase(connection, gait).pose[2])


@row(
    "diver-arm",
    "diver who swings one arm down through half a turn: tilt of the body [rad]",
    "H. R. Dullin, W. Tong, SIAM J. Appl. Dyn. Syst. 15 (2016) 1806",
    relative=1e-10,
)
def diver_arm() -> Numbers:
    """Compare an arctangent with a simulation of robots/diver at zero momentum."""
    shoulder, arm = np.array([0.2, 0.45]), np.array([0.0, -0.3])  # across and up [m]
    parts = ((42.0, [0.0, 0.2], 2.2), (25.0, [0.0, -0.5], 1.6), (4.0, [-0.2, 0.75], 0.12))
    mass = sum(part[0] for part in parts)
    centre = np.asarray(sum(m * np.array(c) for m, c, _ in parts)) / mass
    own = sum(moment + m * np.sum((np.array(c) - centre) ** 2) for m, c, moment in parts)
    out, e = shoulder - centre, 4.0 * mass / (4.0 + mass)
    P = own + 0.12 + e * (out @ out + arm @ arm)
    Q = 2.0 * e * np.hypot(*out) * np.hypot(*arm)
    least = np.arctan2(out[1], out[0]) - np.arctan2(arm[1], arm[0])
    angles = np.array([0.0, np.pi]) - least
    turns = np.floor((angles + np.pi) / (2.0 * np.pi))
    root = np.sqrt(P**2 - Q**2)
    primitive = 2.0 / root * (np.arctan(root / (P + Q) * np.tan(0.5 * angles)) + np.pi * turns)
    more = 0.12 - own + e * (arm @ arm - out @ out)
    tilt = 0.5 * (np.pi + more * (primitive[1] - primitive[0]))
    robot = load("diver", lock={"hips": [0, 0, 0], "right_shoulder": [np.pi, 0, 0]})
    swing = {"left_shoulder": [f"{np.pi!r}*(1 + cos({np.pi!r}*t))/2", "0*t", "0*t"]}
    traj = simulate(robot, prescribed=swing, momentum=0, duration=1.0, rtol=1e-13, atol=1e-15)
    return numbers([tilt, 0.0, 0.0], Rotation.from_quat(traj.pose[-1, 3:]).as_rotvec())


ROWS = (beanie_turn, beanie_swing, cat_equal_bends, kane_scher_cat, hopper, diver_arm)
