"""Three equal planar links in a viscous fluid, in a perfect fluid, and on wheels."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from ...common.arrays import Array
from .public_names import Connection, Ellipse, Ellipsoid, Gait, Rod, Wheel, load, phase
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


@row(
    "purcell-straight",
    "Purcell's swimmer, stretched out: sideways speed and turn of the body per rate of a joint",
    "E. M. Purcell, Am. J. Phys. 45 (1977) 3",
    relative=1e-13,
)
def purcell_straight() -> Numbers:
    """Compare L/6 and 7/27, for either joint, with the connection."""
    expected = [1.0 / 18.0, 1.0 / 18.0, -7.0 / 27.0, 7.0 / 27.0]
    return numbers(expected, purcell(2.0).local([0.0, 0.0])[1:].ravel())


@row(
    "purcell-small-stroke",
    "Purcell's swimmer, stretched out: displacement per area of a small stroke, drag ratio 2 [m]",
    "L. E. Becker, S. A. Koehler, H. A. Stone, J. Fluid Mech. 490 (2003) 15",
    relative=1e-12,
)
def purcell_small_stroke() -> Numbers:
    """Compare 5 L (k − 1)/81, for drag ratio k and length L, with the curvature."""
    B = purcell(2.0).curvature([0.0, 0.0])
    return numbers([5.0 / 243.0, 0.0, 0.0], B[:, 0, 1])


@row(
    "purcell-circle",
    "Purcell's swimmer, drag ratio 2: displacement by a circle of 1 rad in its joints [m]",
    "E. M. Purcell, Am. J. Phys. 45 (1977) 3",
    relative=1e-11,
)
def purcell_circle() -> Numbers:
    """Compare resistive-force theory, integrated by SciPy, with the phase."""
    L = 2.0 * HALF
    expected = pose_by_hand(np.array([L, 2.0 * L, 2.0 * L**3 / 12.0]))
    return numbers(expected, phase(purcell(2.0), CIRCLE, tolerance=1e-12).pose)


@row(
    "perfect-fluid-circle",
    "three ellipses of ratio 10 in a perfect fluid: pose after a circle of 1 rad",
    "E. Kanso, J. E. Marsden, C. W. Rowley, J. B. Melli-Huber, J. Nonlinear Sci. 15 (2005) 255",
    relative=1e-11,
)
def perfect_fluid_circle() -> Numbers:
    """Compare Kirchhoff's added masses, integrated by SciPy, with the phase."""
    a, b, L, density = HALF, 0.1 * HALF, 2.0 * HALF, 10.0
    added = [np.pi * b**2, np.pi * a**2, np.pi / 8.0 * (a**2 - b**2) ** 2]
    tensor = np.array([L, L, L**3 / 12.0]) + density * np.array(added)
    ellipses = {name: Ellipse(a, b, (at, 0.0, 0.0)) for name, at in PLACES.items()}
    fish = Connection.fluid(load("three_rods"), density, ellipses)
    return numbers(pose_by_hand(tensor), phase(fish, CIRCLE, tolerance=1e-12).pose)


@row(
    "spheroid",
    "prolate spheroid 2:1 in a perfect fluid: added masses and moment, relative to its own",
    LAMB,
    relative=1e-12,
)
def spheroid() -> Numbers:
    """Compare Lamb's closed form with the added-mass tensor."""
    e = np.sqrt(0.75)
    log = np.log((1.0 + e) / (1.0 - e))
    p = 2.0 * (1.0 - e**2) / e**3 * (0.5 * log - e)
    q = 1.0 / e**2 - (1.0 - e**2) / (2.0 * e**3) * log
    turn = e**4 * (q - p) / ((2.0 - e**2) * (2.0 * e**2 - (2.0 - e**2) * (q - p)))
    volume = 4.0 / 3.0 * np.pi * 2.0
    found = np.diag(Ellipsoid((2.0, 1.0, 1.0)).tensor) / volume
    return numbers([p / (2.0 - p), q / (2.0 - q), turn], [found[0], found[1], found[5]])


@row(
    "kinematic-snake",
    "kinematic snake of three links at (0.9, −0.4) rad: speed and turn per rate of each joint",
    "E. A. Shammas, H. Choset, A. A. Rizzi, Int. J. Robotics Res. 26 (2007) 1043",
    relative=1e-12,
)
def kinematic_snake() -> Numbers:
    """Compare the solution of two wheel constraints with the connection."""
    (c1, c2), (s1, s2) = np.cos([0.9, -0.4]), np.sin([0.9, -0.4])
    d = s2 * (1.0 + c1) - s1 * (1.0 + c2)
    expected = np.array([-HALF * (1.0 + c2), -HALF * (1.0 + c1), -s2, -s1]) / d
    wheels = [Wheel(name, (at, 0.0, 0.0)) for name, at in PLACES.items()]
    A = Connection.kinematic(load("purcell_swimmer"), wheels).local([0.9, -0.4])
    return numbers(expected, [*A[0], *A[2]])


ROWS = (
    purcell_straight, purcell_small_stroke, purcell_circle, perfect_fluid_circle, spheroid,
    kinematic_snake,
)  # fmt: skip
