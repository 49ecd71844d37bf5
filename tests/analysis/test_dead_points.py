"""Shapes and gaits at dead points of independent joints, against closed forms and Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from loop_robots import FOUR_BAR, crank_angles, five_bar, four_bar
from scipy.integrate import solve_ivp

import pinred
from pinred.analysis.connections import gaits_of_all_joints
from pinred.analysis.connections.gaits_of_all_joints import AllJointsCode, along_joints
from pinred.analysis.connections.loop_connection import LoopConnectionCode
from pinred.analysis.phases.gait import FourierArc
from pinred.common.arrays import Array
from pinred.common.errors import InputError, IntegrationError, SingularInertiaError
from pinred.system.coordinates import InitialState
from pinred.system.loops.loop_assembly import loop_gaps
from pinred.system.robot_file_contents import Contents
from pinred.system.system import System

TAU = 2.0 * np.pi


@cache
def crank_rocker() -> pinred.System:
    """Return a four-bar whose crank turns completely."""
    model, loops = four_bar()
    return pinred.load(model, loops=loops)


def closed_form(crank: Array) -> Array:
    """Return crank, coupler and rocker at increasing crank angles, (N, 3), without jumps."""
    x = np.array([[angle, *crank_angles(angle)] for angle in crank.tolist()])
    return np.column_stack([crank, np.unwrap(x[:, 1]), np.unwrap(x[:, 2])])


def series(path: Callable[[Array], Array], turns: list[int], count: int = 256) -> pinred.Gait:
    """Return the Fourier gait through a path (N, m) of times in [0, 1)."""
    t = np.arange(count) / count
    modes = np.fft.rfft(path(t) - TAU * np.outer(t, turns), axis=0) / count
    kept = slice(1, 48)
    return pinred.Gait.fourier(
        modes[0].real, 2.0 * modes[kept].real, -2.0 * modes[kept].imag, turns=turns
    )


def full_turn(start: float = 0.0) -> pinred.Gait:
    """Return a full turn of the crank as a gait of all joints."""
    return series(lambda t: closed_form(start + TAU * t), [1, -1, 0])


def of_joints(gait: pinred.Gait, joints: list[int]) -> pinred.Gait:
    """Return the gait of some joints alone, which do not turn."""
    return series(lambda t: gait.at(t)[0][:, joints], [0] * len(joints))


def by(system: pinred.System, *joints: str) -> pinred.Connection:
    """Return the mechanical connection over some joints."""
    return pinred.Connection.mechanical(system, independent=joints)


def dead_crank() -> float:
    """Return the crank angle at which crank and coupler are aligned and the rocker turns back."""
    a, b, c, d = (FOUR_BAR[name] for name in ("crank", "coupler", "rocker", "frame"))
    return -float(np.arccos(((a + b) ** 2 + d**2 - c**2) / (2.0 * (a + b) * d)))


@cache
def turned_by_pinocchio(start: float) -> Array:
    """Integrate the pose over a full turn of the crank, with the closed form and CRBA."""
    model = crank_rocker().model
    data, h = model.createData(), 1e-3

    def rate(t: float, pose: Array) -> Array:
        x = closed_form(start + TAU * t + h * np.array([-3, -2, -1, 0, 1, 2, 3]))
        slope = (x[6] - x[0] + 9.0 * (x[1] - x[5]) + 45.0 * (x[4] - x[2])) / (60.0 * h)
        q = np.concatenate([[0.0, 0.0, 1.0, 0.0], x[3]])
        H = pin.crba(model, data, q)
        H = np.triu(H) + np.triu(H, 1).T
        v = -np.linalg.solve(H[:3, :3], H[:3, 3:] @ (TAU * slope))
        c, s = np.cos(pose[2]), np.sin(pose[2])
        return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]])

    end = solve_ivp(rate, (0.0, 1.0), np.zeros(3), "DOP853", rtol=1e-10, atol=1e-11)
    return np.asarray(end.y[:, -1])


def test_shape_at_a_dead_point_has_other_independent_joints() -> None:
    """The rocker stands still there; the values are those of the closed form."""
    red = pinred.LoopReduction(crank_rocker(), independent=["rocker"])
    near, h = dead_crank(), 1e-3
    x = closed_form(near + h * np.array([-3, -2, -1, 0, 1, 2, 3]))
    slope = (x[6] - x[0] + 9.0 * (x[1] - x[5]) + 45.0 * (x[4] - x[2])) / (60.0 * h)
    assert abs(slope[2]) < 1e-10
    here = red.at(x[3])
    (joint,) = here.independent
    assert joint != "rocker"
    scale = slope[crank_rocker().shape_names.index(joint)]
    np.testing.assert_allclose(here.G[:, 0], slope / scale, atol=1e-10)
    expected = here.tree.local_connection @ slope / scale
    np.testing.assert_allclose(here.local_connection[:, 0], expected, atol=1e-10)
    assert red.at(closed_form(np.array([near + 0.5]))[0]).independent == ("rocker",)


# Two further tests pass dead points of cranks and rockers.
@pytest.mark.by_hand("rocker")
@pytest.mark.parametrize(
    "joint",
    ["rocker", *(pytest.param(name, marks=pytest.mark.by_hand) for name in ("crank", "coupler"))],
)
def test_phase_of_a_full_turn_does_not_depend_on_the_independent_joint(joint: str) -> None:
    """A gait of all joints passes the dead points of each of them."""
    connection = by(crank_rocker(), joint)
    turn = pinred.phase(connection, full_turn())
    np.testing.assert_allclose(turn.pose, turned_by_pinocchio(0.0), atol=1e-9)
    assert turn.length > 1.0
    momentum = pinred.phase(connection, full_turn(), [0.1, 0.2, 0.3])
    crank = pinred.Gait.waypoints([[0.0]], turns=[1])
    expected = pinred.phase(by(crank_rocker(), "crank"), crank, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(momentum.pose, expected.pose, atol=1e-9)
    assert momentum.length == pytest.approx(expected.length, rel=1e-9)


# Every run has the five-bar below.
@pytest.mark.by_hand
def test_crank_turns_on_where_the_gait_of_the_rocker_passes_its_dead_points() -> None:
    """The rocker swings between its ends, also from one of them, and also in reverse."""
    connection, group = by(crank_rocker(), "rocker"), crank_rocker().group
    for start in (0.7, dead_crank()):
        gait = of_joints(full_turn(start), [2])
        assert gait.m == 1
        turn = pinred.phase(connection, gait)
        np.testing.assert_allclose(turn.pose, turned_by_pinocchio(start), atol=1e-9)
    back = pinred.phase(connection, of_joints(full_turn(0.7), [2]).reversed())
    expected = group.inverse(turned_by_pinocchio(0.7))
    np.testing.assert_allclose(back.pose, expected, atol=1e-9)


def test_rocker_that_ends_before_its_dead_point_turns_back() -> None:
    """The crank then swings to and fro, which displaces nothing; beyond the point is an error."""
    connection, end = (
        by(crank_rocker(), "rocker"),
        float(closed_form(np.array([dead_crank()]))[0, 2]),
    )
    for short, turns_back in ((1e-3, True), (-1e-3, False)):
        gait = pinred.Gait.fourier([end - short - 0.2], [[0.2]], [[0.0]])
        if turns_back:
            np.testing.assert_allclose(pinred.phase(connection, gait).pose, 0.0, atol=1e-9)
            continue
        with pytest.raises(SingularInertiaError, match=r"the loops tips .* from rocker near x"):
            pinred.phase(connection, gait)


def test_gait_that_passes_a_dead_point_once_does_not_close() -> None:
    """Other joints are on the other branch after one cycle; the message states both shapes."""
    connection, end = (
        by(crank_rocker(), "rocker"),
        float(closed_form(np.array([dead_crank()]))[0, 2]),
    )
    gait = pinred.Gait.fourier([end - 0.2], [[0.2]], [[0.0]])
    with pytest.raises(SingularInertiaError, match="dead point of rocker, and the other joints do"):
        pinred.phase(connection, gait)


def test_gait_of_two_cranks_passes_the_dead_points_of_a_five_bar() -> None:
    """Both branches meet where the couplers are aligned; the left side serves as a reference."""
    aligned = np.pi - np.arccos(0.8)  # angle of the left crank if the shape is symmetric

    def path(t: Array) -> Array:
        crank = aligned + 0.25 * np.cos(TAU * t)
        coupler = -aligned + 0.25 * np.sin(TAU * t)
        tip = 0.5 * np.exp(1j * crank) + 0.9 * np.exp(1j * (crank + coupler))
        arm = tip - 1.0
        inner = np.arccos((abs(arm) ** 2 + 0.5**2 - 0.9**2) / (2.0 * 0.5 * abs(arm)))
        right = np.angle(arm) - inner
        end = 1.0 + 0.5 * np.exp(1j * right)
        angle = np.angle(np.exp(-1j * right) * (tip - end))
        return np.column_stack([crank, coupler, right, angle])

    model, loops = five_bar()
    start = InitialState(path(np.zeros(1))[0], np.zeros(4), np.zeros(3), 1.0)
    system = System(model, "five_bar", start, contents=Contents(loops=tuple(loops)))
    names = ("left_crank", "left_coupler", "right_crank", "right_coupler")
    assert system.shape_names == names
    gait = series(path, [0] * 4)
    on_left = pinred.phase(by(system, *names[:2]), of_joints(gait, [0, 1]))
    cranks = by(system, "left_crank", "right_crank")
    for turn in (pinred.phase(cranks, of_joints(gait, [0, 2])), pinred.phase(cranks, gait)):
        np.testing.assert_allclose(turn.pose, on_left.pose, atol=1e-10)
    assert abs(on_left.pose[2]) > 1e-3
    directions = np.cumsum(path(np.linspace(0.0, 1.0, 64)).reshape(-1, 2, 2), axis=2)[:, :, 1]
    sines = np.sin(directions[:, 1] - directions[:, 0])
    assert sines.min() < -0.1 < 0.1 < sines.max()


def test_paths_that_are_open_or_of_other_joints_are_refused_by_name() -> None:
    """The messages name the loop and its gap, the joints, or the ball."""
    connection = by(crank_rocker(), "crank")
    with pytest.raises(InputError, match=r"closed shapes of 'four_bar', but loop 'tips' has a gap"):
        pinred.phase(connection, pinred.Gait.fourier([0.0] * 3, [[0.1] * 3], [[0.0] * 3]))
    with pytest.raises(InputError, match=r"expected 1 independent joints \(crank\), or all 3"):
        pinred.phase(connection, pinred.Gait.fourier([0.0] * 2, [[0.1] * 2], [[0.0] * 2]))
    model, loops = four_bar("z", ball=True)
    system = pinred.load(model, loops=loops)
    some = by(system, "crank")
    path = pinred.Gait.fourier([0.0] * system.m, [[0.1] * system.m], [[0.0] * system.m])
    with pytest.raises(InputError, match="cannot contain balls, and 'four_bar' has coupler"):
        pinred.phase(some, path)


def rounded_turn() -> pinred.Gait:
    """Return a full turn with few harmonics, so that loops are slightly open."""
    gait = full_turn()
    arc = gait.arcs[0]
    return pinred.Gait((replace(arc, cos=arc.cos[:6], sin=arc.sin[:6]),), gait.turns)  # type: ignore[call-arg,attr-defined]


def test_shapes_that_were_not_closed_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's method that does not converge ends with the shape, not with open loops."""
    connection = by(crank_rocker(), "rocker")
    monkeypatch.setattr(gaits_of_all_joints, "_ITERATIONS", 1)
    with pytest.raises(InputError, match=r"no closed shape of 'four_bar' was found near x = \["):
        pinred.phase(connection, rounded_turn())


def along_all_joints(connection: pinred.Connection) -> AllJointsCode:
    """Return the code of a connection along paths of all joints."""
    joined, _ = along_joints(connection, full_turn())
    assert isinstance(joined.code, AllJointsCode)
    return joined.code


def opened(gap: float) -> Array:
    """Return a shape (1, 3) of the crank-rocker whose loop has a gap relative to its size."""
    closure = crank_rocker().closure
    assert closure is not None
    x, move = closed_form(np.array([0.7])), np.array([0.0, 1.0, 0.0])
    slope = loop_gaps(crank_rocker(), x[0] + 1e-6 * move, closure.length).max() / 1e-6
    return np.asarray(x + gap / slope * move)


def test_open_paths_are_refused() -> None:
    """A gap of 2 % of the loop's size is an error; one of 0.5 % is closed."""
    code = along_all_joints(by(crank_rocker(), "rocker"))
    x, _ = code.closed(opened(5e-3), np.zeros((1, 3)))
    closure = crank_rocker().closure
    assert closure is not None
    assert loop_gaps(crank_rocker(), x[0], closure.length).max() < 1e-14
    with pytest.raises(InputError, match="expected a path of closed shapes"):
        code.closed(opened(2e-2), np.zeros((1, 3)))


def test_gap_that_remains_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """After one Newton step, the gap is quadratic in the first one; 4e-10 is an error."""
    code, still = along_all_joints(by(crank_rocker(), "rocker")), np.zeros((1, 3))
    closure = crank_rocker().closure
    assert closure is not None
    monkeypatch.setattr(gaits_of_all_joints, "_ITERATIONS", 1)
    monkeypatch.setattr(gaits_of_all_joints, "_SHUT", 1.0)
    left = loop_gaps(crank_rocker(), code.closed(opened(1e-4), still)[0][0], closure.length).max()
    monkeypatch.undo()
    monkeypatch.setattr(gaits_of_all_joints, "_ITERATIONS", 1)
    for gap, is_refused in ((4e-10, True), (4e-11, False)):
        x = opened(1e-4 * float(np.sqrt(gap / left)))
        if not is_refused:
            code.closed(x, still)
            continue
        with pytest.raises(InputError, match="no closed shape of 'four_bar' was found near x"):
            code.closed(x, still)


def test_tracked_path_that_misses_its_start_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Differences of 5e-8 rad exceed errors of the interpolation, which are below 1e-8 rad."""
    connection, gait = by(crank_rocker(), "rocker"), of_joints(full_turn(0.7), [2])
    code, tracked = connection.code, gaits_of_all_joints._tracked
    assert isinstance(code, LoopConnectionCode)
    assert gaits_of_all_joints.through_dead_points(code, gait) is not None

    def drifting(*arguments: Any) -> Any:
        result: Any = tracked(*arguments)
        result[0][-1] += 5e-8
        return result

    with monkeypatch.context() as patch:
        patch.setattr(gaits_of_all_joints, "_tracked", drifting)
        with pytest.raises(SingularInertiaError, match="the other joints do not return"):
            gaits_of_all_joints.through_dead_points(code, gait)


def test_path_that_misses_the_independent_joints_is_not_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A closed shape that is shifted along the path has an angle that differs by 5e-8 rad."""
    code, filled = by(crank_rocker(), "rocker").code, gaits_of_all_joints._filled
    assert isinstance(code, LoopConnectionCode)

    def shifted(*arguments: Any) -> Any:
        x: Any = filled(*arguments)
        step = x[4] - x[3]
        x[3] += 5e-8 / step[2] * step
        return x

    monkeypatch.setattr(gaits_of_all_joints, "_filled", shifted)
    assert gaits_of_all_joints.through_dead_points(code, of_joints(full_turn(0.7), [2])) is None


def sums_of_cosines(largest: float, size: float, harmonic: int) -> pinred.Gait | None:
    """Return the gait of samples whose first coefficient is `largest`, and another one `size`."""
    s = np.arange(256) / 256
    x = 2.0 * (largest * np.cos(TAU * s) + size * np.cos(harmonic * TAU * s))
    return gaits_of_all_joints._as_gait(x[:, None], np.zeros(1), 1.0, 0.0)


@pytest.mark.parametrize(
    ("largest", "size", "is_resolved"),
    [(0.5, 3e-9, False), (0.01, 3e-10, True), (100.0, 3e-8, True)],
)
def test_path_with_unresolved_harmonics_is_not_used(
    largest: float, size: float, is_resolved: bool
) -> None:
    """A Fourier series keeps a quarter of the samples as harmonics; the others must be small."""
    assert (sums_of_cosines(largest, size, 100) is not None) == is_resolved


@pytest.mark.parametrize(
    ("largest", "size", "harmonics"), [(1.0, 3e-15, 3), (0.01, 3e-16, 1), (100.0, 3e-14, 1)]
)
def test_round_off_adds_no_harmonics(largest: float, size: float, harmonics: int) -> None:
    """Coefficients count from 1e-15 of the largest, or of one radian."""
    gait = sums_of_cosines(largest, size, 3)
    assert gait is not None
    arc = gait.arcs[0]
    assert isinstance(arc, FourierArc)
    assert len(arc.cos) == harmonics


def test_nearly_closed_paths_are_replaced_by_the_nearest_closed_ones() -> None:
    """The phase of a path with few harmonics is that of a closed path: a full turn in SE(2)."""
    exact, rough = full_turn(), rounded_turn()
    gap = np.abs(rough.at(0.0)[0] - exact.at(0.0)[0]).max()
    assert 1e-6 < gap < 1e-3
    connection = by(crank_rocker(), "rocker")
    turn, expected = (pinred.phase(connection, gait) for gait in (rough, exact))
    # The closed path starts at a slightly different crank angle; the turn does not depend on it.
    np.testing.assert_allclose(turn.pose[2], expected.pose[2], atol=1e-10)


def test_flat_parallelogram_is_an_error_that_names_loop_and_shape() -> None:
    """All equations of the loop become dependent there, so no other joint helps."""
    model, loops = four_bar(lengths={"crank": 0.5, "coupler": 1.0, "rocker": 0.5, "frame": 1.0})
    contents = Contents(loops=tuple(replace(loop, coupled=False) for loop in loops))
    flat = System(model, "four_bar", contents=contents)
    message = r"loops tips of 'four_bar' become dependent at x = \[0\. 0\. 0\.\]"
    with pytest.raises(SingularInertiaError, match=message):
        pinred.LoopReduction(flat, independent=["rocker"])
    start = InitialState(np.array([0.4, -0.4, 0.4]), np.zeros(3), np.zeros(3), 1.0)
    system = System(model, "four_bar", start, contents=contents)
    red = pinred.LoopReduction(system, independent=["rocker"])
    with pytest.raises(SingularInertiaError, match=message):
        red.at([0.0, 0.0, 0.0])
    turn = pinred.Gait.waypoints([[0.4, -0.4, 0.4]], turns=[1, -1, 1])
    with pytest.raises(IntegrationError, match=r"loops tips .* dependent at t = .*x = \["):
        pinred.phase(by(system, "crank"), turn)
