"""Connections of drag, fluid and wheels against closed forms and published numbers."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import three_links
from assertions import close
from lifts import pose_after_cycle
from three_links import CENTRES, LENGTH, LINKS

import pinred
from pinred.analysis.connections.drag_fluid_and_wheels import added_masses
from pinred.common.arrays import Array

Gait = pinred.Gait
CIRCLE = Gait.fourier([0.0, 0.0], [[1.0, 0.0]], [[0.0, 1.0]])
SHAPES = [np.array([0.0, 0.0]), np.array([0.7, -0.4]), np.array([-1.3, 2.1])]
RODS = {name: pinred.Rod(LENGTH, 2.0, 1.0, centre=(CENTRES[name], 0.0, 0.0)) for name in LINKS}


def swimmer() -> pinred.Connection:
    """Purcell's, with drag ratio 2."""
    return pinred.Connection.viscous(pinred.load("purcell_swimmer"), RODS)


@pytest.mark.parametrize("x", SHAPES)
def test_viscous_connection_equals_resistive_force_theory(x: Array) -> None:
    """Drag of three links, derived manually: A to round-off, and the dissipation metric."""
    drag = np.diag([LENGTH, 2.0 * LENGTH, 2.0 * LENGTH**3 / 12.0])
    G = three_links.form(x, drag)
    A = swimmer()
    close(A.local(x), three_links.local(G), 1e-15)
    close(A.metric(x), G[3:, 3:] - G[3:, :3] @ three_links.local(G), 1e-15)


def test_purcell_swimmer_has_published_displacement() -> None:
    """The published displacement of a circle of radius 1, ratio 2, base in the middle link."""
    p = pinred.phase(swimmer(), CIRCLE, tolerance=1e-12)
    assert float(np.hypot(*p.pose[:2])) == pytest.approx(0.0512808243, abs=5e-11)
    assert abs(p.pose[2]) < 1e-13
    assert p.screw.angle == 0.0
    assert p.screw.slide == pytest.approx(0.0512808243, abs=5e-11)


def test_drag_tensor_equals_rod() -> None:
    """A tensor in the link's frame gives the same connection."""
    by_hand = {name: np.array(rod.tensor) for name, rod in RODS.items()}
    A = pinred.Connection.viscous(pinred.load("purcell_swimmer"), by_hand)
    close(A.local(SHAPES[1]), swimmer().local(SHAPES[1]), 1e-16)


def test_rod_in_space_has_integrated_drag() -> None:
    """Along any axis, against the integral over its length."""
    axis, centre = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.1, -0.2])
    tensor = pinred.Rod(0.8, 3.0, 1.5, centre, axis).tensor
    u = axis / np.linalg.norm(axis)
    resist = 3.0 * (np.eye(3) - np.outer(u, u)) + 1.5 * np.outer(u, u)
    s, w = np.polynomial.legendre.leggauss(4)
    expected = np.zeros((6, 6))
    for at, weight in zip(0.4 * s, 0.4 * w, strict=True):
        J = np.hstack([np.eye(3), -pin.skew(centre + at * u)])
        expected += weight * J.T @ resist @ J
    close(tensor, expected, 1e-14)


@pytest.mark.parametrize("convention", ["textbook", "sysplotter"])
def test_three_ellipses_in_fluid(convention: str) -> None:
    """Added masses π b², π a² and moment π/8 (a² − b²)², or (a² − b²)² as sysplotter has it."""
    a, b, rho = 0.5 * LENGTH, 0.04, 1.3
    factor = np.pi / 8.0 if convention == "textbook" else 1.0
    added = rho * np.diag([np.pi * b**2, np.pi * a**2, factor * (a**2 - b**2) ** 2])
    rigid = np.diag([LENGTH, LENGTH, LENGTH**3 / 12.0])
    bodies = {
        name: pinred.Ellipse(a, b, (CENTRES[name], 0.0, 0.0), convention=convention)  # type: ignore[arg-type]
        for name in LINKS
    }
    A = pinred.Connection.fluid(pinred.load("three_rods"), rho, bodies)
    for x in SHAPES:
        G = three_links.form(x, rigid + added)
        close(A.local(x), three_links.local(G), 1e-14)
        close(A.metric(x), G[3:, 3:] - G[3:, :3] @ three_links.local(G), 1e-14)
    other = "sysplotter" if convention == "textbook" else "textbook"
    swapped = pinred.Ellipse(a, b, convention=other)  # type: ignore[arg-type]
    ratio = swapped.tensor[5, 5] / pinred.Ellipse(a, b, convention=convention).tensor[5, 5]  # type: ignore[arg-type]
    assert ratio == pytest.approx(8.0 / np.pi if other == "sysplotter" else np.pi / 8.0)


def test_added_masses_of_ellipsoids_equal_lambs_table() -> None:
    """A sphere has half its mass; 2:1:1 has Lamb's 0.209 and 0.702, and a moment of 0.240."""
    mass, moment = added_masses(np.array([0.7, 0.7, 0.7]))
    close(mass, np.full(3, 0.5 * 4.0 / 3.0 * np.pi * 0.7**3), 1e-14)
    close(moment, np.zeros(3), 1e-14)
    a, b = 2.0, 1.0
    volume = 4.0 / 3.0 * np.pi * a * b * b
    mass, moment = added_masses(np.array([a, b, b]))
    close(mass / volume, [0.2096, 0.7042, 0.7042], 6e-4)
    close(moment / (volume * (a**2 + b**2) / 5.0), [0.0, 0.2394, 0.2394], 6e-4)
    # By the closed form of prolate spheroids: e² = 1 − b²/a².
    e = np.sqrt(0.75)
    log = np.log((1.0 + e) / (1.0 - e))
    alpha = 2.0 * (1.0 - e**2) / e**3 * (0.5 * log - e)
    beta = 1.0 / e**2 - (1.0 - e**2) / (2.0 * e**3) * log
    close(mass / volume, [alpha / (2.0 - alpha), beta / (2.0 - beta), beta / (2.0 - beta)], 1e-13)
    turn = e**4 * (beta - alpha) / ((2.0 - e**2) * (2.0 * e**2 - (2.0 - e**2) * (beta - alpha)))
    close(moment / (volume * (a**2 + b**2) / 5.0), [0.0, turn, turn], 1e-13)


def test_long_ellipsoid_has_moment_of_ellipses() -> None:
    """Sliced across, it is ellipses: π/8 (b² − c²)² integrated along it, 16 a/15 times that."""
    a, b, c = 3000.0, 0.9, 0.4
    _, moment = added_masses(np.array([a, b, c]))
    assert moment[0] == pytest.approx(np.pi / 8.0 * (b**2 - c**2) ** 2 * 16.0 / 15.0 * a, rel=1e-5)


def snake() -> pinred.Connection:
    """Three links with a wheel each."""
    wheels = [pinred.Wheel(name, (CENTRES[name], 0.0, 0.0)) for name in LINKS]
    return pinred.Connection.kinematic(pinred.load("purcell_swimmer"), wheels)


def test_kinematic_connection_of_snake() -> None:
    """A = W_b⁻¹ W_s, W the sideways speeds of the links' centres."""
    A = snake()
    for x in (np.array([0.9, -0.4]), np.array([-1.3, 2.1])):
        J = three_links.centre_jacobians(x)
        W = np.array([J[name][1] for name in LINKS])
        close(A.local(x), np.linalg.solve(W[:, :3], W[:, 3:]), 1e-13)
        with pytest.raises(pinred.InputError, match="no metric"):
            A.metric(x)
    gait = Gait.fourier([1.0, -0.5], [[0.3, 0.0]], [[0.0, 0.4]])
    p = pinred.phase(A, gait, tolerance=1e-12)

    def velocity(_: Array, x: Array, xdot: Array) -> Array:
        J = three_links.centre_jacobians(x)
        W = np.array([J[name][1] for name in LINKS])
        return -np.linalg.solve(W[:, :3], W[:, 3:] @ xdot)

    close(p.pose, pose_after_cycle(A.group, gait, velocity), 1e-10)
    with pytest.raises(pinred.InputError, match="define no momentum"):
        pinred.phase(A, gait, [1.0, 0.0, 0.0])


def test_kinematic_connection_at_singular_shape_raises() -> None:
    """On one arc, also straight, the wheels do not determine the motion; no gait may cross it."""
    A = snake()
    for x in ([0.0, 0.0], [0.6, 0.6]):
        with pytest.raises(
            pinred.SingularInertiaError, match="do not determine the motion of the body"
        ):
            A.local(x)
        with pytest.raises(
            pinred.SingularInertiaError, match="do not determine the motion of the body"
        ):
            _ = A.grid([[1.0, -0.5], x]).curvature
    with pytest.raises(pinred.SingularInertiaError, match="crosses shapes"):
        pinred.phase(A, Gait.fourier([0.5, 0.1], [[0.7, 0.0]], [[0.0, 0.6]]))


def car(trailers: int) -> pin.Model:
    """A car in the plane: a driven wheel, steering, and trailers hitched at their axles."""
    model = pin.Model()
    model.gravity.setZero()
    body = pin.Inertia(2.0, np.zeros(3), np.diag([0.1, 0.2, 0.3]))
    base = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, body, pin.SE3.Identity())
    model.addBodyFrame("chassis", base, pin.SE3.Identity(), 0)
    drive = model.addJoint(base, pin.JointModelRY(), pin.SE3.Identity(), "drive")
    model.appendBodyToJoint(drive, body, pin.SE3.Identity())
    ahead = pin.SE3(np.eye(3), np.array([0.6, 0.0, 0.0]))
    steer = model.addJoint(base, pin.JointModelRZ(), ahead, "steer")
    model.appendBodyToJoint(steer, body, pin.SE3.Identity())
    model.addBodyFrame("axle", steer, pin.SE3.Identity(), 0)
    if trailers:
        hitch = model.addJoint(base, pin.JointModelRZ(), pin.SE3.Identity(), "hitch")
        model.appendBodyToJoint(hitch, body, pin.SE3.Identity())
        model.addBodyFrame("trailer", hitch, pin.SE3.Identity(), 0)
    return model


def test_kinematic_car() -> None:
    """It moves at R φ̇ and rotates at R φ̇ tan(steering)/ℓ."""
    wheels: list[pinred.Wheel | pinred.Rolling] = [
        pinred.Wheel("chassis"),
        pinred.Wheel("axle"),
        pinred.Rolling("drive", 0.3, "chassis"),
    ]
    A = pinred.Connection.kinematic(pinred.load(car(0)), wheels)
    k = A.joints.index("drive")
    for steer in (0.0, 0.4, -0.9):
        x = np.zeros(2)
        x[1 - k] = steer
        expected = np.zeros((3, 2))
        expected[:, k] = [-0.3, 0.0, -0.3 * np.tan(steer) / 0.6]
        close(A.local(x), expected, 1e-14)


def test_car_with_trailer() -> None:
    """Without an engine: steering and hitch move it, as ω = ḣ-rate of the hitch says."""
    system = pinred.load(car(1), lock={"drive": 0.0})
    wheels = [pinred.Wheel("chassis"), pinred.Wheel("axle"), pinred.Wheel("trailer", (-0.5, 0, 0))]
    A = pinred.Connection.kinematic(system, wheels)
    k = A.joints.index("hitch")
    steer, hitch = 0.4, 0.7
    x = np.zeros(2)
    x[k], x[1 - k] = hitch, steer
    # v = u; ω = u tan(steer)/ℓ; the trailer's wheel: −u sin h − 0.5 (ω + ḣ) = 0.
    per_u = -2.0 * np.sin(hitch) - np.tan(steer) / 0.6
    u = 1.0 / per_u
    expected = np.zeros((3, 2))
    expected[:, k] = [-u, 0.0, -u * np.tan(steer) / 0.6]
    close(A.local(x), expected, 1e-13)


def test_invalid_drag_fluid_and_wheels_raise() -> None:
    """Unknown links, wrong wheels and numbers, by name."""
    system = pinred.load("purcell_swimmer")
    with pytest.raises(pinred.InputError, match=r"did you mean 'rear'.*the links are"):
        pinred.Connection.viscous(system, {"raer": RODS["rear"]})
    with pytest.raises(pinred.InputError, match="symmetric"):
        pinred.Connection.viscous(system, {"rear": np.triu(np.ones((6, 6)))})
    with pytest.raises(pinred.InputError, match="at least one link"):
        pinred.Connection.viscous(system, {})
    with pytest.raises(pinred.InputError, match="needs 3 wheels, got 1"):
        pinred.Connection.kinematic(system, [pinred.Wheel("rear")])
    with pytest.raises(pinred.InputError, match="must not be zero"):
        pinred.Connection.kinematic(system, [pinred.Wheel("rear", axle=(0.0, 0.0, 0.0))] * 3)
    with pytest.raises(pinred.InputError, match="no shape joint 'nope'"):
        pinred.Connection.kinematic(system, [pinred.Rolling("nope", 1.0, "rear")] * 3)
    with pytest.raises(pinred.InputError, match="convention"):
        pinred.Ellipse(1.0, 0.5, convention="other")  # type: ignore[arg-type]
    with pytest.raises(pinred.InputError, match="above zero"):
        pinred.Ellipsoid((1.0, 0.0, 1.0))
    with pytest.raises(pinred.InputError, match="density"):
        pinred.Connection.fluid(system, 0.0, {"rear": pinred.Ellipsoid((1.0, 1.0, 1.0))})
