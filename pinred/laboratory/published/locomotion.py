"""Locomotion and collisions: bodies in fluids, on wheels and on the ground.

Three planar links swim and roll, robots on wheels keep a momentum, bodies stick together, and feet
stop at the ground.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from ...analysis.connections.connection import Connection
from ...analysis.connections.drag_fluid_and_wheels import Ellipse, Ellipsoid, Rod, Wheel
from ...analysis.connections.mixed_connection import follow_mixed, mixed_connection, simulate_mixed
from ...analysis.phases.gait import Gait
from ...analysis.phases.phase import phase
from ...common.arrays import Array
from ...scene.scene import Scene
from ...scene.stop import Stop
from ...simulation.contact.capture import capture, land
from ...simulation.simulate import simulate
from ...system.load import load
from ...system.robot_description import Model
from .row import Numbers, numbers, row

HALF = 1.0 / 6.0  # half of the length of a link [m]
PLACES = {"rear": -HALF, "middle": 0.0, "front": HALF}  # centres in the frames of the links
CIRCLE = Gait.fourier([0.0, 0.0], [[1.0, 0.0]], [[0.0, 1.0]])
LAMB = "H. Lamb, Hydrodynamics, §71 and §114"


def centre_velocities(x: Array) -> list[Array]:
    """Return the planar twists of the centres in the axes of the links, (3, 5) per (ξ, ẋ)."""
    twists = [np.eye(3, 5)]
    for side, angle, column in ((-1.0, -x[0], 3), (1.0, x[1], 4)):
        c, s = np.cos(angle), np.sin(angle)
        J = np.zeros((3, 5))
        J[2, 2], J[2, column] = 1.0, side
        J[:2, :3] = np.array([[c, s], [-s, c]]) @ [[1.0, 0.0, 0.0], [0.0, 1.0, side * HALF]]
        J[1] += side * HALF * J[2]
        twists.append(J)
    return twists


def by_hand(x: Array, tensor: Array) -> Array:
    """Return A (3, 2) of Σ JᵀDJ, for a tensor D = diag (3,) at the centre of each link."""
    G = np.sum([J.T @ np.diag(tensor) @ J for J in centre_velocities(x)], axis=0)
    return np.asarray(np.linalg.solve(G[:3, :3], G[:3, 3:]))


def pose_by_hand(tensor: Array) -> Array:
    """Return the pose (3,) after the circle by SciPy."""

    def rate(t: float, pose: Array) -> Array:
        x, xdot = CIRCLE.at(t)
        twist = -by_hand(x, tensor) @ xdot
        c, s = np.cos(pose[2]), np.sin(pose[2])
        return np.array([c * twist[0] - s * twist[1], s * twist[0] + c * twist[1], twist[2]])

    solution = solve_ivp(rate, (0.0, 1.0), np.zeros(3), "DOP853", rtol=1e-13, atol=1e-15)
    return np.asarray(solution.y[:, -1])


def purcell(ratio: float) -> Connection:
    """Return Purcell's swimmer with a ratio of transverse to axial drag."""
    rods = {
        name: Rod(2.0 * HALF, across=ratio, along=1.0, centre=(at, 0.0, 0.0))
        for name, at in PLACES.items()
    }
    return Connection.viscous(load("purcell_swimmer"), rods)


@row("E. M. Purcell, Am. J. Phys. 45 (1977) 3", relative=1e-13)
def purcell_straight() -> Numbers:
    """Compare L/6 and 7/27, for either joint, with the connection.

    Returns:
        Purcell's swimmer, stretched out: sideways speed and turn of the body per rate of a joint.
    """
    expected = [1.0 / 18.0, 1.0 / 18.0, -7.0 / 27.0, 7.0 / 27.0]
    return numbers(expected, purcell(2.0).local([0.0, 0.0])[1:].ravel())


@row("L. E. Becker, S. A. Koehler, H. A. Stone, J. Fluid Mech. 490 (2003) 15", relative=1e-12)
def purcell_small_stroke() -> Numbers:
    """Compare 5 L (k − 1)/81, for drag ratio k and length L, with the curvature.

    Returns:
        Purcell's swimmer, stretched out: displacement per area of a small stroke, drag ratio 2
        [m].
    """
    B = purcell(2.0).curvature([0.0, 0.0])
    return numbers([5.0 / 243.0, 0.0, 0.0], B[:, 0, 1])


@row("E. M. Purcell, Am. J. Phys. 45 (1977) 3", relative=1e-11)
def purcell_circle() -> Numbers:
    """Compare resistive-force theory, integrated by SciPy, with the phase.

    Returns:
        Purcell's swimmer, drag ratio 2: displacement by a circle of 1 rad in its joints [m].
    """
    L = 2.0 * HALF
    expected = pose_by_hand(np.array([L, 2.0 * L, 2.0 * L**3 / 12.0]))
    return numbers(expected, phase(purcell(2.0), CIRCLE, tolerance=1e-12).pose)


@row(
    "E. Kanso, J. E. Marsden, C. W. Rowley, J. B. Melli-Huber, J. Nonlinear Sci. 15 (2005) 255",
    relative=1e-11,
)
def perfect_fluid_circle() -> Numbers:
    """Compare Kirchhoff's added masses, integrated by SciPy, with the phase.

    Returns:
        three ellipses of ratio 10 in a perfect fluid: pose after a circle of 1 rad.
    """
    a, b, L, density = HALF, 0.1 * HALF, 2.0 * HALF, 10.0
    added = [np.pi * b**2, np.pi * a**2, np.pi / 8.0 * (a**2 - b**2) ** 2]
    tensor = np.array([L, L, L**3 / 12.0]) + density * np.array(added)
    ellipses = {name: Ellipse(a, b, (at, 0.0, 0.0)) for name, at in PLACES.items()}
    fish = Connection.fluid(load("three_rods"), density, ellipses)
    return numbers(pose_by_hand(tensor), phase(fish, CIRCLE, tolerance=1e-12).pose)


@row(LAMB, relative=1e-12)
def spheroid() -> Numbers:
    """Compare Lamb's closed form with the added-mass tensor.

    Returns:
        prolate spheroid 2:1 in a perfect fluid: added masses and moment, relative to its own.
    """
    e = np.sqrt(0.75)
    log = np.log((1.0 + e) / (1.0 - e))
    p = 2.0 * (1.0 - e**2) / e**3 * (0.5 * log - e)
    q = 1.0 / e**2 - (1.0 - e**2) / (2.0 * e**3) * log
    turn = e**4 * (q - p) / ((2.0 - e**2) * (2.0 * e**2 - (2.0 - e**2) * (q - p)))
    volume = 4.0 / 3.0 * np.pi * 2.0
    added_masses = np.diag(Ellipsoid((2.0, 1.0, 1.0)).tensor) / volume
    return numbers([p / (2.0 - p), q / (2.0 - q), turn], added_masses[[0, 1, 5]])


@row("E. A. Shammas, H. Choset, A. A. Rizzi, Int. J. Robotics Res. 26 (2007) 1043", relative=1e-12)
def kinematic_snake() -> Numbers:
    """Compare the solution of two wheel constraints with the connection.

    Returns:
        kinematic snake of three links at (0.9, −0.4) rad: speed and turn per rate of each joint.
    """
    (c1, c2), (s1, s2) = np.cos([0.9, -0.4]), np.sin([0.9, -0.4])
    d = s2 * (1.0 + c1) - s1 * (1.0 + c2)
    expected = np.array([-HALF * (1.0 + c2), -HALF * (1.0 + c1), -s2, -s1]) / d
    wheels = [Wheel(name, (at, 0.0, 0.0)) for name, at in PLACES.items()]
    A = Connection.kinematic(load("purcell_swimmer"), wheels).local([0.9, -0.4])
    return numbers(expected, [*A[0], *A[2]])


@row(
    "Ju. I. Neimark, N. A. Fufaev, Dynamics of Nonholonomic Systems (1972); A. M. Bloch, "
    "Nonholonomic Mechanics and Control (2003)",
    relative=1e-10,
)
def chaplygin_sleigh() -> Numbers:
    """Compare c tanh κt and the Gudermannian with a simulation; a rotor stays at rest in space.

    Returns:
        Chaplygin's sleigh from a spin on the spot: speed [m/s] and heading [rad] after 3 s.
    """
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


@row("P. S. Krishnaprasad, D. P. Tsakiris, Dyn. Syst. 16 (2001) 347", relative=1e-10)
def roller_racer() -> Numbers:
    """Compare one equation for the forward speed, by SciPy, with the mixed connection.

    Returns:
        roller racer, steered by 0.6 sin 2πt rad: pose after 2 s [m, m, rad].
    """
    front, back = 0.5, 0.2  # from the rear axle to the hinge, and to the steered axle [m]
    mass, moment, arm_mass, arm = 3.0, 0.4, 0.5, 0.02
    robot = (
        Model("racer").body("seat", mass=mass, inertia=moment)
        .hinge("steer", parent="seat", axis="z", at=[front, 0.0, 0.0], mass=arm_mass, inertia=arm)
    )  # fmt: skip
    gait = Gait.fourier([0.0], [[0.0]], [[0.6]])

    def rate(t: float, y: Array) -> list[float]:
        phi, dphi = (float(coordinate[0]) for coordinate in gait.at(t))
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


@row(SNAKEBOARD, relative=1e-10)
def snakeboard_drive() -> Numbers:
    """Compare the pose after two cycles of the drive gait.

    Returns:
        snakeboard, axles and rotor at 1:1 (drive gait): pose after 2 cycles [m, m, rad].
    """
    return snakeboard(steering=1, spinning=1)


@row(SNAKEBOARD, relative=1e-10)
def snakeboard_rotate() -> Numbers:
    """Compare the pose after two cycles of the rotate gait.

    Returns:
        snakeboard, axles and rotor at 1:2 (rotate gait): pose after 2 cycles [m, m, rad].
    """
    return snakeboard(steering=1, spinning=2)


@row(SNAKEBOARD, relative=1e-10)
def snakeboard_park() -> Numbers:
    """Compare the pose after two cycles of the parking gait.

    Returns:
        snakeboard, axles and rotor at 2:3 (parking gait): pose after 2 cycles [m, m, rad].
    """
    return snakeboard(steering=2, spinning=3)


POINT = 1e-12  # moment of inertia of bodies that the sources take as points [kg m²]


@row(
    "R. A. Serway, J. W. Jewett, Physics for Scientists and Engineers (2008), example 11.9; "
    "C. E. Mungan, Perfectly inelastic collision between a disk and a stick (2012)",
    relative=1e-11,
)
def disc_and_stick() -> Numbers:
    """Compare a disc of 2 kg at 3 m/s, and a stick of 1 kg and 4 m at rest, with the book.

    Returns:
        a disc hits the end of a stick and sticks: speed of both [m/s], rotation [rad/s], loss [J].
    """
    still = (0.0, 0.0, 0.0)
    stick = Model("stick").body("stick", mass=1.0, inertia=1.0 * 4.0**2 / 12.0)
    stick = stick.fixed("end", parent="stick", at=[0.0, 2.0, 0.0])
    disc = Model("disc").body("disc", mass=2.0, inertia=POINT)
    both = capture(
        Scene(system=load(stick, group="SE2", gravity=still), xi0=[0.0, 0.0, 0.0]),
        Scene(
            system=load(disc, group="SE2", gravity=still),
            pose0=[0.0, 2.0, 0.0], xi0=[3.0, 0.0, 0.0],
        ),
        at="end", onto="disc",
    )  # fmt: skip
    rotation = both.instant.xi[2]
    centre = 2.0 * 2.0 / (2.0 + 1.0)  # of both, from the centre of the stick [m]
    speed = both.instant.xi[0] - centre * rotation
    return numbers([2.0, -1.0, 1.0], [speed, rotation, both.energy_lost])


@row("T. McGeer, Int. J. Robotics Res. 9 (1990) 62, on the rimless wheel", relative=1e-14)
def rimless_wheel() -> Numbers:
    """Compare (cos 2α + r²) / (1 + r²), for half an angle α of two spokes, with a landing.

    Returns:
        a wheel of six spokes, radius of gyration 0.4 m, rolls onto its next spoke: ratio of its
        angular velocities.
    """
    half, gyration, rate = np.pi / 6.0, 0.4, -1.3
    wheel = Model("wheel").body("hub", mass=5.0, inertia=5.0 * gyration**2)
    for name, angle in (("old", -half), ("new", half)):
        at = [np.sin(angle), -np.cos(angle), 0.0]
        wheel = wheel.fixed(name, parent="hub", at=at)
    # The hub turns about the old foot, at rate times its distance across.
    twist = [rate * -np.cos(half), rate * np.sin(half), rate]
    robot = load(wheel, group="SE2", gravity=(0.0, 0.0, 0.0))
    landing = land(Scene(system=robot, xi0=twist), "new")
    expected = (np.cos(2.0 * half) + gyration**2) / (1.0 + gyration**2)
    return numbers(expected, landing.instant.xi[2] / rate)


LIGHT = 1e-9  # mass of a foot of the walker, relative to that of its hip


@row(
    "M. Garcia, A. Chatterjee, A. Ruina, M. Coleman, J. Biomech. Eng. 120 (1998) 281", relative=1e-7
)
def simplest_walker() -> Numbers:
    """Compare cos 2θ θ̇ and cos 2θ (1 − cos 2θ) θ̇ with a landing of two legs with light feet.

    Returns:
        the simplest walking model at its heel strike, at a step of 0.2 rad and -0.2 rad/s: rates
        of the stance leg and between the legs [rad/s].
    """
    step, rate, swing = 0.2, -0.2, -0.7  # any rate of the swinging leg makes no difference
    point, foot = 1e-9 * LIGHT, [0.0, -1.0, 0.0]
    walker = Model("walker").body("hip", mass=1.0, inertia=point)
    for name in ("stance", "swing"):
        walker = walker.hinge(name, parent="hip", axis="z", mass=LIGHT, inertia=point, com=foot)
        walker = walker.fixed(f"{name}_foot", parent=name, at=foot)
    # Before the strike the hip turns about the foot of the stance leg, which is at the angle θ.
    robot = load(walker, group="SE2", gravity=(0.0, 0.0, 0.0))
    start = Scene(
        system=robot, x0=[step, -step], xdot0=[rate, rate - swing],
        xi0=[-rate * np.cos(step), -rate * np.sin(step), 0.0],
    )  # fmt: skip
    landing = land(start, "swing_foot")
    legs = landing.instant.xi[2] + landing.instant.xdot
    c = np.cos(2.0 * step)
    return numbers([c * rate, c * (1.0 - c) * rate], [legs[1], legs[1] - legs[0]])


@row(
    "A. D. Ames, S. Sastry, Hybrid Routhian reduction of Lagrangian hybrid systems, ACC (2006)",
    relative=1e-10,
)
def floor_pendulum() -> Numbers:
    """Compare quadratures of the reduced system, of one degree of freedom, with a simulation.

    Returns:
        a spherical pendulum that bounces from the floor with e = 0.6: times of three impacts [s],
        and the rate before the third [rad/s].
    """
    mass, length, shaft, gravity, e = 2.0, 0.7, 0.05, 9.81, 0.6
    lean, turning, floor = 0.5, 3.0, np.pi / 2.0
    inertia = mass * length**2
    momentum = (shaft + inertia * np.sin(lean) ** 2) * turning

    def amended(angle: float) -> float:
        across = shaft + inertia * np.sin(angle) ** 2
        return float(0.5 * momentum**2 / across + mass * gravity * length * np.cos(angle))

    def fall(top: float) -> float:
        """Return the time from rest at an angle to the floor; angles are top + width·s²."""
        width, energy = floor - top, amended(top)

        def slowness(s: float) -> float:
            drop = max(energy - amended(top + width * s**2), 1e-300)
            return float(2.0 * width * s / np.sqrt(2.0 * drop / inertia))

        return float(quad(slowness, 0.0, 1.0, epsabs=1e-13, epsrel=1e-13)[0])

    times, top, rates = [fall(lean)], lean, [np.nan]
    rates = [np.sqrt(2.0 * (amended(lean) - amended(floor)) / inertia)]
    for _ in range(2):
        rates.append(e * rates[-1])
        left = amended(floor) + 0.5 * inertia * rates[-1] ** 2
        top = brentq(lambda angle, left=left: amended(angle) - left, top, floor, xtol=1e-15)
        times.append(times[-1] + 2.0 * fall(top))
    model = Model("pendulum").body("shaft", mass=1.0, inertia=shaft)
    model = model.hinge(
        "lean", parent="shaft", axis="y", mass=mass, inertia=POINT, com=[0.0, 0.0, length]
    )
    robot = load(model, group="SO2", gravity=(0.0, 0.0, -gravity))
    traj = simulate(
        robot, x0=[lean], xdot0=[0.0], xi0=[turning], duration=times[-1] + 0.01, rtol=1e-13,
        atol=1e-15, stops={"lean": Stop(-3.0, floor, restitution=e)},
    )  # fmt: skip
    table = traj.impacts
    return numbers([*times, rates[-1]], [*table.t, table.rate_before[-1]])
