"""Members, flows with derivatives, and parameters of robots with closed loops."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from loop_robots import four_bar, random_loops

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import IntegrationError, UnsupportedOperationError
from pinred.simulation.closed_loops import may_pass_singular_shape
from pinred.simulation.flow_map.flow import Flow

PARALLELOGRAM = {"crank": 0.5, "coupler": 1.0, "rocker": 0.5, "frame": 1.0}
FOLDED = {"crank": 2.0, "coupler": -2.0, "rocker": 2.0}


@pytest.fixture(scope="module")
def linkage() -> pinred.System:
    """Return the four-bar linkage."""
    model, loops = four_bar()
    return pinred.load(model, loops=loops)


def with_balls() -> tuple[pin.Model, list[pinred.Loop]]:
    """Return a robot in space with balls and two loops."""
    return random_loops(3, ("3d", "3d"), 3, balls=True)


def parallelogram() -> pinred.System:
    """Return a four-bar that can fold when it is flat."""
    model, loops = four_bar(lengths=PARALLELOGRAM)
    return pinred.load(model, loops=[replace(loop, coupled=False) for loop in loops])


def test_members_equal_single_simulations(linkage: pinred.System) -> None:
    """Rates by name are kept in each member, in lanes and one after another."""
    rates = np.array([0.5, 1.0, 2.0])
    start = {"x0": {"crank": 1.0}, "duration": 0.5}
    for method in ("DOP853", "Gauss(0.01)"):
        many = pinred.simulate_many(linkage, **start, xdot0={"crank": rates}, method=method)  # type: ignore[arg-type]
        assert not many.failures
        np.testing.assert_allclose(many.xdot[:, 0, 0], rates, rtol=1e-14)
        for k, rate in enumerate(rates):
            alone = pinred.simulate(linkage, **start, xdot0={"crank": rate}, method=method)  # type: ignore[arg-type]
            atol = 1e-13 if method == "DOP853" else 0.0
            np.testing.assert_allclose(many[k].x, alone.x, rtol=0.0, atol=atol)
            np.testing.assert_allclose(many[k].pose, alone.pose, rtol=0.0, atol=atol)


def test_open_members_are_closed_or_listed_as_failures(linkage: pinred.System) -> None:
    """One warning counts the members that move; those that do not close are failures."""
    x0 = np.array([[1.0, 0.0, 0.0], [1.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        many = pinred.simulate_many(linkage, x0=x0, duration=0.1)
    texts = [str(entry.message) for entry in caught if entry.category is pinred.LoopWarning]
    assert len(texts) == 1
    assert texts[0].startswith("2 initial states of 2 members leave loops open. The first: x0 leav")
    (failure,) = many.failures
    assert failure.member == 2
    assert "do not close near this shape" in failure.reason
    with pytest.warns(pinred.LoopWarning):
        alone = pinred.simulate(linkage, x0=x0[1], duration=0.1)
    np.testing.assert_allclose(many[1].x[0], alone.x[0], rtol=1e-14)


def test_members_through_a_singular_shape_are_failures() -> None:
    """A parallelogram is flat at crank angle π; reports before and after it reveal that."""
    many = pinred.simulate_many(
        parallelogram(), x0=FOLDED, xdot0={"crank": np.array([0.5, 1.0])}, duration=1.5,
        method=pinred.DOP853(max_steps=2000),
    )  # fmt: skip
    assert [failure.member for failure in many.failures] == [1]
    assert np.isnan(many.x[1, -1]).all()
    assert np.isfinite(many.x[0]).all()


def test_singular_shapes_between_shapes_are_found() -> None:
    """The orientation of the rows of J changes behind the flat shape."""
    system = parallelogram()
    angles = np.array([[2.0], [2.4], [2.8], [3.4], [3.8]])
    through = angles * np.array([1.0, -1.0, 1.0])
    assert not may_pass_singular_shape(system, through[:3])
    assert not may_pass_singular_shape(system, through[3:])
    assert may_pass_singular_shape(system, through)


def differences(flow: Flow, state: dict[str, Array], name: str, direction: Array) -> Array:
    """Return central differences of order 4 of the end state along a direction of an input."""
    h, space, group = 1e-4, flow.system.space, flow.system.group

    def end(step: float) -> object:
        moved = state[name] + step * direction
        if name == "x0":
            moved = space.integrate(state["x0"], step * direction)
        return flow(**{**state, name: moved})

    def change(k: int) -> Array:
        ahead, behind = end(k * h), end(-k * h)
        assert isinstance(ahead, pinred.State)
        assert isinstance(behind, pinred.State)
        between = group.compose(group.inverse(behind.pose.ravel()), ahead.pose.ravel())
        return np.concatenate(
            [
                space.difference(behind.x.ravel(), ahead.x.ravel()),
                (ahead.xdot - behind.xdot).ravel(),
                group.log(between),
                (ahead.xi - behind.xi).ravel(),
            ]
        )

    return (8.0 * change(1) - change(2)) / (12.0 * h)


@pytest.mark.parametrize(
    "robot",
    [four_bar, pytest.param(with_balls, marks=pytest.mark.by_hand)],
    ids=["four-bar", "with balls"],
)
@pytest.mark.filterwarnings("ignore::pinred.LoopWarning")
def test_derivatives_of_flows_equal_differences(
    robot: Callable[[], tuple[pin.Model, list[pinred.Loop]]],
) -> None:
    """Directions that open the loops are projected; at other states, too."""
    model, loops = robot()
    system = pinred.load(model, loops=loops)
    start, rng = pinred.Scene(system=system, seed=2).start, np.random.default_rng(0)
    flow = pinred.flow(
        system, x0=start.x, xdot0=start.xdot, xi0=start.xi, duration=0.2, method="Gauss(0.01)",
        wrt=["x0", "xdot0", "xi0"],
    )  # fmt: skip
    assert system.closure is not None
    other = pinred.Scene(
        system=system, x0=system.space.integrate(start.x, 0.1 * rng.normal(size=system.m))
    ).start.x
    for x in (start.x, other):
        state = {"x0": x, "xdot0": start.xdot, "xi0": start.xi}
        for name, size in flow.inputs.items():
            direction = rng.normal(size=size)
            along = flow.jvp({name: direction}, **state)
            expected = differences(flow, state, name, direction)
            np.testing.assert_allclose(along, expected, rtol=0.0, atol=1e-9 * np.abs(along).max())
            weights = rng.normal(size=along.shape)
            back = flow.vjp(weights, **state)[name] @ direction
            np.testing.assert_allclose(back, weights @ along, rtol=1e-12)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_flow_through_a_singular_shape_raises(tolerance: float) -> None:
    """Steps jump over the flat shape; errors of the integration move the motion beside it."""
    flow = pinred.flow(
        parallelogram(), x0=FOLDED, xdot0={"crank": 1.0}, duration=2.0, rtol=tolerance
    )
    with pytest.raises(IntegrationError, match=r"loops tips of 'four_bar' become dependent"):
        flow()


def test_parameters_equal_a_robot_with_other_numbers(linkage: pinred.System) -> None:
    """Mass and centre of a link in a loop: values, the judge, and derivatives of the flow."""
    model, loops = four_bar()
    k = model.getJointId("coupler")
    inertia = model.inertias[k]
    centre = np.array([0.5, 0.1, 0.0])
    about_centre = pin.Inertia(1.4, centre, 1.4 / inertia.mass * inertia.inertia)
    model.inertias[k] = about_centre
    start = {"x0": {"crank": 1.0}, "xdot0": {"crank": 2.0}, "duration": 0.3}
    other = pinred.simulate(pinred.load(model, loops=loops), **start)  # type: ignore[arg-type]
    values = {
        "coupler.mass": 1.4,
        "coupler.com": centre,
        "coupler.inertia": pinred.load(model, loops=loops)
        .model.inertias[k]
        .inertia[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]],
    }
    scene = pinred.Scene(system=linkage, parameters=values, **start)  # type: ignore[arg-type]
    traj = pinred.simulate(scene)
    np.testing.assert_allclose(traj.x, other.x, atol=1e-10)
    flow = pinred.flow(scene, wrt=["coupler.mass"], method="Gauss(0.01)")

    def end(mass: float) -> Array:
        state = flow(**{"coupler.mass": mass})
        assert isinstance(state, pinred.State)
        return np.concatenate([state.x.ravel(), state.xdot.ravel()])

    h = 1e-3
    slope = (8.0 * (end(1.4 + h) - end(1.4 - h)) - end(1.4 + 2 * h) + end(1.4 - 2 * h)) / (12 * h)
    along = flow.jvp({"coupler.mass": 1.0})[: len(slope)]
    assert np.abs(along).max() > 1e-3
    np.testing.assert_allclose(along, slope, atol=1e-9 * np.abs(along).max())


def test_parameters_that_change_lengths_of_loops_are_refused(linkage: pinred.System) -> None:
    """Another placement would need another assembly."""
    with pytest.raises(
        UnsupportedOperationError, match=r"coupler.placement change the lengths of .* 'tips'"
    ):
        pinred.Scene(system=linkage, seed=1, parameters={"coupler.placement": np.zeros(6)})
