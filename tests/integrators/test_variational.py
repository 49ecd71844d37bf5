"""The variational integrator: discrete action by Pinocchio, order by ABA, invariants."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi
import numpy as np
import pinocchio as pin
import pytest
from discrete_action import REST, STIFFNESS, Action, points_of
from orders import errors_at_the_end, fit_order
from scipy.spatial.transform import Rotation
from stiff_kernels import kernel_by_numba

import pinred
from pinred import Gauss, Variational
from pinred.common.errors import InputError, NoConvergence, NonFiniteState
from pinred.forces import Damper, Torque, Wrench
from pinred.integrators import integrate as drive
from pinred.integrators.integrate import Solution, integrate
from pinred.integrators.integrate_many import STATUS, integrate_many
from pinred.integrators.stepping import run_state
from pinred.integrators.stepping.run_state import Canonical
from pinred.judge.reference_solution import FullMotion, FullState
from pinred.signals import Fourier
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.plan import plan_of

ROOT = Path(__file__).parents[2]


@pytest.mark.by_hand("satellite_two_arms-start2", "falling_cat-start0")
@pytest.mark.parametrize(
    ("robot", "start"),
    [
        ("falling_cat", {"seed": 3}),
        ("satellite_two_arms", {"seed": 1}),
        ("satellite_two_arms", {"x0": np.full(6, 0.3), "xdot0": np.full(6, 0.7), "momentum": 0}),
        ("planar_chain5", {"seed": 2}),
        ("coupled_spatial", {"seed": 5}),
    ],
)
@pytest.mark.sampled
def test_discrete_action_is_stationary(robot: str, start: dict[str, Any]) -> None:
    """Under variations of inner points. Another method of order 2 fails this test."""
    system, h, count = pinred.load(robot), 0.02, 12
    action, rng = Action(system, h), np.random.default_rng(0)
    points = points_of(system, Variational(h), count, **start)
    other = points_of(system, Gauss(h, 2), count, **start)
    largest, by_other = 0.0, 0.0
    size = 0.0
    for k in range(1, count):
        variation = rng.normal(size=system.n - system.group.linear)
        largest = max(largest, abs(action.slope(points, k, variation, 1e-4)))
        by_other = max(by_other, abs(action.slope(other, k, variation, 1e-4)))
        # What cancels: the momentum at the end of one step, and at the begin of the next.
        one = (points[k][0] - points[k - 1][0]) / h
        size = max(size, float(abs(action.metric(points[k][0])[:, -system.m :] @ one).max()))
    assert largest < 1e-9 * max(size, 0.1)
    assert by_other > 1e3 * largest


@pytest.mark.parametrize("robot", ["planar_chain5", "coupled_spatial", "falling_cat"])
def test_variational_has_order_2(robot: str) -> None:
    """Order 2 in shape and attitude, by ABA."""
    counts = [150, 200, 270, 360]
    for errors in errors_at_the_end(robot, Variational, counts):
        order = fit_order(errors, [1 / count for count in counts])
        assert order == pytest.approx(Variational.order, abs=0.1)


def test_order_2_with_forces_and_prescribed_joint() -> None:
    """Forces without a potential act in the stages; order 2 also inside steps."""
    system = pinred.load("falling_cat")
    scene = pinred.Scene(
        system=system,
        seed=2,
        times=[0.501, 1.0],
        prescribed={"sway": Fourier(0.0, [0.3], [0.1], 2.0)},
        forces=[
            Damper("bend", 0.05),
            Torque(lambda t, x, xdot, mu: {"twist": 0.05 * mu[-1] * t - 0.02 * x[0] * xdot[0]}),
        ],
    )
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    truth = full.run(y0, np.array([0.501, 1.0]), 1e-12, 1e-14)
    steps, errors = [1 / 100, 1 / 140, 1 / 200, 1 / 280], []
    for h in steps:
        traj = pinred.simulate(replace(scene, method=Variational(h)))
        error = full.distance(truth, FullMotion(x=traj.x, q=traj.q))
        errors.append(np.hypot(error.shape, error.rotation))
    for k in range(2):
        assert fit_order([float(e[k]) for e in errors], steps) == pytest.approx(2.0, abs=0.15)


# Closed loops keep momentum and energy over as many steps.
@pytest.mark.by_hand
def test_momentum_is_constant_and_energy_bounded() -> None:
    """Over 1e5 steps momentum stays at round-off and the energy shows no trend."""
    system = pinred.load("falling_cat")
    springs = dict.fromkeys(system.shape_names, (STIFFNESS, REST))
    traj = pinred.simulate(
        system, seed=3, duration=1000.0, times=np.linspace(0.0, 1000.0, 2001), springs=springs,
        method=Variational(0.01),
    )  # fmt: skip
    assert traj.run.steps == 100_000
    data, J, E = system.model.createData(), [], []
    for q, v, x in zip(traj.q, traj.v, traj.x, strict=True):
        pin.ccrba(system.model, data, q, v)
        J.append(data.hg.angular.copy())
        kinetic = pin.computeKineticEnergy(system.model, data, q, v)
        kinetic -= 0.5 * data.hg.linear @ data.hg.linear / system.mass
        E.append(kinetic + 0.5 * STIFFNESS * float(((x - REST) ** 2).sum()))
    drift = np.abs(np.array(J) - J[0]).max()
    # As far as numbers tell: the centre of mass has gone a long way.
    assert drift < 1e-11 * np.linalg.norm(J[0])
    energy = np.array(E) / E[0] - 1.0
    assert 1e-6 < abs(energy).max() < 0.05
    slope = np.polyfit(np.linspace(0.0, 1.0, len(energy)), energy, 1)[0]
    assert abs(slope) < 0.2 * abs(energy).max()


def test_pauses_reports_and_storage_do_not_change_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dense output and batch members have the same bits, too."""
    system = pinred.load("coupled_spatial")
    flow = CompiledFlow.of_plan(
        plan_of(pinred.Scene(system=system, seed=1, method=Variational(0.02)))
    )
    layout = flow.kernel.layout
    assert flow.kernel.canonical == (system.m, 3, 0)

    def run(times: Any) -> Solution:
        return integrate(
            Variational(0.02), flow.kernel.rate.address, flow.parameters, flow.y0, 2.0, times,
            layout.quaternions, canonical=flow.kernel.canonical,
        )  # fmt: skip

    uninterrupted = run([0.0, 0.3, 2.0])
    times = np.sort(np.concatenate([np.linspace(0.0, 2.0, 333), uninterrupted.knots]))
    once = run(times)
    monkeypatch.setattr(run_state, "EVALUATIONS_BETWEEN_PAUSES", 1)
    monkeypatch.setattr(drive, "_FIRST_KNOTS", 1)
    paused = run([0.0, 0.3, 2.0])
    for other in (once, paused):
        assert np.array_equal(uninterrupted.states, other.states)
    assert np.array_equal(uninterrupted.y, paused.y)
    assert np.array_equal(uninterrupted.at(times), once.y)
    assert np.array_equal(paused.at([0.3]), uninterrupted.y[1:2])
    several = pinred.simulate_many(system, seeds=range(3), duration=0.5, method=Variational(0.01))
    for k in range(3):
        alone = pinred.simulate(system, seed=k, duration=0.5, method=Variational(0.01))
        assert np.array_equal(several[k].x, alone.x)
        shape = pinred.simulate(
            system, seed=k, duration=0.5, method=Variational(0.01), outputs="shape"
        )
        assert np.array_equal(shape.x, alone.x)


def _gap(y: Any, p: Any, d: Any) -> None:  # noqa: ARG001
    hole = np.sqrt((y[2] - 0.04) * (y[2] - 0.06))  # no number at clock times between the two
    d[0], d[1], d[2] = y[1], -y[0] + 0.0 * hole, 1.0


def test_unsolved_report_raises() -> None:
    """The step crosses an interval of non-finite rates, and a report time lies in it."""
    address = kernel_by_numba(_gap)
    options: dict[str, Any] = {"canonical": Canonical(1)}
    start, method = [1.0, 0.0, 0.0], Variational(0.1)
    over = integrate(method, address, [], start, 0.3, [0.0, 0.1, 0.25, 0.3], **options)
    assert np.isfinite(over.y).all()
    with pytest.raises(NoConvergence, match="use shorter steps") as caught:
        integrate(method, address, [], start, 0.3, [0.0, 0.05, 0.3], **options)
    assert caught.value.time == 0.0
    with pytest.raises(NoConvergence, match=r"t = 0\.05 s, inside a step"):
        over.at([0.05])
    many = integrate_many(
        method, address, np.zeros((2, 0)), [start, [1.0, 0.0, 0.5]], 0.3, [0.0, 0.05], **options
    )
    assert [STATUS[s] for s in many.status.tolist()] == [
        "without a solution of its implicit step", "done",
    ]  # fmt: skip
    assert np.isnan(many.y[0, 1]).all()


def test_method_is_self_adjoint() -> None:
    """With all velocities reversed, the motion returns to its start."""
    system = pinred.load("satellite_two_arms")
    forward = pinred.simulate(system, seed=1, times=[0.0, 5.0], method=Variational(0.02))
    back = pinred.simulate(
        system, x0=forward.x[-1], xdot0=-forward.xdot[-1], pose0=forward.pose[-1],
        xi0=-forward.xi[-1], times=[0.0, 5.0], method=Variational(0.02),
    )  # fmt: skip
    np.testing.assert_allclose(back.x[-1], forward.x[0], atol=1e-10)
    turn = Rotation.from_quat(forward.pose[0, 3:]).inv() * Rotation.from_quat(back.pose[-1, 3:])
    assert turn.magnitude() < 1e-10


def test_invalid_runs_are_rejected() -> None:
    """A momentum that changes, steps that are too long, and non-finite rates."""
    top = pinred.load(ROOT / "examples/heavy_top.urdf", group="SO3")
    with pytest.raises(InputError, match="Variational needs a constant angular momentum"):
        pinred.simulate(top, seed=1, duration=0.1, method=Variational(0.01))
    cat = pinred.load("falling_cat")
    pushed: dict[str, Any] = {"forces": Wrench([0, 0, 0.5, 0, 0, 0]), "duration": 0.1}
    with pytest.raises(InputError, match="constant angular momentum"):
        pinred.simulate(cat, seed=1, method=Variational(0.01), **pushed)
    hard = dict.fromkeys(cat.shape_names, (1e6, 0.0))
    with pytest.raises(NoConvergence, match="use shorter steps"):
        pinred.simulate(cat, seed=1, duration=1.0, method=Variational(0.1), springs=hard)
    gone = Torque(lambda t, *_: {"bend": casadi.sqrt(0.5 - t)})
    with pytest.raises(NonFiniteState) as caught:
        pinred.simulate(cat, seed=1, duration=2.0, method=Variational(0.01), forces=gone)
    assert caught.value.time == pytest.approx(0.5, abs=0.011)
    for step in (0.0, -1.0, np.nan):
        with pytest.raises(InputError):
            Variational(step)
