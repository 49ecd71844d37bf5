"""Collisions: bodies that stick together, feet that stop at the ground, and a rebound."""

from __future__ import annotations

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from . import Model, Scene, Stop, capture, land, load, simulate
from .row import Numbers, numbers, row

POINT = 1e-12  # moment of inertia of bodies that the sources take as points [kg m²]


@row(
    "disc-and-stick",
    "a disc hits the end of a stick and sticks: speed of both [m/s], rotation [rad/s], loss [J]",
    "R. A. Serway, J. W. Jewett, Physics for Scientists and Engineers (2008), example 11.9; "
    "C. E. Mungan, Perfectly inelastic collision between a disk and a stick (2012)",
    relative=1e-11,
)
def disc_and_stick() -> Numbers:
    """Compare a disc of 2 kg at 3 m/s, and a stick of 1 kg and 4 m at rest, with the book."""
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


@row(
    "rimless-wheel",
    "a wheel of six spokes, radius of gyration 0.4 m, rolls onto its next spoke: ratio of its "
    "angular velocities",
    "T. McGeer, Int. J. Robotics Res. 9 (1990) 62, on the rimless wheel",
    relative=1e-14,
)
def rimless_wheel() -> Numbers:
    """Compare (cos 2α + r²) / (1 + r²), for half an angle α of two spokes, with a landing."""
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
    "simplest-walker",
    "the simplest walking model at its heel strike, at a step of 0.2 rad and -0.2 rad/s: rates of "
    "the stance leg and between the legs [rad/s]",
    "M. Garcia, A. Chatterjee, A. Ruina, M. Coleman, J. Biomech. Eng. 120 (1998) 281",
    relative=1e-7,
)
def simplest_walker() -> Numbers:
    """Compare cos 2θ θ̇ and cos 2θ (1 − cos 2θ) θ̇ with a landing of two legs with light feet."""
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
    "floor-pendulum",
    "a spherical pendulum that bounces from the floor with e = 0.6: times of three impacts [s], "
    "and the rate before the third [rad/s]",
    "A. D. Ames, S. Sastry, Hybrid Routhian reduction of Lagrangian hybrid systems, ACC (2006)",
    relative=1e-10,
)
def floor_pendulum() -> Numbers:
    """Compare quadratures of the reduced system, of one degree of freedom, with a simulation."""
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
