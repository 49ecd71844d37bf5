"""Loops whose closed shapes are linear in independent joints: parallelograms become couplings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from loop_robots import FOUR_BAR, four_bar

import pinred
from pinred.common.errors import InputError
from pinred.judge.full_system import loop_errors
from pinred.system.coordinates import InitialState
from pinred.system.loops.independent_joints import loop_chart, with_constant_loops
from pinred.system.loops.loop import Loop
from pinred.system.loops.loop_assembly import loop_gaps
from pinred.system.robot_file_contents import Contents
from pinred.system.system import System

PARALLELOGRAM = {"crank": 0.5, "coupler": 1.0, "rocker": 0.5, "frame": 1.0}


def test_parallelogram_becomes_a_coupling_also_if_its_zero_shape_is_flat() -> None:
    """The crank leads, coupler and rocker follow at ratios −1 and 1; inspect says so."""
    model, loops = four_bar(lengths=PARALLELOGRAM)
    system = pinred.load(model, loops=loops)
    assert (system.m, system.loops, system.closure) == (1, (), None)
    assert [*map(str, system.couplings)] == ["coupler = -1·crank", "rocker = 1·crank"]
    assert system.contents.coupled_loops == tuple(loops)
    text = str(pinred.inspect(system))
    assert "tips: coupler_tip = rocker_tip (3d): linear in independent joints" in text
    bare = System(model, "bar", contents=Contents(loops=tuple(loops)))
    driven = with_constant_loops(bare, ["rocker"])  # motors lead
    assert [*map(str, driven.couplings)] == ["crank = 1·rocker", "coupler = -1·rocker"]
    kept = pinred.load(model, loops=[replace(loops[0], coupled=False)])
    assert (kept.m, kept.shape_dim, kept.contents.coupled_loops) == (3, 1, ())


@pytest.mark.by_hand("0.0001")
@pytest.mark.parametrize("length", [1e-9, 1e-4, 0.3])
def test_quadrangle_that_is_nearly_a_parallelogram_remains_a_loop(length: float) -> None:
    """Round-off of 1e-16 passes; a rocker longer by 1e-9 m does not."""
    model, loops = four_bar(lengths={**PARALLELOGRAM, "rocker": 0.5 + length})
    assert pinred.load(model, loops=loops).loops == tuple(loops)
    model, loops = four_bar(lengths={**PARALLELOGRAM, "rocker": 0.5 + 1e-16})
    assert not pinred.load(model, loops=loops).loops


def test_crossed_parallelogram_remains_a_loop() -> None:
    """From an initial state with crossed sides, the closed shapes are not linear."""
    model, loops = four_bar(lengths=PARALLELOGRAM)
    crank, tip, end = 1.0, 0.5 * np.exp(1j), _crossed(1.0)
    x = np.array([crank, np.angle(end - tip) - crank, np.angle(end - 1.0)])
    contents = Contents(loops=tuple(loops))
    for shape, count in ((x, 1), (np.array([1.0, -1.0, 1.0]), 0)):
        start = InitialState(shape, np.zeros(3), np.zeros(3), 1.0)
        system = System(model, "bar", start, contents=contents)
        found = with_constant_loops(system)
        assert len(found.loops) == count
        assert (found is system) == bool(count)
    assert found.initial is not None
    np.testing.assert_array_equal(found.initial.x, [1.0])


def _crossed(crank: float) -> complex:
    """Return where the tips meet if the sides cross."""
    tip, hinge = 0.5 * np.exp(1j * crank), 1.0 + 0.0j
    parallel, along = tip + 1.0, (hinge - tip) / abs(hinge - tip)
    return complex(tip + along * np.conj((parallel - tip) / along))


def test_motion_through_the_flat_shape_passes_compare() -> None:
    """The gap of the loop is measured with its frames; before that, the loop agrees."""
    model, loops = four_bar(lengths=PARALLELOGRAM)
    spring = {"crank": (2.0, 3.0)}
    start = {"xdot0": {"crank": 3.0}, "xi0": [0.1, 0.2, 0.3], "springs": spring}
    system = pinred.load(model, loops=loops)
    traj = pinred.simulate(system, x0={"crank": 2.9}, **start, duration=1.0)  # type: ignore[arg-type]
    assert traj.x.max() > np.pi + 0.1  # flat at π
    report = pinred.compare(traj)
    assert report.passed, str(report)
    assert report.loop_gap is not None
    assert report.loop_gap < 1e-12
    as_loop = pinred.load(model, loops=[replace(loops[0], coupled=False)])
    shape = {"crank": 2.0, "coupler": -2.0, "rocker": 2.0}
    end = pinred.simulate(as_loop, x0=shape, **start, duration=0.2)  # type: ignore[arg-type]
    again = pinred.simulate(system, x0={"crank": 2.0}, **start, duration=0.2)  # type: ignore[arg-type]
    np.testing.assert_allclose(again.q[-1], end.q[-1], atol=1e-9)
    np.testing.assert_allclose(again.v[-1], end.v[-1], atol=1e-8)


def test_judge_finds_a_coupling_that_opens_its_loop() -> None:
    """The gap of the loop is measured with the frames of the model."""
    model, loops = four_bar(lengths=PARALLELOGRAM)
    system = pinred.load(model, loops=loops)
    traj = pinred.simulate(system, x0={"crank": 0.4}, xdot0={"crank": 2.0}, duration=0.2)
    number = system.model.getFrameId("rocker_tip")
    system.model.frames[number].placement = pin.SE3(np.eye(3), np.array([0.5, 1e-6, 0.0]))
    gap = loop_errors(system, traj.states).gap
    assert gap is not None
    assert gap > 5e-7
    assert pinred.compare(traj).verdict == "FAILED"


def test_several_loops_are_coupled_one_by_one() -> None:
    """A loop that another one closes needs no equations; a four-bar beside it remains."""
    model, loops = four_bar(lengths=PARALLELOGRAM)
    again = Loop("rocker_tip", "coupler_tip", "z", "again")
    system = pinred.load(model, loops=[*loops, again])
    assert (system.loops, len(system.contents.coupled_loops), system.m) == ((), 2, 1)
    for name, parent, x in (("a", "base", 2.0), ("b", "a", 0.4), ("c", "base", 3.0)):
        at = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        joint = model.addJoint(model.getJointId(parent), pin.JointModelRZ(), at, name)
        bar = pin.Inertia(1.0, np.array([0.3, 0.0, 0.0]), 0.1 * np.eye(3))
        model.appendBodyToJoint(joint, bar, pin.SE3.Identity())
    for name, x in (("b", FOUR_BAR["coupler"]), ("c", FOUR_BAR["rocker"])):
        tip = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        kind = pin.FrameType.OP_FRAME
        model.addFrame(pin.Frame(f"{name}_tip", model.getJointId(name), 0, tip, kind))
    both = pinred.load(model, loops=[Loop("b_tip", "c_tip", name="bar"), *loops])
    assert [loop.name for loop in both.loops] == ["bar"]
    assert (both.m, both.shape_dim, both.followers) == (4, 2, ("coupler", "rocker"))


def test_placements_of_a_coupled_loop_do_not_vary_but_masses_do() -> None:
    """A longer rocker would open the loop."""
    model, loops = four_bar(lengths=PARALLELOGRAM)
    system = pinred.load(model, loops=loops)
    heavy = pinred.load(model, loops=loops, parameters={"rocker.mass": 2.0})
    assert heavy.mass == pytest.approx(system.mass + 2.0 - model.inertias[4].mass)
    with pytest.raises(InputError, match=r"loop 'tips' is a coupling for the placements"):
        pinred.Scene(system=system, parameters={"rocker.translation": [1.1, 0.0, 0.0]})


def test_chart_follows_shapes_near_a_dead_point_in_shorter_steps() -> None:
    """Newton's method fails from the assembled shape, and not along waypoints of 2e-3 rad."""
    system = pinred.load("parallel_biped")
    names = ("left_front_hip", "left_front_knee", "right_front_hip", "right_rear_hip")
    chart, goal = loop_chart(system, names), np.array([0.6, -0.3, 0.3, -0.3])
    assert system.closure is not None
    (x,) = chart.shapes(goal[None])
    assert loop_gaps(system, x, system.closure.length).max() < 1e-14
    start = system.closure.x[[system.shape_names.index(name) for name in names]]
    waypoints = chart.shapes(np.linspace(start, goal, 400))
    np.testing.assert_allclose(x, waypoints[-1], atol=1e-12)
