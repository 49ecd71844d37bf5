"""Other tools: equality of their models, and convergence to the reference."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cache
from importlib.util import find_spec

import casadi as ca
import numpy as np
import pytest
from trees import random_model

import pinred
from pinred.common.errors import IntegrationError, UnsupportedOperationError, install_command
from pinred.judge.reference_solution import FullMotion, FullState
from pinred.kernels.kernel import Structure
from pinred.kernels.reduced_graph import ReducedGraph
from pinred.laboratory.bench import SOLVERS, Problem, reference_of
from pinred.laboratory.bench.peers.aba import (
    EQUAL,
    equality,
    full_vector_field,
    missing_unless_equal,
)
from pinred.laboratory.bench.peers.cvodes import full_graph
from pinred.laboratory.bench.peers.drake import DrakeModel, check_in_child_process
from pinred.laboratory.bench.peers.mujoco import MujocoModel
from pinred.laboratory.bench.problems import Solver
from pinred.lie import GROUPS
from pinred.scene.initial_state import random_state
from pinred.system.system import System

needs_heyoka = pytest.mark.skipif(find_spec("heyoka") is None, reason="heyoka is not installed")
MODELS = {"mujoco": MujocoModel, "pydrake": DrakeModel}
# What builds a peer is warned about by the peer itself.
pytestmark = pytest.mark.filterwarnings("ignore")


def require(package: str) -> None:
    """Skip the test if a package is not installed."""
    if find_spec(package) is None:
        pytest.skip(f"{package} is not installed")


@pytest.mark.parametrize("group", sorted(GROUPS))
@pytest.mark.parametrize("package", sorted(MODELS))
def test_peer_model_equals_pinocchio(package: str, group: str) -> None:
    """Mass matrix and accelerations of random trees with general axes, branches and armature."""
    require(package)
    for seed in (1, 2):
        model = random_model(group, 5, seed)
        armature = np.zeros(model.nv)
        armature[-3:] = 0.1, 0.2, 0.3
        model.armature = armature
        if group == "SE3":  # MuJoCo allows free joints at the world's origin only
            model.jointPlacements[1].setIdentity()
        system = pinred.load(model)
        if package == "pydrake" and group not in ("R", "SO2", "SE2", "SE3"):
            with pytest.raises(UnsupportedOperationError, match="base must float"):
                DrakeModel(system)
            continue
        result = equality(*pair(package, system))
        assert result.mass < 1e-12
        assert result.acceleration < 1e-10


def pair(package: str, system: System) -> tuple[System, MujocoModel | DrakeModel]:
    """Return a system and a peer's model of it."""
    return system, MODELS[package](system)


@pytest.mark.parametrize("group", sorted(GROUPS))
def test_full_graph_equals_pinocchio(group: str) -> None:
    """The textbook's graph has ABA's accelerations and the judge's root kinematics."""
    for seed in (1, 2):
        model = random_model(group, 5, seed)
        armature = np.zeros(model.nv)
        armature[-3:] = 0.1, 0.2, 0.3
        model.armature = armature
        system = pinred.load(model)
        rng = np.random.default_rng(seed)
        pose = system.group.exp(rng.normal(size=system.r))
        judge = FullState(pinred.Scene(system=system, seed=0))
        y = judge.state(pose, *(rng.normal(size=k) for k in (system.m, system.r, system.m)))
        expected = judge.rate(0.0, y)
        result = np.array(full_graph(system)(y)).ravel()
        np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("package", sorted(MODELS))
def test_peer_with_different_model_is_not_timed(package: str) -> None:
    """A peer without armature is reported."""
    require(package)
    system = pinred.load("planar_chain5")
    heavy = system.model.copy()
    heavy.armature = np.array([0.0] * 3 + [1e-6] * 5)
    other = pinred.load(heavy)
    result = equality(other, MODELS[package](system))
    assert result.mass > EQUAL
    assert not result.holds
    missing = missing_unless_equal(package, "It", lambda _: MODELS[package](system))
    line = missing(Problem("p", "", other, random_state(other, 0)))
    assert line.startswith("It is not timed: its model is not Pinocchio's; mass matrix and")
    assert missing(Problem("p", "", system, random_state(system, 0))) == ""


def test_missing_peer_is_reported() -> None:
    """The message says how to install it."""
    missing = missing_unless_equal("no_such_package", "It", MujocoModel)
    system = pinred.load("cartpole")
    line = missing(Problem("p", "", system, random_state(system, 0)))
    assert line == f"It is left out: {install_command('bench')}"


def test_aborting_library_is_a_failure() -> None:
    """An abort does not end the benchmark; exceptions are ignored in the child process."""

    def raises() -> None:
        raise ValueError("somebody else's")

    check_in_child_process(lambda: None, "It")
    check_in_child_process(raises, "It")
    with pytest.raises(IntegrationError, match=r"It aborts \(signal 6\)"):
        check_in_child_process(os.abort, "It")


ROBOTS = ("cartpole", "elroys_beanie", "planar_chain5", "rigid_body", "satellite_two_arms")


@cache
def solve_briefly(robot: str) -> tuple[Problem, FullMotion]:
    """Solve a robot's problem over a short time; return it and its final state."""
    system = pinred.load(robot)
    assert system.initial is not None
    problem = Problem(robot, "", system, replace(system.initial, duration=0.3))
    return problem, reference_of(problem).end


# The compiler needs half a minute for the code of CVODES.
@pytest.mark.by_hand("cvodes", "cvodes-reduced")
@pytest.mark.parametrize("method", SOLVERS, ids=lambda method: method.name)
def test_methods_converge_to_reference(method: Solver) -> None:
    """In every group, errors decrease with the order or with the tolerance."""
    expected = {"euler": 1.0, "implicitfast": 1.0, "rk4": 4.0, "rkmk4": 4.0}
    expected |= {"gauss6": 6.0}
    line = ""
    if all(line := method.missing(solve_briefly(robot)[0]) for robot in ROBOTS):
        pytest.skip(line)
    for robot in ROBOTS:
        problem, truth = solve_briefly(robot)
        if method.missing(problem):
            continue
        errors = []
        for setting in (1 / 8, 1 / 16) if method.fixed else (1e-4, 1e-10):
            prepared = method.prepare(problem, setting)
            end = prepared.end(prepared.run())
            errors.append(problem.apart(truth, FullMotion(end.x[None], end.q[None])))
            energies = [
                problem.full.totals.kinetic_energy(q, v) + problem.full.totals.potential_energy(q)
                for q, v in ((problem.q0, problem.v0), (end.q, end.v))
            ]
        if not method.fixed:
            assert errors[1] < 1e-8, robot
            assert energies[1] == pytest.approx(energies[0], rel=1e-8), robot
            continue
        order = expected[method.name.partition("-")[2]]
        assert errors[1] < max(errors[0] / 2.0 ** (order - 0.5), 1e-12), robot
        assert energies[1] == pytest.approx(energies[0], rel=0.1), robot


@pytest.mark.parametrize("group", sorted(GROUPS))
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_full_vector_field_equals_judge(group: str, seed: int) -> None:
    """The fast vector field for SciPy equals the judge's independent one."""
    system = pinred.load(random_model(group, 4, seed))
    rng = np.random.default_rng(seed)
    pose = system.group.exp(rng.normal(size=system.r))
    judge = FullState(pinred.Scene(system=system, seed=0))
    y = judge.state(pose, *(rng.normal(size=k) for k in (system.m, system.r, system.m)))
    expected = judge.rate(0.0, y)
    np.testing.assert_allclose(
        full_vector_field(system)(0.0, y), expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max()
    )


@needs_heyoka
@pytest.mark.parametrize("robot", ["planar_chain5", "coupled_spatial", "cartpole"])
def test_taylor_expressions_equal_casadi_graph(robot: str) -> None:
    """The values evaluated by heyoka are the same, in the plane, in space, and with gravity."""
    import heyoka as hy

    from pinred.laboratory.bench.peers.heyoka import taylor_expressions

    system = pinred.load(robot)
    gravity = (2,) if robot == "cartpole" else ()
    rate = ReducedGraph(system, Structure(zero_momentum=False, gravity=gravity)).rate()
    rng = np.random.default_rng(0)
    y, parameters = (rng.normal(size=rate.numel_in(k)) for k in range(2))
    pairs = taylor_expressions(rate, parameters.tolist())
    evaluate = hy.cfunc([f for _, f in pairs], [v for v, _ in pairs])
    expected = np.array(rate(y, parameters)).ravel()
    np.testing.assert_allclose(evaluate(y), expected, rtol=1e-12, atol=1e-12)


@needs_heyoka
def test_taylor_folds_constants_and_rejects_unknown_operations() -> None:
    """Expressions of parameters alone become numbers."""
    import heyoka as hy

    from pinred.laboratory.bench.peers.heyoka import taylor_expressions

    y, p = ca.SX.sym("y", 2), ca.SX.sym("p", 1)
    rate = ca.Function("f", [y, p], [ca.vertcat(ca.sin(p) / 2.0 + 1.0, y[0] * (p * p))])
    (_, first), (_, second) = taylor_expressions(rate, [0.5])
    assert str(first) == str(hy.expression(np.sin(0.5) / 2.0 + 1.0))
    assert str(second) == str(0.25 * hy.expression("y0"))
    with pytest.raises(UnsupportedOperationError, match="instruction 1 of 'g'"):
        taylor_expressions(ca.Function("g", [y, p], [ca.fabs(y)]), [0.5])
