"""Limits of the robot's file: what a motion does to them, in every kind of file."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred import SceneWarning
from pinred.cli.command_line import main
from pinred.forces import PD, Spring, Torque
from pinred.simulation import trajectory as limit_excess

URDF = """<robot name="arm"><link name="bus"><inertial><mass value="10"/>
<inertia ixx="2" iyy="2" izz="2" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="bus"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-0.5" upper="1.0" effort="2" velocity="0.8"/></joint>
<link name="arm"><inertial><origin xyz="0.3 0 0"/><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
MJCF = """<mujoco><compiler angle="radian"/><worldbody><body name="bus"><freejoint/>
<inertial pos="0 0 0" mass="10" diaginertia="2 2 2"/><body name="arm">
<joint name="hinge" axis="0 0 1" limited="true" range="-0.5 1.0"/>
<inertial pos="0.3 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></body></worldbody></mujoco>"""
AT_REST: dict[str, Any] = {"xi0": [0.0] * 6}


def use(traj: pinred.Trajectory, kind: str) -> Any:
    """The only row of a kind."""
    (row,) = (row for row in traj.limits if row.limit.kind == kind)
    return row


def test_table_has_the_extremes_of_a_known_motion() -> None:
    """X = 1.2 sin(t): the position passes 1 by 0.2 at π/2, the rate passes 0.8 by 0.4 at 0."""
    arm = pinred.load(text=URDF)
    with pytest.warns(SceneWarning, match=r"position of hinge by .* rad at t = ") as caught:
        traj = pinred.simulate(
            arm, prescribed={"hinge": "1.2*sin(t)"}, times=[0.0, 4.0], duration=None, **AT_REST
        )
    position, rate, effort = (use(traj, kind) for kind in ("position", "rate", "effort"))
    assert position.excess == pytest.approx(1.2 * abs(np.sin(4.0)) - 0.5, abs=1e-9)
    assert (position.t, position.greatest) == (4.0, pytest.approx(1.2, abs=0.01))
    assert rate.excess == pytest.approx(0.4, abs=1e-3)
    assert (rate.t, rate.least < -0.75) == (0.0, True)
    # A planar motion about the common centre of mass: torque = I_eff ẍ about the hinge's axis.
    reduced = 10.0 * 1.0 / 11.0 * 0.3**2 + 0.1  # of the arm against the base's centre
    inertia = reduced * 2.0 / (reduced + 2.0)
    assert effort.least == pytest.approx(-1.2 * inertia, rel=1e-3)
    assert effort.greatest == pytest.approx(1.2 * abs(np.sin(4.0)) * inertia, rel=1e-6)
    assert effort.excess == 0.0
    assert str(caught[0].message).count("hinge") == 2
    assert [row.limit.kind for row in traj.limits.exceeded] == ["position", "rate"]
    assert "hinge" in repr(traj.limits)
    assert "hinge" in traj.limits._repr_html_()


def test_extremes_between_report_times_are_found() -> None:
    """The report times are at the zeros of the motion."""
    arm = pinred.load(text=URDF)
    traj = pinred.simulate(
        arm, prescribed={"hinge": "0.9*sin(t)"}, times=[0.0, np.pi, 2 * np.pi], **AT_REST
    )
    assert use(traj, "position").least == pytest.approx(-0.9, abs=0.02)


@pytest.mark.parametrize(
    ("forces", "springs", "effort"),
    [
        ([Torque({"hinge": 3.0})], {}, 3.0),
        ([Torque({"hinge": 3.0}), Spring("hinge", 50.0, 0.3)], {}, 3.0),
        ([Torque({"hinge": 3.0})], {"hinge": (50.0, 0.3)}, 3.0),
        ([PD({"hinge": 0.1}, kp=40.0, kd=0.0)], {}, 4.0),
        ([], {"hinge": (50.0, 0.3)}, None),
    ],
    ids=["torque", "torque beside a spring", "torque beside springs", "control", "springs alone"],
)
def test_effort_is_what_a_motor_exerts(forces: Any, springs: Any, effort: float | None) -> None:
    """Springs are no motors."""
    traj = pinred.simulate(
        pinred.load(text=URDF), forces=forces, springs=springs, duration=0.3, x0=[0.0], **AT_REST
    )
    rows = [row for row in traj.limits if row.limit.kind == "effort"]
    if effort is None:
        assert not rows
        return
    assert rows[0].greatest == pytest.approx(effort, rel=1e-9)
    assert rows[0].excess == pytest.approx(effort - 2.0, rel=1e-9)


def test_urdf_and_mjcf_give_the_same_warning(tmp_path: Path) -> None:
    """Neither warns when it is loaded, and both name the joint after a simulation."""
    messages = []
    for suffix, text in ((".urdf", URDF), (".xml", MJCF)):
        path = tmp_path / f"arm{suffix}"
        path.write_text(text, encoding="utf-8")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            robot = pinred.load(path)
        assert any(left.what == "joint limits" for left in robot.left_out)
        with pytest.warns(SceneWarning, match="goes beyond the limits of its file") as caught:
            traj = pinred.simulate(robot, x0=[0.9], xdot0=[0.5], duration=1.0, **AT_REST)
        messages.append(str(caught[0].message).partition("of hinge by")[2])
        assert use(traj, "position").greatest == pytest.approx(float(traj.x.max()), rel=1e-9)
    assert messages[0] == messages[1]


def test_motion_within_the_limits_is_silent_and_a_warning_is_given_once() -> None:
    """A loop of simulations does not repeat the line for the same limits."""
    arm = pinred.load(text=URDF)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        inside = pinred.simulate(arm, x0=[0.1], xdot0=[0.1], duration=1.0, **AT_REST)
    assert not inside.limits.exceeded
    with pytest.warns(SceneWarning):
        pinred.simulate(arm, x0=[0.9], xdot0=[0.5], duration=1.0, **AT_REST)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = pinred.simulate(arm, x0=[0.9], xdot0=[0.6], duration=1.0, **AT_REST)
    assert again.limits.exceeded


def test_other_joints_are_named_or_held(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Python, scene files and the command line hold the same joints."""
    options: dict[str, Any] = {"x0": {"sway": 0.3}, "duration": 0.5, **AT_REST}
    plan = {"bend": "0.4*sin(2*t)"}
    cat = pinred.load("falling_cat")
    with pytest.warns(SceneWarning, match="nothing drives sway, twist of 'falling_cat'"):
        free = pinred.simulate(cat, prescribed=plan, **options)
    assert np.ptp(free.x[:, 1]) > 1e-3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pinred.simulate(cat, prescribed=plan, hold="free", **options)
        named = pinred.simulate(cat, prescribed={**plan, "sway": 0.3, "twist": 0.0}, **options)
        held = pinred.simulate(cat, prescribed=plan, hold="others", **options)
        driven = [PD({"sway": 0.1, "twist": 0.2}, kp=1.0, kd=1.0)]
        pinred.simulate(pinred.load("falling_cat"), prescribed=plan, forces=driven, **options)
    np.testing.assert_array_equal(held.q, named.q)
    assert pinred.compare(held).passed
    pickled = pinred.simulate(held.scene, x0={"sway": 0.2})  # held where the new scene starts
    np.testing.assert_array_equal(pickled.x[:, 1], 0.2)
    for line in ('hold = "others"\n[prescribed]\n', '[prescribed]\nothers = "hold"\n'):
        path = tmp_path / "scene.toml"
        path.write_text(
            'robot = "falling_cat"\nstart = { x0 = { sway = 0.3 }, xi0 = [0, 0, 0, 0, 0, 0] }\n'
            f'run = {{ duration = 0.5, samples = 201 }}\n{line}bend = "0.4*sin(2*t)"\n',
            encoding="utf-8",
        )
        assert main(["run", str(path), "--out", str(tmp_path / "run.npz")]) == 0
        np.testing.assert_array_equal(np.load(tmp_path / "run.npz")["q"], held.q)
    assert not capsys.readouterr().err
    arguments = ["falling_cat", "--x0", "sway=0.3", "--xi0", "0,0,0,0,0,0", "--time", "0.5"]
    arguments += ["--prescribed", "bend=0.4*sin(2*t)", "--out", str(tmp_path / "cli.npz")]
    assert main(["simulate", *arguments, "--hold", "others"]) == 0
    np.testing.assert_array_equal(np.load(tmp_path / "cli.npz")["q"], held.q)


def test_balls_are_held_and_members_with_other_shapes_are_refused() -> None:
    """A ball is held at its attitude; rows of x0 would need rows of the held values."""
    diver = pinred.load("falling_cat_ball")
    ball = next(joint for joint in diver.space.joints if joint.kind.is_ball)
    others = [joint.name for joint in diver.space.joints if not joint.kind.is_ball]
    if others:
        plan: dict[str, Any] = {others[0]: "0.1*t"}
        held = pinred.simulate(diver, seed=1, duration=0.2, prescribed=plan, hold="others")
        np.testing.assert_allclose(held.x[:, ball.x], np.tile(held.x[0, ball.x], (201, 1)), atol=0)
    cat = pinred.load("falling_cat")
    with pytest.raises(pinred.InputError, match="members with different initial shapes"):
        pinred.simulate_many(
            cat, members={"x0": np.zeros((2, 3))}, prescribed={"bend": 0.1}, hold="others",
            duration=0.1,
        )  # fmt: skip
    with pytest.raises(pinred.InputError, match="hold: the loops of 'four_bar'"):
        pinred.simulate(pinred.load("four_bar"), seed=1, hold="others", duration=0.1)


def test_scene_of_a_flow_has_the_default_times() -> None:
    """Its largest angle is that of the motion, not of the end."""
    flow = pinred.flow(pinred.load("falling_cat"), seed=1, duration=0.5, wrt=["x0"])
    assert len(pinred.simulate(flow.scene).t) == 201
    assert flow().x.shape == (3,)
    assert flow.t.tolist() == [0.5]


@pytest.mark.parametrize(
    ("upper", "excess", "counts"),
    [("1.0", 2e-10, False), ("1.0", 5e-9, True), ("0", 2e-13, False), ("0", 5e-12, True)],
)
def test_round_off_is_no_excess(upper: str, excess: float, counts: bool) -> None:
    """1e-9 of the limit, or of a milliradian where the limit is smaller, is round-off."""
    arm = pinred.load(text=URDF.replace('upper="1.0"', f'upper="{upper}"'))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)
        traj = pinred.simulate(
            arm,
            prescribed={"hinge": f"{upper} + {excess}*sin(t)"},
            times=[0.0, np.pi / 2],
            **AT_REST,
        )
    position = use(traj, "position")
    assert position.greatest == pytest.approx(float(upper) + excess, rel=1e-12)
    assert position.excess == (pytest.approx(excess, rel=1e-3) if counts else 0.0)


def test_numbers_of_compared_times_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """20,000 times in the table, 500 for efforts, and 6 after a simulation; steps are divided."""
    counts: dict[str, list[int]] = {"efforts": [], "uses": []}
    compute_efforts, compute_uses = limit_excess._efforts, limit_excess._uses

    def efforts(plan: Any, motion: Any, t: Any) -> Any:
        counts["efforts"].append(len(t))
        return compute_efforts(plan, motion, t)

    def uses(system: Any, states: Any, *rest: Any) -> Any:
        counts["uses"].append(len(states.t))
        return compute_uses(system, states, *rest)

    monkeypatch.setattr(limit_excess, "_efforts", efforts)
    monkeypatch.setattr(limit_excess, "_uses", uses)
    arm, forces = pinred.load(text=URDF), [Torque({"hinge": 0.01})]
    for count, table in ((25_000, 20_000), (2, None)):
        times = np.linspace(0.0, 1.0, count)
        traj = pinred.simulate(arm, forces=[*forces, *forces], times=times, **AT_REST)
        forces = [Torque({"hinge": 0.02})]  # efforts of the same forces are computed once
        assert len(traj.limits) == 3
        steps = len(traj.motion.knots) - 1
        assert counts["uses"].pop() == (table or 4 * steps + 1)
        assert counts["efforts"] == ([6, 500] if table else [2, min(500, 4 * steps + 1)])
        counts["efforts"].clear()
