"""Best gaits of ball joints, against RNEA, SciPy over Pinocchio, and differences."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from assertions import close
from ball_trees import ball_tree, joined_bodies
from lifts import at_rotation_vectors, by_pinocchio, random_gait

import pinred
from pinred.analysis.phases.lift import fourier_basis, path_lift, piece_nodes
from pinred.common.arrays import Array
from pinred.planning.optimisation.limits import BALL_LIMIT, limits_of
from pinred.planning.optimisation.objective import COSTS, CostKind, cost_of, torques

CENTRE = {"joint": [0.2, -0.3, 0.1]}


@cache
def tree() -> tuple[pinred.System, Array, pinred.Connection]:
    """Return a tree of balls and hinges, a centre, and the connection about it."""
    system = ball_tree(3, 2)
    centre = system.space.random(np.random.default_rng(1), 1.0)
    return system, centre, pinred.Connection.mechanical(system).in_chart(centre)


def rnea_torques(system: pinred.System, gait: pinred.Gait, centre: Array, t: float) -> Array:
    """Return the joint torques of a loop at zero momentum, in the frame of the shape, by RNEA."""
    red, step = pinred.Reduction(system), 1e-3

    def velocity(t: float) -> tuple[Array, Array]:
        x, rates = at_rotation_vectors(system, centre, *gait.at(t))
        return x, np.concatenate([-red.local_connection(x) @ rates, rates])

    weights = {1: 0.75, 2: -0.15, 3: 1.0 / 60.0}  # of differences of order 6
    x, v = velocity(t)
    change = np.zeros_like(v)
    for k, w in weights.items():
        change += w * (velocity(t + k * step)[1] - velocity(t - k * step)[1])
    model, data = system.sorted_model, system.sorted_model.createData()
    q = system.sorted_q(system.group.identity(), x)
    return np.asarray(
        pin.rnea(model, data, q, system.joint_rates(v), system.joint_rates(change / step))
    )


# The cost of the best gait of a ball is that of RNEA.
@pytest.mark.by_hand
def test_torques_along_loop_are_those_of_rnea() -> None:
    """In the axes of the children, about a centre, also far from it."""
    system, centre, A = tree()
    gait = random_gait(np.random.default_rng(5), system.m).scaled(1.5)
    series, basis = gait.series, fourier_basis(2, 1)
    c = np.vstack([series.mean, series.cos, series.sin])
    x, slope, bend = basis.values @ c, basis.slopes @ c, basis.bends @ c
    tau = torques(A, x, slope / gait.period, bend / gait.period**2)
    for k, s in enumerate(piece_nodes(1)[::3].tolist()):
        expected = rnea_torques(system, gait, centre, s * gait.period)
        size = float(np.abs(tau).max())
        close(expected[: system.r], np.zeros(system.r), 1e-9 * size)
        close(tau[3 * k], expected[system.r :], 1e-9 * size)


@pytest.mark.by_hand("torque", "length")
@pytest.mark.parametrize("kind", COSTS)
def test_slopes_of_costs_with_balls_equal_differences(kind: CostKind) -> None:
    """All costs of a random loop of two balls, about a random centre."""
    _, _, A = tree()
    basis, step = fourier_basis(2, 16), 1e-5
    c, change = 0.4 * np.random.default_rng(0).normal(size=(2, 5, A.m))

    def cost(c: Array) -> float:
        return cost_of(kind, A, basis, c, path_lift(A, basis, c), 1.3).value

    slope = cost_of(kind, A, basis, c, path_lift(A, basis, c), 1.3).slope
    difference = (cost(c + step * change) - cost(c - step * change)) / (2.0 * step)
    assert np.sum(slope * change) == pytest.approx(difference, rel=1e-7, abs=1e-300)


def test_best_gait_of_ball_is_confirmed_by_independent_integration() -> None:
    """The phase by SciPy over Pinocchio's momenta, the cost by RNEA, and both by simulation."""
    system = joined_bodies()
    A = pinred.Connection.mechanical(system).in_chart(CENTRE)
    best = pinred.optimise_gait(
        A, objective="rotation", axis="x", cost="torque", harmonics=1, limits=1.0, starts=1
    )
    assert best.residual < 1e-6
    assert best.margins["limits"] >= 0.0
    chart = A.chart
    assert chart is not None
    expected = by_pinocchio(system, best.gait, np.zeros(6), chart.centre)
    error = A.group.error(best.phase.pose, expected)
    assert max(error.rotation, error.translation) < 1e-11
    assert best.value == pytest.approx(A.group.log(expected)[3], rel=1e-10)
    times = np.arange(64) / 64.0
    tau = np.array([rnea_torques(system, best.gait, chart.centre, float(t))[6:] for t in times])
    assert best.cost == pytest.approx(np.sum(tau**2) / 64.0, rel=1e-9)
    simulated = best.trajectory.driving_torques
    close(simulated[0], tau[0], 1e-8 * float(np.abs(tau).max()))
    assert max(best.flow_error.rotation, best.flow_error.translation) < 1e-10


def test_loop_that_leaves_rotation_vectors_is_refused_by_name() -> None:
    """Limits beyond 2π let the optimiser leave the chart; the error names the ball."""
    A = pinred.Connection.mechanical(joined_bodies())
    with pytest.raises(pinred.NoOptimum, match="ball joint 'joint' reaches 2π"):
        pinred.optimise_gait(
            A, axis="x", cost="acceleration", harmonics=1, starts=1,
            limits=[(6.0, 9.0), (-1.0, 1.0), (-1.0, 1.0)],
        )  # fmt: skip


def test_default_limits_of_balls_stay_in_chart() -> None:
    """Balls get ±3.6 rad for each entry; ranges of hinges are shifted by the centre."""
    system = pinred.load("astronaut")
    A = pinred.Connection.mechanical(system).in_chart({"left_knee": 0.5})
    limits, plain = limits_of(A, None, None, None), system.space.scalar_v
    np.testing.assert_array_equal(limits.shape[system.space.ball_v, 1], BALL_LIMIT)
    assert np.sqrt(3.0) * BALL_LIMIT < 2.0 * np.pi
    at_rest = limits_of(pinred.Connection.mechanical(system).in_chart(), None, None, None)
    shift = np.where(np.array(system.shape_names)[plain] == "left_knee", 0.5, 0.0)
    np.testing.assert_allclose(limits.shape[plain], at_rest.shape[plain] - shift[:, None])
