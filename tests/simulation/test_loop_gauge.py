"""The gauge of the impetus: its multipliers ν stay bounded under steady loads of the loops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loop_robots import four_bar

import pinred
from pinred.common.arrays import Array
from pinred.integrators.integrate import integrate
from pinred.integrators.methods import Method
from pinred.kernels import build, reference_state
from pinred.reduction.pointwise_reduction import mass_matrix
from pinred.reduction.tree import loop_constraints
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.plan import plan_of
from pinred.system.loops.kinematics import loop_jacobian, loop_values

# Centrifugal forces load the loop steadily as the crank turns.
START: dict[str, Any] = {
    "x0": {"crank": 1.0}, "xdot0": {"crank": 6.0}, "xi0": [0.1, 0.2, 0.3],
    "springs": {"rocker": (3.0, 0.2)},
}  # fmt: skip


def run(method: Method, duration: float) -> tuple[pinred.Trajectory, Array]:
    """Return the motion of a new four-bar, and the largest |ν| at its report times, (T,)."""
    model, loops = four_bar()
    system = pinred.load(model, loops=loops)
    times = np.linspace(0.0, duration, 201)
    traj = pinred.simulate(system, times=times, method=method, **START)
    flow, closure = CompiledFlow.of_plan(plan_of(traj.scene)), system.closure
    assert closure is not None
    states = integrate(
        method, flow.address(method), flow.parameters, flow.y0, duration, times,
        flow.kernel.layout.quaternions, tangent=flow.tangent,
    ).y  # fmt: skip
    impetus, nu = states[:, system.m : 2 * system.m], np.empty(len(times))
    for k, x in enumerate(traj.x):
        velocity = np.concatenate([traj.xi[k], traj.xdot[k]])
        pi = (mass_matrix(system, x) @ velocity)[system.r :]
        J = loop_jacobian(system, x)[closure.rows]
        nu[k] = np.abs(np.linalg.lstsq(J.T, impetus[k] - pi, rcond=None)[0]).max()
    return traj, nu


@pytest.mark.parametrize(
    ("method", "gap", "energy", "end"),
    [
        (pinred.DOP853(1e-10, 1e-12), 3e-8, 3e-7, 200.0),
        pytest.param(pinred.DOP853(1e-10, 1e-12), 3e-8, 3e-7, 1000.0, marks=pytest.mark.by_hand),
        pytest.param(pinred.Gauss(0.005, 6), 1e-7, 5e-8, 1000.0, marks=pytest.mark.by_hand),
    ],
)
def test_multipliers_momentum_and_energy_stay_bounded(
    method: Method, gap: float, energy: float, end: float
) -> None:
    """The number of steps per second does not grow either."""
    short, early = run(method, 10.0)
    traj, nu = run(method, end)
    assert early.max() > 5.0
    assert nu.max() < 1.2 * early.max()
    assert traj.run.steps < 0.105 * end * short.run.steps
    assert max(np.abs(loop_values(traj.system, x)).max() for x in traj.x) < gap
    J = traj.spatial_momentum
    assert np.abs(J - J[0]).max() < 1e-12 * np.abs(J).max()
    assert np.ptp(traj.energy) < energy * traj.energy[0]


def test_multipliers_grow_without_the_rate_of_the_gauge(monkeypatch: pytest.MonkeyPatch) -> None:
    """The impetus grows with time, and the steps become shorter."""
    method = pinred.DOP853(1e-10, 1e-12)
    damped, _ = run(method, 100.0)
    for module in (loop_constraints, build, reference_state):
        monkeypatch.setattr(module, "GAUGE_RATE", 0.0)
    traj, nu = run(method, 100.0)
    assert nu[-1] > 500.0
    assert traj.run.steps > 3 * damped.run.steps
    np.testing.assert_allclose(traj.x[-1], damped.x[-1], rtol=1e-5)
