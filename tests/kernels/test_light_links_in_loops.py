"""Kernels of loops with links that are much lighter than the links that they connect."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from loop_robots import four_bar

import pinred
from pinred.reduction.tree.loop_constraints import needs_second_solution
from pinred.system.loops.kinematics import LoopKinematics
from pinred.system.state_fields import State

START = {"momentum": 0, "x0": {"crank": 0.5}, "xdot0": {"crank": 5.0}}


def light_four_bar(share: float) -> pinred.System:
    """Return a four-bar whose coupler has a share of its usual mass.

    The multipliers are in the axes of the rocker, so they turn relative to the coupler, and its
    momentum becomes a difference of large terms.
    """
    model, _ = four_bar()
    coupler = model.inertias[3]
    inertia = pin.Inertia(share * coupler.mass, coupler.lever, share * coupler.inertia)
    model.inertias[3] = inertia
    return pinred.load(model, loops="rocker_tip=coupler_tip")


@pytest.mark.parametrize(("share", "needed"), [(1.0, False), (1e-3, False), (1e-4, True)])
def test_second_solution_is_for_light_links_only(share: float, needed: bool) -> None:
    """A coupler of 1e-4 responds 664 times more in the open tree than at closed loops."""
    assert needs_second_solution(light_four_bar(share)) is needed


@pytest.mark.parametrize("share", [1e-4, 1e-8])
def test_velocity_of_light_links_keeps_its_digits(share: float) -> None:
    """One dense system for velocities and multipliers, at the stored impetus, by Pinocchio.

    Without the second solution, a share of 1e-4 loses three digits, and one of 1e-8 nearly all.
    """
    system = light_four_bar(share)
    motion = pinred.simulate(system, duration=1.0, **START)  # type: ignore[arg-type]
    flow, segment = motion.motion.flow_of(0), motion.motion.segments[0]
    model, r = system.sorted_model, system.r
    kinematics, data, error = LoopKinematics(model, system.loops), model.createData(), 0.0
    assert system.closure is not None
    for t in np.linspace(0.1, 1.0, 10):
        times = np.array([t])
        y = motion.motion.changes(times).y[0]
        state = flow.states(times, y[None], segment.parameters)
        assert isinstance(state, State)
        q = system.sorted_q(state.pose[0], state.x[0])
        v = np.concatenate([state.xi[0], state.xdot[0]])
        upper = np.triu(pin.crba(model, data, q))
        H = upper + np.triu(upper, 1).T
        J = kinematics.jacobian(q)[system.closure.rows]
        impetus = flow.canonical_momenta(t, y)[2]  # type: ignore[attr-defined]
        matrix = np.block([[H, J.T], [J, np.zeros((len(J), len(J)))]])
        right = np.concatenate([H[:r] @ v, impetus, np.zeros(len(J))])
        exact = np.linalg.solve(matrix, right)[: len(v)]
        error = max(error, float(np.abs(v - exact).max() / np.abs(exact).max()))
    assert error < 1e-14


# The velocity that lost digits is tested below.
@pytest.mark.by_hand
@pytest.mark.slow
def test_compare_passes_for_light_links_in_loops() -> None:
    """The kernel was refused for a share of 1e-6: a reference of the validation lost digits."""
    system = light_four_bar(1e-6)
    report = pinred.compare(pinred.simulate(system, duration=0.5, **START))  # type: ignore[arg-type]
    assert report.passed, str(report)
