"""Flow maps: their values, and their derivatives against independent computations."""

from __future__ import annotations

import pickle
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import pinred
from pinred import InputError, Parameter
from pinred.common.arrays import Array
from pinred.forces import Controller, Torque, Wrench
from pinred.integrators import integrate
from pinred.integrators.run_derivatives import run_along, run_back
from pinred.kernels.reduced_graph import ReducedGraph
from pinred.signals import Fourier, Hold, Spline
from pinred.simulation.flow_map.flow import Flow

ROWS = ["x", "xdot", "pose", "xi", "body_momentum", "spatial_momentum", "energy"]
METHODS = ["DOP853", "Tsit5", "AdaptiveGauss", "Gauss(0.01)"]


def flow_of(name: str, **options: Any) -> Flow:
    """Return the flow of a bundled robot with a spring, with derivatives by all inputs."""
    system = pinred.load(name)
    gain, names = Parameter("gain", 2.0), system.shape_names
    wrt = ["x0", "xdot0", "pose0", "xi0", "gain"] if names else ["pose0", "xi0"]

    def torque(_t: Any, x: Any, xdot: Any, _mu: Any) -> Any:
        return {names[0]: -gain * ca.sin(x[0]) - 0.1 * xdot[0]}

    forces = [Torque(torque)] if names else []
    given = {"seed": 1, "duration": 0.5, "forces": forces, "wrt": wrt, "of": ROWS, **options}
    return pinred.flow(system, **given)


def covector_of(flow: Flow, jacobian: dict[str, Any]) -> Any:
    """Return a random covector of the outputs."""
    shape = jacobian["pose0"].shape[:-1]
    assert shape[-1] == sum(place.stop - place.start for place in flow.outputs.values())
    return np.random.default_rng(0).normal(size=shape)


@pytest.mark.by_hand
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "name", ["cartpole", "rigid_body", "falling_cat", "coupled_planar", "double_spherical_pendulum"]
)
def test_vjp_agrees_with_jacobian(name: str, method: str) -> None:
    """λᵀ(J v) = (λᵀJ) v to round-off, at the end and over times, for all inputs."""
    for times in (None, [0.0, 0.013, 0.2, 0.5]):
        flow = flow_of(name, method=method, times=times)
        jacobian = flow.jacobian()
        covector = covector_of(flow, jacobian)
        for key, found in flow.vjp(covector).items():
            expected = np.tensordot(covector, jacobian[key], covector.ndim)
            size = np.linalg.norm(covector) * max(1.0, float(np.linalg.norm(jacobian[key])))
            assert np.abs(found - expected).max(initial=0.0) < 1e-13 * size, key


@pytest.mark.by_hand
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["planar_chain5", "satellite_two_arms", "falling_cat"])
def test_tangent_agrees_with_differences_at_frozen_steps(name: str, method: str) -> None:
    """Differences of integrations with the same steps give the same derivatives."""
    flow = flow_of(name, method=method, times=[0.0, 0.1, 0.37, 0.5])
    (solution,) = flow.run({}).solutions
    propagator, rng = flow.propagator, np.random.default_rng(1)
    y, p = solution.states[0], solution.params
    along, along_p = rng.normal(size=(len(y), 1)), rng.normal(size=(len(p), 1))
    knots = solution.knots

    def end(s: float, v: Any, w: Any) -> Any:
        return run_along(
            propagator.method, propagator.field, p + s * along_p[:, 0], y + s * along[:, 0],
            knots, solution.times, v, w,
        )  # fmt: skip

    found = end(0.0, along, along_p)
    errors = []
    for h in (1e-3, 3e-4, 1e-4, 3e-5):
        sides = [end(s * h, along[:, :0], along_p[:, :0]) for s in (-2, -1, 1, 2)]
        for slopes, name_of in ((found.slopes[..., 0], "y"), (found.end_slopes[:, 0], "end")):
            low, less, more, most = (getattr(side, name_of) for side in sides)
            richardson = (8.0 * (more - less) - (most - low)) / (12.0 * h)
            errors.append(np.abs(richardson - slopes).max() / np.abs(slopes).max())
    assert min(errors[0::2]) < 1e-8
    assert min(errors[1::2]) < 1e-8


@pytest.mark.by_hand
def test_jacobian_agrees_with_variational_equations() -> None:
    """SciPy integrates the variational equations with CasADi's Jacobian."""
    system = pinred.load("planar_chain5")
    functions = pinred.casadi_functions(system)
    flow = pinred.flow(system, seed=2, duration=0.5, wrt=["x0"], method="DOP853", rtol=1e-12)
    (solution,) = flow.run({}).solutions
    y, p = solution.states[0], solution.params
    n = len(y)
    assert functions.layout.size == n

    def rate(_t: float, z: Any) -> Any:
        J = np.array(functions.vector_field_jacobian(z[:n], p))
        slope = J @ z[n:].reshape(n, n)
        return np.concatenate([np.array(functions.vector_field(z[:n], p))[:, 0], slope.ravel()])

    z0 = np.concatenate([y, np.eye(n).ravel()])
    exact = (
        solve_ivp(rate, (0.0, 0.5), z0, "DOP853", rtol=1e-11, atol=1e-13).y[n:, -1].reshape(n, n)
    )
    propagator = flow.propagator
    found = run_along(
        propagator.method, propagator.field, p, y, solution.knots, solution.times, np.eye(n),
        np.zeros((len(p), n)),
    )  # fmt: skip
    assert np.abs(found.end_slopes - exact).max() < 1e-8 * np.abs(exact).max()


@pytest.mark.parametrize("name", ["cartpole", "satellite_two_arms"])
@pytest.mark.sampled
def test_flow_agrees_with_simulate_and_its_differences(name: str) -> None:
    """Values are equal to the bit; derivatives agree within the error of step control."""
    flow = flow_of(name, method="DOP853", rtol=1e-12, times=[0.2, 0.5])
    scene = flow.scene
    states = pinred.simulate(scene).states
    for key, value in vars(flow()).items():
        np.testing.assert_array_equal(value, getattr(states, key))
    rng, h = np.random.default_rng(0), 1e-4
    given: Any = scene.given
    group = flow.system.group
    values = {"x0": given.x[0], "xdot0": given.xdot[0], "xi0": given.xi[0], "gain": 2.0}
    for key, size in flow.inputs.items():
        v = rng.normal(size=size)
        sides: list[Any] = []
        for s in (-h, h):
            value = group.compose(given.pose[0], group.exp(s * v)) if key == "pose0" else None
            moved = value if value is not None else values[key] + s * (v if size > 1 else v[0])
            sides.append(flow(**{key: moved}))
        found = flow.jvp({key: v})
        for row in ("x", "xdot", "xi", "spatial_momentum"):
            low, high = (getattr(side, row) for side in sides)
            expected = (high - low) / (2.0 * h)
            error = np.abs(found[..., flow.outputs[row]] - expected).max()
            assert error < 2e-6 * max(1.0, np.abs(found).max()), (key, row)
        low, high = (side.pose for side in sides)
        turned = group.log(group.compose(group.inverse(low), high)) / (2.0 * h)
        error = np.abs(found[..., flow.outputs["pose"]] - turned).max()
        assert error < 2e-6 * max(1.0, np.abs(found).max()), (key, "pose")


def test_derivatives_through_breaks_agree_with_differences() -> None:
    """Derivatives pass breaks of tables, with Parameters in tables and plans."""
    system = pinred.load("falling_cat")
    high, mean = Parameter("high", 0.4), Parameter("mean", 0.1)
    options: dict[str, Any] = {
        "seed": 3,
        "duration": 0.6,
        "method": "DOP853",
        "rtol": 1e-12,
        "forces": [Torque({"sway": Hold([0.0, 0.2, 0.4], [0.1, high, -0.1])})],
        "prescribed": {
            "bend": Fourier(mean, [0.1], [0.2], 1.0),
            "twist": Spline([0.0, 0.3, 1.0], [0.0, high, 0.1]),
        },
    }
    flow = pinred.flow(system, wrt=["x0", "high", "mean"], times=[0.1, 0.2, 0.5], **options)
    jacobian = flow.jacobian()
    assert not jacobian["x0"][..., [0, 2]].any()  # those of plans are not read
    for name, value in (("high", 0.4), ("mean", 0.1)):
        low, up = (flow(**{name: value + s * 1e-4}) for s in (-1, 1))
        for row in ("x", "xdot"):
            expected = (getattr(up, row) - getattr(low, row)) / 2e-4
            np.testing.assert_allclose(jacobian[name][..., flow.outputs[row]], expected, atol=1e-6)
    covector = covector_of_shape(jacobian["high"].shape)
    for name, found in flow.vjp(covector).items():
        expected = np.tensordot(covector, jacobian[name], 2)
        np.testing.assert_allclose(found, expected, atol=1e-11)


def covector_of_shape(shape: tuple[int, ...]) -> Any:
    """Return a random covector of a shape."""
    return np.random.default_rng(5).normal(size=shape)


def test_inputs_default_to_the_scene() -> None:
    """Joints may be given by name, and momentum is an input if the scene gives it."""
    system = pinred.load("falling_cat")
    flow = pinred.flow(system, seed=1, duration=0.2, wrt=["x0"])
    same = flow(x0=flow.scene.given.x[0])
    np.testing.assert_array_equal(same.x, flow().x)
    named = flow(x0={"bend": 0.3})
    np.testing.assert_array_equal(named.x, flow(x0=[0.3, 0.0, 0.0]).x)
    still = pinred.flow(system, x0=[0.1, 0.2, 0.0], momentum=0, duration=0.2, wrt=["x0"])
    state: Any = still()
    assert not np.abs(state.body_momentum).max() > 1e-14
    moving = pinred.flow(system, x0=[0.1, 0.2, 0.0], momentum=0, duration=0.2, wrt=["momentum"])
    assert moving.jacobian()["momentum"].shape == (18, 6)
    assert "falling_cat" in repr(flow)
    shape = pinred.flow(system, seed=1, duration=0.2, wrt=["x0"], outputs="shape")
    assert [*shape.outputs] == ["x", "xdot"]
    np.testing.assert_allclose(
        shape.jacobian()["x0"], flow.jacobian()["x0"][:6], rtol=1e-6, atol=1e-8
    )


def test_invalid_names_shapes_and_scenes_are_rejected() -> None:
    """The message states the name, shape or option."""
    cat = pinred.load("falling_cat")
    with pytest.raises(InputError, match="no input 'x_0'; did you mean 'x0'"):
        pinred.flow(cat, seed=1, wrt=["x_0"])
    with pytest.raises(InputError, match="named twice"):
        pinred.flow(cat, seed=1, wrt=["x0", "x0"])
    with pytest.raises(InputError, match=r"its inputs are pose0, x0, xdot0, xi0$"):
        pinred.flow(cat, seed=1, wrt=["momentum"])
    with pytest.raises(InputError, match="outputs of a flow must be among x, xdot"):
        pinred.flow(cat, seed=1, of=["poses"])  # type: ignore[list-item]
    with pytest.raises(InputError, match="the steps of RKMK4 have no derivatives"):
        pinred.flow(cat, seed=1, method="RKMK4(0.01)")
    hold = Controller(lambda *_: [0.0, 0.0, 0.0], 0.1)
    with pytest.raises(InputError, match="controller is a Python function"):
        pinred.flow(cat, seed=1, forces=[hold])
    flow = pinred.flow(cat, seed=1, duration=0.1, wrt=["x0"])
    with pytest.raises(InputError, match="x0 must have shape"):
        flow(x0=[1.0])
    with pytest.raises(InputError, match="must be finite"):
        flow(x0=[np.nan, 0.0, 0.0])
    with pytest.raises(InputError, match="the direction of x0 must have shape"):
        flow.jvp({"x0": [1.0]})
    with pytest.raises(InputError, match="no input 'xdot0'"):
        flow.jvp({"xdot0": [1.0, 0.0, 0.0]})
    with pytest.raises(InputError, match="the covector must have shape"):
        flow.vjp([1.0])
    with pytest.raises(InputError, match="no output 'q'"):
        flow.vjp({"q": [1.0]})
    with pytest.raises(InputError, match="the covector must be finite"):
        flow.vjp(np.full(18, np.nan))


def seeing(joint: str, entry: int) -> Torque:
    """Return a torque that depends on an entry of the pose."""
    return Torque(lambda s: {joint: -0.3 * s.pose[entry]})


@pytest.mark.slow
@pytest.mark.parametrize("name", ["coupled_planar", "falling_cat"])
@pytest.mark.sampled
def test_derivatives_of_forces_that_depend_on_pose(name: str) -> None:
    """Both modes agree with differences, over times and for single steps."""
    system = pinred.load(name, gravity=(0.0, 0.0, -3.0) if name == "falling_cat" else None)
    joint, push = system.shape_names[0], Parameter("push", 0.4)
    forces = [
        Torque(lambda s: {joint: -push * s.pose[0] - 0.2 * s.xi[0] + 0.1 * s.pose[2]}),
        Wrench(lambda s: -push * s.xi, name="drag"),
    ]
    wrt = ["x0", "xdot0", "pose0", "xi0", "push", "gravity"]
    wrt = wrt if name == "falling_cat" else wrt[:-1]
    options: Any = {"of": ROWS, "method": "DOP853", "rtol": 1e-12, "times": [0.1, 0.4]}
    flow = pinred.flow(system, seed=1, forces=forces, wrt=wrt, **options)
    scene, group, h = flow.scene, system.group, 1e-4
    states = pinred.simulate(scene).states
    ends, given = flow(), scene.given  # type: Any, Any
    np.testing.assert_allclose(ends.q, states.q, rtol=0, atol=1e-13)
    jacobian = flow.jacobian()
    covector = np.random.default_rng(0).normal(size=jacobian["pose0"].shape[:-1])
    for key, found in flow.vjp(covector).items():
        expected = np.tensordot(covector, jacobian[key], covector.ndim)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)
    own: dict[str, Any] = {"x0": given.x[0], "xdot0": given.xdot[0], "xi0": given.xi[0]}
    own |= {"push": 0.4, "gravity": system.gravity}
    for key, size in flow.inputs.items():
        v = np.random.default_rng(1).normal(size=size)
        sides: list[Any] = []
        for s in (-h, h):
            moved = own[key] + s * (v if size > 1 else v[0]) if key in own else None
            if moved is None:
                moved = group.compose(given.pose[0], group.exp(s * v))
            sides.append(flow(**{key: moved}))
        found = flow.jvp({key: v})
        for row in ("x", "xdot", "xi", "body_momentum", "spatial_momentum"):
            low, high = (getattr(side, row) for side in sides)
            expected = (high - low) / (2.0 * h)
            error = np.abs(found[..., flow.outputs[row]] - expected).max()
            assert error < 2e-6 * max(1.0, np.abs(found).max()), (key, row)
    step, state = flow.step(0.02), scene.start  # type: Any, Any
    for k in range(20):
        state = step(state, t=0.02 * k)
    np.testing.assert_allclose(state.pose, states.pose[-1], rtol=0, atol=1e-7)


def test_events_are_rejected_and_attitude_torques_accepted() -> None:
    """Flows reject events; a torque that depends on the attitude has derivatives."""
    system = pinred.load("coupled_planar")
    joint = system.shape_names[0]
    with pytest.raises(pinred.InputError, match="does not detect events"):
        pinred.flow(system, seed=0, events=[pinred.Event("x[0]")], wrt=["x0"])
    scene = pinred.Scene(system=system, seed=0, duration=0.5, forces=[seeing(joint, 2)])
    f = pinred.flow(scene, wrt=["pose0"])
    h, own = 1e-5, scene.given.pose[0]
    ends = [f(pose0=own + np.array([0.0, 0.0, sign * h])).xdot for sign in (1.0, -1.0)]
    slope = f.jvp({"pose0": [0.0, 0.0, 1.0]})
    names = f.outputs
    np.testing.assert_allclose(
        slope[names["xdot"]], (ends[0] - ends[1]) / (2.0 * h), rtol=1e-5, atol=1e-7
    )


def test_repeated_and_failing_integrations_agree_with_simulate() -> None:
    """Long, failing and overflowing integrations agree; fields are computed at first access."""
    system = pinred.load("falling_cat")
    long = pinred.flow(system, seed=1, duration=20.0, method="DOP853", rtol=1e-10)
    scene = long.scene
    traj = pinred.simulate(scene)
    assert traj.run.steps > 128
    for _ in range(2):  # without room for its steps, and with it
        end: Any = long()
        np.testing.assert_array_equal(end.q, traj.states.q[-1])
        long._last = None
    assert "xdot" not in vars(end)
    for name in ("t", "energy", "xi", "pose", "body_momentum"):
        np.testing.assert_array_equal(getattr(end, name), getattr(traj.states, name)[-1])
    with pytest.raises(ValueError, match="read-only"):
        end.q[0] = 1.0
    with pytest.raises(AttributeError, match="qs"):
        _ = end.qs
    again = pickle.loads(pickle.dumps(end))
    assert type(again) is pinred.State
    np.testing.assert_array_equal(again.pose, end.pose)
    few = pinred.flow(system, seed=1, duration=20.0, method=pinred.DOP853(max_steps=20))
    with pytest.raises(pinred.IntegrationError, match="limit of 20 steps at"):
        few()
    with pytest.raises(InputError, match="the inputs of a flow must be finite"):
        long(x0=np.array([np.inf, -np.inf, 0.0]))
    with pytest.raises(InputError, match="the inputs of a flow must be finite"):
        long(x0=np.array([np.nan, 0.0, 0.0]))
    shape = pinred.flow(system, seed=1, duration=0.2, outputs="shape", method="DOP853")()
    assert type(pickle.loads(pickle.dumps(shape))) is pinred.ShapeState
    with pytest.raises(AttributeError):
        _ = getattr(shape, "pose")  # noqa: B009


def gradients_beside_cvodes(flow: Flow, tolerance: float) -> tuple[Array, Array]:
    """Return gradients of λ · y at the end of one segment, by pinred's adjoint and by CVODES's.

    The inputs are the initial reduced state and the parameters. The component along each
    quaternion's length is excluded: the flow normalises quaternions, CVODES does not.
    """
    propagator, kernel = flow.propagator, flow.propagator.kernel
    (solution,) = propagator.run(flow.run({}).given, stages=True).solutions
    y0, times = solution.states[0].copy(), solution.times
    covector = np.random.default_rng(0).normal(size=len(y0))
    rate = ReducedGraph(kernel.system, kernel.structure, kernel.forces).rate()
    y, p = ca.SX.sym("y", rate.numel_in(0)), ca.SX.sym("p", rate.numel_in(1))
    options = {"reltol": tolerance, "abstol": 1e-2 * tolerance, "max_num_steps": 1_000_000}
    dae = {"x": y, "p": p, "ode": rate(y, p)}
    integrator = ca.integrator("cvodes", "cvodes", dae, 0.0, flow.scene.end, options)
    adjoint = integrator.factory("adjoint", ["x0", "p", "adj:xf"], ["adj:x0", "adj:p"])
    by_cvodes = [np.array(part).ravel() for part in adjoint(y0, solution.params, covector)]
    none = np.zeros((len(times), len(y0)))
    own = run_back(propagator.method, propagator.field, solution, times, covector, none)
    gradients = np.append(own.by_state, own.by_parameters), np.concatenate(by_cvodes)
    first, count = kernel.layout.quaternions
    for k in range(first, first + 4 * count, 4):
        q = y0[k : k + 4] / np.linalg.norm(y0[k : k + 4])
        for gradient in gradients:
            gradient[k : k + 4] -= q * (q @ gradient[k : k + 4])
    return gradients


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "duration"), [("planar_chain5", 2.0), ("satellite_two_arms", 0.5)]
)
@pytest.mark.sampled
def test_vjp_agrees_with_cvodes(name: str, duration: float) -> None:
    """Gradients of the end state agree where the flow has moderate growth."""
    system = pinred.load(name, gravity=(0, 0, 0))
    flow = pinred.flow(system, seed=1, duration=duration, method="DOP853", rtol=1e-9)
    (solution,) = flow.run({}).solutions
    y, p, propagator = solution.states[0].copy(), solution.params, flow.propagator
    stretch = run_along(
        propagator.method, propagator.field, p, y, solution.knots, solution.times,
        np.eye(len(y)), np.zeros((len(p), len(y))),
    ).end_slopes  # fmt: skip
    assert np.linalg.norm(stretch, 2) < 1e3
    own, by_cvodes = gradients_beside_cvodes(flow, 1e-9)
    assert np.abs(by_cvodes - own).max() < 1e-6 * np.abs(own).max()
    assert len(own) == len(y) + len(p)


@pytest.mark.parametrize("method", ["DOP853", "AdaptiveGauss"])
def test_stages_are_stored_below_a_size_limit(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Gradients agree with the Jacobian with stored stages and without."""
    flow = flow_of("cartpole", method=method, times=[0.1, 0.2, 0.5])
    jacobian = flow.jacobian()
    covector = covector_of(flow, jacobian)

    def kept() -> bool:
        assert flow._last is not None
        (solution,) = flow._last[1].solutions
        return bool(solution.stored.shape[1] > solution.states.shape[1])

    def agrees() -> None:
        for key, found in flow.vjp(covector).items():
            expected = np.tensordot(covector, jacobian[key], covector.ndim)
            size = np.linalg.norm(covector) * max(1.0, float(np.linalg.norm(jacobian[key])))
            assert np.abs(found - expected).max(initial=0.0) < 1e-13 * size, key

    agrees()  # the run of the Jacobian, which has kept none
    assert not kept()
    flow._last = None
    agrees()
    assert kept()
    (solution,) = flow.run({}).solutions
    room = 8 * 128 * solution.stored.shape[1]
    for most, expected in ((room, True), (room - 1, False)):
        monkeypatch.setattr(integrate, "MOST_STAGE_BYTES", most)
        flow._last = None
        agrees()
        assert kept() is expected


def test_derivative_that_is_not_finite_is_refused() -> None:
    """1/cosh is zero where cosh overflows, but its expression of the derivative is ∞/∞."""
    pulse = Torque({"bend": lambda t, *_: 0.5 / ca.cosh((t - 1.0) / 1e-3)})
    cat = pinred.load("falling_cat")
    flow = pinred.flow(cat, forces=[pulse], seed=1, duration=2.0, method="DOP853", wrt=["x0"])
    assert np.isfinite(flow().x).all()
    with pytest.raises(pinred.IntegrationError, match="a derivative of the flow of 'falling_cat'"):
        flow.jacobian()
    with pytest.raises(pinred.IntegrationError, match="cosh overflows"):
        flow.jvp({"x0": [1.0, 0.0, 0.0]})
