"""Turns of the body by motions of the joints: cats, hopper, diver, and arms of satellites."""

from __future__ import annotations

import casadi
import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

from ...common.arrays import Array
from ...forces.kinds import PotentialEnergy
from . import (
    Connection,
    Event,
    FloatingArm,
    Gait,
    Model,
    Reduction,
    load,
    phase,
    simulate,
)
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


VIRTUAL = (
    "Z. Vafa, S. Dubowsky, Int. J. Robotics Res. 9 (1990) 3; Y. Umetani, K. Yoshida, "
    "IEEE Trans. Robotics and Automation 5 (1989) 303"
)


@row(
    "dynamic-singularity",
    "planar arm of 40, 4 and 3 kg: second joint at a dynamic singularity, first at −65° [°]",
    "E. Papadopoulos, S. Dubowsky, J. Dyn. Sys., Meas., Control 115 (1993) 44",
    printed="-11.41",
)
def dynamic_singularity() -> Numbers:
    """Compare the printed angle with the root of the least singular value."""
    arm = FloatingArm(load("floating_arm"), "hand")
    (angle,) = arm.singular_values_of("q2", [np.radians(-65.0), 0.0], limits=(-1.5, 1.5))
    return numbers(-11.41, np.degrees(angle))


def virtual_jacobian(x: Array) -> Array:
    """Return the generalised Jacobian (2, 2) of the same arm by virtual links."""
    masses, moments = np.array([40.0, 4.0, 3.0]), np.diag([6.667, 0.333, 0.25])
    lever = np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 1.0, 0.5]])  # of the three centres
    mean = masses @ lever / masses.sum()
    K = (lever.T * masses) @ lever - masses.sum() * np.outer(mean, mean) + moments
    virtual = np.array([0.5, 1.0, 1.0]) - mean
    angle = np.array([0.0, x[0], x[0] + x[1]])
    inertia = (K * np.cos(angle[:, None] - angle)).sum(axis=1)
    joints = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])  # derivatives of the link angles
    rates = joints - np.outer(np.ones(3), inertia @ joints / inertia.sum())
    return np.asarray(np.array([-virtual * np.sin(angle), virtual * np.cos(angle)]) @ rates)


@row(
    "singular-angle",
    "the same angle, to all digits, by virtual links [°]",
    VIRTUAL,
    relative=1e-9,
)
def singular_angle() -> Numbers:
    """Compare the zero of the determinant of virtual links with the singular value."""
    first = np.radians(-65.0)
    expected = brentq(lambda q2: np.linalg.det(virtual_jacobian(np.array([first, q2]))), -0.5, 0.0,
                      xtol=1e-14)  # fmt: skip
    arm = FloatingArm(load("floating_arm"), "hand")
    (angle,) = arm.singular_values_of("q2", [first, 0.0], limits=(-1.5, 1.5))
    return numbers(np.degrees(expected), np.degrees(angle))


@row(
    "virtual-manipulator",
    "the same arm: its generalised Jacobian at (0.4, 0.9) rad, by virtual links [m]",
    VIRTUAL,
    relative=1e-13,
)
def virtual_manipulator() -> Numbers:
    """Compare virtual links about the centre of mass with the generalised Jacobian."""
    x = np.array([0.4, 0.9])
    arm = FloatingArm(load("floating_arm"), "hand")
    found = arm.generalized_jacobian(x, axes="world")[:2]
    return numbers(virtual_jacobian(x).ravel(), found.ravel())


@row(
    "spacedyn-one-link",
    "SpaceDyn's example of one link: rates of the base about y and z per joint rate",
    "SpaceDyn, Space Robotics Laboratory, Tohoku University, Set_global_value.py",
    relative=1e-13,
)
def spacedyn_one_link() -> Numbers:
    """Compare −5/36 and −13/36 with the connection."""
    robot = (
        Model("one_link").body("base", mass=100.0, inertia=10.0)
        .hinge("link", parent="base", axis="z", at=[0.0, 0.5, 0.0], mass=100.0, inertia=10.0,
               com=[0.0, 0.0, 0.5])
    )  # fmt: skip
    A = Reduction(load(robot)).local_connection([0.8])
    return numbers([-5.0 / 36.0, -13.0 / 36.0], -A[4:, 0])


@row(
    "satellite-arm",
    "satellite of 2500 kg, arm of 150 kg as ETS-VII: turn of the base by a loop of the arm [rad]",
    "K. Yoshida, Int. J. Robotics Res. 22 (2003) 321; numbers of our own",
    relative=1e-11,
)
def satellite_arm() -> Numbers:
    """Compare arctangents with the phase: a turn by 90°, out, back, and in."""
    mass, arm, at, reach = 2500.0, 150.0, 1.2, 1.0
    robot = (
        Model("satellite").body("base", mass=mass, inertia=2000.0)
        .hinge("shoulder", parent="base", axis="z", at=[at, 0.0, 0.0], mass=0.5 * arm, inertia=30.0)
        .slide("boom", parent="shoulder", axis="x", mass=0.5 * arm, inertia=20.0)
    )  # fmt: skip

    half = 0.5 * arm  # at the shoulder, so it moves with the base
    rest = mass + half
    e, lever = half * rest / (half + rest), at * mass / rest
    own = 2000.0 + mass * half / rest * at**2 + e * lever**2

    def by_shoulder(length: float) -> float:
        """Return the integral of A while the shoulder turns from 0 to 90°."""
        link, Q = 50.0 + e * length**2, 2.0 * e * lever * length
        P = own + link
        root = np.sqrt(P**2 - Q**2)
        return float(0.25 * np.pi + (link - own) / root * np.arctan(root / (P + Q)))

    def by_boom(length: float) -> float:
        """Return the integral of A while the boom at 90° grows from zero to a length."""
        scale = np.sqrt(e / (own + 50.0))
        return float(lever * scale * np.arctan(scale * length))

    changes = (by_shoulder(reach), by_boom(reach + 1.0) - by_boom(reach), -by_shoulder(reach + 1.0))
    connection = Connection.mechanical(load(robot, group="SE2"))
    moves = [{"shoulder": np.pi / 2}, {"boom": 1.0}, {"shoulder": -np.pi / 2}, {"boom": -1.0}]
    gait = Gait.strokes([0.0, reach], moves, connection.joints)
    return numbers(-sum(changes), phase(connection, gait).pose[2])
