"""The variational integrator with closed loops: discrete action, order, invariants, and bits."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from discrete_action import STIFFNESS, Action, points_of
from loop_robots import five_bar, four_bar, gripper, random_loops
from orders import fit_order

import pinred
from pinred import Gauss, Variational
from pinred.common.arrays import Array
from pinred.common.errors import KernelMismatch, NoConvergence
from pinred.integrators.stepping import run_state
from pinred.judge.reference_solution import FullMotion, FullState
from pinred.kernels import build
from pinred.simulation import checkpoint
from pinred.system.loops.kinematics import loop_jacobian, loop_values

START: dict[str, Any] = {"x0": {"crank": 1.0}, "xdot0": {"crank": 2.0}, "xi0": [0.1, 0.2, 0.3]}


@pytest.fixture(scope="module")
def linkage() -> pinred.System:
    """Return the four-bar linkage."""
    model, loops = four_bar()
    return pinred.load(model, loops=loops)


def in_space() -> tuple[pinred.System, dict[str, Any]]:
    """Return a robot in space with balls and a spatial loop."""
    model, loops = random_loops(3, ("3d",), 2, balls=True)
    return pinred.load(model, loops=loops), {"seed": 1}


def driven() -> tuple[pinred.System, dict[str, Any]]:
    """Return the five-bar linkage with a prescribed crank."""
    model, loops = five_bar()
    system = pinred.load(model, loops=loops)
    assert system.closure is not None
    plan = f"{float(system.closure.x[0])!r} + 0.4*sin(2*t)"
    springs = {"right_crank": (3.0, 0.2)}
    return system, {"xi0": [0.1, 0.0, 0.3], "prescribed": {"left_crank": plan}, "springs": springs}


def largest_gap(system: pinred.System, shapes: Array) -> float:
    """Return the largest |φ| of the independent equations."""
    assert system.closure is not None
    return max(float(np.abs(loop_values(system, x)[system.closure.rows]).max()) for x in shapes)


def test_discrete_action_is_stationary_on_closed_shapes(linkage: pinred.System) -> None:
    """Under closed variations of inner points; under open ones, the multipliers remain."""
    h, count = 0.01, 12
    action, rng = Action(linkage, h), np.random.default_rng(0)
    points = points_of(linkage, Variational(h), count, **START)
    other = points_of(linkage, Gauss(h, 2), count, **START)
    largest = by_other = opened = 0.0
    for k in range(1, count):
        J = loop_jacobian(linkage, points[k][0])
        variation = rng.normal(size=linkage.n - linkage.group.linear)
        opened = max(opened, abs(action.slope(points, k, variation, 1e-4)))
        shape = variation[-linkage.m :]
        shape -= np.linalg.pinv(J, rcond=1e-9) @ J @ shape
        largest = max(largest, abs(action.slope(points, k, variation, 1e-4)))
        by_other = max(by_other, abs(action.slope(other, k, variation, 1e-4)))
    assert largest < 1e-9
    assert by_other > 1e3 * largest
    assert opened > 1e6 * largest


@pytest.mark.parametrize(
    "make",
    [
        driven,
        pytest.param(in_space, marks=pytest.mark.by_hand),
    ],
)
def test_order_2_against_aba_with_multipliers(
    make: Callable[[], tuple[pinred.System, dict[str, Any]]],
) -> None:
    """In shape and attitude, also inside steps; the loops are closed to round-off everywhere."""
    system, start = make()
    times = np.array([0.2503, 0.5])
    scene = pinred.Scene(system=system, times=times, **start)
    full = FullState(scene)
    y0 = full.state(scene.start.pose, scene.start.x, scene.start.xi, scene.start.xdot)
    truth = full.run(y0, times, 1e-12, 1e-14)
    steps, errors = [1 / 200, 1 / 280, 1 / 400, 1 / 560], []
    for h in steps:
        traj = pinred.simulate(scene, method=Variational(h))
        error = full.distance(truth, FullMotion(x=traj.x, q=traj.q))
        errors.append(np.hypot(error.shape, error.rotation))
        assert largest_gap(system, traj.x) < 1e-13
    for k in range(2):
        assert fit_order([float(e[k]) for e in errors], steps) == pytest.approx(2.0, abs=0.1)


def test_loops_and_momentum_keep_to_round_off_and_energy_is_bounded(linkage: pinred.System) -> None:
    """Over 1e5 steps the energy shows no trend."""
    traj = pinred.simulate(
        linkage, **START, springs={"rocker": (STIFFNESS, 0.2)}, method=Variational(0.01),
        times=np.linspace(0.0, 1000.0, 2001),
    )  # fmt: skip
    assert traj.run.steps == 100_000
    assert largest_gap(linkage, traj.x) < 1e-13
    J = traj.spatial_momentum[:, -1]
    assert np.ptp(J) < 1e-11 * abs(J[0])
    energy = traj.energy / traj.energy[0] - 1.0
    assert 1e-6 < abs(energy).max() < 0.05
    slope = np.polyfit(np.linspace(0.0, 1.0, len(energy)), energy, 1)[0]
    assert abs(slope) < 0.2 * abs(energy).max()


def test_step_is_self_adjoint(linkage: pinred.System) -> None:
    """With all velocities reversed, the motion returns to its start."""
    forward = pinred.simulate(linkage, **START, times=[0.0, 2.0], method=Variational(0.01))
    back = pinred.simulate(
        linkage, x0=forward.x[-1], xdot0=-forward.xdot[-1], pose0=forward.pose[-1],
        xi0=-forward.xi[-1], times=[0.0, 2.0], method=Variational(0.01),
    )  # fmt: skip
    np.testing.assert_allclose(back.x[-1], forward.x[0], atol=1e-9)
    np.testing.assert_allclose(back.pose[-1, 2:], forward.pose[0, 2:], atol=1e-9)


def test_members_and_dense_output_have_the_bits_of_single_runs(linkage: pinred.System) -> None:
    """States inside steps are ends of shorter steps, which start without multipliers."""
    rates = np.array([0.5, 1.0, 2.0])
    options: dict[str, Any] = {"x0": {"crank": 1.0}, "duration": 0.5, "method": Variational(0.01)}
    many = pinred.simulate_many(linkage, xdot0={"crank": rates}, **options)
    for k, rate in enumerate(rates):
        alone = pinred.simulate(linkage, xdot0={"crank": rate}, **options)
        assert np.array_equal(many[k].x, alone.x)
    coarse = pinred.simulate(linkage, **START, times=[0.0, 0.5], method=Variational(0.01))
    fine = pinred.simulate(
        linkage, **START, times=[0.0, 0.123, 0.245, 0.5], method=Variational(0.01)
    )
    assert np.array_equal(coarse.x[-1], fine.x[-1])
    assert np.array_equal(np.stack([coarse(t).x for t in fine.t[1:3]]), fine.x[1:3])


def test_checkpointed_run_continues_with_the_same_bits(
    linkage: pinred.System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file contains no address, so the code that closes the loops is found again."""
    options: dict[str, Any] = {**START, "times": [0.0, 5.0], "method": Variational(0.01)}
    whole = pinred.simulate(linkage, **options)
    monkeypatch.setattr(run_state, "EVALUATIONS_BETWEEN_PAUSES", 512)
    monkeypatch.setattr(checkpoint, "INTERVAL", 0.0)
    monkeypatch.setattr(checkpoint, "_SHARE", 0.0)
    write, path = checkpoint.Checkpoint._write, tmp_path / "run.ckpt"

    def interrupted(self: checkpoint.Checkpoint, more: list[dict[str, Any]]) -> None:
        write(self, more)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint.Checkpoint, "_write", interrupted)
        with pytest.raises(KeyboardInterrupt):
            pinred.simulate(linkage, **options, checkpoint=path)
    continued = pinred.simulate(linkage, **options, checkpoint=path)
    assert np.array_equal(whole.x, continued.x)


# Loops and couplings have tests of their own, with this order.
@pytest.mark.by_hand
def test_gripper_with_coupling_moves_as_with_dop853(tmp_path: Path) -> None:
    """Two loops and a follower; the error falls with the square of the step."""
    path = tmp_path / "gripper.xml"
    path.write_text(gripper())
    system = pinred.load(path)
    truth = pinred.simulate(system, seed=1, times=[0.1], rtol=1e-12)
    errors = []
    for h in (0.002, 0.001):
        traj = pinred.simulate(system, seed=1, times=[0.1], method=Variational(h))
        assert largest_gap(system, traj.x) < 1e-13
        errors.append(float(np.abs(traj.x - truth.x).max()))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_code_that_differs_from_pinocchio_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The validation compares multipliers, pull and gap."""
    monkeypatch.setattr(build, "loop_values", lambda *_: np.full(3, 0.1))
    model, loops = four_bar(lengths={"crank": 0.41, "coupler": 0.9, "rocker": 0.8, "frame": 1.0})
    with pytest.raises(KernelMismatch, match="closes the loops"):
        pinred.simulate(
            pinred.load(model, loops=loops), **START, duration=0.1, method=Variational(0.01)
        )


def test_step_that_cannot_close_the_loops_raises(linkage: pinred.System) -> None:
    """A step in which the crank turns twice."""
    fast = {**START, "xdot0": {"crank": 60.0}}
    with pytest.raises(NoConvergence, match="use shorter steps"):
        pinred.simulate(linkage, **fast, duration=1.0, method=Variational(0.2))
