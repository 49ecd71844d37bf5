"""The lift of paths to the group: constant twists in closed form, and where it must fail."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Polynomial, legendre
from scipy.special import comb, factorial

from pinred.analysis.phases.lift import STAGES, PathSegments, lift
from pinred.common.arrays import Array
from pinred.common.errors import NoConvergence
from pinred.lie import GROUPS

SE3 = GROUPS["SE3"]
LIMIT = 64 * 4e-16  # largest change of the last iteration, relative to the state


def constant(twist: Array, durations: Array) -> PathSegments:
    """Return segments of given durations along which a spatial twist is constant."""
    a = np.broadcast_to(twist, (len(durations), STAGES, 6)).copy()
    return PathSegments(durations, a, np.zeros((0, STAGES, 6, 6)))


def spin(angle: float) -> PathSegments:
    """Return one segment that turns by an angle about the third axis."""
    return constant(np.array([0.0, 0.0, 0.0, 0.0, 0.0, angle]), np.ones(1))


def step_angle(angle: float) -> float:
    """Return the angle by which a Gauss step of 8 stages turns a quaternion, for an exact angle.

    The step multiplies by Padé's approximant (8, 8) of exp(i angle / 2).
    """
    k = np.arange(STAGES + 1)
    weights = factorial(2 * STAGES - k) * comb(STAGES, k) / factorial(2 * STAGES)
    return float(4.0 * np.angle(Polynomial(weights)(0.5j * angle)))


def last_change(angle: float) -> float:
    """Return the relative change of the 80th fixed-point iteration of `spin`, by NumPy."""
    x, _ = legendre.leggauss(STAGES)
    c, powers = 0.5 * (x + 1.0), np.arange(STAGES)
    A = (c[:, None] ** (powers + 1) / (powers + 1)) @ np.linalg.inv(c[:, None] ** powers)
    Y = [np.ones(STAGES, complex)]
    for _ in range(80):
        Y.append(1.0 + 0.5j * angle * A @ Y[-1])
    parts = (np.abs(z.view(float)) for z in (Y[-1] - Y[-2], Y[-1]))
    change, size = (float(part.max()) for part in parts)
    return change / max(1.0, size)


@pytest.mark.parametrize("durations", [[1.0], [0.3, 0.5, 0.2]])
def test_constant_twist_gives_its_exponential(durations: list[float]) -> None:
    """At each segment end, to round-off."""
    twist, h = np.array([0.3, -0.5, 0.2, 0.6, -0.4, 0.5]), np.array(durations)
    path = lift(SE3, constant(twist, h), np.zeros(6))
    for time, pose in zip([0.0, *np.cumsum(h)], path, strict=True):
        error = SE3.error(SE3.exp(time * twist), pose)
        assert error.rotation < 2e-15
        assert error.translation < 2e-15


@pytest.mark.parametrize("angle", [0.5, 3.0, 6.0])
def test_long_step_turns_by_pade_approximant(angle: float) -> None:
    """The stages are solved to round-off also where the step itself is inaccurate."""
    pose = lift(SE3, spin(angle), np.zeros(6))[-1]
    expected = SE3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, step_angle(angle)]))
    assert SE3.error(expected, pose).rotation < 1e-14


def test_unfinished_iteration_is_refused() -> None:
    """The 80th iteration may change the state by its round-off, and not by 4 to 8 times LIMIT.

    Near 14 rad the iteration contracts so slowly that it has not reached round-off.
    """
    for angle in np.linspace(9.0, 12.0, 61):
        lift(SE3, spin(angle), np.zeros(6))
    angles = np.linspace(13.5, 15.0, 601)
    changes = np.array([last_change(angle) for angle in angles]) / LIMIT
    wild = angles[(changes > 3.5) & (changes < 8.0)]
    assert len(wild) > 10
    for angle in wild[::4]:
        with pytest.raises(NoConvergence, match="segment 0 of 1 did not converge"):
            lift(SE3, spin(angle), np.zeros(6))


def test_round_off_of_iteration_scales_with_position() -> None:
    """A base that moves by 100 km while it turns by 9 to 12 rad is lifted, too."""
    for angle in np.linspace(9.0, 12.0, 16):
        twist = np.array([1e5, 0.0, 0.0, 0.0, 0.0, angle])
        (end,) = lift(SE3, constant(twist, np.ones(1)), np.zeros(6))[1:]
        expected = SE3.exp(twist)
        assert np.linalg.norm(end[:3] - expected[:3]) < 1e-3 * 1e5  # the step is inaccurate
        np.testing.assert_array_equal(end[2:5], 0.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
@pytest.mark.parametrize("entry", [0, 5])
def test_twists_that_are_not_finite_are_refused(bad: float, entry: int) -> None:
    """One NaN at one node must not become a pose; the time reached is reported."""
    segments = constant(np.full(6, 0.1), np.array([0.25, 0.5, 0.5]))
    segments.a[1, 3, entry] = bad
    if bad == 1e200 and entry == 0:
        return  # a velocity that does not overflow
    with pytest.raises(NoConvergence, match="segment 1 of 3 did not converge") as failure:
        lift(SE3, segments, np.zeros(6))
    assert failure.value.time == 0.25
