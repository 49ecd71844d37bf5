"""Arms on free-floating satellites."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from ...common.arrays import Array
from .public_names import Connection, FloatingArm, Gait, Model, Reduction, load, phase
from .row import Numbers, numbers, row

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


ROWS = (
    dynamic_singularity, singular_angle, virtual_manipulator, spacedyn_one_link, satellite_arm,
)  # fmt: skip
