"""Minimum-perturbation frames, surface integrals of curvature, and flatness."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from assertions import close
from link_poses import link_pose
from strategies import make_case
from textbook import DELTA, J2, M2, D, M
from three_links import CENTRES, LENGTH, LINKS

import pinred
from pinred.analysis.phases.corrected_integral import norm_distance
from pinred.common.arrays import Array
from pinred.kernels.connection.connection_form import form_of

CIRCLE = pinred.Gait.fourier([0.0, 0.0], [[1.0, 0.0]], [[0.0, 1.0]])
RODS = {name: pinred.Rod(LENGTH, 2.0, 1.0, centre=(CENTRES[name], 0.0, 0.0)) for name in LINKS}
BOX = [[-1.5, 1.5], [-1.5, 1.5]]


@cache
def swimmer() -> pinred.Connection:
    """Purcell's swimmer, with drag ratio 2."""
    return pinred.Connection.viscous(pinred.load("purcell_swimmer"), RODS)


@cache
def frame_of_box(degree: int | None = None) -> pinred.OptimalFrame:
    """Return the optimal frame of the swimmer over the box."""
    return pinred.optimal_frame(swimmer(), BOX, degree=degree)


def test_optimal_frame_reduces_error_of_surface_integral() -> None:
    """For Purcell's circle of radius 1 the error falls from 27 % to below 0.5 %."""
    A = swimmer()
    before = pinred.corrected_integral(A, CIRCLE)
    assert before.error == pytest.approx(0.266, abs=2e-3)
    assert not before.trusted
    after = pinred.corrected_integral(A, CIRCLE, frame_of_box(14))
    on_disc = pinred.corrected_integral(A, CIRCLE, pinred.optimal_frame(A, CIRCLE, degree=6))
    assert after.error < 5e-3
    assert on_disc.error < 0.02
    for result in (after, on_disc):
        assert result.trusted
        # In another frame the phase is conjugate to the published one.
        assert np.hypot(*result.phase[:2]) == pytest.approx(0.0512808243, abs=1e-8)
    off_centre = pinred.Gait.fourier([0.4, 0.0], [[1.0, 0.0]], [[0.0, 1.0]])
    turning = pinred.corrected_integral(A, off_centre)
    assert abs(turning.log[2]) > 1e-3
    differences = (turning.integral - turning.log)[:2]
    assert turning.error == pytest.approx(np.hypot(*differences) / np.hypot(*turning.log[:2]))


def test_error_of_surface_integral_grows_with_radius() -> None:
    """The error grows with the radius in any frame, and it is reported."""
    A = swimmer()
    frame = pinred.optimal_frame(A, [[-2.5, 2.5], [-2.5, 2.5]], degree=14)
    errors = [
        pinred.corrected_integral(A, CIRCLE.scaled(radius), frame).error for radius in (1.0, 2.4)
    ]
    assert errors[0] < errors[1]


def test_optimal_frame_is_independent_of_base_link() -> None:
    """All base links give the same least norm to 1e-8."""
    A = swimmer()
    others = (A.seen_from("front"), A.seen_from("rear"))
    found = [frame_of_box(14), *(pinred.optimal_frame(c, BOX, degree=14) for c in others)]
    norms = np.array([[each.angular, each.linear] for each in found])
    close(norms, np.tile(norms[0], (3, 1)), 1e-8)
    assert found[0].angular < 0.2 * found[0].angular_before
    assert found[1].linear < 0.1 * found[1].linear_before


@pytest.mark.parametrize("reach", [1.5, 2.5])
@pytest.mark.sampled
def test_distance_of_optimal_frame_is_that_to_high_degree(reach: float) -> None:
    """The norm by degree 26 is closer to the limit than degree 14 by the estimated distance."""
    box = [[-reach, reach]] * 2
    coarse, fine = (
        frame_of_box(d) if box == BOX else pinred.optimal_frame(swimmer(), box, degree=d)
        for d in (14, 26)
    )
    assert coarse.degree == 14
    missed = (coarse.angular - fine.angular) / coarse.angular
    assert 1e-6 < missed < 1e-4
    assert 0.7 * missed < coarse.distance < 4.0 * missed
    assert fine.distance < 1e-6


def test_degree_of_optimal_frame_is_raised_until_it_converged() -> None:
    """Degree 14 would be 5e-5 from the limit."""
    frame = frame_of_box()
    assert frame.degree > 14
    assert frame.distance <= 1e-6
    assert frame.angular == pytest.approx(0.033980975, rel=1e-6)  # by degree 28, extrapolated


def test_distance_of_optimal_frame_in_closed_form() -> None:
    """For A = x₀ e₁ on the square, u solves Laplace's equation with ∂u/∂n = A·n: a series.

    A = ∇(x₀x₁)/2 + (−x₁, x₀)/2. The best rotation removes the gradient part of A; the torsion of a
    square bar, 2.2492 (2a)⁴/16, is the remaining ∫|A′|² of (−x₁, x₀).
    """
    group = pinred.lie.GROUPS["SO2"]

    def values(x: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(v[0] + x[0] * v[2])

    form = form_of(
        group, ("a", "b"), ("rad", "rad"), "areas", values,
        lambda x: np.array([[1.0, 0.0, x[0]]]), symmetric=False,
    )  # fmt: skip
    frame = pinred.optimal_frame(pinred.Connection.of(form), [[-1.0, 1.0]] * 2)
    odd = np.arange(1, 200, 2)
    torsion = 16.0 / 3.0 * (1.0 - 192.0 / np.pi**5 * np.sum(np.tanh(0.5 * np.pi * odd) / odd**5.0))
    expected = np.sqrt(0.25 * torsion / 4.0)
    assert frame.angular >= expected
    assert (frame.angular - expected) / expected == pytest.approx(frame.distance, rel=0.5)
    assert frame.distance <= 1e-6


def test_norm_distance_extrapolates_powers() -> None:
    """Exact for 2 + 3 d⁻⁵; round-off and degrees that do not increase are recognised."""
    degrees = [10, 12, 14]
    norms = [2.0 + 3.0 * d**-5.0 for d in degrees]
    spectral = [1.0 + 10.0 ** (-d) for d in degrees]
    assert norm_distance(degrees, norms, 2.0) == pytest.approx(1.5 * 14.0**-5.0, rel=1e-6)
    assert norm_distance(degrees, [1.0, 1.0, 1.0], 1.0) < 1e-12
    assert 1e-14 < norm_distance(degrees, spectral, 1.0) < 1e-11
    assert norm_distance([1, 1, 1], norms, 1.0) == np.inf
    assert norm_distance(degrees, [1.0, 0.9, 0.7], 1.0) > 0.7 * 0.99  # It does not converge yet.
    assert norm_distance(degrees, [1e-2, 1e-4, 1e-6], 1.0) <= 1e-6


def test_optimal_frame_connection_is_its_velocity() -> None:
    """A′ is the velocity of the frame on a horizontal motion."""
    A = swimmer()
    frame, G = frame_of_box(14), A.group
    x, xdot, h = np.array([0.7, -0.4]), np.array([0.3, 0.9]), 1e-4
    step = [G.compose(G.inverse(frame.pose(x)), frame.pose(x + k * h * xdot)) for k in (-1, 1)]
    displacement = (G.log(step[1]) - G.log(step[0])) / (2.0 * h)
    xi = G.Ad(G.inverse(frame.pose(x))) @ A.velocity(x, xdot) + displacement
    close(frame.local(x) @ (xdot / 1.5), -xi, 1e-7)


def test_other_frames_have_larger_norm() -> None:
    """Any other smooth frame has larger angular and linear norms."""
    best = frame_of_box(14)
    rng = np.random.default_rng(1)
    u, w = best.patch.nodes, best.patch.weights / best.patch.weights.sum()
    for _ in range(5):
        amount = 1e-3 * rng.normal(size=3)
        k = rng.normal(size=2)
        wave, slope = np.sin(u @ k), np.cos(u @ k)[:, None] * k
        field = best.local_at(u)
        displacement = field.copy()
        displacement[:, 2] -= amount[2] * slope
        change = w @ (displacement[:, 2] ** 2 - field[:, 2] ** 2).sum(axis=1)
        assert change > 0.0
        # A shift δp of the origin changes A_v to A′_v + A_ω × δp − ∂δp, to first order.
        arms = amount[:2, None] * wave
        turning = field[:, 2]
        across = [-turning * arms[1][:, None], turning * arms[0][:, None]]
        shifted = field[:, :2] + np.stack(across, axis=1)
        shifted -= amount[:2, None] * slope[:, None, :]
        first = w @ ((shifted - field[:, :2]) * field[:, :2]).sum(axis=(1, 2))
        size = w @ ((shifted - field[:, :2]) ** 2).sum(axis=(1, 2))
        assert abs(first) < 0.2 * size


@pytest.mark.by_hand
def test_optimal_attitude_in_space_is_stationary() -> None:
    """For SO(3) over three joints on 20³ nodes, two sections give the same norm."""
    case = make_case("SO3", 3, 4)
    A = pinred.Connection.mechanical(case.system)
    best = pinred.optimal_frame(A, [[-0.6, 0.6]] * 3, nodes=20)
    assert best.angular < best.angular_before

    def turned(x: ca.SX) -> ca.SX:
        q = ca.vertcat(0.3 * ca.sin(x[0]), 0.2 * x[1], 0.1 * x[2] * x[0], 1.0)
        return q / ca.norm_2(q)

    other = pinred.optimal_frame(A.in_section(turned), [[-0.6, 0.6]] * 3, nodes=20)
    assert other.angular == pytest.approx(best.angular, rel=1e-3)
    assert 2 <= best.iterations <= 16


def test_optimal_origin_of_free_robot_is_centre_of_mass() -> None:
    """In SE(3) no translation is left in the frame of the centre of mass."""
    system = pinred.load("falling_cat")
    frame = pinred.optimal_frame(
        pinred.Connection.mechanical(system), [[-0.8, 0.8]] * 2, joints=(0, 1), degree=12
    )
    assert frame.linear < 1e-8
    x = np.array([0.5, -0.3, 0.0])
    com = pinred.Reduction(system).split(x).com
    # The origin is unique up to a constant, so the difference is independent of the shape.
    G = system.group

    def seen(shape: Array) -> Array:
        return np.asarray(G.inverse(frame.pose(shape))[:3])

    assert np.isfinite(seen(x)).all()
    close(frame.pose(x)[:3], com, 1e-6)


def test_optimal_frame_improves_gait_of_six_joints() -> None:
    """On the disc of the gait the surface integral improves."""
    A = pinred.Connection.mechanical(pinred.load("satellite_two_arms"))
    rng = np.random.default_rng(3)
    gait = pinred.Gait.fourier(
        rng.uniform(-0.5, 0.5, 6), rng.uniform(-0.5, 0.5, (1, 6)), rng.uniform(-0.5, 0.5, (1, 6))
    )
    before = pinred.corrected_integral(A, gait)
    after = pinred.corrected_integral(A, gait, pinred.optimal_frame(A, gait, degree=8))
    turned = [np.linalg.norm((each.integral - each.log)[3:]) for each in (before, after)]
    assert turned[1] < 0.5 * turned[0]


def test_surface_integral_is_exact_for_so2() -> None:
    """For SO(2) the surface integral equals the phase."""
    A = pinred.Connection.mechanical(pinred.load("double_spherical_pendulum"))
    gait = pinred.Gait.fourier(
        [0.5, 0.4, -0.3], [[0.2, 0.1, 0.0], [0.05, 0.0, 0.02]], [[0.0, 0.2, -0.1], [0.0, 0.03, 0.1]]
    )
    corrected = pinred.corrected_integral(A, gait)
    assert corrected.error < 1e-9


def test_flat_coordinates_need_zero_curvature() -> None:
    """Coordinates exist if the curvature vanishes; otherwise they are refused."""
    rods = pinred.flatness(pinred.Connection.mechanical(pinred.load("three_rods")))
    assert not rods.attitude_is_flat
    assert not rods.is_flat
    assert rods.relative[0] > 1e-3
    B = pinred.Reduction(pinred.load("three_rods")).curvature(rods.worst)
    assert np.abs(B).max() == pytest.approx(rods.curvature[1], rel=1e-12)
    with pytest.raises(pinred.InputError, match="no such frame"):
        rods.coordinates([0.1, 0.2])
    assert "attitude: not flat" in str(rods)
    board = pinred.load("snakeboard")  # On a free base its A is independent of the shape.
    flat = pinred.flatness(pinred.Connection.mechanical(board))
    assert flat.is_flat
    assert flat.attitude_is_flat
    x = np.array([0.3, -0.4, 0.9])
    A = pinred.Reduction(board).local_connection(x)
    close(flat.coordinates(x)[2], A[2] @ x, 1e-13)


def test_holonomy_of_flat_connections_around_circles() -> None:
    """A flat connection is a product on a box only: a turn of a joint moves the base."""
    beanie = pinred.flatness(pinred.Connection.mechanical(pinred.load("elroys_beanie")))
    close(beanie.holonomy["beanie"], [-2.0 * np.pi / 3.0], 1e-14)
    assert "a turn of beanie moves the base by [-2.094395]" in str(beanie)
    # The coupled bodies turn at the constant twist (0, I2 m2 d, −I2 m)/Δ.
    system = pinred.load("coupled_planar")
    flat = pinred.flatness(pinred.Connection.mechanical(system), [[0.5, 0.9]])
    twist = np.array([0.0, J2 * M2 * D, -J2 * M]) / DELTA
    (pose,) = flat.holonomy.values()
    error = system.group.error(pose, system.group.exp(2.0 * np.pi * twist))
    assert max(error.rotation, error.translation) < 1e-13
    assert not pinred.flatness(pinred.Connection.mechanical(pinred.load("three_rods"))).holonomy


def test_flat_coordinates_are_fixed_in_space() -> None:
    """A single joint is flat: from another base link, h(x) describes the same frame in space."""
    system = pinred.load("coupled_planar")
    A = pinred.Connection.mechanical(system)
    G = A.group
    other = [f.name for f in system.model.frames if f.parentJoint == 2][-1]
    flat, seen = pinred.flatness(A), pinred.flatness(A.seen_from(other))
    x = np.array([0.8])
    start = link_pose(system, other, np.zeros(1))
    expected = G.compose(
        G.compose(G.inverse(link_pose(system, other, x)), flat.coordinates(x)), start
    )
    error = G.error(expected, seen.coordinates(x))
    assert error.rotation < 1e-12
    assert error.translation < 1e-12


def test_invalid_limits_joints_and_gaits_are_refused() -> None:
    """Arguments that do not match are refused."""
    A = swimmer()
    with pytest.raises(pinred.InputError, match="one to three joints"):
        pinred.optimal_frame(A, [0.0, 1.0])
    with pytest.raises(pinred.InputError, match="indices below 2"):
        pinred.optimal_frame(A, BOX, joints=(0, 5))
    with pytest.raises(pinred.InputError, match="apply to a box of joint limits"):
        pinred.optimal_frame(A, CIRCLE, joints=(0, 1))
    with pytest.raises(pinred.InputError, match="one Fourier series"):
        pinred.corrected_integral(A, pinred.Gait.waypoints([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    with pytest.raises(pinred.InputError, match="each of 2 joints"):
        pinred.flatness(A, [[0.0, 1.0]])
