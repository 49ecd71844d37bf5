"""Flows through impacts at joint stops: derivatives against closed forms, differences, full states.

Differences are those of `simulate`, or of full-state code of the tests (hybrid_reference.py), along
one random direction of all inputs, with Richardson extrapolation.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from ball_trees import ball_tree, joined_bodies
from coupled_trees import make_case
from hybrid_reference import HybridReference, stops_of
from slides import bouncing_slide, pair_of_slides, slide_beside
from trees import random_model

import pinred
from pinred import Parameter
from pinred.common.arrays import Array
from pinred.forces import ComputedTorque, Controller, Torque
from pinred.scene.stop import changed_stops
from pinred.simulation import run_with_stops
from pinred.simulation.run_with_stops import StoppedMotion
from pinred.system.state_fields import State

TIGHT: dict[str, Any] = {"rtol": 1e-11, "atol": 1e-12}
PUSH, SWITCH = Parameter("push", 0.7), Parameter("switch", 0.8)


def richardson(value: Callable[[float], Array], h: float) -> Array:
    """Return the derivative at 0 by central differences of three steps."""
    one, two, four = ((value(k * h) - value(-k * h)) / (2.0 * k * h) for k in (1.0, 2.0, 4.0))
    first, second = (4.0 * one - two) / 3.0, (4.0 * two - four) / 3.0
    return np.asarray((16.0 * first - second) / 15.0)


def displacement(system: pinred.System, at: Any, state: Any) -> Array:
    """Return x, ẋ, pose and twist of a state relative to another one, in tangent coordinates."""
    group, space = system.group, system.space
    x = np.linalg.lstsq(space.rate_map(at.x), state.x - at.x, rcond=None)[0]
    pose = group.log(group.compose(group.inverse(at.pose), state.pose))
    return np.concatenate([x, state.xdot - at.xdot, pose, state.xi - at.xi])


def assert_derivatives(
    system: pinred.System, wrt: list[str], *, h: float = 2e-4, tolerance: float = 1e-7, **run: Any
) -> pinred.Trajectory:
    """Assert that jvp agrees with differences of `simulate`, and vjp and jacobian with jvp."""
    run = {**TIGHT, **run}
    flow, traj = pinred.flow(system, wrt=wrt, **run), pinred.simulate(system, **run)
    rng, end = np.random.default_rng(0), flow.scene.end
    own = {name: flow.own(name) for name in flow.inputs}
    along = {name: rng.normal(size=size) for name, size in flow.inputs.items()}
    np.testing.assert_allclose(flow().x, traj.x[-1], rtol=1e-9, atol=1e-10)

    def value(s: float) -> Array:
        moved = {name: own[name] + s * along[name] for name in own}
        states: dict[str, Any] = {n: moved.pop(n) for n in ("x0", "xdot0", "xi0") if n in moved}
        numbers = {name: float(moved.pop(name)[0]) for name in [*moved] if ".stop." in name}
        values = {n: v if v.size > 1 else float(v[0]) for n, v in moved.items()}
        stops = changed_stops(stops_of(traj), numbers)
        options: dict[str, Any] = {**run, **states, "parameters": values, "stops": stops}
        other = pinred.simulate(system, **options)
        assert other.impacts.joint == traj.impacts.joint
        return displacement(system, flow(), other.at(end))

    expected, found = richardson(value, h), flow.jvp(along)
    np.testing.assert_allclose(found, expected, atol=tolerance * np.abs(expected).max())
    J, covector = flow.jacobian(), rng.normal(size=len(found))
    columns = {name: matrix.reshape(len(found), -1) for name, matrix in J.items()}
    summed = sum(columns[name] @ along[name] for name in columns)
    np.testing.assert_allclose(summed, found, atol=1e-10 * np.abs(found).max())
    for name, gradient in flow.vjp(covector).items():
        terms = np.abs(covector) @ np.abs(columns[name])
        np.testing.assert_allclose(
            np.ravel(gradient), covector @ columns[name], atol=1e-10 * (1.0 + terms.max())
        )
    return traj


def test_bounce_of_a_slide_has_the_closed_form() -> None:
    """After a bounce, x = e (|v| T − x0) and v = −e v0."""
    e, T = 0.6, 1.0
    flow = pinred.flow(
        bouncing_slide(), x0=[0.3], xdot0=[-1.0], xi0=[0.2], duration=T,
        stops={"slide": (0.0, 9.0, e)}, of=["x", "xdot"],
        wrt=["x0", "xdot0", "slide.stop.lower", "slide.stop.restitution"],
    )  # fmt: skip
    state, J = flow(), flow.jacobian()
    np.testing.assert_allclose(J["slide.stop.lower"], [1.0 + e, 0.0], atol=1e-12)
    np.testing.assert_allclose(J["slide.stop.restitution"], [T - 0.3, 1.0], atol=1e-12)
    moved = flow(**{"slide.stop.lower": 0.1, "slide.stop.restitution": 0.7})
    np.testing.assert_allclose([*moved.x, *moved.xdot], [0.1 + 0.7 * (T - 0.2), 0.7], rtol=1e-12)
    np.testing.assert_allclose([*state.x, *state.xdot], [e * (T - 0.3), e], rtol=1e-12)
    np.testing.assert_allclose(J["x0"], [[-e], [0.0]], atol=1e-12)
    np.testing.assert_allclose(J["xdot0"], [[-e * T], [-e]], atol=1e-12)


@pytest.mark.by_hand("3.0-True")
@pytest.mark.parametrize(("T", "rests"), [(3.0, True), (2.0, False)])
def test_accumulating_impacts_have_the_closed_form(T: float, rests: bool) -> None:
    """A pressed slide bounces to rest; the impulses on it move the free slide beside it.

    The ratio of both inverse masses is 1/3, so x2 − x1/3 moves uniformly.
    """
    flow = pinred.flow(
        pair_of_slides(), x0=[0.3, 0.1], xdot0=[-0.5, 0.2], xi0=[0.1], duration=T,
        stops={"left": (0.0, 9.0, 0.5)}, forces=[Torque(lambda *_: {"left": -PUSH})],
        wrt=["x0", "xdot0", "push", "left.stop.restitution"], of=["x", "xdot"], **TIGHT,
    )  # fmt: skip
    traj = pinred.simulate(flow.scene)
    assert (len(traj.impacts) == 20) is rests
    assert (len(traj.motion.modes) == 2) is rests
    slopes = flow.jacobian()
    J = np.hstack([matrix.reshape(4, -1) for matrix in slopes.values()])
    expected = [[-1 / 3, 1.0, -T / 3, T, 0.0, 0.0], [0.0, 0.0, -1 / 3, 1.0, 0.0, 0.0]]
    np.testing.assert_allclose(J[[1, 3]] - J[[0, 2]] / 3, expected, atol=1e-8)
    if rests:
        np.testing.assert_array_equal(J[[0, 2]], 0.0)


def time_force(t: Any, *_: Any) -> Any:
    """Return a torque that depends on time, on the first joint."""
    return [-PUSH * ca.cos(3.0 * t)]


def switched_force(t: Any, *_: Any) -> Any:
    """Return a torque that switches at a time which is a parameter."""
    return [ca.if_else(t < SWITCH, -PUSH, PUSH)]


def force_switched_at_rest(t: Any, *_: Any) -> Any:
    """Return a torque that switches while a joint rests, and then grows."""
    return [ca.if_else(t < SWITCH, -PUSH, -2.0 * PUSH) + 2.0 * t]


# A switch at rest contains a switch in motion.
# A force that switches while a joint rests depends on time, too.
@pytest.mark.by_hand("switched_force-inputs1-0.0", "time_force-inputs0-0.5")
@pytest.mark.parametrize(
    ("force", "inputs", "restitution"),
    [
        (time_force, ["push"], 0.5),
        (switched_force, ["push", "switch"], 0.0),
        (force_switched_at_rest, ["push", "switch"], 0.0),
        *(
            pytest.param(force, inputs, restitution, marks=pytest.mark.by_hand)
            for force, inputs, restitution in (
                (time_force, ["push"], 0.0),
                (switched_force, ["push", "switch"], 0.5),
                (force_switched_at_rest, ["push", "switch"], 0.5),
            )
        ),
    ],
)
def test_slide_with_forces_of_time_agrees_with_differences(
    force: Any, inputs: list[str], restitution: float
) -> None:
    """A joint bounces, or rests until a force pulls it away, at a time that depends on inputs."""
    traj = assert_derivatives(
        bouncing_slide(), ["x0", "xdot0", "xi0", "slide.mass", "slide.stop.lower", *inputs],
        x0=[0.05], xdot0=[-0.3], xi0=[0.2], duration=1.2, forces=[Torque(force)],
        stops={"slide": (0.0, 1.0, restitution)},
    )  # fmt: skip
    assert len(traj.impacts) >= 1
    if not restitution:
        assert [label for _, label in traj.motion.modes[1:]] == [
            "slide at its lower stop", "no joint at rest",
        ]  # fmt: skip


def cat_run() -> dict[str, Any]:
    """Return options of a cat with two joints that rest at stops, alone and together."""
    forces = [
        Torque(
            lambda t, *_: {
                "bend": -PUSH * ca.cos(4.0 * t),
                "sway": 0.5 * PUSH * ca.sin(3.0 * t + 1.0),
            }
        )
    ]
    stops = {"bend": (-0.3, 0.3), "sway": (-0.3, 0.3)}
    return {"xdot0": [2.0, -1.0, 0.5], "duration": 0.8, "stops": stops, "forces": forces}


# `test_rest_and_release_agree_with_full_state_differences` differentiates the same motion.
@pytest.mark.by_hand
def test_joints_at_rest_together_agree_with_differences() -> None:
    """An impact presses a joint at rest against its stop, or moves it away."""
    cat = pinred.load("falling_cat")
    traj = assert_derivatives(
        cat, ["x0", "xdot0", "xi0", "push", "bend.stop.upper", "sway.stop.lower"],
        xi0=np.full(cat.r, 0.1), **cat_run(),
    )  # fmt: skip
    labels = [label for _, label in traj.motion.modes]
    assert any("bend" in label and "sway" in label for label in labels)
    assert len(traj.impacts) > len(traj.impacts.times)  # a joint at rest gets an impulse, too


def tree_of(seed: int) -> tuple[pinred.System, dict[str, Any]]:
    """Return a random tree, with followers for odd seeds, and a run with a few impacts."""
    rng = np.random.default_rng(1000 + seed)
    group = ("R", "SO2", "SE2", "SO3", "SE3")[seed % 5]
    joints = int(rng.integers(2, 5))
    if seed % 2:
        system = make_case(group, joints + 1, seed).system
        chosen = [joint.name for joint in system.space.joints]
    else:
        system = pinred.load(random_model(group, joints, seed))
        chosen = [joint.name for joint in system.tree.joints]
    e = float(rng.choice([0.0, 0.5, 0.9, 1.0]))
    values = dict(zip(system.tree.x_names, system.joint_values(np.zeros(system.m)), strict=True))
    stops = {}
    for name in chosen:
        lower, upper = values[name] + rng.uniform(0.2, 0.5, 2) * [-1.0, 1.0]
        stops[name] = pinred.Stop(lower, upper, e)
    run: dict[str, Any] = {
        "x0": np.zeros(system.m), "xdot0": rng.normal(size=system.m),
        "xi0": 0.3 * rng.normal(size=system.r), "stops": stops,
    }  # fmt: skip
    times = pinred.simulate(system, duration=3.0, **run).impacts.times
    if len(times) < 5:
        return system, {**run, "duration": 3.0}
    k = 2 + int(np.diff(times[2:6]).argmax())  # the motion ends far from impacts
    return system, {**run, "duration": 0.5 * float(times[k] + times[k + 1])}


def assert_tree(seed: int) -> None:
    """Assert that the derivatives of a random tree agree with differences."""
    system, run = tree_of(seed)
    body = list(system.sorted_model.names)[2]
    kinds = ["lower", "upper"]
    if all(0.0 < stop.restitution < 1.0 for stop in run["stops"].values()):
        kinds.append("restitution")
    numbers = [f"{joint}.stop.{kind}" for joint in run["stops"] for kind in kinds]
    inputs = ["x0", "xdot0", "xi0", f"{body}.body.mass", *numbers]
    assert_derivatives(system, inputs, h=2e-5, tolerance=1e-6, **run)


def test_random_tree_agrees_with_differences() -> None:
    """A tree on SE(2) with followers, which comes to rest."""
    assert_tree(7)


@pytest.mark.by_hand
@pytest.mark.parametrize("seed", [k for k in range(40) if k != 7])
def test_many_random_trees_agree_with_differences(seed: int) -> None:
    """Random trees on all groups."""
    assert_tree(seed)


# The random tree of the default suite has stops at followers, too.
@pytest.mark.by_hand
def test_stop_of_a_follower_agrees_with_differences() -> None:
    """Its position, divided by the ratio, bounds the leader."""
    system = make_case("SE2", 4, 2).system
    coupling = system.couplings[0]
    ((leader, ratio),) = coupling.ratios.items()
    rates = np.random.default_rng(0).normal(size=system.m)
    start = pinred.simulate(system, xdot0=rates, duration=0.1)
    values = dict(zip(system.tree.x_names, system.joint_values(start.x[0]), strict=True))
    name, at = coupling.follower, values[coupling.follower]
    assert abs(ratio) not in (0.0, 1.0)
    assert leader != name
    traj = assert_derivatives(
        system,
        ["x0", "xdot0", *(f"{name}.stop.{kind}" for kind in ("lower", "upper", "restitution"))],
        x0=np.zeros(system.m), xdot0=rates, duration=0.7, stops={name: (at - 0.1, at + 0.1, 0.5)},
    )  # fmt: skip
    assert len(traj.impacts) == 2


def test_tree_with_balls_agrees_with_differences() -> None:
    """The stops of hinges act beside balls, whose attitudes are integrated."""
    system = ball_tree(2, 3, "SE2", balls=0.0)
    hinge = next(joint for joint in system.space.joints if not joint.kind.is_ball)
    rates = np.random.default_rng(1).normal(size=system.m)
    traj = assert_derivatives(
        system, ["xdot0", "xi0"], xdot0=rates, xi0=np.full(3, 0.2), duration=1.0,
        stops={hinge.name: (-0.15, 0.15, 0.5)},
    )  # fmt: skip
    assert len(traj.impacts) >= 1


# Impulses do not contain gravity; its derivatives are tested without stops.
@pytest.mark.by_hand
def test_gravity_at_a_pivot_agrees_with_differences() -> None:
    """A chain on a pivot under gravity, whose strength is an input."""
    model = random_model("SO3", 2, 5)
    model.gravity.linear = -9.81 * np.eye(3)[2]
    system = pinred.load(model)
    traj = assert_derivatives(
        system, ["x0", "xdot0", "xi0", "gravity.strength"], duration=0.5,
        xdot0=np.random.default_rng(2).normal(size=system.m),
        parameters={"gravity.strength": 9.81},
        stops=dict.fromkeys(system.shape_names, pinred.Stop(-0.2, 0.2, 0.5)),
    )  # fmt: skip
    assert len(traj.impacts) >= 3


# Every run has the random tree above, and full states in test_joint_stops.
@pytest.mark.by_hand
def test_rest_and_release_agree_with_full_state_differences() -> None:
    """Differences of pin.aba, SciPy and impulses of CRBA, with a torque that depends on time."""
    cat = pinred.load("falling_cat")
    run = {**cat_run(), **TIGHT}
    flow = pinred.flow(cat, wrt=["x0", "xdot0", "xi0", "push"], **run)
    traj = pinred.simulate(flow.scene)
    assert len(traj.motion.modes) > 2
    rng = np.random.default_rng(3)
    along = {name: rng.normal(size=size) for name, size in flow.inputs.items()}
    bend, sway = (cat.model.joints[cat.model.getJointId(name)].idx_v for name in ("bend", "sway"))

    def value(s: float) -> Array:
        start = {n: flow.own(n) + s * along[n] for n in ("x0", "xdot0", "xi0")}
        push = 0.7 + s * along["push"][0]

        def torque(t: float, *_: Array) -> Array:
            tau = np.zeros(cat.model.nv)
            tau[bend], tau[sway] = -push * np.cos(4.0 * t), 0.5 * push * np.sin(3.0 * t + 1.0)
            return tau

        first = pinred.simulate(cat, **{**run, **start, "duration": 1e-9})
        reference = HybridReference(cat, stops_of(traj), torque, 1e-13)
        shape = dict(zip(cat.tree.x_names, cat.joint_values(start["x0"]), strict=True))
        motion = reference.run(first.q[0], first.v[0], shape, np.array([flow.scene.end]))
        assert len(motion.modes) == len(traj.motion.modes)
        return np.asarray(motion.v[-1])

    expected = richardson(value, 2e-4)
    rows = {name: flow.jvp(along)[place] for name, place in flow.outputs.items()}
    found = np.concatenate([rows["xi"], rows["xdot"]])
    np.testing.assert_allclose(found, cat.sort_v(expected), atol=1e-6 * np.abs(expected).max())


def pressing_force(*_: Any) -> Any:
    """Return a torque that presses the first joint against its lower stop."""
    return [-PUSH]


def bounce(**options: Any) -> pinred.Flow:
    """Return the flow of a bouncing slide that is pressed against its stop."""
    run: dict[str, Any] = {
        "x0": [0.3], "xdot0": [-1.0], "xi0": [0.2], "duration": 1.0, "wrt": ["x0", "xdot0", "push"],
        "stops": {"slide": (0.0, 9.0, 0.5)}, "forces": [Torque(pressing_force)],
    }  # fmt: skip
    return pinred.flow(bouncing_slide(), **{**run, **options})


def test_states_at_times_and_copies_agree_with_simulate() -> None:
    """A flow over times has the bits of `simulate`, and derivatives before and after impacts."""
    times = [0.0, 0.2, 0.9, 1.9]
    flow = bounce(times=times, duration=None)
    traj = pinred.simulate(flow.scene)
    assert len(traj.impacts) == 2
    for states in (flow(), pickle.loads(pickle.dumps(flow))()):
        np.testing.assert_array_equal(states.x, traj.x)
        np.testing.assert_array_equal(states.xdot, traj.xdot)
    J = flow.jacobian(x0=[0.31], push=0.72)
    for k, t in enumerate(times[1:], 1):
        one = bounce(duration=t).jacobian(x0=[0.31], push=0.72)
        for name, rows in one.items():
            np.testing.assert_allclose(J[name][k], rows, atol=1e-7)


def test_moved_stop_has_the_derivatives_of_its_own_scene() -> None:
    """A joint rests at the stop that the call states, and its mode is that of the scene."""
    cat, run = pinred.load("falling_cat"), cat_run()
    flows = [
        pinred.flow(cat, **{**run, **TIGHT, "stops": stops, "wrt": ["x0", "bend.stop.lower"]})
        for stops in (run["stops"], {**run["stops"], "bend": (-0.28, 0.3)})
    ]
    flows[0].jacobian()
    slopes, expected = flows[0].jacobian(**{"bend.stop.lower": -0.28}), flows[1].jacobian()
    assert len(pinred.simulate(flows[1].scene).motion.modes) > 2
    for name, matrix in expected.items():
        np.testing.assert_allclose(slopes[name], matrix, atol=1e-8 * np.abs(matrix).max())
    assert np.abs(flows[0].jacobian()["x0"] - expected["x0"]).max() > 1e-2


def test_adapters_agree_with_the_flow() -> None:
    """Plain vectors and CasADi have the values and derivatives of the flow."""
    flow = bounce(of=["x", "xdot"])
    columns, at = flow.columns(), [np.array([0.31]), np.array([-1.1]), np.array([0.75])]
    inputs = {"x0": at[0], "xdot0": at[1], "push": 0.75}
    state, J = flow(**inputs), flow.jacobian(**inputs)
    value, expected = np.concatenate([state.x, state.xdot]), [J[n].reshape(2, -1) for n in J]
    np.testing.assert_array_equal(columns.value(*at), value)
    np.testing.assert_array_equal(
        columns.values(*(np.array([a, a]) for a in at)), np.array([value, value])
    )
    for found, matrix in zip(columns.jacobian(*at), expected, strict=True):
        np.testing.assert_allclose(found, matrix, rtol=1e-12, atol=1e-13)
    for found, matrix in zip(columns.vjp(at, [1.0, 2.0]), expected, strict=True):
        np.testing.assert_allclose(found, [1.0, 2.0] @ matrix, rtol=1e-10, atol=1e-12)
    callback = flow.casadi()
    np.testing.assert_array_equal(callback(*at).full().ravel(), value)
    symbols = [ca.SX.sym("a"), ca.SX.sym("b"), ca.SX.sym("c")]
    arguments = [ca.MX.sym(str(symbol)) for symbol in symbols]
    gradient = ca.Function("g", arguments, [ca.jacobian(callback(*arguments), arguments[0])])
    np.testing.assert_allclose(gradient(*at).full(), expected[0], rtol=1e-10, atol=1e-12)


# Both adapters are tested with other flows, and this flow with the adapter of SciPy.
@pytest.mark.by_hand
@pytest.mark.slow
def test_jax_and_torch_agree_with_the_flow() -> None:
    """Gradients by JAX and PyTorch are those of the flow."""
    torch, jax = pytest.importorskip("torch"), pytest.importorskip("jax")
    flow = bounce(of=["x", "xdot"])
    at = [np.array([0.31]), np.array([-1.1]), np.array([0.75])]
    expected = flow.vjp([0.0, 1.0], x0=at[0], xdot0=at[1], push=0.75)
    tensors = [torch.tensor(a, requires_grad=True) for a in at]
    flow.torch()(*tensors)[1].backward()
    with jax.enable_x64(True):
        function = flow.jax()
        gradient = jax.grad(lambda *a: function(*a)[1], argnums=(0, 1, 2))(*at)
    for name, tensor, found in zip(expected, tensors, gradient, strict=True):
        np.testing.assert_allclose(
            tensor.grad.numpy().ravel(), np.ravel(expected[name]), rtol=1e-10
        )
        np.testing.assert_allclose(np.ravel(found), np.ravel(expected[name]), rtol=1e-10)


def pair(**options: Any) -> pinred.Flow:
    """Return the flow of two slides that move to their stops."""
    run: dict[str, Any] = {
        "x0": [0.0, 0.0], "xdot0": [1.0, -1.0], "xi0": [0.0], "duration": 1.0, "wrt": ["xdot0"],
    }  # fmt: skip
    return pinred.flow(pair_of_slides(), **{**run, **options})


def arc(position: float, restitution: float = 0.5) -> pinred.Flow:
    """Return the flow of a slide at x = t − t²/2, with a stop near the turning point 0.5."""
    return pinred.flow(
        bouncing_slide(), x0=[0.0], xdot0=[1.0], xi0=[0.0], duration=1.5, rtol=1e-9, atol=1e-10,
        forces=[Torque(lambda *_: [-0.75])], stops={"slide": (-1.0, position, restitution)},
        wrt=["xdot0"],
    )  # fmt: skip


REFUSED: dict[str, tuple[Callable[[], pinred.Flow], str]] = {
    "two at once": (
        lambda: pair(stops={"left": (-1.0, 0.5, 0.5), "right": (-0.5, 1.0, 0.5)}),
        "left, right reach their stops at one time, t = 0.5 s",
    ),
    "one just after the other": (
        lambda: pair(stops={"left": (-1.0, 0.5, 0.5), "right": (-0.5 - 1.5e-10, 1.0, 0.5)}),
        "reach their stops at one time",
    ),
    "one turned away by the other": (
        lambda: pair(
            xdot0=[1.0, 0.1], stops={"left": (-1.0, 0.5, 0.5), "right": (-1.0, 0.05 + 5e-11)}
        ),
        "left, right reach their stops at one time",
    ),
    "one by the other": (
        lambda: pair(xdot0=[1.0, 0.0], stops={"left": (-1.0, 0.5, 0.5), "right": (-5e-11, 1.0)}),
        "reach their stops at one time",
    ),
    "grazing": (lambda: arc(0.5 - 5e-10), "'slide' grazes its upper stop at t = 0.99"),
    "near miss": (lambda: arc(0.5 + 5e-10), "'slide' grazes its upper stop at t = 1 s"),
    "report at an impact": (
        lambda: bounce(forces=(), wrt=["x0"], duration=None, times=[0.1, 0.3, 0.5]),
        "gives the state at t = 0.3 s, the time of an impact of slide",
    ),
    "end at an impact": (
        lambda: bounce(forces=(), wrt=["x0"], duration=0.3 - 1e-12),
        "ends as joint 'slide' reaches its lower stop",
    ),
    "start at a stop": (lambda: bounce(x0=[0.0], wrt=["x0"]), "with respect to x0 are one-sided"),
    "stop moves at the start": (
        lambda: bounce(x0=[0.0], wrt=["slide.stop.lower"]),
        "with respect to slide.stop.lower are one-sided",
    ),
    "no restitution": (
        lambda: bounce(stops={"slide": (0.0, 9.0)}, wrt=["slide.stop.restitution"]),
        "with respect to slide.stop.restitution is one-sided at zero",
    ),
    "rest at the start": (
        lambda: bounce(x0=[0.0], xdot0=[0.0], wrt=["xdot0"]),
        "with respect to xdot0 are one-sided",
    ),
    "switch at an impact": (
        lambda: bounce(wrt=["x0"], forces=[Torque(lambda t, *_: [ca.if_else(t < 0.3, 0.0, 1.0)])]),
        "a force switches at t = 0.3 s, the time of an impact",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_derivatives_that_are_one_sided_are_refused_by_name(case: str) -> None:
    """States exist, but jacobian and vjp name the joint and the time."""
    make, message = REFUSED[case]
    flow = make()
    flow()
    with pytest.raises(pinred.InputError, match=message):
        flow.jacobian()
    shape = (len(flow.t),) if flow.over_times else ()
    covector = np.ones((*shape, sum(p.stop - p.start for p in flow.outputs.values())))
    with pytest.raises(pinred.InputError, match=message):
        flow.vjp(covector)


def beside(second: str, **options: Any) -> pinred.Flow:
    """Return the flow of a slide that bounces beside a joint that is pressed to its stop."""
    run: dict[str, Any] = {
        "x0": [0.3, 0.0], "xdot0": [-1.0, 0.0], "xi0": [0.1], "duration": 0.8,
        "forces": [Torque(lambda *_: {"beside": -PUSH})],
        "stops": {"left": (0.0, 9.0, 0.5), "beside": (0.0, 9.0)},
    }  # fmt: skip
    return pinred.flow(slide_beside(second), **{**run, **options})


# The refused impact, below, has an arm.
@pytest.mark.by_hand("arm")
@pytest.mark.parametrize("second", ["slide", "arm"])
def test_impact_that_misses_a_joint_at_rest_has_a_derivative(second: str) -> None:
    """The joint at rest stays there, whatever the impulse is."""
    flow = beside(second, wrt=["xi0", "push", "left.stop.lower"], of=["x", "xdot"])
    J, e = flow.jacobian(), 0.5
    assert len(pinred.simulate(flow.scene).motion.modes) == 1
    np.testing.assert_allclose(J["left.stop.lower"], [1.0 + e, 0.0, 0.0, 0.0], atol=1e-10)
    np.testing.assert_allclose(J["push"], 0.0, atol=1e-12)


def test_impact_that_would_press_or_move_a_joint_at_rest_is_refused() -> None:
    """On one side of the line of the impulse it presses the arm, on the other it moves the arm."""
    inputs: dict[str, Any] = {"wrt": ["beside.stop.lower"], "of": ["x"], "x0": [0.3, 0.02]}
    slopes = beside("slide", **inputs).jacobian()["beside.stop.lower"]
    np.testing.assert_allclose(slopes, [0.0, 1.0], atol=1e-10)
    flow = beside("arm", **inputs)
    assert flow().x[1] == 0.0
    with pytest.raises(pinred.InputError, match="neither presses joint 'beside' against its stop"):
        flow.jacobian()


def test_joint_that_comes_to_rest_without_impulse_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A rate that counts as zero at the stop is that of a joint that grazes it."""
    monkeypatch.setattr(run_with_stops, "_AT_REST", 2.0)
    flow = bounce(stops={"slide": (0.0, 9.0)}, wrt=["x0"])
    assert len(pinred.simulate(flow.scene).impacts) == 0
    with pytest.raises(pinred.InputError, match=r"'slide' grazes its lower stop at t = 0\.26"):
        flow.jacobian()


def test_derivatives_near_refused_motions_exist() -> None:
    """Bounds of refusals are those of the tolerance: ten times as far away, derivatives exist."""
    for position in (0.5 - 5e-9, 0.5 + 5e-9):
        assert np.isfinite(arc(position).jacobian()["xdot0"]).all()
    apart = pair(stops={"left": (-1.0, 0.5, 0.5), "right": (-0.5 - 1.5e-9, 1.0, 0.5)})
    assert np.isfinite(apart.jacobian()["xdot0"]).all()
    kicked = pair(xdot0=[1.0, 0.0], stops={"left": (-1.0, 0.5, 0.5), "right": (-1e-8, 1.0)})
    assert np.isfinite(kicked.jacobian()["xdot0"]).all()
    # An impact at the start has a fixed time.
    flow = bounce(x0=[0.0], wrt=["xdot0", "push"], duration=0.5, of=["x", "xdot"])
    assert len(pinred.simulate(flow.scene).impacts) == 1
    J, e, m = flow.jacobian(), 0.5, 0.75
    np.testing.assert_allclose(J["xdot0"].ravel(), [-0.5 * e, -e], atol=1e-10)
    np.testing.assert_allclose(J["push"], [-0.125 / m, -0.5 / m], atol=1e-10)


def test_single_steps_and_lanes_are_refused() -> None:
    """A single step does not look for impacts."""
    flow = bounce()
    with pytest.raises(pinred.InputError, match="stops: a single step"):
        flow.step(0.01).linear(flow.scene.start)
    with pytest.raises(pinred.InputError, match="no SIMD lanes"):
        flow.propagator.outputs_of_many(np.zeros((2, 1)), np.zeros((2, 1)), None)


@pytest.mark.parametrize(
    ("force", "message"),
    [
        (ComputedTorque({"bend": 0.1, "sway": 0.0, "twist": 0.0}, 4.0, 1.0), "ComputedTorque"),
        (Controller(lambda _: {"bend": 0.1}, period=0.1, joints=("bend",)), "Controller"),
    ],
    ids=["computed torque", "controller"],
)
def test_laws_that_depend_on_rest_are_refused(force: Any, message: str) -> None:
    """Torques of these laws change when a joint comes to rest."""
    with pytest.raises(pinred.InputError, match=f"flows with stops take no {message}"):
        pinred.flow(
            pinred.load("falling_cat"), xdot0=[1.0, 0.0, 0.0], duration=0.5, forces=[force],
            stops={"bend": (-0.1, 0.1)}, wrt=["xdot0"],
        )  # fmt: skip


def test_stops_of_balls_are_refused() -> None:
    """Flows know no saltation matrix of a ball."""
    with pytest.raises(pinred.InputError, match="stops of hinges and slides, got one of ball"):
        pinred.flow(
            joined_bodies(), xdot0=[1.0, 0.0, 0.0], momentum=0, duration=0.5,
            stops={"joint": pinred.BallStop(angle=0.3, restitution=0.5)}, wrt=["xdot0"],
        )  # fmt: skip


@pytest.mark.by_hand
@pytest.mark.parametrize(
    ("name", "duration", "width", "restitution"),
    [
        ("falling_cat", 2.0, 0.5, 0.6),
        ("solo12", 0.6, 0.25, 0.3),
        ("satellite_two_arms", 3.0, 0.3, 0.9),
    ],
)
@pytest.mark.filterwarnings("ignore::pinred.common.errors.SceneWarning")
def test_motion_with_impacts_costs_little_more_than_its_pieces(
    name: str, duration: float, width: float, restitution: float
) -> None:
    """CPU times of interleaved runs; durations differ, so that no run repeats another one."""
    system, rng = pinred.load(name), np.random.default_rng(0)
    rates = np.array([3.0, -2.0, 1.0]) if name == "falling_cat" else 2.0 * rng.normal(size=system.m)
    stops = dict.fromkeys(system.shape_names, pinred.Stop(-width, width, restitution))
    start: dict[str, Any] = {
        "x0": np.zeros(system.m), "xdot0": rates,
        "xi0": 0.2 * rng.normal(size=system.r),
    }  # fmt: skip
    traj = pinred.simulate(system, duration=duration, stops=stops, **start)
    assert isinstance(traj.motion, StoppedMotion)
    times, pieces = [*traj.motion.impacts.times, duration], []
    for phase, end in zip(traj.motion.phases, times, strict=True):
        flow = phase.flow
        at = flow.states(np.array([phase.start]), flow.y0[None], flow.parameters)
        assert isinstance(at, State)
        state = {"x0": at.x[0], "xdot0": at.xdot[0], "xi0": at.xi[0], "pose0": at.pose[0]}
        pieces.append((state, end - phase.start))
    # Other processes only add time, to either side, so the smallest of several ratios decides.
    ratios = []
    for first in (1, 16, 31, 46):
        costs = np.zeros((15, 2))
        for k, row in enumerate(costs):
            factor, marks = 1.0 + 1e-7 * (first + k), [time.process_time()]
            pinred.simulate(system, duration=factor * duration, stops=stops, **start)
            marks.append(time.process_time())
            for state, length in pieces:
                pinred.simulate(system, duration=factor * length, **state)
            row[:] = np.diff([*marks, time.process_time()])
        ratios.append(float(np.median(costs[:, 0] / costs[:, 1])))
        if ratios[-1] <= 1.4:
            return
    raise AssertionError(f"the ratios of the times are {ratios}")  # 1.05 to 1.36
