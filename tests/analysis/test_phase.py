"""Phases of gaits, against closed forms, published numbers, and SciPy over Pinocchio."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from assertions import close
from hypothesis import given, settings
from hypothesis import strategies as st
from lifts import by_pinocchio, random_gait
from scipy.integrate import quad, solve_ivp
from strategies import groups, make_case, seeds
from textbook import DELTA, I1, I2, J2, M2, D, M
from trees import random_model

import pinred
from pinred.analysis.phases.phase import screw_of
from pinred.common.arrays import Array
from pinred.lie.groups import group_named
from pinred.system.robot_file_contents import Contents, Coupling

Gait = pinred.Gait
CIRCLE = Gait.fourier([0.0, 0.0], [[1.0, 0.0]], [[0.0, 1.0]])
TRIANGLE = [[-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]


WINDING = [
    Gait.waypoints([[0.3]], turns=[1]),
    Gait.fourier([0.1], [[0.4]], [[0.2]], turns=1, period=2.0),
    Gait.waypoints([[0.3], [-1.0], [2.0]], turns=[1]).shifted(0.4),
    Gait.waypoints([[0.3]], turns=[-1]).reversed(),
]


def mechanical(name: str) -> pinred.Connection:
    """The mechanical connection of a bundled robot."""
    return pinred.Connection.mechanical(pinred.load(name))


@pytest.mark.parametrize("gait", WINDING)
def test_turn_of_propeller_rotates_elroys_beanie(gait: pinred.Gait) -> None:
    """By −2π I2/(I1 + I2) for any gait that turns it once, although the connection is flat."""
    A = mechanical("elroys_beanie")
    turn = -2.0 * np.pi * I2 / (I1 + I2)
    close(pinred.phase(A, gait).pose, [turn], 1e-14)
    close(pinred.phase(A, gait.then(gait)).pose, [2.0 * turn], 3e-14)
    close(pinred.phase(A, gait.reversed()).pose, [-turn], 1e-14)
    mu, T = 0.7, gait.period
    close(pinred.phase(A, gait, mu).pose, [turn + mu * T / (I1 + I2)], 1e-14)


# A gait of two cranks, in test_dead_points.py, winds, too.
@pytest.mark.by_hand
def test_phase_of_winding_gait_agrees_with_pinocchio() -> None:
    """Two hinges of three rods turn in opposite senses and wobble; with momentum, too."""
    system = pinred.load("three_rods")
    A, mu = pinred.Connection.mechanical(system), np.array([0.3, -0.2, 0.4])
    gait = Gait.fourier([0.2, 0.1], [[0.5, 0.0]], [[0.1, 0.4]], turns=[1, -1], period=1.5)
    close(gait.at(1.5)[0] - gait.at(0.0)[0], [2.0 * np.pi, -2.0 * np.pi], 1e-14)
    for moved in (gait, gait.shifted(0.3)):
        for momentum in (np.zeros(3), mu):
            error = A.group.error(
                pinred.phase(A, moved, momentum).pose, by_pinocchio(system, moved, momentum)
            )
            assert error.rotation < 1e-10
            assert error.translation < 1e-10


@pytest.mark.parametrize("turns", [1, 3, -7])
def test_error_bound_without_other_errors_is_round_off_of_path(turns: int) -> None:
    """64 units of round-off per radian, and per metre times radians; zero where nothing moves."""
    gait, unit = Gait.waypoints([[0.3]], turns=[turns]), 64.0 * np.finfo(float).eps
    beanie = pinred.phase(mechanical("elroys_beanie"), gait)
    turn = 2.0 * np.pi * abs(turns) * I2 / (I1 + I2)
    assert beanie.error.rotation == pytest.approx(unit * (1.0 + turn), rel=0.3, abs=0.0)
    assert beanie.error.translation == 0.0
    local = np.array([0.0, -J2 * M2 * D / DELTA, J2 * M / DELTA])
    p = pinred.phase(mechanical("coupled_planar"), gait)
    path = 2.0 * np.pi * abs(turns) * np.abs(local)
    assert p.error.rotation == pytest.approx(unit * (1.0 + path[2]), rel=0.3, abs=0.0)
    assert p.error.translation == pytest.approx(unit * path[1] * (1.0 + path[2]), rel=0.3, abs=0.0)
    exact = p.group.exp(-2.0 * np.pi * turns * local)
    error = p.group.error(exact, p.pose)
    assert error.rotation <= p.error.rotation
    assert error.translation <= p.error.translation


def test_error_bound_includes_path_by_momentum() -> None:
    """At constant shape the base turns by μT/I only, here by seven radians."""
    A, mu = mechanical("elroys_beanie"), 7.0 * (I1 + I2)
    p = pinred.phase(A, Gait.fourier([0.3], [[0.0]], [[1e-9]]), mu)
    assert p.error.rotation == pytest.approx(64.0 * np.finfo(float).eps * 8.0, rel=0.5, abs=0.0)


def two_links(first: pin.JointModel, ratio: float) -> pinred.System:
    """Return a planar chain on a turning base, whose last hinge follows the first joint."""
    model = pin.Model()
    model.gravity.setZero()
    joint, place = 0, pin.SE3(np.eye(3), np.array([0.7, 0.0, 0.0]))
    body = pin.Inertia(1.0, np.array([0.4, 0.1, 0.0]), 0.1 * np.eye(3))
    for name, kind in (
        ("base", pin.JointModelRZ()),
        ("first", first),
        ("last", pin.JointModelRZ()),
    ):
        joint = model.addJoint(joint, kind, place, name)
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    contents = Contents(couplings=(Coupling("last", {"first": ratio}, 0.2),))
    return pinred.System(model, "two_links", contents=contents)


@pytest.mark.parametrize(
    ("first", "ratio", "fine"),
    [
        (pin.JointModelRZ(), 2.0, True),
        (pin.JointModelRZ(), 1.5, False),
        (pin.JointModelPX(), 0.0, False),
        (pin.JointModelPX(), 1.0, False),
    ],
)
@pytest.mark.sampled
def test_only_turns_that_restore_the_robot_are_accepted(
    first: pin.JointModel, ratio: float, fine: bool
) -> None:
    """Slides, and leaders of followers with a broken ratio, do not repeat after 2π."""
    system = two_links(first, ratio)
    A, gait = pinred.Connection.mechanical(system), Gait.waypoints([[0.2]], turns=[1])
    if fine:
        expected = by_pinocchio(system, gait, np.zeros(1))
        close(pinred.phase(A, gait).pose, expected, 1e-10)
        return
    with pytest.raises(pinred.InputError, match=r"complete turn restores.* a turn of 'first'"):
        pinred.phase(A, gait)


def test_phase_of_elroys_beanie() -> None:
    """Without momentum the phase is zero; with it, the base rotates by μT/I for any gait."""
    A = mechanical("elroys_beanie")
    gait = Gait.fourier([0.3], [[0.5]], [[-0.4]], period=2.5)
    close(pinred.phase(A, gait).pose, [0.0], 1e-14)
    p = pinred.phase(A, gait, [0.7])
    close(p.pose, [0.7 * 2.5 / (I1 + I2)], 1e-14)
    close(p.dynamic, p.pose, 1e-14)
    close(p.geometric, [0.0], 1e-14)
    close(p.cycles(7), 7.0 * p.pose, 1e-13)
    half = 0.5 * gait.period  # At half time the base has rotated by −A Δx + μt/I.
    k = int(np.argmin(np.abs(p.times - half)))
    displacement = gait.at(p.times[k])[0] - gait.at(0.0)[0]
    close(p.path[k], -I2 / (I1 + I2) * displacement + 0.7 * p.times[k] / (I1 + I2), 1e-13)


def test_pose_of_coupled_planar_bodies() -> None:
    """A does not depend on the shape, so the pose is exp(−A (x − x0)) along the gait."""
    A = mechanical("coupled_planar")
    gait = Gait.fourier([0.3], [[0.5]], [[-0.4]], period=2.5)
    p = pinred.phase(A, gait)
    close(p.pose, np.zeros(3), 1e-14)
    local = np.array([0.0, -J2 * M2 * D / DELTA, J2 * M / DELTA])
    displacement = gait.at(p.times)[0] - gait.at(0.0)[0]
    close(p.path, A.group.exp(-displacement * local), 1e-13)


def test_three_rods_rotate_by_triangle_gait() -> None:
    """The line integral of A and the surface integral of B agree."""
    A = mechanical("three_rods")
    p = pinred.phase(A, Gait.waypoints(TRIANGLE))
    assert p.pose[2] == pytest.approx(0.033787199534, abs=5e-13)
    # Planar rotations commute, so the angle is −∬ B over the triangle.
    x, w = np.polynomial.legendre.leggauss(24)
    u, v = np.meshgrid(x, x, indexing="ij")
    shapes = np.stack(
        [u, -1.0 + 0.5 * (v + 1.0) * (1.0 - u)], axis=-1
    )  # triangle below the diagonal
    weights = np.multiply.outer(w, w) * 0.5 * (1.0 - u)
    B = A.grid(shapes).curvature[..., 2, 0, 1]
    assert -float((weights * B).sum()) == pytest.approx(p.pose[2], abs=1e-12)
    assert np.hypot(*p.pose[:2]) < 1.0


def test_three_rods_do_not_rotate_by_circles() -> None:
    """The angle row of the curvature is odd, so loops about the straight shape cancel."""
    assert abs(pinred.phase(mechanical("three_rods"), CIRCLE).pose[2]) < 1e-15


@settings(max_examples=6)
@given(group=groups, joints=st.integers(1, 3), seed=seeds, moving=st.booleans())
def test_phase_matches_scipy_over_pinocchio(
    group: str, joints: int, seed: int, moving: bool
) -> None:
    """Random trees on every group, with and without momentum: DOP853 over CRBA."""
    case = make_case(group, joints, seed)
    gait = random_gait(case.rng, joints, harmonics=1)
    mu = case.rng.normal(size=case.system.r) if moving else np.zeros(case.system.r)
    p = pinred.phase(pinred.Connection.mechanical(case.system), gait, mu)
    expected = by_pinocchio(case.system, gait, mu)
    error = p.group.error(expected, p.pose)
    size = 1.0 + float(np.linalg.norm(p.path, axis=1).max())
    assert error.rotation <= p.error.rotation + 1e-9
    assert error.translation <= p.error.translation + 1e-9 * size
    if group in ("SO2", "SE2", "RxSE2"):  # Full turns count.
        assert p.pose[-1] == pytest.approx(expected[-1], abs=1e-8)


@pytest.mark.parametrize("make", [Gait.waypoints, Gait.spline])
def test_phase_of_gait_with_corners(make: object) -> None:
    """The reference integrates each segment between corners separately."""
    system = pinred.load("falling_cat")
    gait = make([[0.5, 0.0, 0.2], [-0.5, 0.7, 0.1], [0.1, -0.6, -0.9]])  # type: ignore[operator]
    mu = np.array([0.02, -0.01, 0.03, 0.01, 0.02, -0.01])
    p = pinred.phase(pinred.Connection.mechanical(system), gait, mu)
    error = p.group.error(by_pinocchio(system, gait, mu), p.pose)
    assert error.rotation < 1e-10
    assert error.translation < 1e-10


@pytest.mark.parametrize("count", [40, pytest.param(200, marks=pytest.mark.by_hand)])
def test_error_bound_holds_on_random_gaits(count: int) -> None:
    """Random gaits are compared with eight times as many samples."""
    A = mechanical("falling_cat")
    rng = np.random.default_rng(8)
    for _ in range(count):
        gait = random_gait(rng, 3)
        rough = pinred.phase(A, gait, tolerance=1e-4)
        fine = pinred.phase(A, gait, tolerance=1e-12)
        assert fine.samples >= 2 * rough.samples or fine.error.rotation < 1e-12
        error = A.group.error(fine.pose, rough.pose)
        assert error.rotation <= rough.error.rotation + fine.error.rotation
        assert error.translation <= rough.error.translation + fine.error.translation


def test_phase_needs_few_shapes() -> None:
    """Three harmonics of solo12 to 1e-10 need at most 192 shapes."""
    pytest.importorskip("example_robot_data")
    A = mechanical("solo12")
    rng = np.random.default_rng(1)
    for _ in range(3):
        size = (3, 12)
        gait = Gait.fourier(
            rng.uniform(-0.3, 0.3, 12), rng.uniform(-0.4, 0.4, size), rng.uniform(-0.4, 0.4, size)
        )
        p = pinred.phase(A, gait)
        assert p.samples <= 192
        error = A.group.error(pinred.phase(A, gait, tolerance=1e-13).pose, p.pose)
        assert max(float(error.rotation), float(error.translation)) < 1e-10


def test_phase_is_dynamic_times_geometric() -> None:
    """The dynamic part solves ḋ = d Ad_h I⁻¹ μ separately."""
    system = pinred.load("coupled_spatial")
    A, group, red = pinred.Connection.mechanical(system), system.group, pinred.Reduction(system)
    gait = random_gait(np.random.default_rng(2), 3, harmonics=1)
    mu = np.array([0.1, -0.2, 0.3, 0.4, 0.1, -0.3])
    p = pinred.phase(A, gait, mu)
    whole = group.compose(p.dynamic, p.geometric)
    assert group.error(whole, p.pose).rotation < 1e-14
    close(group.error(pinred.phase(A, gait).pose, p.geometric).rotation, 0.0, 1e-10)

    # Integrate (h, d) together; d obeys a separate equation, with d = g h⁻¹.
    def rate(t: float, y: Array) -> Array:
        h, d = group.normalize(y[:7]), group.normalize(y[7:])
        x, xdot = gait.at(t)
        split = red.split(x)
        locked_inertia = np.linalg.solve(split.locked_inertia, group.Ad(group.compose(d, h)).T @ mu)
        return np.concatenate(
            [
                group.rate(h, -split.local_connection @ xdot),
                group.rate(d, group.Ad(h) @ locked_inertia),
            ]
        )

    start = np.tile(group.identity(), 2)
    solution = solve_ivp(rate, (0.0, gait.period), start, method="DOP853", rtol=1e-12, atol=1e-13)
    error = group.error(group.normalize(solution.y[7:, -1]), p.dynamic)
    assert error.rotation < 1e-10
    assert error.translation < 1e-10


def test_phase_of_several_cycles() -> None:
    """Without momentum the phases are powers; with it, the momentum rotates with the body."""
    system = pinred.load("falling_cat")
    A, group = pinred.Connection.mechanical(system), system.group
    gait = random_gait(np.random.default_rng(5), 3, harmonics=1)
    p = pinred.phase(A, gait)
    two = by_pinocchio(system, Gait(gait.arcs * 2), np.zeros(6))
    assert group.error(two, p.cycles(2)).rotation < 1e-9
    undone = group.compose(p.cycles(5), p.cycles(-5))
    assert group.error(group.identity(), undone).rotation < 1e-14
    mu = np.array([0.02, -0.01, 0.03, 0.01, 0.02, -0.01])
    moving = pinred.phase(A, gait, mu)
    there = by_pinocchio(system, Gait(gait.arcs * 2), mu)
    error = group.error(there, moving.cycles(2))
    assert error.rotation < 1e-9
    assert error.translation < 1e-9
    # The conserved spatial momentum gives the final body momentum.
    J = group.spatial_momentum(moving.pose, moving.end_momentum)
    close(J, mu, 1e-14)
    with pytest.raises(pinred.InputError, match="non-negative"):
        moving.cycles(-1)


def test_phase_matches_simulation() -> None:
    """The simulation with all joints prescribed shares no quadrature with the phase."""
    system = pinred.load("falling_cat")
    gait = Gait.fourier([0.2, 0.0, -0.1], [[0.3, 0.0, 0.2]], [[0.0, 0.4, 0.1]])
    mu = np.array([0.02, -0.01, 0.03, 0.01, 0.02, -0.01])
    plans = {
        name: f"{mean} + {c}*cos(2*pi*t) + {s}*sin(2*pi*t)"
        for name, mean, c, s in zip(
            system.shape_names, [0.2, 0.0, -0.1], [0.3, 0.0, 0.2], [0.0, 0.4, 0.1], strict=True
        )
    }
    traj = pinred.simulate(
        system, prescribed=plans, momentum=mu, duration=1.0, rtol=1e-12, atol=1e-12
    )
    p = pinred.phase(pinred.Connection.mechanical(system), gait, mu)
    error = system.group.error(traj.pose[-1], p.pose)
    assert error.rotation < 1e-9
    assert error.translation < 1e-9


@pytest.mark.parametrize(
    ("group", "pose", "text"),
    [
        ("SO2", [0.0], "none"),
        ("SO2", [-0.3], "0.3 rad about (0, 0, -1)"),
        ("SE2", [0.0, 0.05, 0.0], "none, but a slide of 0.05 m along (0, 1, 0)"),
        ("SE3", [0.1, 0.0, 0.0, np.sin(0.2), 0.0, 0.0, np.cos(0.2)], "0.4 rad about (1, 0, 0), "
         "slide 0.1 m"),
    ],
)  # fmt: skip
def test_screw_text_names_only_what_moves(group: str, pose: list[float], text: str) -> None:
    """Without rotation the axis has no meaning, and without translation there is no slide."""
    assert str(screw_of(group_named(group), np.array(pose))) == text


def test_screw_of_phase() -> None:
    """A planar motion has a circle as its path, a spatial one a helix."""
    A = pinred.Connection.mechanical(pinred.load("planar_chain5"))
    p = pinred.phase(A, random_gait(np.random.default_rng(1), 5))
    assert p.screw.angle == pytest.approx(p.pose[2], abs=1e-14)
    centre = p.screw.point[:2]
    for n in (1, 2, 5):
        assert np.linalg.norm(p.cycles(n)[:2] - centre) == pytest.approx(p.screw.radius, rel=1e-9)
    B = pinred.Connection.mechanical(pinred.load("satellite_two_arms"))
    q = pinred.phase(B, random_gait(np.random.default_rng(1), 6))
    foot = q.screw.point
    far = q.pose[:3] - foot
    direction = float(far @ q.screw.axis)
    assert direction == pytest.approx(q.screw.slide, abs=1e-12)
    assert np.linalg.norm(far - direction * q.screw.axis) == pytest.approx(
        q.screw.radius, abs=1e-12
    )


def test_length_matches_reduced_metric() -> None:
    """∫√(ẋᵀ M ẋ) dt equals SciPy's quadrature over Pinocchio's reduced metric."""
    system = pinred.load("three_rods")
    red = pinred.Reduction(system)

    def speed(t: float) -> float:
        x, xdot = CIRCLE.at(t)
        return float(np.sqrt(xdot @ red.reduced_metric(x) @ xdot))

    expected = quad(speed, 0.0, 1.0, epsabs=1e-12, limit=200)[0]
    p = pinred.phase(pinred.Connection.mechanical(system), CIRCLE, tolerance=1e-12)
    assert p.length == pytest.approx(expected, abs=1e-9)


def test_mismatched_arguments_and_tolerances_are_refused() -> None:
    """Arguments that do not match and unattainable tolerances are refused."""
    A = mechanical("three_rods")
    with pytest.raises(pinred.InputError, match=r"expected 2 joints for .*, got 1\."):
        pinred.phase(A, Gait.fourier([0.0], [[1.0]], [[0.0]]))
    with pytest.raises(pinred.ShapeError, match="momentum"):
        pinred.phase(A, CIRCLE, [1.0])
    with pytest.raises(pinred.InputError, match="tolerance"):
        pinred.phase(A, CIRCLE, tolerance=0.0)
    with pytest.raises(pinred.InputError, match="whole number"):
        pinred.phase(A, CIRCLE).cycles(1.5)  # type: ignore[arg-type]


@pytest.mark.parametrize("group", ["SO3", "SO2"])
def test_symmetry_breaking_gravity_is_refused(group: str) -> None:
    """Motions do not follow A under such gravity, in any frame."""
    model = random_model(group, 2, 1)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    heavy = pinred.Connection.mechanical(pinred.load(model))
    model.gravity.linear = np.zeros(3)
    light = pinred.Connection.mechanical(pinred.load(model))
    gait = pinred.Gait.fourier([0.0, 0.0], [[0.3, 0.0]], [[0.0, 0.3]])
    assert pinred.phase(light, gait).length > 0.0
    close(heavy.curvature([0.1, 0.2]), light.curvature([0.1, 0.2]), 1e-13)
    still = heavy.group.identity()
    framed = heavy.in_section(lambda x: ca.vertcat(*(0.0 * x[0] + float(each) for each in still)))
    says = "momenta are not conserved: gravity"
    calls: list[Callable[[], object]] = [
        lambda: pinred.phase(heavy, gait),
        lambda: pinred.phase(framed, gait),
        lambda: pinred.phase_slopes(heavy, gait),
        lambda: pinred.optimise_gait(heavy, axis="z" if group == "SO3" else None),
    ]
    for call in calls:
        with pytest.raises(pinred.SymmetryError, match=says):
            call()


def test_non_numbers_are_refused() -> None:
    """The message names the argument."""
    A = mechanical("three_rods")
    calls: list[Callable[[], object]] = [
        lambda: pinred.phase(A, 3),  # type: ignore[arg-type]
        lambda: pinred.phase(3, CIRCLE),  # type: ignore[arg-type]
        lambda: pinred.phase(A, CIRCLE).cycles(np.nan),  # type: ignore[arg-type]
        lambda: CIRCLE.shifted("a"),  # type: ignore[arg-type]
        lambda: CIRCLE.shifted(np.nan),
        lambda: pinred.optimise_gait(A, starts=np.nan),  # type: ignore[arg-type]
        lambda: pinred.optimise_gait(A, seed=-1),
        lambda: pinred.reorient(pinred.load("three_rods"), "a"),
        lambda: pinred.reorient(pinred.load("three_rods"), 0.3, momentum=[0.0, 0.0, 1e6]),
    ]
    for call in calls:
        with pytest.raises(pinred.PinredError):
            call()
