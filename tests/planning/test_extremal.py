"""Extremals of the isoholonomic problem, against closed forms and Pinocchio."""

from __future__ import annotations

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from assertions import close
from inverse_dynamics import joint_torques
from lifts import random_gait
from three_links import CENTRES, LENGTH, LINKS

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import IntegrationError
from pinred.kernels.connection.connection_form import ConnectionForm, form_of
from pinred.lie import GROUPS
from pinred.planning.optimisation import extremal as wong
from pinred.planning.optimisation.extremal import ExtremalProblem, levenberg_marquardt, start_of
from pinred.planning.optimisation.gait_search import Task
from pinred.planning.optimisation.limits import limits_of
from pinred.planning.optimisation.objective import AxisAim, TargetAim, axis_aim, target_aim

BEST = 2.385991643818944  # rotation per length of three rods, by Pinocchio's mass matrix


def rods() -> pinred.Connection:
    """Return the mechanical connection of three equal rods."""
    return pinred.Connection.mechanical(pinred.load("three_rods"))


def swimmer() -> pinred.Connection:
    """Return the connection of Purcell's swimmer with drag ratio 2."""
    drag = {name: pinred.Rod(LENGTH, 2.0, 1.0, centre=(CENTRES[name], 0.0, 0.0)) for name in LINKS}
    return pinred.Connection.viscous(pinred.load("purcell_swimmer"), drag)


def heisenberg() -> pinred.Connection:
    """Return A = (0, x₀) on the flat plane: a loop turns the base by minus its area."""

    def matrix(x0: float) -> Array:
        A = np.array([[0.0, x0]])
        return np.block([[np.eye(1), A], [A.T, np.eye(2) + A.T @ A]])

    def values(x: ca.SX, v: ca.SX) -> ca.SX:
        momentum = v[0] + x[0] * v[2]
        return ca.vertcat(momentum, v[1], v[2] + x[0] * momentum)

    form: ConnectionForm = form_of(
        GROUPS["SO2"], ("a", "b"), ("rad", "rad"), "areas", values,
        lambda x: matrix(float(x[0])), symmetric=True,
    )  # fmt: skip
    return pinred.Connection.of(form)


@pytest.fixture(scope="module")
def best_circle() -> pinred.BestGait:
    """Return the shortest loop of one harmonic that turns the base by 0.7 rad."""
    return pinred.optimise_gait(heisenberg(), objective="target", target=0.7, harmonics=1, starts=1)


def test_extremals_of_constant_curvature_are_circles(best_circle: pinred.BestGait) -> None:
    """Isoperimetric inequality: L² = 4π |θ|, and the charge is dL/dθ = √(π/θ)."""
    theta = best_circle.phase.pose[0]
    circle = pinred.extremal(best_circle)
    assert theta == pytest.approx(0.7)
    assert circle.length == pytest.approx(np.sqrt(4.0 * np.pi * theta), rel=1e-11)
    close(circle.charge, [np.sqrt(np.pi / theta)], 1e-9)
    assert circle.pose[0] == pytest.approx(theta, rel=1e-11)
    x, _ = circle.gait.samples(64)
    radii = np.linalg.norm(x - circle.gait.series.mean, axis=1)
    close(radii, np.full(64, np.sqrt(theta / np.pi)), 1e-10)
    assert len(circle.gait.series.cos) <= 8
    assert "not proven" in str(circle)


@pytest.fixture(scope="module")
def best() -> pinred.BestGait:
    """Return the best rotation per length of three rods with three harmonics."""
    return pinred.optimise_gait(rods(), harmonics=3, starts=1)


@pytest.fixture(scope="module")
def extremal(best: pinred.BestGait) -> pinred.Extremal:
    """Return its extremal."""
    return pinred.extremal(best)


# Circles have closed forms, and the distance of an optimum to its extremal is checked by default.
@pytest.mark.by_hand
def test_extremal_of_three_rods_has_merit_of_pinocchio(extremal: pinred.Extremal) -> None:
    """Rotation per length by Pinocchio's mass matrix; Fourier loops approach it from below."""
    assert extremal.residual <= 1e-10
    assert extremal.error <= 1e-11
    assert extremal.merit == pytest.approx(BEST, abs=1e-11)
    red = pinred.Reduction(pinred.load("three_rods"))
    x, xdot = extremal.gait.samples(100)
    states = list(zip(x, xdot, strict=True))
    turned = np.mean([-(red.local_connection(y) @ v)[2] for y, v in states])
    length = np.mean([np.sqrt(v @ red.reduced_metric(y) @ v) for y, v in states])
    assert turned / length == pytest.approx(extremal.merit, rel=1e-12)
    assert turned == pytest.approx(extremal.pose[2], rel=1e-12)


def test_extremal_obeys_wong_equations_of_pinocchio(extremal: pinred.Extremal) -> None:
    """Torques by RNEA at zero momentum equal the magnetic force ⟨μ, B(·, ẋ)⟩ with μ = L ∂L/∂g."""
    system, period = pinred.load("three_rods"), extremal.gait.period
    red = pinred.Reduction(system)
    mu = extremal.length / period * extremal.charge
    close(mu[:2], np.zeros(2), 1e-10)  # A rotation needs no force.
    arc = extremal.gait.series
    k = np.arange(1, len(arc.cos) + 1)
    for t in period * np.array([0.05, 0.3, 0.62, 0.9]):
        x, xdot = extremal.gait.at(t)
        rate = 2.0 * np.pi * k / period
        bend = -(rate**2 * np.cos(rate * t)) @ arc.cos - (rate**2 * np.sin(rate * t)) @ arc.sin
        force = np.einsum("i,iab,b->a", mu, red.curvature(x), xdot)
        assert np.abs(force).max() > 1e-3
        close(joint_torques(system, x, xdot, bend), force, 1e-9)


def test_distance_of_optimum_is_difference_to_extremal(
    best: pinred.BestGait, extremal: pinred.Extremal
) -> None:
    """Three harmonics lack 2e-5 of the merit."""
    distance = best.distance()
    assert distance.route == "extremal"
    assert distance.value == pytest.approx(extremal.merit - best.merit, abs=1e-11)
    assert distance.value == pytest.approx(BEST - 2.3859707714, abs=1e-9)
    assert "to the extremal nearby" in str(distance)


@pytest.mark.by_hand
def test_distance_without_extremal_is_that_to_twice_the_harmonics() -> None:
    """Torque per rotation with one harmonic and with two."""
    coarse, fine = (
        pinred.optimise_gait(rods(), cost="torque", harmonics=h, starts=1) for h in (1, 2)
    )
    distance = coarse.distance()
    assert distance.route == "harmonics"
    assert distance.value == pytest.approx(fine.merit - coarse.merit, rel=1e-6)
    assert "at least 1.4e+00" in str(distance)
    assert "got cost 'torque'" in distance.reason


def test_distance_of_polygon_is_not_known() -> None:
    """A polygon has no extremal and no harmonics."""
    best = pinred.optimise_gait(rods(), cost=None, vertices=8, limits=1.0, starts=1)
    distance = best.distance()
    assert distance.value is None
    assert distance.route == "none"
    assert str(distance).startswith("not known: best: expected an optimum with cost 'length'")


def test_extremal_with_corner_is_made_of_arcs(
    best_circle: pinred.BestGait, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The circle as a loop that may have a corner: arcs with the length of a Fourier series."""
    smooth = pinred.extremal(best_circle)
    assert smooth.corner == 0.0
    assert smooth.gait.is_smooth
    monkeypatch.setattr(wong, "_CORNER", -1.0)
    arcs = pinred.extremal(best_circle)
    assert not arcs.gait.is_smooth
    assert arcs.error < 1e-10
    t = np.linspace(0.0, 1.0, 50)
    close(arcs.gait.at(t)[0], smooth.gait.at(t)[0], 1e-10)


@pytest.mark.by_hand
def test_extremal_to_an_attitude_has_a_corner() -> None:
    """The attitude depends on where a cycle starts, and the momentum p balances the corner."""
    A = pinred.Connection.mechanical(pinred.load("falling_cat"))
    options = {"objective": "target", "target": [0.5, 0.2, 0.0], "limits": 3.0, "starts": 1}
    best = pinred.optimise_gait(A, **options, harmonics=5)  # type: ignore[arg-type]
    loop = pinred.extremal(best)
    assert 0.3 < loop.corner < 0.4
    assert 1e-7 < best.cost - loop.length < 1e-6
    p = pinred.phase(A, loop.gait, tolerance=1e-12)
    assert p.length == pytest.approx(loop.length, rel=1e-12)
    error = A.group.error(p.pose, loop.pose)
    assert max(error.rotation, error.translation) < 1e-11
    # M (ẋ(T) − ẋ(0)) = Aᵀ (μ(0) − μ(T)), with Pinocchio's metric and connection.
    red, period = pinred.Reduction(A.system), loop.gait.period  # type: ignore[arg-type]
    (start, first), (_, last) = loop.gait.at(0.0), loop.gait.at(np.nextafter(period, 0.0))
    J = loop.charge * loop.length / period
    mu = A.group.Ad(loop.pose).T @ J
    jump = red.reduced_metric(start) @ (last - first)
    close(jump, red.local_connection(start).T @ (J - mu), 1e-9)


@pytest.mark.by_hand
def test_extremal_stroke_of_purcells_swimmer() -> None:
    """Displacement without rotation: the charge is a force and a moment, constant in space."""
    best = pinred.optimise_gait(swimmer(), objective="displacement", harmonics=5, starts=1)
    stroke = pinred.extremal(best)
    assert 0.0 < stroke.merit - best.merit < 1e-8
    p = pinred.phase(swimmer(), stroke.gait, tolerance=1e-12)
    assert p.pose[0] / p.length == pytest.approx(stroke.merit, rel=1e-11)
    assert abs(p.pose[2]) < 1e-11
    # The charge is the gradient of the length: dL/dx = L/x along the axis.
    assert stroke.charge[0] == pytest.approx(1.0 / stroke.merit, rel=1e-9)


@pytest.mark.by_hand
def test_charge_is_derivative_of_length() -> None:
    """Extremals of two targets: ΔL/Δθ by central differences, and a bound instead of a target."""
    theta, step = 0.3, 1e-3
    lengths = []
    for target in (theta - step, theta, theta + step):
        best = pinred.optimise_gait(
            rods(), objective="target", target=target, harmonics=5, starts=1
        )
        found = pinred.extremal(best)
        lengths.append(found.length)
        if target == theta:
            charge = found.charge[2]
    assert (lengths[2] - lengths[0]) / (2.0 * step) == pytest.approx(charge, rel=1e-5)
    bounded = pinred.optimise_gait(rods(), most=lengths[1], harmonics=5, starts=1)
    assert pinred.extremal(bounded).value == pytest.approx(theta, rel=1e-10)


@pytest.mark.by_hand("space")
@pytest.mark.parametrize("kind", ["rotation", "bounded", "displacement", "target", "space"])
@pytest.mark.sampled
def test_jacobian_of_shooting_equals_differences_of_residuals(kind: str) -> None:
    """Along a random direction, for planar and spatial groups, values and targets."""
    A = pinred.Connection.mechanical(pinred.load("falling_cat")) if kind == "space" else rods()
    rng = np.random.default_rng(4)
    gait = random_gait(rng, A.m, 1)
    aim: AxisAim | TargetAim = target_aim(A.group, [0.1, 0.2, 0.3])
    if kind in ("rotation", "bounded"):
        aim = axis_aim(A.group, "rotation", None)
    elif kind == "displacement":
        aim = axis_aim(A.group, "displacement", "x")
    most = 1.0 if kind == "bounded" else None
    problem = ExtremalProblem(Task(A, aim, "length", most, limits_of(A, 3.0, None, None), 1.0))
    start = start_of(problem, gait)
    along = rng.normal(size=len(start.z)) * start.scale
    J = problem.jacobian(start.z, start.scale)
    assert J.shape == (len(start.z), len(start.z))
    step = 1e-6
    expected = (
        problem.residuals(start.z + step * along) - problem.residuals(start.z - step * along)
    ) / (2.0 * step)
    found = J @ along
    size = np.abs(J) @ np.abs(along) + 1e-3 * start.units
    close(found / size, expected / size, 5e-5)


def test_levenberg_marquardt_finds_nearest_point_of_a_curve() -> None:
    """Zeros of (|z|² − 1, 0) form a circle: the step has least norm, so it is radial."""

    def residuals(z: Array) -> Array:
        if z @ z > 2.0:
            raise IntegrationError("beyond the edge")
        return np.array([z @ z - 1.0, 0.0])

    def jacobian(z: Array) -> Array:
        return np.array([2.0 * z, np.zeros(2)])

    for start in ([0.3, 0.4], [3e-3, 4e-3]):  # From here an undamped step leaves the domain.
        root = levenberg_marquardt(residuals, jacobian, np.array(start), tolerance=1e-10)
        assert root.residual < 1e-12
        close(root.z, [0.6, 0.8], 1e-6)
    stuck = levenberg_marquardt(
        lambda _: np.ones(1), lambda _: np.eye(1), np.ones(1), tolerance=0.1
    )
    assert stuck.residual == 1.0


def test_extremal_refuses_other_problems(best: pinred.BestGait) -> None:
    """Other costs, polygons, active limits and inactive bounds are named."""
    tight = replace(best.task, limits=limits_of(rods(), best.gait.limits, None, None))
    for change, message in (
        ({"task": replace(best.task, cost="torque")}, "expected an optimum with cost 'length'"),
        ({"gait": pinred.Gait.waypoints([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])}, "got a polygon"),
        ({"task": tight}, "got one at its limits"),
        ({"task": replace(best.task, most=9.0)}, "expected a length at its bound 9"),
    ):
        with pytest.raises(pinred.InputError, match=re.escape(message)):
            pinred.extremal(replace(best, **change))


@pytest.mark.parametrize(
    ("constant", "value", "message"),
    [
        ("RESIDUAL", 0.0, "no extremal was found near the optimum"),
        ("_WORSE", -1.0, "increase the harmonics"),
    ],
)
def test_extremal_checks_its_result(
    best_circle: pinred.BestGait,
    monkeypatch: pytest.MonkeyPatch,
    constant: str,
    value: float,
    message: str,
) -> None:
    """Each bound refuses a loop that exceeds it."""
    monkeypatch.setattr(wong, constant, value)
    with pytest.raises(pinred.NoOptimum, match=message):
        pinred.extremal(best_circle)


def test_extremal_beyond_limits_is_refused(best_circle: pinred.BestGait) -> None:
    """The circle has a radius of 0.47 rad."""
    task = replace(best_circle.task, limits=limits_of(heisenberg(), 0.1, None, None))
    with pytest.raises(pinred.NoOptimum, match="exceeds the limits"):
        wong.polish(task, best_circle.gait, best_circle.merit)
