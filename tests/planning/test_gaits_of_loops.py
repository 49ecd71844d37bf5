"""Optimal gaits of robots with closed loops, simulated and compared with full ABA."""

from __future__ import annotations

import re

import numpy as np
import pytest
from loop_robots import five_bar

import pinred
from pinred.planning.optimisation.limits import limits_of

CRANKS = ("left_crank", "right_crank")
LIMITS = {"left_crank": (1.5, 2.5), "right_crank": (0.6, 1.5)}


@pytest.mark.slow
@pytest.mark.by_hand
def test_best_gait_of_a_five_bar_equals_its_simulation() -> None:
    """The torques that the optimiser limits are those of the simulation, which ABA confirms."""
    model, loops = five_bar()
    system = pinred.load(model, loops=loops)
    connection = pinred.Connection.mechanical(system, independent=CRANKS)
    best = pinred.optimise_gait(
        connection, cost="torque", most=30.0, harmonics=1, starts=1, limits=LIMITS, torques=8.0
    )
    assert re.search("independent joints +left_crank, right_crank\n", str(best))
    assert best.trajectory.x.shape[1] == 4
    error = best.flow_error
    assert max(float(error.rotation), float(error.translation)) < 1e-8
    assert best.report.passed, str(best.report)
    # The largest torque of the gait is at its limit, between two report times.
    peak = np.abs(best.trajectory.driving_torques).max()
    assert 7.9 < peak <= 8.0 * (1.0 + 1e-6)


def test_file_limits_of_independent_joints_are_the_default() -> None:
    """Limits are looked up by the name of the joint, in the order of `independent`."""
    model, loops = five_bar()
    for k, (low, high) in enumerate(((-2.0, 2.5), (-1.0, 1.0), (-1.5, 2.0), (-3.0, 3.0))):
        at = model.idx_qs[2 + k]
        model.lowerPositionLimit[at], model.upperPositionLimit[at] = low, high
    system = pinred.load(model, loops=loops)
    connection = pinred.Connection.mechanical(system, independent=CRANKS[::-1])
    ranges = limits_of(connection, None, None, None)
    np.testing.assert_array_equal(ranges.shape, [[-1.5, 2.0], [-2.0, 2.5]])


def linkage() -> pinred.Connection:
    """Return the connection of the five-bar linkage over its cranks."""
    model, loops = five_bar()
    return pinred.Connection.mechanical(pinred.load(model, loops=loops), independent=CRANKS)


@pytest.mark.slow
@pytest.mark.by_hand
def test_reorientation_of_a_five_bar_reaches_its_target_in_the_simulation() -> None:
    """The cranks move from rest to rest, and the figure names them."""
    plan = pinred.reorient(linkage(), 0.01, limits=LIMITS)
    assert plan.connection.joints == CRANKS
    assert plan.remaining < 1e-12
    assert plan.missed < 1e-9
    assert plan.report.passed, str(plan.report)
    assert plan.trajectory.driving_torques.shape == (len(plan.trajectory.t), 2)
    figure = pinred.plot(plan, "loop")
    labels = [axes.get_legend_handles_labels()[1] for axes in figure.axes]
    assert any({*CRANKS} <= {*names} for names in labels)


@pytest.mark.by_hand
def test_tumbling_five_bar_reaches_its_target_from_a_stated_shape() -> None:
    """x0 states independent joints, by name or in order; others are refused."""
    x0 = {"left_crank": 2.0, "right_crank": 1.1}
    momentum = [0.0, 0.0, 0.02]
    plan = pinred.reorient(linkage(), 0.05, limits=LIMITS, momentum=momentum, x0=x0)
    assert plan.missed < 1e-8
    system = plan.system
    start = plan.trajectory.x[0, [system.shape_names.index(name) for name in CRANKS]]
    np.testing.assert_allclose(start, [2.0, 1.1], atol=1e-12)
    with pytest.raises(pinred.InputError, match="left_coupler"):
        pinred.reorient(linkage(), 0.05, limits=LIMITS, x0={"left_coupler": 0.1})
