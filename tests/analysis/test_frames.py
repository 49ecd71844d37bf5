"""Minimum-perturbation frames, surface integrals of curvature, flatness."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from assertions import close
from link_poses import link_pose
from strategies import make_case
from three_links import CENTRES, LENGTH, LINKS

import pinred
from pinred.common.arrays import Array

CIRCLE = pinred.Gait.fourier([0.0, 0.0], [[1.0, 0.0]], [[0.0, 1.0]])
RODS = {name: pinred.Rod(LENGTH, 2.0, 1.0, centre=(CENTRES[name], 0.0, 0.0)) for name in LINKS}
BOX = [[-1.5, 1.5], [-1.5, 1.5]]


def swimmer() -> pinred.Connection:
    """Purcell's, with drag ratio 2."""
    return pinred.Connection.viscous(pinred.load("purcell_swimmer"), RODS)


def test_the_surface_integral_becomes_trustworthy() -> None:
    """Purcell's circle of radius 1: from 27 % in the middle link to below 0.5 % in the frame."""
    A = swimmer()
    before = pinred.corrected_integral(A, CIRCLE)
    assert before.error == pytest.approx(0.266, abs=2e-3)
    assert not before.trusted
    frame = pinred.optimal_frame(A, BOX)
    after = pinred.corrected_integral(A, CIRCLE, frame)
    assert after.error < 5e-3
    assert after.trusted
    # The frame is only another frame: the phase in it is the conjugate of the published one.
    assert np.hypot(*after.phase[:2]) == pytest.approx(0.0512808243, abs=1e-8)
    assert pinred.corrected_integral(A, CIRCLE, pinred.optimal_frame(A, CIRCLE)).error < 0.02


def test_where_it_stops_being_trustworthy() -> None:
    """With the radius of the circle the error grows, in any frame; and it is told."""
    A = swimmer()
    frame = pinred.optimal_frame(A, [[-2.5, 2.5], [-2.5, 2.5]])
    errors = [
        pinred.corrected_integral(A, CIRCLE.scaled(radius), frame).error for radius in (1.0, 2.4)
    ]
    assert errors[0] < errors[1]


def test_it_does_not_matter_from_where() -> None:
    """The same least norm from every base link, to 1e-8."""
    A = swimmer()
    found = [pinred.optimal_frame(c, BOX) for c in (A, A.seen_from("front"), A.seen_from("rear"))]
    norms = np.array([[each.angular, each.linear] for each in found])
    close(norms, np.tile(norms[0], (3, 1)), 1e-8)
    assert found[0].angular < 0.2 * found[0].angular_before
    assert found[1].linear < 0.1 * found[1].linear_before


def test_the_frame_is_the_frame() -> None:
    """A′ by its definition: the velocity that the frame has on a horizontal motion."""
    A = swimmer()
    frame, G = pinred.optimal_frame(A, BOX), A.group
    x, xdot, h = np.array([0.7, -0.4]), np.array([0.3, 0.9]), 1e-4
    step = [G.compose(G.inverse(frame.pose(x)), frame.pose(x + k * h * xdot)) for k in (-1, 1)]
    moved = (G.log(step[1]) - G.log(step[0])) / (2.0 * h)
    xi = G.Ad(G.inverse(frame.pose(x))) @ A.velocity(x, xdot) + moved
    close(frame.local(x) @ (xdot / 1.5), -xi, 1e-7)


def test_least_means_least() -> None:
    """Any other smooth frame disturbs more: angular and linear parts, each by itself."""
    A = swimmer()
    best = pinred.optimal_frame(A, BOX)
    rng = np.random.default_rng(1)
    u, w = best.patch.nodes, best.patch.weights / best.patch.weights.sum()
    for _ in range(5):
        amount = 1e-3 * rng.normal(size=3)
        k = rng.normal(size=2)
        wave, slope = np.sin(u @ k), np.cos(u @ k)[:, None] * k
        field = best.local_at(u)
        moved = field.copy()
        moved[:, 2] -= amount[2] * slope
        change = w @ (moved[:, 2] ** 2 - field[:, 2] ** 2).sum(axis=1)
        assert change > 0.0
        # p → p + δp in the frame: A′_v + A_ω × δp − ∂δp (in its axes, to first order).
        arms = amount[:2, None] * wave
        turning = field[:, 2]
        across = [-turning * arms[1][:, None], turning * arms[0][:, None]]
        shifted = field[:, :2] + np.stack(across, axis=1)
        shifted -= amount[:2, None] * slope[:, None, :]
        first = w @ ((shifted - field[:, :2]) * field[:, :2]).sum(axis=(1, 2))
        size = w @ ((shifted - field[:, :2]) ** 2).sum(axis=(1, 2))
        assert abs(first) < 0.2 * size


@pytest.mark.by_hand
def test_attitudes_in_space() -> None:
    """SO(3) over three joints on 20³ nodes: the same norm from two sections, and stationary."""
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


def test_free_floating_robots_want_their_centre_of_mass() -> None:
    """In SE(3) the best origin is the centre of mass: nothing of the translations is left."""
    system = pinred.load("falling_cat")
    frame = pinred.optimal_frame(
        pinred.Connection.mechanical(system), [[-0.8, 0.8]] * 2, joints=(0, 1), degree=12
    )
    assert frame.linear < 1e-8
    x = np.array([0.5, -0.3, 0.0])
    com = pinred.Reduction(system).split(x).com
    # Up to a point that is fixed in the frame: the difference does not depend on the shape.
    G = system.group

    def seen(shape: Array) -> Array:
        return np.asarray(G.inverse(frame.pose(shape))[:3])

    assert np.isfinite(seen(x)).all()
    close(frame.pose(x)[:3], com, 1e-6)


def test_a_gait_in_many_joints() -> None:
    """On the disc of a gait of six joints the integral gets better, whatever the joints."""
    A = pinred.Connection.mechanical(pinred.load("satellite_two_arms"))
    rng = np.random.default_rng(3)
    gait = pinred.Gait.fourier(
        rng.uniform(-0.5, 0.5, 6), rng.uniform(-0.5, 0.5, (1, 6)), rng.uniform(-0.5, 0.5, (1, 6))
    )
    before = pinred.corrected_integral(A, gait)
    after = pinred.corrected_integral(A, gait, pinred.optimal_frame(A, gait))
    turned = [np.linalg.norm((each.integral - each.log)[3:]) for each in (before, after)]
    assert turned[1] < 0.5 * turned[0]


def test_stokes_in_a_commutative_group() -> None:
    """Of SO(2) the surface integral is the phase, exactly."""
    A = pinred.Connection.mechanical(pinred.load("double_spherical_pendulum"))
    gait = pinred.Gait.fourier(
        [0.5, 0.4, -0.3], [[0.2, 0.1, 0.0], [0.05, 0.0, 0.02]], [[0.0, 0.2, -0.1], [0.0, 0.03, 0.1]]
    )
    found = pinred.corrected_integral(A, gait)
    assert found.error < 1e-9


def test_flat_and_not_flat() -> None:
    """Curvature is a verdict: coordinates where it vanishes, a refusal where it does not."""
    rods = pinred.flatness(pinred.Connection.mechanical(pinred.load("three_rods")))
    assert not rods.attitude_is_flat
    assert not rods.is_flat
    assert rods.relative[0] > 1e-3
    B = pinred.Reduction(pinred.load("three_rods")).curvature(rods.worst)
    assert np.abs(B).max() == pytest.approx(rods.curvature[1], rel=1e-12)
    with pytest.raises(pinred.InputError, match="no such frame"):
        rods.coordinates([0.1, 0.2])
    assert "attitude: not flat" in str(rods)
    board = pinred.load("snakeboard")  # afloat, its A does not depend on the shape
    flat = pinred.flatness(pinred.Connection.mechanical(board))
    assert flat.is_flat
    assert flat.attitude_is_flat
    x = np.array([0.3, -0.4, 0.9])
    A = pinred.Reduction(board).local_connection(x)
    close(flat.coordinates(x)[2], A[2] @ x, 1e-13)


def test_flat_coordinates_stand_still() -> None:
    """One joint is always flat: from any base link the frame h(x) goes where the other says."""
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
    apart = G.error(expected, seen.coordinates(x))
    assert apart.rotation < 1e-12
    assert apart.translation < 1e-12


def test_refusals() -> None:
    """Limits, joints and gaits that do not fit."""
    A = swimmer()
    with pytest.raises(pinred.InputError, match="one to three joints"):
        pinred.optimal_frame(A, [0.0, 1.0])
    with pytest.raises(pinred.InputError, match="indices below 2"):
        pinred.optimal_frame(A, BOX, joints=(0, 5))
    with pytest.raises(pinred.InputError, match="go with limits"):
        pinred.optimal_frame(A, CIRCLE, joints=(0, 1))
    with pytest.raises(pinred.InputError, match="one Fourier series"):
        pinred.corrected_integral(A, pinred.Gait.waypoints([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    with pytest.raises(pinred.InputError, match="each of 2 joints"):
        pinred.flatness(A, [[0.0, 1.0]])
