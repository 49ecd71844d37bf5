"""Phases of loops of ball joints, against closed forms, and SciPy over Pinocchio."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from assertions import close
from ball_trees import ball_tree, joined_bodies
from lifts import by_pinocchio, random_gait
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import pinred
from pinred.common.arrays import Array

Gait = pinred.Gait
J1, J2 = 0.7, 0.3
SHARE = J2 / (J1 + J2)  # A = SHARE · R for two spherical bodies that are joined at their centres


def spherical_pair() -> pinred.Connection:
    """Return the connection of two spherical bodies, joined by a ball at both centres of mass."""
    moments = np.array([[J1] * 3, [J2] * 3])
    return pinred.Connection.mechanical(joined_bodies(moments, np.zeros((2, 3))))


def spherical_pose(gait: pinred.Gait, centre: Array) -> Array:
    """Return the attitude after a loop, from ξ = −s R σ with Ṙ Rᵀ = (R σ)^, by SciPy."""

    def rate(t: float, q: Array) -> Array:
        w, wdot = gait.at(t)
        spatial = pin.Quaternion(centre).matrix() @ pin.exp3(w) @ pin.Jexp3(w) @ wdot
        xi, (v, scalar) = -SHARE * spatial, (q[:3], q[3])
        return 0.5 * np.append(scalar * xi + np.cross(v, xi), -v @ xi)

    start = np.array([0.0, 0.0, 0.0, 1.0])
    solution = solve_ivp(rate, (0.0, gait.period), start, "DOP853", rtol=3e-14, atol=1e-15)
    return np.asarray(solution.y[:, -1])


def test_connection_in_chart_is_pull_back_of_spherical_pair() -> None:
    """A = s R J and B = s (1 − s) R (Jα × Jβ) about a centre, also far from it and at w = 0."""
    A = spherical_pair()
    centre = np.array([0.3, -1.0, 0.4])
    chart = A.in_chart({"joint": centre.tolist()})
    assert (chart.nx, chart.m, chart.joints) == (3, 3, ("joint.x", "joint.y", "joint.z"))
    direction = np.array([0.6, -0.2, 0.5])
    for size in (0.0, 1e-9, 0.2, 1.0, 2.4, 2.5, 5.0, 12.0):
        w = size * direction
        R = pin.exp3(centre) @ pin.exp3(w)
        J = pin.Jexp3(w) if size else np.eye(3)
        close(chart.local(w)[3:], SHARE * R @ J, 2e-15)
        areas = np.cross(J[:, :, None], J[:, None, :], axis=0)
        curvature = SHARE * (1.0 - SHARE) * np.einsum("ij,jab->iab", R, areas)
        np.testing.assert_allclose(chart.curvature(w)[3:], curvature, rtol=0.0, atol=3e-15)


def test_phase_of_spherical_pair_agrees_with_integration_of_closed_form() -> None:
    """About a centre given by joint name, as quaternion, and as shape."""
    A, gait = spherical_pair(), random_gait(np.random.default_rng(4), 3)
    centre = Rotation.from_rotvec([0.3, -1.0, 0.4]).as_quat()
    expected = spherical_pose(gait, centre)
    for value in ({"joint": [0.3, -1.0, 0.4]}, {"joint": 2.0 * centre}, centre):
        p = pinred.phase(A.in_chart(value), gait, tolerance=1e-13)
        np.testing.assert_allclose(p.pose[3:], expected, rtol=0.0, atol=1e-13)
    at_rest = pinred.phase(A, gait, tolerance=1e-13).pose
    close(at_rest, pinred.phase(A.in_chart(), gait, tolerance=1e-13).pose, 0.0)
    assert np.abs(at_rest[3:] - expected).max() > 1e-3


@pytest.mark.parametrize(("axial", "transverse", "bend"), [(0.1, 0.4, 1.04), (0.3, 0.5, 0.4)])
def test_cat_with_ball_turns_over_as_kane_and_scher(
    axial: float, transverse: float, bend: float
) -> None:
    """Two axisymmetric halves, bent by 2b, roll without twist: R = Rz(ψ) Ry(2b) Rz(−ψ).

    The loop is a circle of radius 2b in the rotation vector.  The frame between both halves turns
    about the bisector of their axes by 2π J_a cos b / (J_a cos² b + J_t sin² b).
    """
    moments = np.tile([transverse, transverse, axial], (2, 1))
    A = pinred.Connection.mechanical(joined_bodies(moments, np.zeros((2, 3))))
    circle = Gait.fourier(np.zeros(3), [[0.0, 2.0 * bend, 0.0]], [[-2.0 * bend, 0.0, 0.0]])
    c, s = np.cos(bend), np.sin(bend)
    turn = 2.0 * np.pi * axial * c / (axial * c**2 + transverse * s**2)
    expected = Rotation.from_rotvec(turn * np.array([s, 0.0, c]))
    p = pinred.phase(A, circle, tolerance=1e-13)
    error = (expected.inv() * Rotation.from_quat(p.pose[3:])).magnitude()
    assert error < 1e-13 * turn
    close(p.pose[:3], np.zeros(3), 1e-15)


# Every run has phases of a spherical pair, by an independent integration.
@pytest.mark.by_hand("4-SE2")
@pytest.mark.parametrize(
    ("seed", "group"), [pytest.param(3, "SE3", marks=pytest.mark.by_hand), (4, "SE2")]
)
def test_phase_of_trees_with_balls_agrees_with_pinocchio(seed: int, group: str) -> None:
    """Random gaits of balls, hinges and slides, with momentum, about a random centre."""
    system = ball_tree(seed, 3, group)
    rng = np.random.default_rng(seed)
    centre, gait = system.space.random(rng, 1.0), random_gait(rng, system.m)
    A = pinred.Connection.mechanical(system).in_chart(centre)
    for momentum in (np.zeros(system.r), rng.uniform(-0.3, 0.3, system.r)):
        pose = pinred.phase(A, gait, momentum, tolerance=1e-11).pose
        error = A.group.error(pose, by_pinocchio(system, gait, momentum, centre))
        assert max(error.rotation, error.translation) < 1e-10


def test_full_turn_of_ball_closes() -> None:
    """A turn about an axis moves the pair by −2πs; a wobbling one as the integral of SciPy says."""
    A, identity = spherical_pair(), np.array([0.0, 0.0, 0.0, 1.0])
    plain = pinred.phase(A, Gait.waypoints([np.zeros(3)], turns=[0, -1, 0]))
    angle = np.pi * SHARE
    close(plain.pose[3:], [0.0, np.sin(angle), 0.0, np.cos(angle)], 1e-14)
    wobbling = Gait.fourier(np.zeros(3), [[0.0] * 3], [[0.3, 0.4, -0.2]], turns=[0, 0, 2])
    p = pinred.phase(A, wobbling, tolerance=1e-13)
    expected = spherical_pose(wobbling, identity)
    close(p.pose[3:], expected * np.sign(expected @ p.pose[3:]), 1e-13)
    close(p.cycles(2), A.group.compose(p.pose, p.pose), 1e-14)
    centre = Rotation.from_rotvec([0.4, 0.2, 0.1]).as_quat()
    across = Gait.waypoints([[np.pi, 0.0, 0.0]], turns=[-1, 0, 0])  # from π to −π, the same R
    half = pinred.phase(A.in_chart(centre), across).pose
    close(np.abs(half[3:]), np.abs(spherical_pose(across, centre)), 1e-13)


def test_turn_that_opens_ball_is_refused_by_name() -> None:
    """A turn about one axis restores no ball that starts off this axis; nor does a hinge there."""
    system = ball_tree(3, 2)
    A = pinred.Connection.mechanical(system)
    start = np.zeros(system.m)
    start[0] = 0.1
    for axis in (1, 2):
        turns = np.eye(system.m)[axis]
        with pytest.raises(pinred.InputError, match=r"restores the robot.*'j0'"):
            pinred.phase(A, Gait.waypoints([start], turns=turns))
    closed = pinred.phase(A, Gait.waypoints([start], turns=np.eye(system.m)[0]))
    assert np.isfinite(closed.pose).all()


def test_slopes_of_phase_with_balls_equal_differences() -> None:
    """Derivatives of pose, length and action by all Fourier coefficients, about a centre."""
    system = ball_tree(3, 2)
    A = pinred.Connection.mechanical(system).in_chart({"j0": [0.2, 0.9, -0.4]})
    gait, rng = random_gait(np.random.default_rng(1), system.m), np.random.default_rng(2)
    slopes, series = pinred.phase_slopes(A, gait), gait.series
    close(slopes.pose, pinred.phase(A, gait, tolerance=1e-12).pose, 1e-10)
    change = rng.normal(size=(5, system.m))

    def moved(step: float) -> pinred.PhaseSlopes:
        terms = np.vstack([series.mean, series.cos, series.sin]) + step * change
        moved_gait = Gait.fourier(terms[0], terms[1:3], terms[3:], period=gait.period)
        return pinred.phase_slopes(A, moved_gait)

    step = 1e-4
    after, before = moved(step), moved(-step)
    between = A.group.log(A.group.compose(A.group.inverse(before.pose), after.pose)) / (2.0 * step)
    close(np.tensordot(slopes.twist, change, 2), between, 1e-6)
    for name in ("length", "action"):
        difference = (getattr(after, name) - getattr(before, name)) / (2.0 * step)
        assert np.sum(getattr(slopes, f"{name}_slope") * change) == pytest.approx(
            difference, rel=1e-6
        )


# Phases of the pair and of trees with balls have references by default.
@pytest.mark.by_hand
def test_surface_integral_with_ball_is_phase_of_commutative_group() -> None:
    """Stokes' theorem on SO(2), over the disc of a gait of rotation vectors."""
    system = ball_tree(5, 1, "SO2")
    A, gait = pinred.Connection.mechanical(system), random_gait(np.random.default_rng(3), system.m)
    integral = pinred.corrected_integral(A, gait)
    assert abs(float(integral.log[0])) > 1e-3
    close(integral.integral, integral.log, 1e-10)


def test_frames_with_balls() -> None:
    """Translations along one axis are flat: the frame is the centre of mass.

    A frame that is optimal over a disc makes the surface integral of a spherical pair better.
    """
    system = ball_tree(5, 1, "R")
    A = pinred.Connection.mechanical(system)
    flat, w = pinred.flatness(A), np.random.default_rng(0).uniform(-1.0, 1.0, system.m)
    assert flat.is_flat
    model, data = system.sorted_model, system.sorted_model.createData()

    def com(w: Array) -> float:
        shape = system.space.integrate(system.space.neutral, w)
        return float(pin.centerOfMass(model, data, system.sorted_q(np.zeros(1), shape))[0])

    close(flat.coordinates(w), [com(w) - com(np.zeros(system.m))], 1e-12)
    pair, gait = spherical_pair(), Gait.fourier(np.zeros(3), np.eye(3)[:1], np.eye(3)[1:2])
    frame = pinred.optimal_frame(pair, gait, degree=8)
    before, after = (pinred.corrected_integral(pair, gait, frame) for frame in (None, frame))
    assert frame.angular < frame.angular_before
    errors = [np.linalg.norm(result.integral - result.log) for result in (before, after)]
    assert errors[1] < 0.1 * errors[0]


def test_section_over_rotation_vectors_conjugates_phase() -> None:
    """In a frame h(w) that turns with the ball, the phase is h(w₀)⁻¹ g h(w₀)."""
    A, gait = spherical_pair(), random_gait(np.random.default_rng(6), 3)

    def pose(w: ca.SX) -> ca.SX:
        half = 0.5 * w[0]
        return ca.vertcat(0.2 * w[1], w[2], 0.0, ca.sin(half), 0.0, 0.0, ca.cos(half))

    g, moved = (pinred.phase(C, gait, tolerance=1e-12).pose for C in (A, A.in_section(pose)))
    w = ca.SX.sym("w", 3)
    h = np.asarray(ca.Function("h", [w], [pose(w)])(gait.at(0.0)[0])).ravel()
    close(moved, A.group.compose(A.group.inverse(h), A.group.compose(g, h)), 1e-11)


def test_centre_of_robots_without_balls_shifts_gaits() -> None:
    """A centre of hinges adds to the gait; without centre the connection is the same object."""
    A = pinred.Connection.mechanical(pinred.load("three_rods"))
    assert A.in_chart() is A
    shifted = A.in_chart({"alpha2": 0.4})
    gait = Gait.fourier([0.1, 0.2], [[0.5, 0.0]], [[0.0, 0.6]])
    moved = Gait.fourier([0.1, 0.6], [[0.5, 0.0]], [[0.0, 0.6]])
    close(pinred.phase(shifted, gait).pose, pinred.phase(A, moved).pose, 1e-14)
    with pytest.raises(pinred.InputError, match="already has a centre"):
        shifted.in_chart([0.0, 0.0])
    with pytest.raises(pinred.InputError, match="neck"):
        A.in_chart({"neck": 0.1})
    with pytest.raises(pinred.InputError, match="without a centre"):
        shifted.seen_from(A.joints[0])
