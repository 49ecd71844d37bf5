"""Flows of robots with ball joints: derivatives along the frame, adapters, steps, refusals."""

from __future__ import annotations

from typing import Any

import aba
import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree, joined_bodies

import pinred
from pinred import Parameter
from pinred.common.arrays import Array
from pinred.forces import Torque
from pinred.lie.rotations import quaternion_exp
from pinred.signals import Fourier, Hold
from pinred.simulation.flow_map.flow import Flow

ROWS: Any = ["x", "xdot", "pose", "xi", "body_momentum", "spatial_momentum", "energy"]
INPUTS = ["x0", "xdot0", "pose0", "xi0"]
MOTION: dict[str, Any] = {
    "x0": {"joint": (0.5, 0.2, 0.1)},
    "xdot0": {"joint": (1.0, -0.5, 0.7)},
    "xi0": np.array([0.1, 0.0, 0.0, 0.3, 0.8, -0.2]),
    "times": [0.2, 0.6],
    "rtol": 1e-12,
    "atol": 1e-13,
}
_STEP = 1e-4  # of central differences


@pytest.fixture(scope="module")
def bodies() -> pinred.System:
    """Two bodies, joined by a ball."""
    return joined_bodies()


def moved(flow: Flow, name: str, direction: Array) -> Array:
    """Return an input of a scene, moved along a tangent direction."""
    system, value = flow.system, flow.own(name)
    if name == "x0":
        return system.space.integrate(value, direction)
    if name == "pose0":
        return np.asarray(system.group.compose(value, system.group.exp(direction)))
    return value + direction


def tangent(system: pinred.System, row: str, low: Any, high: Any) -> Array:
    """Return the tangent from one state to another, in rows of a flow, (T, rows)."""
    if row == "x":
        return system.space.difference(low.x, high.x)
    if row == "pose":
        return np.asarray(system.group.log(system.group.compose(
            system.group.inverse(low.pose), high.pose
        )))  # fmt: skip
    change = getattr(high, row) - getattr(low, row)
    return np.asarray(change.reshape(np.size(low.t), -1))


# Differences of ABA judge a tree with two balls, and batches and adapters all columns.
@pytest.mark.by_hand
@pytest.mark.parametrize("method", ["DOP853", "Gauss(0.02, 8)"])
@pytest.mark.sampled
def test_jacobian_with_ball_equals_differences_of_simulations(
    bodies: pinred.System, method: str
) -> None:
    """All rows by all inputs, with quaternions and with lifted balls; vjp is the transpose."""
    flow = pinred.flow(bodies, **MOTION, method=method, wrt=INPUTS, of=ROWS)
    assert flow.inputs == {"x0": 3, "xdot0": 3, "pose0": 6, "xi0": 6}
    jacobian = flow.jacobian()
    rng = np.random.default_rng(0)
    for name, size in flow.inputs.items():
        v = rng.normal(size=size)
        sides: list[Any] = []
        for h in (-_STEP, _STEP):
            options = MOTION | {name: moved(flow, name, h * v), "rtol": 1e-13, "atol": 1e-14}
            sides.append(pinred.simulate(bodies, **options).states)
        along = flow.jvp({name: v})
        np.testing.assert_allclose(along, jacobian[name] @ v, rtol=0.0, atol=1e-13)
        for row in ROWS:
            expected = tangent(bodies, row, *sides) / (2.0 * _STEP)
            error = np.abs(along[:, flow.outputs[row]] - expected).max()
            assert error <= 1e-7 * np.abs(along).max(), (name, row)
    covector = rng.normal(size=jacobian["x0"].shape[:-1])
    for name, found in flow.vjp(covector).items():
        scale = np.linalg.norm(covector) * np.linalg.norm(jacobian[name])
        expected = np.tensordot(covector, jacobian[name], 2)
        assert np.abs(found - expected).max() <= 1e-13 * scale


# Every run has the balls of test_many_derivatives.
@pytest.mark.by_hand
def test_jvp_of_random_tree_equals_differences_of_aba() -> None:
    """SciPy integrates ABA of a tree with two balls, a hinge and a slide."""
    system = ball_tree(11, 4)
    flow = pinred.flow(system, seed=1, duration=0.6, method="DOP853", rtol=1e-12, wrt=INPUTS)
    start, rng = flow.scene.start, np.random.default_rng(2)
    along = {name: rng.normal(size=size) for name, size in flow.inputs.items()}
    model, ends = system.sorted_model, []
    for h in (-_STEP, _STEP):
        at: Any = {name: moved(flow, name, h * v) for name, v in along.items()}
        q0, v0 = system.sorted_q(at["pose0"], at["x0"]), system.sorted_v(at["xi0"], at["xdot0"])
        q, v = aba.integrate(model, q0, v0, np.array([0.0, 0.6]), rtol=1e-13)
        ends.append((q[-1], v[-1]))
    (q_low, v_low), (q_high, v_high) = ends
    found, r = flow.jvp(along), system.r
    turned = np.concatenate([found[flow.outputs["pose"]], found[flow.outputs["x"]]])
    expected = pin.difference(model, q_low, q_high) / (2.0 * _STEP)
    np.testing.assert_array_equal(start.x, flow.own("x0"))
    assert np.abs(turned - expected).max() <= 1e-6 * np.abs(expected).max()
    rates = np.concatenate([found[flow.outputs["xi"]], found[flow.outputs["xdot"]]])
    expected = (v_high - v_low) / (2.0 * _STEP)
    assert r + system.m == len(expected)
    assert np.abs(rates - expected).max() <= 1e-6 * np.abs(expected).max()


def test_values_of_flow_with_ball_equal_simulation_for_all_forms(bodies: pinred.System) -> None:
    """Rotation vectors and quaternions of any length and sign state the same shape."""
    flow = pinred.flow(bodies, **MOTION, method="DOP853", wrt=["x0"])
    state: Any = flow()
    np.testing.assert_array_equal(state.x, pinred.simulate(flow.scene).x)
    w = np.array([0.1, 0.4, -0.3])
    q = quaternion_exp(w)
    expected: Any = pinred.simulate(bodies, **MOTION | {"x0": q}, method="DOP853").states
    forms: list[Any] = [q, -3.0 * q, {"joint": w}, {"joint": 2.0 * q}]
    for form in forms:
        moved_state: Any = flow(x0=form)
        np.testing.assert_allclose(np.abs(moved_state.x), np.abs(expected.x), atol=1e-14)
        np.testing.assert_allclose(moved_state.xdot, expected.xdot, atol=1e-13)
    with pytest.raises(pinred.InputError, match="quaternion of ball joint 'joint'"):
        flow(x0=np.zeros(4))
    with pytest.raises(pinred.InputError, match="must be finite"):
        flow(x0=np.full(4, np.nan))
    with pytest.raises(pinred.ShapeError, match="direction of x0 must have shape"):
        flow.jvp({"x0": np.zeros(4)})


def test_adapters_differentiate_quaternion_entries(bodies: pinred.System) -> None:
    """Jacobians of plain vectors equal differences, at a quaternion that is not of length one."""
    flow = pinred.flow(bodies, **MOTION, method="DOP853", wrt=["xdot0", "x0", "xi0"])
    columns = flow.columns()
    assert columns.sizes == (3, 4, 6)
    values = [columns.starts[0], 1.7 * columns.starts[1], columns.starts[2]]
    jacobian, h = columns.jacobian(*values), 1e-4
    for k, slopes in enumerate(jacobian):
        for j in range(slopes.shape[1]):
            shift = h * np.eye(slopes.shape[1])[j]
            low, high = (
                columns.value(*[v + s * shift if i == k else v for i, v in enumerate(values)])
                for s in (-1, 1)
            )
            error = np.abs(slopes[:, j] - (high - low) / (2.0 * h)).max()
            assert error <= 1e-6 * max(1.0, np.abs(slopes).max()), (k, j)
    radial = jacobian[1] @ values[1]
    assert np.abs(radial).max() <= 1e-13 * np.abs(jacobian[1]).max()
    covector = np.random.default_rng(0).normal(size=columns.size)
    for found, slopes in zip(columns.vjp(values, covector), jacobian, strict=True):
        np.testing.assert_allclose(found, covector @ slopes, rtol=0.0, atol=1e-12)
    many = columns.values(*(np.stack([v, v]) for v in values))
    np.testing.assert_allclose(many[1], columns.value(*values), rtol=0.0, atol=1e-12)
    function = flow.casadi()
    np.testing.assert_array_equal(function(*values).full()[:, 0], columns.value(*values))
    by_casadi = function.jacobian()(*values, columns.value(*values))
    np.testing.assert_array_equal(by_casadi[1].full(), jacobian[1])


@pytest.mark.by_hand
def test_jax_and_torch_differentiate_quaternion_entries(bodies: pinred.System) -> None:
    """Both directions of derivatives equal those between vectors, also in a batch."""
    jax, torch = (pytest.importorskip(name) for name in ("jax", "torch"))
    flow = pinred.flow(bodies, **MOTION, method="DOP853", wrt=["x0", "xdot0"])
    columns = flow.columns()
    values = [1.7 * columns.starts[0], columns.starts[1]]
    expected = columns.jacobian(*values)
    with jax.enable_x64(True):
        function = flow.jax()
        for mode in (jax.jacfwd, jax.jacrev):
            for found, J in zip(mode(function, (0, 1))(*values), expected, strict=True):
                np.testing.assert_allclose(found, J, rtol=0.0, atol=1e-12)
        batch = np.stack([values[0], columns.starts[0]])
        rows = jax.vmap(function, in_axes=(0, None))(batch, values[1])
        for row, x in zip(rows, batch, strict=True):
            np.testing.assert_allclose(row, columns.value(x, values[1]), atol=1e-12)
    tensors = tuple(torch.tensor(v) for v in values)
    found = torch.autograd.functional.jacobian(flow.torch(), tensors)
    for part, J in zip(found, expected, strict=True):
        np.testing.assert_allclose(part, J, rtol=0.0, atol=1e-12)


def test_flow_of_tree_with_prescribed_joint_equals_simulation() -> None:
    """A prescribed hinge between balls, whose indices of coordinate and rate differ."""
    system = ball_tree(11, 3)
    name = next(j.name for j in system.space.joints[1:] if not j.kind.is_ball)
    assert system.x_names.index(name) != system.shape_names.index(name)
    high = Parameter("high", 0.3)
    options: dict[str, Any] = {"seed": 1, "duration": 0.3, "method": "DOP853", "rtol": 1e-12}
    plan = {name: Fourier(0.1, [high], [0.2], 1.0)}
    flow = pinred.flow(system, prescribed=plan, wrt=["x0", "high"], **options)
    states: Any = pinred.simulate(flow.scene).states
    end: Any = flow()
    np.testing.assert_allclose(end.q, states.q[-1], rtol=0.0, atol=1e-12)
    slopes = flow.jvp({"high": 1.0})
    low, up = (flow(high=0.3 + s * _STEP) for s in (-1, 1))
    for row in ("x", "xdot"):
        expected = tangent(system, row, low, up) / (2.0 * _STEP)
        error = np.abs(slopes[flow.outputs[row]] - expected.ravel()).max()
        assert error <= 1e-7 * np.abs(slopes).max(), row


def test_step_map_with_ball_has_square_jacobian(bodies: pinred.System) -> None:
    """The tangent of a state has 2n entries; steps compose to the whole flow."""
    options: dict[str, Any] = MOTION | {"times": None, "duration": 0.2}
    flow = pinred.flow(bodies, **options, method="DOP853", wrt=INPUTS)
    step, state, product = flow.step(0.02), flow.scene.start, np.eye(18)  # type: Any, Any, Any
    for k in range(10):
        linear = step.linear(state, t=0.02 * k)
        state, product = linear.state, linear.by_state @ product
    jacobian = flow.jacobian()
    assert step.outputs == flow.outputs
    whole = np.hstack([jacobian[name] for name in ("x0", "xdot0", "pose0", "xi0")])
    np.testing.assert_allclose(product, whole, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("method", ["DOP853", "AdaptiveGauss"])
@pytest.mark.sampled
def test_derivatives_pass_breaks_and_conditions_on_time(bodies: pinred.System, method: str) -> None:
    """A table on a ball's axis and a switch time that is a Parameter; the mass of a body."""
    size, when = Parameter("size", 0.7), Parameter("when", 0.25)

    def torque(s: Any) -> Any:
        return {"joint.y": ca.if_else(s.t < when, size, -0.3)}

    options: dict[str, Any] = MOTION | {"method": method, "times": [0.1, 0.5], "duration": 0.5}
    forces = [Torque(torque), Torque({"joint.x": Hold([0.0, 0.3], [0.2, size])})]
    wrt = ["x0", "size", "when", "joint.mass"]
    flow = pinred.flow(bodies, **options, forces=forces, wrt=wrt)
    jacobian = flow.jacobian()
    steps = {"size": 0.7, "when": 0.25, "joint.mass": float(flow.own("joint.mass")[0])}
    for name, value in steps.items():
        low, high = (flow(**{name: value + s * _STEP}) for s in (-1, 1))
        for row in ("x", "xdot", "pose", "xi"):
            expected = tangent(bodies, row, low, high) / (2.0 * _STEP)
            found = jacobian[name][:, flow.outputs[row]].reshape(expected.shape)
            assert np.abs(found - expected).max() <= 1e-6, (name, row)
    covector = np.random.default_rng(1).normal(size=jacobian["size"].shape)
    for name, gradient in flow.vjp(covector).items():
        expected = np.tensordot(covector, jacobian[name], 2)
        scale = np.linalg.norm(covector) * max(1.0, float(np.linalg.norm(jacobian[name])))
        assert np.abs(gradient - expected).max() <= 1e-12 * scale, name
