"""Figures of connections and phases, against Pinocchio."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pinocchio as pin
import pytest
from figures import drawn
from matplotlib.axes import Axes
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

import pinred
from pinred import plots
from pinred.lie.group import Group
from pinred.lie.groups import SE2, SE3
from pinred.lie.rotations import left_jacobian
from pinred.views.motion_source import labels_of
from pinred.views.playback.colours_and_view_options import LOOK
from pinred.views.plots.connection_field import draw_field, moved_component, plane, refine, title_at

CIRCLE = pinred.Gait.fourier([0.3, 0.2], [[0.5, 0.0]], [[0.0, 0.5]])


def rods() -> pinred.Connection:
    """Load three rods in the plane."""
    return pinred.Connection.mechanical(pinred.load("three_rods"))


def contour_sets(axes: Axes) -> list[QuadContourSet]:
    """Return the contour sets of some axes."""
    return [item for item in axes.collections if isinstance(item, QuadContourSet)]


def dash_patterns(item: QuadContourSet) -> list[tuple[float, list[float] | None]]:
    """Return the offset and dashes of each line of a contour set."""
    return cast("list[tuple[float, list[float] | None]]", item.get_linestyle())


def filled_contours(axes: Axes) -> QuadContourSet:
    """Return the filled contours of some axes."""
    return next(item for item in contour_sets(axes) if item.filled)


def test_zero_contour_has_zero_curvature() -> None:
    """At points of the drawn line, by Pinocchio."""
    figure = plots.field(rods(), limits=[(-2.0, 2.0)] * 2, gait=CIRCLE)
    axes = figure.axes[0]
    sets = [item for item in axes.collections if isinstance(item, QuadContourSet)]
    (zero,) = [item for item in sets if list(item.levels) == [0.0]]
    points = np.concatenate(
        [np.asarray(p.vertices) for p in zero.get_paths() if p.vertices is not None]
    )
    red = pinred.Reduction(pinred.load("three_rods"))
    for point in points[:: len(points) // 5]:
        assert abs(red.curvature(point)[2, 0, 1]) < 1e-3
    x, y = drawn(axes, "path")
    np.testing.assert_allclose(np.hypot(x - 0.3, y - 0.2), 0.5, atol=1e-12)
    assert "signed area of the gait 0.7854" in axes.figure.get_suptitle() + axes.get_title() + str(
        [text.get_text() for text in axes.figure.texts]
    )


def test_figures_and_playback_have_the_same_colours() -> None:
    """Signed fields have Okabe and Ito's blue and vermilion, which pages read from Look."""
    low, high = (0, 114, 178), (213, 94, 0)
    assert [tuple(bytes.fromhex(colour[1:])) for colour in LOOK.field] == [low, high]
    figure = plots.field(rods(), limits=[(-2.0, 2.0)] * 2)
    shown = filled_contours(figure.axes[0]).get_cmap()
    expected = [low, (255, 255, 255), high]
    np.testing.assert_allclose(shown([0.0, 0.5, 1.0], bytes=True)[:, :3], expected, atol=1)


def test_integral_in_title_equals_phase() -> None:
    """For planar bodies the phase is minus the integral over the gait."""
    figure = plots.field(rods(), gait=CIRCLE)
    text = " ".join(
        [figure.get_suptitle(), figure.axes[0].get_title(), *(t.get_text() for t in figure.texts)]
    )
    integral = float(text.split("integral over it ")[1].split()[0].replace("−", "-"))
    turn = pinred.phase(rods(), CIRCLE).pose[2]
    assert -integral == pytest.approx(turn, rel=1e-3)


@pytest.mark.parametrize("part", ["exterior", "bracket", "connection"])
@pytest.mark.sampled
def test_field_draws_terms_and_connection(part: str) -> None:
    """The terms of the curvature, and the vector field of the connection."""
    figure = plots.field(rods(), part=part, component="v1")  # type: ignore[arg-type]
    assert "alpha1" in figure.axes[0].get_xlabel()


def test_cycles_plot_passes_poses() -> None:
    """The path passes through the pose after each cycle, in the plane and in space."""
    p = pinred.phase(rods(), CIRCLE)
    axes = pinred.plot(p, "cycles", count=3).axes[0]
    x, y = drawn(axes, "after each cycle")
    expected = np.array([p.cycles(k)[:2] for k in range(4)])
    np.testing.assert_allclose(np.stack([x, y], axis=1), expected, atol=1e-12)
    cat = pinred.Connection.mechanical(pinred.load("falling_cat"))
    gait = pinred.Gait.fourier(np.zeros(3), [[0.5, 0.0, 0.0]], [[0.0, 0.5, 0.0]])
    q = pinred.phase(cat, gait)
    t, rotated = drawn(plots.cycles(q, count=2).axes[1], "θx")
    assert t[-1] == pytest.approx(2.0)
    expected_turn = np.degrees(cat.group.log(q.cycles(2))[3])
    assert rotated[-1] == pytest.approx(expected_turn, abs=1e-10)


def test_cycles_plot_continues_beyond_half_a_turn() -> None:
    """Rotation vectors are continuous beyond 180°, and each is the attitude of its time."""
    cat = pinred.Connection.mechanical(pinred.load("falling_cat"))
    gait = pinred.Gait.fourier(np.zeros(3), [[0.8, 0.0, 0.0]], [[0.0, 0.8, 0.0]])
    p = pinred.phase(cat, gait)
    figure = plots.cycles(p, count=3)
    position, rotation = figure.axes
    vectors = np.radians([drawn(rotation, f"θ{k}")[1] for k in "xyz"]).T
    assert np.linalg.norm(vectors, axis=1).max() > 1.3 * np.pi
    assert np.linalg.norm(np.diff(vectors, axis=0), axis=1).max() < 0.3
    expected = pin.Quaternion(np.asarray(p.cycles(3)[3:])).toRotationMatrix()
    np.testing.assert_allclose(pin.exp3(vectors[-1]), expected, atol=1e-12)
    places = np.array([drawn(position, k)[1][-1] for k in "xyz"])
    np.testing.assert_allclose(places, p.cycles(3)[:3], atol=1e-12)


@pytest.mark.by_hand
def test_loop_plot_of_gait_and_plan() -> None:
    """The path, the joints, and the final base of a best gait and of a plan."""
    best = pinred.optimise_gait(rods(), limits=1.5, harmonics=1, starts=1)
    plan = pinred.reorient(pinred.load("three_rods"), 0.3, limits=2.5, x0=[0.4, 0.5])
    for source, gait, end in (
        (best, best.gait, best.phase.pose[2]),
        (plan, plan.gait, 0.3),
    ):
        on_curvature, joints, base = (
            axes for axes in pinred.plot(source, "loop").axes if axes.get_label() != "<colorbar>"
        )
        x, y = drawn(on_curvature, "path")
        np.testing.assert_allclose([x.min(), x.max()], gait.limits[0], atol=1e-3)
        np.testing.assert_allclose([y.min(), y.max()], gait.limits[1], atol=1e-3)
        assert drawn(joints, "alpha1")[1][0] == pytest.approx(gait.at(0.0)[0][0])
        assert drawn(base, "θ")[1][-1] == pytest.approx(np.degrees(end), abs=1e-6)
    satellite = pinred.load("satellite_two_arms")
    plan = pinred.reorient(satellite, [0.0, 0.0, 0.1], limits=2.6)
    labels = [axes.get_ylabel() for axes in plots.loop(plan).axes]
    assert "B, component ω3 [rad/rad²]" in labels  # of the target, not the largest
    cat = pinred.Connection.mechanical(pinred.load("falling_cat"))
    turning = pinred.optimise_gait(cat, axis="x", limits=1.0, harmonics=1, starts=1)
    t, _ = drawn(pinred.plot(turning, "loop").axes[-1], "θx")
    assert t[-1] == pytest.approx(1.0)


def test_plots_of_connections_reject_invalid_input() -> None:
    """Wrong types, and other than two joints."""
    with pytest.raises(pinred.InputError, match="field takes a Connection, or a System"):
        plots.field("three_rods")  # type: ignore[arg-type]
    with pytest.raises(pinred.InputError, match="loop draws a BestGait or a TurnPlan"):
        plots.loop(rods())  # type: ignore[arg-type]
    with pytest.raises(pinred.InputError, match="cycles draws a Phase"):
        plots.cycles(rods())  # type: ignore[arg-type]
    with pytest.raises(pinred.InputError, match="count must be"):
        plots.cycles(pinred.phase(rods(), CIRCLE), count=0)
    with pytest.raises(pinred.InputError, match="distinct joints"):
        plots.field(rods(), joints=(0, 0))
    one = pinred.Connection.mechanical(pinred.load("elroys_beanie"))
    with pytest.raises(pinred.InputError, match="at least 2 joints"):
        plots.field(one)


def test_level_curves_have_neither_corners_nor_gaps_at_saddles() -> None:
    """The zeros of a saddle are four straight lines, those of x² + y² − 1 a circle."""
    shapes = plane((0, 1), [(-3.0, 3.0)] * 2, np.zeros(2))
    x, y = shapes.axes[0], shapes.axes[1][:, None]
    noise = 1e-15 * np.random.default_rng(5).standard_normal((len(x), len(x)))
    lengths, ends = [], []
    for values in (x * y + noise, x**2 - y**2 + noise, x**2 + y**2 - 1.0):
        axes = Figure().subplots()
        draw_field(axes, shapes, values, ["a [rad]", "b [rad]"], "B [1]")
        (zero,) = [item for item in contour_sets(axes) if list(item.levels) == [0.0]]
        lines = [line for path in zero.get_paths() for line in path.to_polygons(closed_only=False)]
        lengths.append(sum(float(np.hypot(*np.diff(line, axis=0).T).sum()) for line in lines))
        ends.append(np.concatenate(lines))
        levels = [item for item in contour_sets(axes) if not item.filled]
        assert all(dashes is None for item in levels for _, dashes in dash_patterns(item))
        assert sum(0.0 in item.levels for item in levels) == 1
    np.testing.assert_allclose(lengths, [12.0, 12.0 * np.sqrt(2.0), 2.0 * np.pi], rtol=5e-3)
    assert np.abs(ends[0].prod(axis=1)).max() < 1e-9
    assert np.abs(np.diff(ends[1] ** 2, axis=1)).max() < 1e-9
    middles = 0.5 * (ends[2][1:] + ends[2][:-1])
    assert np.abs(np.hypot(*middles.T) - 1.0).max() < 2e-4
    ramp = np.broadcast_to((x + 3.0) / 6.0, (len(x), len(x)))
    assert refine(shapes.axes, ramp + 3e-10)[1].min() > 0.0
    assert refine(shapes.axes, ramp + 3e-11)[1].min() == 0.0


def test_slice_is_stated_for_any_number_of_fixed_joints() -> None:
    """Few are listed; of many, zeros are counted, and the ninth value is not listed."""
    names = labels_of(pinred.load("planar_chain5"))
    listed = "joint3 = 0 rad, joint4 = 0.5 rad, joint5 = 0 rad"
    assert title_at(names, (0, 1), np.array([1, 1, 0, 0.5, 0])) == f"drawn for {listed}"
    long = replace(names, joints=tuple("abcdefghijklm"), units=("rad",) * 13)
    assert title_at(long, (0, 1), np.zeros(13)) == "drawn for 11 joints at 0"
    some = title_at(long, (0, 1), np.array([1.0] * 3 + [0.0] * 10))
    assert some == "drawn for c = 1 rad, 10 other joints at 0"
    most = title_at(long, (0, 1), np.array([1.0] * 12 + [0.0]))
    assert most.endswith("j = 1 rad, 2 joints more, 1 other joint at 0")


def test_long_titles_are_wrapped_to_the_figure() -> None:
    """The names of a satellite's joints are long."""
    figure = plots.curvature(pinred.load("satellite_two_arms"))
    title = figure.get_suptitle()
    assert [line.split(" ")[0] for line in title.split("\n")] == [
        "satellite_two_arms:", "component", "drawn",
    ]  # fmt: skip
    figure.draw_without_rendering()
    assert figure.texts[0].get_window_extent().x1 < figure.bbox.x1


def test_integral_of_an_odd_field_over_a_centred_gait_is_zero() -> None:
    """Of three equal rods, turn and lateral motion are odd, so the title states no round-off."""
    gait = pinred.Gait.fourier([0.0, 0.0], [[0.8, 0.0]], [[0.0, 0.8]])
    for component in ("turn", "y"):
        title = plots.field(rods(), gait=gait, component=component).get_suptitle()
        assert title.endswith("integral over it 0")


def test_zero_contour_over_axes_of_ball_has_zero_curvature() -> None:
    """In rotation vectors w the curvature is J(w)ᵀ B J(w), with Pinocchio's B at exp(w)."""
    cat = pinred.load("falling_cat_ball")
    red, at = pinred.Reduction(cat), cat.space.integrate(cat.space.neutral, np.array([0.4, 0, 0]))
    figure = plots.curvature(cat, joints=["spine.y", "spine.z"], component="w1", at=at)
    assert "drawn for spine.x = 0.4 rad" in figure.get_suptitle()
    sets = [item for item in figure.axes[0].collections if isinstance(item, QuadContourSet)]
    (zero,) = [item for item in sets if list(item.levels) == [0.0]]
    points = np.concatenate(
        [np.asarray(p.vertices) for p in zero.get_paths() if p.vertices is not None]
    )
    for y, z in points[:: len(points) // 5]:
        w = np.array([0.4, y, z])
        J = left_jacobian(-w)
        B = J.T @ red.curvature(cat.space.integrate(cat.space.neutral, w))[3] @ J
        assert abs(B[1, 2]) < 1e-3 * np.abs(B).max()


def test_fields_of_both_signs_are_white_at_zero_with_equal_axes() -> None:
    """The colours diverge from zero; angles have equal scales; one sign has the other colours."""
    figure = plots.field(rods(), limits=[(-2, 1), (-1, 1)])
    filled = filled_contours(figure.axes[0])
    assert filled.get_cmap().name == "pinred_signed"
    levels = np.asarray(filled.levels)
    assert levels[0] == -levels[-1]
    assert figure.axes[0].get_aspect() == 1.0
    one_sign = plots.field(rods(), limits=[(0.1, 1.0), (0.1, 1.0)]).axes[0]
    filled = filled_contours(one_sign)
    assert filled.get_cmap().name == "cividis"


def test_default_joints_move_most() -> None:
    """The curvature is drawn over the two joints with the largest range of the motion."""
    cat = pinred.load("falling_cat")
    plan = {"bend": "0.01*sin(t)", "sway": "0.5*sin(t)", "twist": "0.4*cos(t)"}
    traj = pinred.simulate(cat, duration=2.0, prescribed=plan, momentum=0)
    assert "B(sway, twist)" in plots.curvature(traj).get_suptitle()
    assert "bend" in plots.phase(traj).get_suptitle().split("\n")[1]
    gait = pinred.Gait.fourier([0, 0, 0], [[0.01, 0.5, 0]], [[0, 0, 0.4]])
    assert "B(sway, twist)" in plots.field(cat, gait=gait).get_suptitle()


def test_loop_is_drawn_over_the_component_of_its_objective() -> None:
    """A displacement along y is drawn over the component of v2, a rotation over that of ω."""
    swimmer = pinred.load("purcell_swimmer")
    drag = {link: pinred.Rod(1.0, across=2.0, along=1.0) for link in ("middle", "front", "rear")}
    connection = pinred.Connection.viscous(swimmer, drag)
    best = pinred.optimise_gait(
        connection, objective="displacement", axis="x", harmonics=1, starts=1, limits=1.0
    )
    labels = [axes.get_ylabel() for axes in plots.loop(best).axes]
    assert "B, component v1 [m/rad²]" in labels
    titles = [axes.get_title(loc="left") for axes in plots.loop(best).axes]
    assert "displacement along x per area of alpha1, alpha2" in titles
    assert plots.loop(best).get_suptitle().startswith("purcell_swimmer: ")
    # The swimmer does not turn, so a field shows the displacement of its gait, too.
    figure = plots.field(connection, gait=best.gait)
    words = "purcell_swimmer: displacement along x per area, B(alpha1, alpha2), component v1"
    assert figure.get_suptitle().split("\n")[0] == words
    title = plots.cycles(best.phase).get_suptitle()
    assert title.endswith("m a cycle")
    assert "°" not in title


@pytest.mark.parametrize(
    ("group", "twist", "expected"),
    [
        (SE2, [0.2, -0.3, 1e-9], 1), (SE2, [0.2, -0.3, 2e-6], 2),
        (SE2, [0, 5e-7, 5e-7], None), (SE2, [0.2, -0.3, 1e-3], 2), (SE2, [0.0, 0.0, 1e-9], None),
        (SE3, [0.1, 0, -0.4, 0, 0, 0], 2), (SE3, [5.0, 0, 0, 0.01, -0.02, 0], 4),
    ],
)  # fmt: skip
def test_moved_component_is_a_turn_or_else_the_largest_displacement(
    group: Group, twist: list[float], expected: int | None
) -> None:
    """Of the motion of a cycle; round-off is none."""
    assert moved_component(group, group.exp(np.array(twist))) == expected


def test_full_turn_counts_as_motion() -> None:
    """Its pose is not the identity, although its logarithm is zero."""
    assert moved_component(SE2, np.array([0.0, 0.0, 2.0 * np.pi])) == 2


def test_titles_say_the_motion_the_slice_and_omitted_joints() -> None:
    """In words, with the values of joints that are not on an axis."""
    cat = pinred.Connection.mechanical(pinred.load("falling_cat"))
    title = plots.field(cat, joints=("bend", "sway"), component="w2", at=[0, 0, 0.4])
    words = "falling_cat: turn about y per area, B(bend, sway), component ω2"
    assert title.get_suptitle() == f"{words}\ndrawn for twist = 0.4 rad"
    assert title.axes[-1].get_ylabel() == "B, component ω2 [rad/rad²]"
    flow = plots.field(cat, part="connection", component="y")
    assert flow.get_suptitle().startswith("falling_cat: displacement along y per joint motion, −A(")
    assert flow.axes[-1].get_ylabel() == "−A, component v2 [m/rad]"


@pytest.mark.parametrize("momentum", [0.0, [0.0, 0.0, 0.4]])
@pytest.mark.sampled
def test_cycles_are_drawn_finely_and_right(momentum: float | list[float]) -> None:
    """Between the ends of segments, against SciPy's DOP853 of ġ = g ξ; the ends are kept."""
    phase = pinred.phase(rods(), CIRCLE, momentum)
    times, poses = phase.fine_path(200)
    assert len(times) > 200 > 5 * len(phase.times)
    every = (len(times) - 1) // (len(phase.times) - 1)
    np.testing.assert_allclose(times[::every], phase.times, atol=1e-15)
    np.testing.assert_allclose(poses[::every], phase.path, atol=1e-12)
    red = pinred.Reduction(pinred.load("three_rods"))

    def rate(t: float, g: np.ndarray[tuple[int], np.dtype[np.float64]]) -> list[float]:
        x, xdot = (values[0] for values in CIRCLE.at([t]))
        at = red.at(x)
        mu = SE2.Ad(g).T @ np.broadcast_to(momentum, (3,))
        xi = np.linalg.solve(at.locked_inertia, mu) - at.local_connection @ xdot
        return [float(value) for value in SE2.rate(g, xi)]

    exact = solve_ivp(rate, (0.0, 1.0), np.zeros(3), "DOP853", times, rtol=1e-11, atol=1e-12).y.T
    np.testing.assert_allclose(poses, exact, rtol=0, atol=1e-8)
    line = plots.cycles(phase, count=2).axes[0].lines[0]
    assert len(np.asarray(line.get_xdata())) == 2 * len(times)
