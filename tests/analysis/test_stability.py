"""Stability: closed-form thresholds, parity of index and growth, effect of dampers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds
from trees import random_model

import pinred
from pinred.analysis.equilibria.amended_potential import AmendedEnergy
from pinred.analysis.equilibria.equilibrium_problem import Points
from pinred.analysis.equilibria.find_equilibria import flow_at
from pinred.analysis.equilibria.relative_equilibrium import RelativeEquilibrium
from pinred.analysis.stability.stability_verdict import second_variation
from pinred.common.arrays import Array
from pinred.forces import Damper
from pinred.kernels.build import jacobian_of
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.plan import plan_of

ROOT = Path(__file__).parent.parent.parent


def test_hanging_top_is_stable_and_precession_is_a_family() -> None:
    """Steady precession at a tilt is one entry of dimension 1."""
    top = pinred.load(ROOT / "examples/heavy_top.urdf", group="SO3")
    equilibria = pinred.relative_equilibria(top, momentum=4.0, starts=200)
    lowest = equilibria[0]
    assert lowest.verdict == "stable"
    for equilibrium in equilibria:
        tilted = abs(abs(equilibrium.direction[2]) - 1.0) > 1e-6
        assert equilibrium.dimension == int(tilted)
    assert sum(e.dimension for e in equilibria) >= 1


@pytest.mark.by_hand
@settings(max_examples=5)
@given(st.sampled_from(["SO2", "SE2", "SO3", "SE3"]), st.integers(1, 3), seeds)
def test_index_is_odd_exactly_if_growing_modes_are_odd(group: str, joints: int, seed: int) -> None:
    """The index and the number of real growing modes are computed independently."""
    model = random_model(group, joints, seed)
    equilibria = pinred.relative_equilibria(pinred.load(model), momentum=1.0, starts=30)
    for equilibrium in equilibria:
        if equilibrium.dimension == 0 and equilibrium.residual < 1e-12:
            assert equilibrium.stability.index % 2 == equilibrium.stability.growing % 2, str(
                equilibrium
            )
            if equilibrium.verdict == "stable":
                assert equilibrium.stability.index in (0, 2) if group == "SO3" else True


# A further test conserves the second variation.
@pytest.mark.by_hand
def test_positive_second_variation_is_energy_minimum() -> None:
    """At the minimum, each small change of the reduced state on its leaf raises the energy."""
    cat = pinred.load("planar_chain5")
    least = pinred.relative_equilibria(cat, momentum=1.0, starts=15)[0]
    assert least.verdict == "stable"
    energy = AmendedEnergy(least.problem)
    point = Points(least.x[None], np.zeros((1, 0)))
    second = second_variation(energy, point, 1.0)
    assert second.index == 0
    assert second.values.min() > 0.0
    rng = np.random.default_rng(0)
    for _ in range(20):
        step = 1e-3 * rng.normal(size=(1, 5))
        assert energy(point.moved(step), 1.0).U[0] > least.amended_potential


# Every run has the modes of the linearised flow, and its growth with a damper.
@pytest.mark.by_hand
def test_energy_norm_is_conserved_at_stable_equilibrium() -> None:
    """h″ from the linearised flow is symmetric and positive, and δzᵀ h″ δz stays constant."""
    pendulum = pinred.load("double_spherical_pendulum")
    least = pinred.relative_equilibria(pendulum, momentum=2.0, starts=100)[0]
    start = pinred.simulate(least.scene(duration=1.0))
    J = pinred.linearise(start).matrix
    second = np.vstack([-J[3:], J[:3]])  # ż = Ω h″ δz in (x, π)
    np.testing.assert_allclose(second, second.T, atol=1e-9 * np.abs(second).max())
    assert np.linalg.eigvalsh(0.5 * (second + second.T)).min() > 0.0
    traj = pinred.simulate(least.scene(1, amplitude=1e-3, duration=60.0))
    red = pinred.Reduction(pendulum)
    momenta = [
        (red.mass_matrix(x) @ np.r_[xi, v])[1:]
        for x, xi, v in zip(traj.x, traj.xi, traj.xdot, strict=True)
    ]
    steady = (red.mass_matrix(least.x) @ np.r_[least.xi, least.xdot])[1:]
    difference = np.hstack([traj.x - least.x, np.array(momenta) - steady])
    size = np.einsum("ti,ij,tj->t", difference, second, difference)
    np.testing.assert_allclose(size, size[0], rtol=0.05)


def damped_growth(each: RelativeEquilibrium, joint: str, c: float) -> float:
    """Return the largest growth with a damper at a joint, by the Jacobian of that kernel."""
    from dataclasses import replace

    scene = replace(each.scene(), forces=Damper(joint, c), outputs="shape")
    flow = CompiledFlow.of_plan(plan_of(scene))
    matrix: Array = jacobian_of(flow.kernel, flow.y0, flow.parameters)
    return float(np.linalg.eigvals(matrix).real.max())


def test_damped_growth_matches_kernel_with_damper() -> None:
    """∂Re λ/∂c of each joint equals the change that a kernel with that damper shows."""
    pendulum = pinred.load("double_spherical_pendulum")
    equilibria = pinred.relative_equilibria(pendulum, momentum=2.0)
    (one,) = (e for e in equilibria if e.verdict == "undecided")
    assert set(one.damped_growth) == set(pendulum.shape_names)
    for joint, growth in one.damped_growth.items():
        assert growth > 0.0
        c = 1e-4 / growth
        assert damped_growth(one, joint, c) == pytest.approx(c * growth, rel=2e-2)
    assert all(not e.damped_growth for e in equilibria if e is not one)


def test_modes_solve_the_linearised_flow() -> None:
    """J v = λ v holds for each mode, with J by differences of the kernel's rates."""
    system = pinred.load("reaction_wheel_satellite")
    equilibria = pinred.relative_equilibria(
        system, momentum=0.5, cyclic={"wheel_x": 0.3}, starts=200
    )
    each = equilibria[0]
    flow = flow_at(each.problem, Points(each.x[None, :1], each.direction[None]), each.xdot, each.xi)
    n, layout = len(flow.y0), flow.kernel.layout

    def rate(y: Array) -> Array:
        return flow.kernel.evaluate_rate(y, flow.parameters)

    still = rate(flow.y0)
    still[2:5] = 0.0  # wheel angles
    assert np.abs(still).max() < 1e-13
    J = np.array([(rate(flow.y0 + h) - rate(flow.y0 - h)) / 2e-6 for h in 1e-6 * np.eye(n)]).T
    assert layout.active == (0,)
    for mode in each.modes:
        v = np.concatenate([[mode.shape[0], mode.momentum[0]], np.zeros(3), mode.base])
        left = J @ v - (mode.growth + 1j * mode.frequency) * v
        left[2:5] = 0.0
        assert np.abs(left).max() < 1e-7 * np.abs(v).max()
