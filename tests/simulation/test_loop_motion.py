"""Motions of robots with closed loops, against Pinocchio's constraint dynamics and ABA."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pinocchio as pin
import pytest
from cassie import cassie, cassie_path
from constraint_dynamics import constraint_dynamics
from loop_robots import four_bar, gripper, planar_legs, random_loops
from scipy.integrate import solve_ivp

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import InputError, IntegrationError, KernelMismatch
from pinred.kernels import validation
from pinred.simulation.compiled.compiled_flow import kernel_of
from pinred.simulation.plan import plan_of
from pinred.system.loops.kinematics import loop_values
from pinred.system.loops.loop import Loop, LoopKind
from pinred.views.playback.playback import shape_panel


def linkage() -> pinred.System:
    """Return the four-bar linkage."""
    model, loops = four_bar()
    return pinred.load(model, loops=loops)


def reference(
    system: pinred.System,
    q: Array,
    v: Array,
    duration: float,
    springs: Mapping[str, tuple[float, float]] = MappingProxyType({}),
) -> tuple[Array, Array]:
    """Integrate Pinocchio's constraint dynamics in the tangent space at q; return q and v."""
    solve, model = constraint_dynamics(system.model, *system.loops), system.model
    stiffness, at = np.zeros(model.nv), np.zeros(model.nv, dtype=int)
    for name, (k, rest) in springs.items():
        assert rest == 0.0
        joint = model.joints[model.getJointId(name)]
        stiffness[joint.idx_v], at[joint.idx_v] = k, joint.idx_q

    def rate(_: float, y: Array) -> Array:
        here = pin.integrate(model, q, y[: model.nv])
        velocity = y[model.nv :]
        change = pin.dIntegrate(model, q, y[: model.nv], pin.ArgumentPosition.ARG1)
        a = solve(here, velocity, -stiffness * here[at])[0]
        return np.concatenate([np.linalg.solve(change, velocity), a])

    y0 = np.concatenate([np.zeros(model.nv), v])
    end = solve_ivp(rate, (0.0, duration), y0, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return pin.integrate(model, q, end[: model.nv]), end[model.nv :]


CASSIE = {
    "xdot0": {"left-knee-op": 1.0, "right-roll-op": -0.5},
    "xi0": [0.0, 0.0, 0.0, 0.3, 0.2, 0.5],
}
LIKE_CASSIE = (3, 2, 3, 2, 3, 2, 2, 2)  # joints of the branches: 19 joints, 4 loops
LIKE_DIGIT = (3, 2, 3, 2, 3, 2, 2, 2, 2, 2, 2, 2)  # 27 joints, 6 loops
ROBOTS: dict[str, Callable[[], tuple[pin.Model, list[Loop]]]] = {
    "four-bar": four_bar,
    "in space": lambda: random_loops(1, ("3d",)),
    "with balls": lambda: random_loops(3, ("3d", "3d"), 3, balls=True),
    "like Cassie": lambda: random_loops(5, ("3d",) * 4, LIKE_CASSIE),
    "like Digit": lambda: random_loops(6, ("3d",) * 6, LIKE_DIGIT),
    "redundant": planar_legs,
}
SIZES = {  # joint rates, equations, rank, dimension of the closed shapes
    "four-bar": (3, 3, 2, 1),
    "with balls": (20, 6, 6, 14),
    "like Cassie": (19, 12, 12, 7),
    "like Digit": (27, 18, 18, 9),
    "redundant": (14, 18, 9, 5),
}


# Robots like Cassie have loops of the same kinds.
@pytest.mark.by_hand("like Digit")
@pytest.mark.parametrize("robot", SIZES)
def test_rank_of_loops_of_every_size(robot: str) -> None:
    """Redundant equations are found."""
    model, loops = ROBOTS[robot]()
    system = pinred.load(model, loops=loops)
    assert system.closure is not None
    sizes = (system.m, system.closure.equations, system.closure.rank, system.shape_dim)
    assert sizes == SIZES[robot]


@pytest.mark.parametrize(
    "robot",
    ["four-bar", *(pytest.param(r, marks=pytest.mark.by_hand) for r in ROBOTS if r != "four-bar")],
)
def test_motion_equals_constraint_dynamics_of_pinocchio(robot: str) -> None:
    """Over 0.3 s, configuration and velocity agree to 1e-10."""
    model, loops = ROBOTS[robot]()
    system = pinred.load(model, loops=loops)
    traj = pinred.simulate(system, seed=1, duration=0.3, rtol=1e-11)
    q, v = reference(system, traj.q[0], traj.v[0], 0.3)
    np.testing.assert_allclose(traj.q[-1], q, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(traj.v[-1], v, rtol=0.0, atol=1e-10 * np.abs(v).max())


@pytest.mark.by_hand
def test_cassie_equals_constraint_dynamics_and_does_not_drift() -> None:
    """The file of example-robot-data with its leg springs, and balls at the rods.

    The springs oscillate at about 3000 rad/s, so an error of 1e-12 in a joint is one of 3e-9 in its
    rate. DOP853 takes steps at its stability limit, which damp these oscillations; AdaptiveGauss
    follows them.
    """
    path = cassie_path()
    if path is None:
        pytest.skip("example-robot-data has no Cassie")
    model, loops, springs = cassie(path)
    system = pinred.load(model, loops=loops)
    closure = system.closure
    assert closure is not None
    assert (system.m, closure.equations, closure.rank, system.shape_dim) == (26, 12, 10, 16)
    precise = pinred.AdaptiveGauss(1e-13, 1e-15)
    traj = pinred.simulate(system, **CASSIE, springs=springs, duration=0.3, method=precise)  # type: ignore[arg-type]
    q, v = reference(system, traj.q[0], traj.v[0], 0.3, springs)
    np.testing.assert_allclose(traj.q[-1], q, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(traj.v[-1], v, rtol=0.0, atol=1e-10 * np.abs(v).max())
    traj = pinred.simulate(system, **CASSIE, springs=springs, duration=5.0, rtol=1e-10)  # type: ignore[arg-type]
    gaps = [np.abs(loop_values(system, x)[closure.rows]).max() for x in traj.x]
    J = traj.spatial_momentum
    assert max(gaps) < 1e-12
    assert np.abs(J - J[0]).max() < 1e-13 * np.abs(J).max()
    assert np.ptp(traj.energy) < 1e-8 * traj.energy[0]


@pytest.mark.by_hand
def test_loops_of_cassie_cost_less_than_one_and_a_half_more_trees() -> None:
    """Ten constraints take inward passes only, and relative velocities along the loops."""
    path = cassie_path()
    if path is None:
        pytest.skip("example-robot-data has no Cassie")
    model, loops, _ = cassie(path)
    system = pinred.load(model, loops=loops)
    closed, tree = (
        kernel_of(
            plan_of(pinred.Scene(system=robot, seed=1, duration=0.1)), zero_momentum=False
        ).instructions
        for robot in (system, system.open_tree())
    )
    assert closed < 2.4 * tree


def test_both_engines_agree() -> None:
    """The readable equations solve the same impetus form with dense matrices."""
    start = {"x0": {"crank": 1.0}, "xdot0": {"crank": 2.0}, "duration": 0.2, "xi0": [0.1, 0.2, 0.3]}
    compiled = pinred.simulate(linkage(), **start)  # type: ignore[arg-type]
    readable = pinred.simulate(linkage(), engine="pinocchio", **start)  # type: ignore[arg-type]
    np.testing.assert_allclose(readable.x, compiled.x, atol=1e-10)
    np.testing.assert_allclose(readable.pose, compiled.pose, atol=1e-10)


def test_loops_and_momentum_do_not_drift() -> None:
    """Five seconds with several turns of the crank, through its dead points."""
    system = linkage()
    start = {"crank": 1.0}, {"crank": 6.0}
    traj = pinred.simulate(system, x0=start[0], xdot0=start[1], duration=5.0, rtol=1e-10)
    assert abs(traj.x[-1, 0] - 1.0) > 4.0 * np.pi
    gaps = [np.abs(loop_values(system, x)).max() for x in traj.x]
    assert max(gaps) < 1e-10
    J = traj.spatial_momentum
    assert np.abs(J - J[0]).max() < 1e-13 * np.abs(J).max()
    assert np.ptp(traj.energy) < 1e-9 * traj.energy[0]


# Every run compares loops in judge/ and scene/.
@pytest.mark.by_hand
@pytest.mark.parametrize(
    "engine", ["compiled", pytest.param("pinocchio", marks=pytest.mark.by_hand)]
)
def test_compare_passes_for_a_four_bar_with_a_spring(engine: str) -> None:
    """Both engines agree with ABA and multipliers; the report has lines for the loops."""
    scene = pinred.Scene(
        system=linkage(), x0={"crank": 0.4}, xdot0={"crank": 2.0}, xi0=[0.1, 0.2, 0.3],
        springs={"rocker": (3.0, 0.2)}, duration=0.5,
    )  # fmt: skip
    report = pinred.compare(pinred.simulate(scene, engine=engine))  # type: ignore[arg-type]
    assert report.passed, str(report)
    assert report.loop_gap is not None
    assert {"gap of loops", "rate of the gap [relative]"} <= set(report.checks)


@pytest.mark.by_hand
def test_compare_passes_for_a_gripper_with_a_coupling(tmp_path: Path) -> None:
    """Two loops and a follower leave one motion."""
    path = tmp_path / "gripper.xml"
    path.write_text(gripper())
    report = pinred.compare(pinred.simulate(pinred.load(path), seed=1, duration=0.3))
    assert report.passed, str(report)


@pytest.mark.by_hand
@pytest.mark.parametrize("kinds", [("6d",), ("z",), ("3d", "6d"), ("x", "y")])
def test_compare_passes_for_loops_in_space(kinds: tuple[LoopKind, ...]) -> None:
    """Welds and hinges close branches of trees; slides take part."""
    model, loops = random_loops(len(kinds), kinds, 5)
    report = pinred.compare(pinred.simulate(pinred.load(model, loops=loops), seed=1, duration=0.5))
    assert report.passed, str(report)


def test_compare_fails_for_a_motion_that_leaves_the_loop() -> None:
    """The judge computes the gap from the frames in the model, so a moved frame is found."""
    system = linkage()
    traj = pinred.simulate(system, x0={"crank": 0.4}, xdot0={"crank": 2.0}, duration=0.2)
    number = system.model.getFrameId("rocker_tip")
    system.model.frames[number].placement = pin.SE3(np.eye(3), np.array([0.8, 1e-6, 0.0]))
    report = pinred.compare(traj)
    assert report.verdict == "FAILED"
    assert report.loop_gap is not None
    assert report.loop_gap > 5e-7


def test_kernel_that_differs_from_pinocchio_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The validation of kernels compares the rates of the impetus."""
    monkeypatch.setattr(validation, "impetus_terms", lambda *_: np.zeros(3))
    with pytest.raises(KernelMismatch, match="acceleration"):
        pinred.simulate(linkage(), xdot0={"crank": 1.0}, duration=0.1)


def test_initial_state_is_projected_and_copies_of_scenes_keep_it() -> None:
    """Stated joints keep their values; otherwise a warning tells the change."""
    system = linkage()
    scene = pinred.Scene(system=system, x0={"crank": 1.0}, xdot0={"crank": 2.0}, duration=1.0)
    assert (scene.start.x[0], scene.start.xdot[0]) == (1.0, 2.0)
    other = replace(scene, duration=0.5)
    np.testing.assert_array_equal(other.start.x, scene.start.x)
    np.testing.assert_allclose(other.start.xdot, scene.start.xdot, rtol=1e-14)
    with pytest.warns(pinred.LoopWarning, match=r"x0 leaves loop 'tips' open by 1.55 m"):
        moved = pinred.Scene(system=system, x0=[1.0, 0.0, 0.0], duration=1.0)
    assert np.abs(loop_values(system, moved.start.x)).max() < 1e-10
    with pytest.warns(pinred.LoopWarning, match="xdot0 opens a loop"):
        pinred.Scene(system=system, xdot0=[1.0, 0.0, 0.0], duration=1.0)
    short, loops = four_bar(lengths={"crank": 0.4, "coupler": 0.9, "rocker": 0.3, "frame": 1.0})
    far = pinred.load(short, loops=loops)
    with pytest.raises(InputError, match=r"x0: the loops of 'four_bar' do not close near"):
        pinred.Scene(system=far, x0={"crank": np.pi, "coupler": 0.0, "rocker": 0.0}, duration=1.0)


def test_loop_forces_equal_those_of_constraint_dynamics() -> None:
    """With a spring, at several times; the loop joins the links by their frames."""
    system = linkage()
    traj = pinred.simulate(
        system, x0={"crank": 0.4}, xdot0={"crank": 2.0}, xi0=[0.1, 0.2, 0.3],
        springs={"rocker": (3.0, 0.2)}, duration=0.5,
    )  # fmt: skip
    k = system.shape_names.index("rocker")
    solve, forces = constraint_dynamics(system.model, system.loops[0]), traj.loop_forces["tips"]
    for n in (0, len(traj) // 2, len(traj) - 1):
        tau = np.zeros(system.model.nv)
        tau[system.r + k] = -3.0 * (traj.x[n, k] - 0.2)
        _, expected = solve(traj.q[n], traj.v[n], tau)
        np.testing.assert_allclose(forces[n, :3], expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(forces[n, 3:], 0.0)


def test_motion_through_a_singular_shape_ends_with_an_error() -> None:
    """A parallelogram is flat at crank angle π, where it can also fold."""
    lengths = {"crank": 0.5, "coupler": 1.0, "rocker": 0.5, "frame": 1.0}
    model, loops = four_bar(lengths=lengths)
    system = pinred.load(model, loops=[replace(loops[0], coupled=False)])
    start = {"crank": 2.0, "coupler": -2.0, "rocker": 2.0}
    scene = pinred.Scene(system=system, x0=start, xdot0={"crank": 1.0}, duration=0.5)
    assert len(pinred.simulate(scene)) > 1
    with pytest.raises(
        IntegrationError, match=r"equations of the loops '?tips'? .*become dependent"
    ):
        pinred.simulate(scene, duration=2.0, method=pinred.DOP853(max_steps=2000))


def test_playback_draws_the_path_without_a_curvature_field(tmp_path: Path) -> None:
    """Shapes off the closed ones have no curvature."""
    traj = pinred.simulate(linkage(), x0={"crank": 1.0}, xdot0={"crank": 2.0}, duration=0.2)
    panel = shape_panel(traj.system, traj.x, traj.xdot)
    assert panel is not None
    assert not panel.field.size
    pinred.save_html(traj, tmp_path / "motion.html")
    assert (tmp_path / "motion.html").stat().st_size > 0
