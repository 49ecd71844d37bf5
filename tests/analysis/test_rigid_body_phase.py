"""Montgomery's rigid-body phase, against Euler's equations by SciPy and its formula."""

from __future__ import annotations

from decimal import Decimal, localcontext
from itertools import pairwise
from math import fsum

import numpy as np
import pinocchio as pin
import pytest
from assertions import close
from numpy.typing import ArrayLike
from scipy.integrate import quad, solve_ivp

import pinred
from pinred.common.arrays import Array
from pinred.lie import SO3


def rotated_by_euler(moments: Array, omega: Array, time: float) -> tuple[Array, Array]:
    """Return angular velocity and quaternion after a time, by Euler's equations."""

    def rate(_: float, y: Array) -> Array:
        w, q = y[:3], y[3:] / np.linalg.norm(y[3:])
        return np.concatenate([np.cross(moments * w, w) / moments, SO3.rate(q, w)])

    start = np.concatenate([omega, SO3.identity()])
    solution = solve_ivp(rate, (0.0, time), start, method="DOP853", rtol=1e-13, atol=1e-14)
    return solution.y[:3, -1], SO3.normalize(solution.y[3:, -1])


MOMENTS = np.array([1.0, 2.0, 2.5])


def test_rigid_body_phase_matches_known_numbers() -> None:
    """`rigid_body` from (0.5, 0.7, 1.6): the angle is 2ET/|J| minus the solid angle."""
    p = pinred.rigid_body_phase(pinred.load("rigid_body"), [0.5, 0.7, 1.6])
    assert p.period == pytest.approx(6.384198031, abs=5e-10)
    assert p.angle == pytest.approx(4.88084917, abs=1e-8)
    E, J = 0.5 * MOMENTS @ [0.25, 0.49, 2.56], np.linalg.norm(MOMENTS * [0.5, 0.7, 1.6])
    assert p.energy == pytest.approx(E)
    assert p.momentum == pytest.approx(J)
    assert p.dynamic == pytest.approx(2.0 * E * p.period / J, rel=1e-14)
    assert (p.dynamic - p.solid_angle - p.angle) % (2.0 * np.pi) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    "omega",
    [
        [0.5, 0.7, 1.6],
        [1.6, 0.7, 0.5],
        [-1.6, 0.7, 0.5],
        [0.5, 0.7, -1.6],
        [0.0, 0.0, 1.0],
        [0.01, 1.0, 0.0],
    ],
)
@pytest.mark.sampled
def test_rigid_body_phase_matches_euler_equations(omega: list[float]) -> None:
    """After one period the rates return, and the body has rotated about J by the angle."""
    w = np.array(omega)
    p = pinred.rigid_body_phase(pinred.load("rigid_body"), w)
    end, q = rotated_by_euler(MOMENTS, w, p.period)
    close(end, w, 1e-10)
    log = SO3.log(q)
    close(np.cross(log, p.axis), np.zeros(3), 1e-10)
    close((log @ p.axis - p.angle + np.pi) % (2.0 * np.pi), np.pi, 1e-10)


def period_in_decimals(omega: tuple[float, ...]) -> Decimal:
    """Return 4 K √(a b c/…) with 60 digits; K(m) = π/(2 agm(1, √(1 − m)))."""
    with localcontext() as context:
        context.prec = 60
        moments, squares = [*map(Decimal, MOMENTS)], [Decimal(w) ** 2 for w in omega]
        above = sum(m * (m - moments[1]) * s for m, s in zip(moments, squares, strict=True))
        a, b, c = moments if above > 0 else moments[::-1]
        rate = (c - b) * sum(m * (m - a) * s for m, s in zip(moments, squares, strict=True))
        x, y = Decimal(1), ((c - a) * above / rate).sqrt()
        for _ in range(30):
            x, y = (x + y) / 2, (x * y).sqrt()
        pi = Decimal("3.14159265358979323846264338327950288419716939937510582097494459")
        return 2 * pi / x / (rate / (a * b * c)).sqrt()


def solid_angle_by_quadrature(omega: tuple[float, ...]) -> float:
    """Return ∮ (1 − cos θ) dφ about the outer axis that the momentum circles."""
    squares = MOMENTS * np.square(omega)
    above = squares @ (MOMENTS - MOMENTS[1])
    a, b, c = MOMENTS if above > 0.0 else MOMENTS[::-1]
    least = abs(above) / (b * (MOMENTS @ squares))

    def cosine(angle: float) -> float:
        bulge = abs(1.0 / a - 1.0 / b) * np.sin(angle) ** 2
        return float(np.sqrt((least + bulge) / (abs(1.0 / b - 1.0 / c) + bulge)))

    ends = [0.0, *np.logspace(-8, 0, 9), np.pi / 2]
    quarter = fsum(quad(cosine, *pair, epsabs=1e-13)[0] for pair in pairwise(ends))
    return float(np.sign(above) * (2.0 * np.pi - 4.0 * quarter))


@pytest.mark.parametrize(
    "omega",
    [(1e-7, 1.0, 0.0), (1e-6, 1.0, 0.0), (1e-14, 1.0, 0.0), (0.0, 1.0, 1e-7), (1e-7, 1.0, 1e-7)],
)
def test_phase_near_separatrix_is_accurate(omega: tuple[float, float, float]) -> None:
    """Neither J² − 2 E b nor 1 − m cancels: the period keeps all digits."""
    p = pinred.rigid_body_phase(pinred.load("rigid_body"), omega)
    assert p.period == pytest.approx(float(period_in_decimals(omega)), rel=1e-15)
    assert p.solid_angle == pytest.approx(solid_angle_by_quadrature(omega), abs=1e-12)


def test_period_near_separatrix_is_published_number() -> None:
    """From (1e-7, 1, 0) the period is 154.7507287982321 s."""
    p = pinred.rigid_body_phase(pinred.load("rigid_body"), [1e-7, 1.0, 0.0])
    assert p.period == pytest.approx(154.7507287982321, rel=1e-15)


def turned_body(moments: ArrayLike, R: Array) -> pinred.System:
    """Return a free body whose principal axes are the columns of R."""
    model = pin.Model()
    model.gravity.setZero()
    root = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "root")
    body = pin.Inertia(1.0, np.zeros(3), R @ np.diag(np.asarray(moments)) @ R.T)
    model.appendBodyToJoint(root, body, pin.SE3.Identity())
    return pinred.load(model)


@pytest.mark.parametrize(
    ("moments", "omega"),
    [
        ((1.0, 2.0, 2.5), (0.0, 1.0, 0.0)),  # about the middle axis
        ((1.0, 1.001, 2.0), (0.0, 1.0, 0.0)),  # whose axes are hard to tell apart
        ((2.0, 2.0, 2.0), (0.3, 0.4, 0.5)),
        ((1.0, 2.0, 2.0), (0.0, 0.6, 0.8)),
        ((1.0, 1.0, 1.6), (0.6, 0.8, 0.0)),
    ],
)
@pytest.mark.sampled(3)
def test_round_off_of_turned_body_makes_no_period(
    moments: tuple[float, ...], omega: tuple[float, ...]
) -> None:
    """In turned axes, round-off of the tensor does not pass for a motion with a period."""
    rng = np.random.default_rng(0)
    for _ in range(40):
        R = pin.exp3(rng.normal(size=3))
        with pytest.raises(pinred.InputError, match="no period"):
            pinred.rigid_body_phase(turned_body(moments, R), R @ omega)


def test_floating_body_phase_about_centre_of_mass() -> None:
    """The axes are not principal, and the frame is not at the centre of mass."""
    rng = np.random.default_rng(3)
    R = pin.exp3(rng.normal(size=3))
    model = pin.Model()
    model.gravity.setZero()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    body = pin.Inertia(2.0, np.array([0.3, -0.2, 0.5]), R @ np.diag(MOMENTS) @ R.T)
    model.appendBodyToJoint(root, body, pin.SE3.Identity())
    p = pinred.rigid_body_phase(pinred.load(model), R @ [0.5, 0.7, 1.6])
    same = pinred.rigid_body_phase(pinred.load("rigid_body"), [0.5, 0.7, 1.6])
    close([p.period, p.angle, p.solid_angle], [same.period, same.angle, same.solid_angle], 1e-11)
    close(p.axis, R @ same.axis, 1e-12)


def test_symmetric_top_phase_matches_closed_form() -> None:
    """The momentum describes a circle; solid angle and period have closed forms."""
    p = pinred.rigid_body_phase(turned_body([1.0, 1.0, 1.6], np.eye(3)), [0.3, 0.4, 1.1])
    assert p.period == pytest.approx(2.0 * np.pi / (0.6 * 1.1), rel=1e-13)
    cosine = 1.6 * 1.1 / np.hypot(0.5, 1.6 * 1.1)
    # For an oblate top the momentum rotates backwards about the body axis.
    assert abs(p.solid_angle) == pytest.approx(2.0 * np.pi * (1.0 - cosine), rel=1e-12)


@pytest.mark.parametrize(
    ("omega", "message"),
    [([0.0, 1.0, 0.0], "no period"), ([0.0, 0.0, 0.0], "non-zero vector"), ([1.0], "omega")],
)
def test_non_periodic_rotations_are_refused(omega: list[float], message: str) -> None:
    """Rotations without a period and bodies at rest are refused."""
    with pytest.raises(pinred.InputError, match=message):
        pinred.rigid_body_phase(pinred.load("rigid_body"), omega)


def test_systems_with_joints_or_planar_are_refused() -> None:
    """Only a single rigid body in space is accepted."""
    with pytest.raises(pinred.InputError, match="Lock them"):
        pinred.rigid_body_phase(pinred.load("falling_cat"), [1.0, 0.0, 0.0])
    with pytest.raises(pinred.InputError, match="SO3 or SE3, got SE2"):
        pinred.rigid_body_phase(pinred.load("three_rods"), [1.0, 0.0, 0.0])
