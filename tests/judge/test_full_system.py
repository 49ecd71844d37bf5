"""Tests of coordinates and constraints of the full system."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree
from coupled_trees import CoupledCase, coupled_cases, make_case, multipliers
from hypothesis import given, settings
from loop_robots import five_bar, four_bar
from robot_texts import joint, link, robot, write
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.judge import full_system as module
from pinred.judge.full_system import (
    Configuration,
    CouplingConstraints,
    RootMotion,
    loop_errors,
    root_motion,
)
from pinred.judge.reference_solution import FullState
from pinred.lie import GROUPS
from pinred.system.loops.kinematics import LoopKinematics
from pinred.system.state_fields import State


def rate_of(root: RootMotion, at: Array, v: Array) -> Array:
    """Return the time derivative of root coordinates as an array."""
    return np.array(root.rate(at, v))


@pytest.mark.parametrize("group", GROUPS)
def test_root_rate_equals_differences_of_integration(group: str) -> None:
    """Compared with fourth-order differences of pin.integrate."""
    model, rng = random_model(group, 0, 3), np.random.default_rng(0)
    root = root_motion(model)
    at = rng.normal(size=root.size)
    if root.turns == 3:
        at[-4:] /= np.linalg.norm(at[-4:])
    v, h = rng.normal(size=model.nv), 1e-3
    slope = np.zeros(model.nq)
    for k, weight in ((1, 2 / 3), (2, -1 / 12)):
        second, back = (pin.integrate(model, root.q(at), s * k * h * v) for s in (1.0, -1.0))
        slope += weight * (second - back) / h
    rate, step = rate_of(root, at, v), 1e-6
    result = (root.q(at + step * rate) - root.q(at - step * rate)) / (2.0 * step)
    np.testing.assert_allclose(result, slope, atol=1e-8)
    if root.turns == 3:
        assert rate[-4:] @ at[-4:] == pytest.approx(0.0, abs=1e-15)  # keeps the norm
    assert root.is_pivoted == (group in ("SO2", "SO3"))


@pytest.mark.parametrize("seed", range(3))
def test_rates_of_joint_coordinates_equal_differences_of_integration(seed: int) -> None:
    """Quaternions of balls and values of other joints move as pin.integrate moves them."""
    model, rng = ball_tree(seed, group="SO2").sorted_model, np.random.default_rng(seed)
    configuration = Configuration(model, root_motion(model))
    joints = configuration.normalised(rng.normal(size=configuration.size))
    v, h = rng.normal(size=model.nv), 1e-3
    rate = np.array(configuration.derivative(joints, v[1:]))
    q, slope = configuration(np.zeros(1), joints), np.zeros(model.nq)
    for k, weight in ((1, 2 / 3), (2, -1 / 12)):
        after, before = (pin.integrate(model, q, s * k * h * v) for s in (1.0, -1.0))
        slope += weight * (after - before) / h
    step, turn = 1e-6, v[:1]
    ends = [configuration(s * step * turn, joints + s * step * rate) for s in (1.0, -1.0)]
    np.testing.assert_allclose((ends[0] - ends[1]) / (2.0 * step), slope, atol=1e-8)
    for first, _ in configuration.balls:
        quaternion = slice(first, first + 4)
        assert rate[quaternion] @ joints[quaternion] == pytest.approx(0.0, abs=1e-15)
    assert configuration.balls


@pytest.mark.parametrize("group", ["SO3", "SE3"])
def test_root_normalises_quaternions(group: str) -> None:
    """Pinocchio gets unit quaternions although integration changes their length."""
    model, rng = random_model(group, 0, 3), np.random.default_rng(0)
    root = root_motion(model)
    at = rng.normal(size=root.size)
    longer = at.copy()
    longer[-4:] *= 1.7
    assert np.linalg.norm(root.q(at)[-4:]) == pytest.approx(1.0, abs=1e-15)
    np.testing.assert_allclose(root.q(longer), root.q(at), atol=1e-15)
    v = rng.normal(size=model.nv)
    slides = root.linear  # a scaled quaternion has a scaled rate but the same translation
    long_rate, rate = rate_of(root, longer, v), rate_of(root, at, v)
    np.testing.assert_allclose(long_rate[:slides], rate[:slides], atol=1e-14)
    np.testing.assert_allclose(long_rate[slides:], 1.7 * rate[slides:])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("joints", [0, 1, 9])
@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.sampled(3)
def test_configuration_of_angles_beyond_full_rotations(group: str, joints: int, seed: int) -> None:
    """Constant rates for one second from zero, including several full rotations."""
    model, rng = random_model(group, joints, seed), np.random.default_rng(seed)
    root = root_motion(model)
    v = np.concatenate([rng.normal(size=root.axes.shape[1]), rng.uniform(-20.0, 20.0, joints)])
    q = pin.integrate(model, pin.neutral(model), v)
    place = q[: model.joints[1].nq].copy()
    if root.circle:
        *slide, c, s = place.tolist()
        place = np.array([*slide, np.arctan2(s, c)])
    result = Configuration(model, root)(place, v[len(v) - joints :])
    np.testing.assert_allclose(result, q, rtol=1e-13, atol=1e-13)


def test_cases_include_angles_and_cosines() -> None:
    """The random trees include both representations of angles."""
    kinds = {
        frozenset(joint.nq for joint in list(random_model(group, joints, seed).joints)[2:])
        for group in GROUPS
        for joints in (1, 9)
        for seed in range(3)
    }
    assert kinds == {frozenset({1}), frozenset({2}), frozenset({1, 2})}


X = np.array([0.4, 0.0, 0.0])

MASSLESS = robot(
    *(link(name, mass) for name, mass in (("a", 2.0), ("b", 2.0), ("c", 0.0), ("d", 1.0))),
    joint("a", "b"), joint("a", "c", content='<axis xyz="0 1 0"/>'),
    joint("b", "d", content='<axis xyz="1 0 0"/><mimic joint="a-c" multiplier="-1.5"/>'),
)  # fmt: skip


@settings(max_examples=8)
@given(coupled_cases())
def test_acceleration_of_random_couplings(case: CoupledCase) -> None:
    """Multipliers by ABA and by one linear system agree with the projected equations."""
    system, rng = case.system, case.rng
    constraints, model = CouplingConstraints(system), system.model
    q = system.q(system.group.exp(rng.normal(size=system.r)), rng.uniform(-2, 2, system.m))
    v, tau = case.whole @ rng.normal(size=system.n), rng.normal(size=model.nv)
    a = constraints.acceleration(q, v, tau)
    data = model.createData()
    upper = np.triu(pin.crba(model, data, q))
    H = upper + np.triu(upper, 1).T
    bias = pin.nonLinearEffects(model, data, q, v)
    G = case.whole
    expected = G @ np.linalg.solve(G.T @ H @ G, G.T @ (tau - bias))
    size = max(1.0, float(np.abs(expected).max())) * max(1.0, np.linalg.cond(H) * 1e-3)
    np.testing.assert_allclose(a, expected, rtol=0, atol=1e-11 * size)
    constraints._uses_aba = False
    np.testing.assert_allclose(
        constraints.acceleration(q, v, tau), expected, rtol=0, atol=1e-11 * size
    )
    still = model.copy()
    np.testing.assert_allclose(
        pin.aba(still, still.createData(), q, v, multipliers(system)(0.0, q, v)),
        constraints.acceleration(q, v, np.zeros(model.nv)), rtol=0, atol=1e-10 * size,
    )  # fmt: skip


@pytest.mark.parametrize("alone", [True, False])
def test_acceleration_in_gravity(alone: bool) -> None:
    """Gravity acts on bodies but not on the response to multipliers."""
    case = make_case("SE3", 5, 0, heavy=True)
    model, rng = case.system.model, case.rng
    assert model.gravity.linear.any()
    constraints, data, G = CouplingConstraints(case.system), model.createData(), case.whole
    assert constraints._uses_aba
    constraints._uses_aba = alone
    q = case.system.q(case.system.group.identity(), rng.uniform(-2, 2, case.system.m))
    v = G @ rng.normal(size=case.system.n)
    upper = pin.crba(model, data, q)
    H = np.triu(upper) + np.triu(upper, 1).T
    bias = pin.nonLinearEffects(model, data, q, v)
    expected = G @ np.linalg.solve(G.T @ H @ G, -G.T @ bias)
    result = constraints.acceleration(q, v, np.zeros(model.nv))
    np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("driven", "seed"), [([0], 0), ([2, 0], 1), ([1, 2], 2), ([], 3)])
def test_acceleration_with_driven_joints(driven: list[int], seed: int) -> None:
    """Driven joints and their followers have the prescribed accelerations."""
    case = make_case("SE3", 7, seed, heavy=True)
    system, rng, G, r = case.system, case.rng, case.whole, case.system.r
    constraints, model, data = CouplingConstraints(system), system.model, system.model.createData()
    q = system.q(system.group.exp(rng.normal(size=r)), rng.uniform(-2, 2, system.m))
    v, tau, values = G @ rng.normal(size=system.n), rng.normal(size=model.nv), rng.normal(size=3)
    upper = pin.crba(model, data, q)
    H = G.T @ (np.triu(upper) + np.triu(upper, 1).T) @ G
    held = r + np.array(driven, dtype=int)
    free = np.setdiff1d(np.arange(system.n), held)
    a = np.zeros(system.n)
    a[held] = values[: len(driven)]
    right = G.T @ (tau - pin.nonLinearEffects(model, data, q, v)) - H @ a
    a[free] = np.linalg.solve(H[np.ix_(free, free)], right[free])
    result = constraints.acceleration(
        q, v, tau, constraints.leads[driven].tolist(), values[: len(driven)]
    )
    np.testing.assert_allclose(result, G @ a, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(("driven", "seed"), [([0], 0), ([2, 0], 1), ([0, 1, 2, 3, 4], 2)])
@pytest.mark.parametrize("fails", [False, True])
def test_acceleration_with_driven_joints_without_couplings(
    driven: list[int], seed: int, fails: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cholesky's method and, where it fails, multipliers agree with the rows of the others."""
    system, rng = pinred.load(random_model("SE3", 5, seed)), np.random.default_rng(seed)
    constraints, model, data = CouplingConstraints(system), system.model, system.model.createData()
    q = system.q(system.group.exp(rng.normal(size=6)), rng.uniform(-2, 2, 5))
    v, tau, values = rng.normal(size=11), rng.normal(size=11), rng.normal(size=len(driven))
    upper = pin.crba(model, data, q)
    H = np.triu(upper) + np.triu(upper, 1).T
    held = 6 + np.array(driven)
    free, a = np.setdiff1d(np.arange(11), held), np.zeros(11)
    a[held] = values
    right = tau - pin.nonLinearEffects(model, data, q, v) - H @ a
    a[free] = np.linalg.solve(H[np.ix_(free, free)], right[free])
    calls = []
    solve = CouplingConstraints._solve_with_multipliers
    monkeypatch.setattr(
        CouplingConstraints,
        "_solve_with_multipliers",
        lambda *given: calls.append(1) or solve(*given),  # type: ignore[func-returns-value]
    )
    if fails:
        monkeypatch.setattr(module, "dposv", lambda _, b, *__: (None, np.nan * b, 1))
    result = constraints.acceleration(q, v, tau, driven, values)
    np.testing.assert_allclose(result, a, rtol=1e-8, atol=1e-8)
    assert len(calls) == fails


def test_acceleration_of_tree_that_is_singular_without_couplings(tmp_path: Path) -> None:
    """A massless leader that moves its follower needs one linear system instead of ABA."""
    system = pinred.load(write(tmp_path, MASSLESS))
    constraints, model, data = CouplingConstraints(system), system.model, system.model.createData()
    (coupling,) = system.couplings
    joints = list(model.names)[2:]
    G = np.delete(np.eye(model.nv), system.r + joints.index(coupling.follower), axis=1)
    ((name, ratio),) = coupling.ratios.items()
    leader = system.r + joints.index(name)
    column = int(np.flatnonzero(G[leader])[0])
    G[system.r + joints.index(coupling.follower), column] = ratio
    rng = np.random.default_rng(0)
    q = system.q(system.group.exp(rng.normal(size=system.r)), rng.uniform(-1, 1, system.m))
    v, tau = G @ rng.normal(size=G.shape[1]), rng.normal(size=model.nv)
    upper = pin.crba(model, data, q)
    H = np.triu(upper) + np.triu(upper, 1).T
    assert np.linalg.cond(H) > 1e12 > 1e8 * np.linalg.cond(G.T @ H @ G)
    bias = pin.nonLinearEffects(model, data, q, v)
    expected = G @ np.linalg.solve(G.T @ H @ G, G.T @ (tau - bias))
    result = constraints.acceleration(q, v, tau)
    np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("group", "seed"),
    [
        ("SE3", 0),
        ("SO2", 8),
        *(pytest.param(*case, marks=pytest.mark.by_hand) for case in (("SE2", 4), ("SO3", 5))),
    ],
)
@pytest.mark.sampled
def test_compare_passes_with_couplings_and_forces(group: str, seed: int) -> None:
    """Random trees with couplings, and springs on leaders and followers."""
    system = make_case(group, 5, seed).system
    springs = dict.fromkeys((system.shape_names[0], system.followers[0]), (2.0, 0.1))
    traj = pinred.simulate(system, seed=seed, duration=0.5, springs=springs)
    report = pinred.compare(traj)
    assert report.passed, str(report)


# `test_acceleration_of_tree_that_is_singular_without_couplings` has the same tree.
@pytest.mark.by_hand
@pytest.mark.slow
def test_compare_passes_for_tree_that_is_singular_without_couplings(tmp_path: Path) -> None:
    """A massless leader that moves its follower needs one linear system instead of ABA."""
    system = pinred.load(write(tmp_path, MASSLESS))
    assert not CouplingConstraints(system)._uses_aba
    assert CouplingConstraints(make_case("SE3", 4, 0).system)._uses_aba
    report = pinred.compare(pinred.simulate(system, seed=1, duration=0.5))
    assert report.passed, str(report)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
@pytest.mark.sampled
def test_compare_fails_for_wrong_coupling_ratio(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """A relative error of 1e-6 in the reduction's ratio fails."""
    right = make_case("SE3", 5, seed).system
    coupled = right.coupled
    assert coupled is not None
    follower = next(j for j, row in enumerate(coupled.G) if j not in coupled.leads and row.any())
    G = coupled.G.copy()
    G[follower] *= 1.0 + 1e-6
    wrong = replace(coupled, G=G, G_x=G)
    monkeypatch.setitem(right.__dict__, "coupled", wrong)
    report = pinred.compare(pinred.simulate(right, seed=1, duration=0.5))
    assert not report.passed
    assert report.equations > 10.0 * report.equations_bound or report.field_error > 1e-8


def test_perturbation_satisfies_couplings() -> None:
    """Positions and rates of followers obey their couplings after the perturbation."""
    case = make_case("SE3", 5, 0)
    scene = pinred.Scene(system=case.system, seed=0, duration=1.0)
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    y, M = full.perturb(y0, 1.0, 1e-3), len(case.b)
    x, xdot = y[7 : 7 + M], y[7 + M + 6 :]
    assert np.abs(y - y0).max() > 1e-4
    np.testing.assert_allclose(x, case.G @ full.couplings.shape(x) + case.b, atol=1e-15)
    np.testing.assert_allclose(xdot, case.G @ full.couplings.shape(xdot), atol=1e-15)


# Trees with couplings and forces are compared by default.
@pytest.mark.by_hand
@pytest.mark.slow
@pytest.mark.parametrize("name", [
    "panda", "baxter",
    *(pytest.param(name, marks=pytest.mark.by_hand) for name in ("tiago_pro", "pr2", "talos_full")),
])  # fmt: skip
@pytest.mark.sampled
@pytest.mark.filterwarnings("ignore::pinred.LeftOutWarning")
def test_compare_passes_for_robots_with_grippers(name: str) -> None:
    """Robots of example-robot-data, with both engines."""
    pytest.importorskip("example_robot_data")
    system = pinred.load(name)
    assert system.followers
    scene = pinred.Scene(system=system, seed=1, duration=0.5)
    traj = pinred.simulate(scene)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    readable = pinred.simulate(scene, engine="pinocchio")
    np.testing.assert_allclose(readable.q, traj.q, atol=1e-8)
    np.testing.assert_allclose(readable.v, traj.v, atol=1e-7)


def test_acceleration_with_loops_of_light_links() -> None:
    """The loops stay closed to round-off; the motion is that of a projection on their kernel."""
    model, loops = five_bar()
    base, parents = 1, []
    for name, x in (("near", 0.2), ("far", 0.8)):
        place = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        first = model.addJoint(base, pin.JointModelRZ(), place, name)
        second = model.addJoint(first, pin.JointModelRZ(), pin.SE3(np.eye(3), X), f"{name}_tip")
        for joint_id in (first, second):
            light = pin.Inertia(1e-8, 0.5 * X, 1e-9 * np.eye(3))
            model.appendBodyToJoint(joint_id, light, pin.SE3.Identity())
        parents.append(second)
        kind = pin.FrameType.OP_FRAME
        model.addFrame(pin.Frame(f"{name}_end", second, 0, pin.SE3(np.eye(3), X), kind))
    system = pinred.load(model, loops=[*loops, pinred.Loop("near_end", "far_end", "3d", "light")])
    constraints, at = CouplingConstraints(system), system.closure
    assert at is not None
    model, rng = system.sorted_model, np.random.default_rng(0)
    q = system.q(system.group.identity(), at.x)
    kinematics = LoopKinematics(model, system.loops)
    J = kinematics.jacobian(q)
    kernel = np.linalg.svd(J)[2][np.linalg.matrix_rank(J, tol=1e-9) :].T
    v, tau = kernel @ rng.normal(size=kernel.shape[1]), rng.normal(size=model.nv)
    tau[-4:] *= 1e-8  # forces of the light links
    b = kinematics.bias(q, v)
    data = model.createData()
    upper = np.triu(pin.crba(model, data, q))
    H, drift = upper + np.triu(upper, 1).T, -np.linalg.pinv(J, 1e-9) @ b
    force = tau - pin.nonLinearEffects(model, data, q, v) - H @ drift
    scale = 1.0 / np.sqrt(np.diag(kernel.T @ H @ kernel))
    G = kernel * scale
    expected = drift + G @ np.linalg.solve(G.T @ H @ G, G.T @ force)
    for axes, digits in ((pin.Convention.LOCAL, 1e-15), (pin.Convention.WORLD, 1e-10)):
        a = constraints.acceleration(q, v, tau, axes=axes)
        assert np.abs(J @ a + b).max() <= 10.0 * digits * (np.abs(J) @ np.abs(a)).max()
        np.testing.assert_allclose(a, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("tilt", [0.0, 1e-10, 5e-9])
def test_acceleration_with_redundant_rows_that_round_off_fills(tilt: float) -> None:
    """A row of a planar loop is not a constraint although a rounded angle makes it nonzero.

    The right side is the projection on the kernel of the two rows in the plane.
    """
    bars, loops = four_bar()
    bars.jointPlacements[3] = bars.jointPlacements[3] * pin.SE3(pin.rpy.rpyToMatrix(tilt, 0, 0), X)
    system = pinred.load(bars, loops=loops)
    closure = system.closure
    assert closure is not None
    assert closure.rank == 2
    model, rng = system.sorted_model, np.random.default_rng(0)
    q = system.q(system.group.identity(), closure.x)
    kinematics, data = LoopKinematics(model, system.loops), model.createData()
    J = kinematics.jacobian(q)[:2]
    G = np.linalg.svd(J)[2][2:].T
    v, tau = G @ rng.normal(size=G.shape[1]), rng.normal(size=model.nv)
    upper = np.triu(pin.crba(model, data, q))
    H, drift = upper + np.triu(upper, 1).T, -np.linalg.pinv(J) @ kinematics.bias(q, v)[:2]
    force = tau - pin.nonLinearEffects(model, data, q, v) - H @ drift
    expected = drift + G @ np.linalg.solve(G.T @ H @ G, G.T @ force)
    a = CouplingConstraints(system).acceleration(q, v, tau)
    np.testing.assert_allclose(a, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.slow
def test_compare_fails_if_an_independent_equation_of_a_loop_is_missing() -> None:
    """The acceleration uses the equations that the system states; the gap measures all."""
    model, loops = four_bar()
    system = pinred.load(model, loops=loops)
    assert system.closure is not None
    scene = {"x0": {"crank": 0.5}, "xdot0": {"crank": 1.0}, "duration": 0.2}
    assert pinred.compare(pinred.simulate(system, **scene)).passed  # type: ignore[arg-type]
    wrong = pinred.load(model, loops=loops)
    vars(wrong)["closure"] = replace(system.closure, rows=system.closure.rows[:1])
    report = pinred.compare(pinred.simulate(wrong, **scene))  # type: ignore[arg-type]
    assert not report.passed
    assert report.loop_gap is not None
    assert report.loop_gap > 1e-3


def test_rate_of_the_gap_leaves_out_what_a_file_rounds() -> None:
    """A tilt of 5e-9 rad moves the gap out of the plane, which no joint can change."""
    bars, loops = four_bar()
    bars.jointPlacements[3] = bars.jointPlacements[3] * pin.SE3(pin.rpy.rpyToMatrix(5e-9, 0, 0), X)
    system = pinred.load(bars, loops=loops)
    motion = pinred.simulate(system, xdot0={"crank": 1.0}, momentum=0, duration=0.5)
    states = motion.motion.states(motion.t)
    assert isinstance(states, State)
    errors = loop_errors(system, states)
    assert errors.rate is not None
    assert errors.rate < 1e-13
