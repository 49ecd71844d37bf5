"""Prescribed joints of robots with closed loops, against a KKT system of Pinocchio's matrices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from loop_robots import five_bar, four_bar
from scipy.integrate import solve_ivp

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import InputError
from pinred.signals import Fourier
from pinred.simulation.flow_map.flow import Flow
from pinred.system.loops.kinematics import loop_values

FREQUENCY, HEIGHT = 2.0, 0.4


@pytest.fixture(scope="module")
def linkage() -> pinred.System:
    """Return the five-bar linkage, which has two degrees of freedom."""
    model, loops = five_bar()
    return pinred.load(model, loops=loops)


@pytest.fixture(scope="module")
def driven(linkage: pinred.System) -> pinred.Trajectory:
    """Return a motion of the linkage with one prescribed crank and a spring at the other."""
    return pinred.simulate(scene_of(linkage))


def scene_of(system: pinred.System) -> pinred.Scene:
    """Return the scene of `driven`."""
    assert system.closure is not None
    plan = f"{float(system.closure.x[0])!r} + {HEIGHT}*sin({FREQUENCY}*t)"
    return pinred.Scene(
        system=system, x0=system.closure.x, xi0=[0.1, 0.0, 0.3], prescribed={"left_crank": plan},
        springs={"right_crank": (3.0, 0.2)}, duration=0.5,
    )  # fmt: skip


def kkt(
    model: pin.Model, t: float, q: Array, v: Array, rest: float = 0.2
) -> tuple[Array, float, Array]:
    """Return acceleration, torque of the drive, and force on the right tip in the world's axes."""
    data, n = model.createData(), model.nv
    names = ("left_tip", "right_tip")
    pin.computeAllTerms(model, data, q, v)
    pin.forwardKinematics(model, data, q, v, np.zeros(n))
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    ids = [model.getFrameId(name) for name in names]
    J = [pin.computeFrameJacobian(model, data, q, k, axes)[:2] for k in ids]
    pin.forwardKinematics(model, data, q, v, np.zeros(n))
    bias = [pin.getFrameClassicalAcceleration(model, data, k, axes).linear[:2] for k in ids]
    drive = np.eye(n)[[3]]
    C = np.vstack([J[1] - J[0], drive])
    wanted = -HEIGHT * FREQUENCY**2 * np.sin(FREQUENCY * t)
    tau = np.zeros(n)
    tau[5] = -3.0 * (q[6] - rest)
    H = np.triu(data.M) + np.triu(data.M, 1).T
    K = np.block([[H, -C.T], [C, np.zeros((3, 3))]])
    right = np.concatenate([tau - data.nle, bias[0] - bias[1], [wanted]])
    solved = np.linalg.solve(K, right)
    return solved[:n], float(solved[-1]), solved[n : n + 2]


def test_motion_torque_and_loop_force_equal_a_kkt_system(
    linkage: pinred.System, driven: pinred.Trajectory
) -> None:
    """The multipliers of the KKT system are the loop force and the torque of the drive."""
    model, nq = linkage.model, linkage.model.nq
    assert list(model.names)[2:] == ["left_crank", "left_coupler", "right_crank", "right_coupler"]

    def rate(t: float, y: Array) -> Array:
        a, _, _ = kkt(model, t, y[:nq], y[nq:])
        turn, v = y[2:4], y[nq:]
        speed = np.array([[turn[0], -turn[1]], [turn[1], turn[0]]]) @ v[:2]
        return np.concatenate([speed, v[2] * np.array([-turn[1], turn[0]]), v[3:], a])

    start = np.concatenate([driven.q[0], driven.v[0]])
    end = solve_ivp(rate, (0.0, 0.5), start, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(driven.q[-1], end[:nq], rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(driven.v[-1], end[nq:], rtol=0.0, atol=1e-10)
    for k in (0, len(driven) // 2, -1):
        q, v = driven.q[k], driven.v[k]
        _, torque, force = kkt(model, float(driven.t[k]), q, v)
        np.testing.assert_allclose(driven.driving_torques[k], torque, rtol=1e-9)
        angle = np.arctan2(q[3], q[2]) + driven.x[k, 0] + driven.x[k, 1]  # of the left coupler
        axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        found = driven.loop_forces["tips"][k, :2]
        np.testing.assert_allclose(found, axes @ force, rtol=1e-9, atol=1e-12)


def test_loops_stay_closed_and_compare_passes(
    linkage: pinred.System, driven: pinred.Trajectory
) -> None:
    """The work of the drive balances the energy."""
    plan = linkage.closure.x[0] + HEIGHT * np.sin(FREQUENCY * driven.t)  # type: ignore[union-attr]
    np.testing.assert_allclose(driven.x[:, 0], plan, rtol=1e-14)
    assert max(np.abs(loop_values(linkage, x)).max() for x in driven.x) < 1e-10
    assert np.abs(driven.energy_balance.residual).max() < 1e-9
    report = pinred.compare(pinred.simulate(scene_of(linkage), duration=0.03))
    assert report.passed, str(report)


def test_both_engines_agree_with_prescribed_joints(driven: pinred.Trajectory) -> None:
    """A driven crank leaves the linkage one degree of freedom."""
    readable = pinred.simulate(driven.scene, engine="pinocchio")
    np.testing.assert_allclose(readable.x, driven.x, atol=1e-10)
    np.testing.assert_allclose(readable.pose, driven.pose, atol=1e-10)


def test_members_with_prescribed_joints_equal_single_simulations() -> None:
    """A driven crank determines the four-bar; the members differ in the parameter of the plan."""
    model, loops = four_bar()
    system = pinred.load(model, loops=loops)
    scenes = [
        pinred.Scene(system=system, momentum=0, prescribed={"crank": f"1 + {w}*t"}, duration=0.5)
        for w in (1.0, 2.0)
    ]
    many = pinred.simulate_many(scenes)
    for member, scene in enumerate(scenes):
        alone = pinred.simulate(scene)
        np.testing.assert_allclose(many[member].x, alone.x, atol=1e-12)
        np.testing.assert_allclose(many[member].pose, alone.pose, atol=1e-12)


def test_errors_of_computed_torque_decay_as_stated(linkage: pinred.System) -> None:
    """Both cranks are driven against a spring at a coupler: ë = −kd ė − kp e in closed form."""
    assert linkage.closure is not None
    x0, kp, kd = linkage.closure.x, 9.0, 4.0
    goals = {"left_crank": float(x0[0]) - 0.1, "right_crank": float(x0[2])}
    force = pinred.forces.ComputedTorque(goals, kp, kd)
    scene = pinred.Scene(
        system=linkage, x0=x0, xi0=[0.1, 0.0, 0.3], forces=[force],
        springs={"right_coupler": (3.0, 0.2)}, duration=1.0,
    )  # fmt: skip
    traj = pinred.simulate(scene)
    a, w, t = 0.5 * kd, np.sqrt(kp - 0.25 * kd**2), traj.t
    error = 0.1 * np.exp(-a * t) * (np.cos(w * t) + a / w * np.sin(w * t))
    np.testing.assert_allclose(traj.x[:, 0] - goals["left_crank"], error, atol=1e-10)
    np.testing.assert_allclose(traj.x[:, 2], x0[2], atol=1e-10)
    assert pinred.compare(pinred.simulate(scene, duration=0.03)).passed
    one = pinred.forces.ComputedTorque({"left_crank": 0.0}, kp, kd)
    with pytest.raises(InputError, match=r"references and plans for 2 joints, .* got 1"):
        pinred.Scene(system=linkage, x0=x0, forces=[one], duration=1.0)


def test_plans_that_contradict_loops_are_refused() -> None:
    """Loops that do not close at time 0, and more plans than degrees of freedom."""
    model, loops = four_bar()
    system = pinred.load(model, loops=loops)
    with pytest.raises(InputError, match=r"prescribed: the loops of 'four_bar' do not close with"):
        pinred.Scene(system=system, momentum=0, prescribed={"rocker": 0.0}, duration=1.0)
    assert system.closure is not None
    plans = {name: float(x) for name, x in zip(system.shape_names, system.closure.x, strict=True)}
    with pytest.raises(InputError, match=r"prescribed: the motions of crank, .* at most 1 joints"):
        pinred.Scene(system=system, momentum=0, prescribed=plans, duration=1.0)


def test_other_joints_start_from_the_stated_shape(linkage: pinred.System) -> None:
    """A whole x0 near another closed shape is moved to that one, not to `closure.x`."""
    assert linkage.closure is not None
    x0 = linkage.closure.x
    near = {"left_crank": float(x0[0]), "right_crank": float(x0[2]) + 0.3}
    other = pinred.Scene(system=linkage, x0=near).start.x
    plan = {"left_crank": float(other[0]) + 1e-4}
    with pytest.warns(pinred.LoopWarning):
        scene = pinred.Scene(system=linkage, x0=other, momentum=0, prescribed=plan)
    assert np.abs(scene.start.x - other).max() < 1e-3
    assert np.abs(loop_values(linkage, scene.start.x)).max() < 1e-10


Values = dict[str, Any]


def difference(flow: Flow, values: Values, name: str, direction: Any) -> Array:
    """Return central differences of order 4 of the end state along a direction of an input."""
    h, group = 1e-4, flow.system.group

    def end(k: int) -> Any:
        return flow(**{**values, name: values[name] + k * h * direction})

    def change(k: int) -> Array:
        ahead, behind = end(k), end(-k)
        between = group.compose(group.inverse(behind.pose.ravel()), ahead.pose.ravel())
        columns = [ahead.x - behind.x, ahead.xdot - behind.xdot, group.log(between)]
        return np.concatenate([np.ravel(a) for a in (*columns, ahead.xi - behind.xi)])

    return (8.0 * change(1) - change(2)) / (12.0 * h)


def four_bar_scene() -> tuple[pinred.Scene, Values]:
    """Return a four-bar whose crank follows a plan with three parameters, and other values."""
    model, loops = four_bar()
    system = pinred.load(model, loops=loops)
    assert system.closure is not None
    at = float(system.closure.x[0])
    a, b, w = (pinred.Parameter(*p) for p in (("at", at), ("height", 0.4), ("frequency", 2.0)))
    scene = pinred.Scene(
        system=system, x0=system.closure.x, momentum=[0.1, 0.2, 0.7],
        prescribed={"crank": Fourier(a, [0.2], [b], w)},
    )  # fmt: skip
    other = {"momentum": np.array([0.1, 0.2, 0.9]), "at": at + 0.3, "height": 0.3}
    return scene, {**other, "frequency": 2.2}


def five_bar_scene() -> tuple[pinred.Scene, Values]:
    """Return a five-bar with one prescribed crank, and another closed shape with other values."""
    model, loops = five_bar()
    system = pinred.load(model, loops=loops)
    assert system.closure is not None
    x0 = system.closure.x
    b, w = pinred.Parameter("height", 0.4), pinred.Parameter("frequency", 2.0)
    scene = pinred.Scene(
        system=system, x0=x0, xi0=[0.1, 0.0, 0.3], springs={"right_crank": (3.0, 0.2)},
        prescribed={"left_crank": Fourier(float(x0[0]), [0.0], [b], w)},
    )  # fmt: skip
    near = {"left_crank": float(x0[0]), "right_crank": float(x0[2]) + 0.1}
    other = {"x0": pinred.Scene(system=system, x0=near).start.x, "xdot0": np.arange(1.0, 5.0)}
    return scene, {**other, "xi0": np.array([0.1, 0.2, 0.3]), "height": 0.3, "frequency": 2.2}


@pytest.mark.sampled
@pytest.mark.parametrize("make", [four_bar_scene, five_bar_scene])
@pytest.mark.filterwarnings("ignore::pinred.LoopWarning")
def test_derivatives_of_flows_with_prescribed_joints_equal_differences(
    make: Callable[[], tuple[pinred.Scene, Values]],
) -> None:
    """By parameters of plans, which move the other joints at time 0, and by initial states."""
    scene, values = make()
    flow = pinred.flow(scene, wrt=list(values), duration=0.5, method="Gauss(0.005)")
    rng = np.random.default_rng(0)
    for name, size in flow.inputs.items():
        direction = 1.0 if np.ndim(values[name]) == 0 else rng.normal(size=size)
        along = flow.jvp({name: direction}, **values)
        expected = difference(flow, values, name, direction)
        np.testing.assert_allclose(along, expected, rtol=0.0, atol=1e-9 * np.abs(along).max())
        weights = rng.normal(size=along.shape)
        back = np.sum(flow.vjp(weights, **values)[name] * direction)
        np.testing.assert_allclose(back, weights @ along, rtol=1e-11, atol=1e-12)


@pytest.mark.filterwarnings("ignore::pinred.LoopWarning")
def test_flow_equals_simulation_at_other_parameters() -> None:
    """The crank starts elsewhere, so the other joints do."""
    scene, values = four_bar_scene()
    flow = pinred.flow(scene, wrt=["at"], duration=0.5, method="Gauss(0.005)")
    state = flow(at=values["at"])
    traj = pinred.simulate(
        scene, parameters={"at": values["at"]}, duration=0.5, method="Gauss(0.005)"
    )
    np.testing.assert_allclose(np.ravel(state.x), traj.x[-1], atol=1e-11)
    np.testing.assert_allclose(np.ravel(state.xdot), traj.xdot[-1], atol=1e-10)


def test_plans_that_do_not_determine_the_initial_shape_are_refused(
    linkage: pinred.System,
) -> None:
    """The other crank could stand anywhere; with a closed x0 the flow runs."""
    assert linkage.closure is not None
    x0 = linkage.closure.x
    scene = pinred.Scene(
        system=linkage, x0=x0, momentum=0, duration=0.1,
        prescribed={"left_crank": pinred.Parameter("at", float(x0[0]))},
    )  # fmt: skip
    flow, moved = pinred.flow(scene, wrt=["at"]), float(x0[0]) + 0.1
    with pytest.raises(InputError, match=r"left_crank .*do not determine .* Also give x0"):
        flow(at=moved)
    start = {"left_crank": moved, "right_crank": float(x0[2])}
    closed = pinred.Scene(system=linkage, x0=start).start.x
    state = flow(at=moved, x0=closed)
    np.testing.assert_allclose(np.ravel(state.x), closed, atol=1e-9)


def test_linearisation_with_a_held_joint_equals_differences(linkage: pinred.System) -> None:
    """With one crank held, a spring at the other swings the linkage at one frequency."""
    assert linkage.closure is not None
    x0, model = linkage.closure.x, linkage.model
    scene = pinred.Scene(
        system=linkage, x0=x0, momentum=0, duration=0.1,
        prescribed={"left_crank": float(x0[0])}, springs={"right_crank": (3.0, float(x0[2]))},
    )  # fmt: skip
    linear = pinred.linearise(pinred.simulate(scene))

    def acceleration(turn: float) -> float:
        """Return that of the right crank without drift, turned from the spring's rest."""
        start = {"left_crank": float(x0[0]), "right_crank": float(x0[2]) + turn}
        at = pinred.Scene(system=linkage, x0=start).start.x
        q = linkage.q(linkage.group.identity(), at)
        return float(kkt(model, 0.0, q, np.zeros(model.nv), float(x0[2]))[0][5])

    h = 1e-3
    slope = (
        8.0 * (acceleration(h) - acceleration(-h)) - acceleration(2 * h) + acceleration(-2 * h)
    ) / (12.0 * h)
    assert slope < -0.5
    frequencies = np.sort(linear.eigenvalues.imag)
    np.testing.assert_allclose(frequencies, [-np.sqrt(-slope), np.sqrt(-slope)], rtol=1e-8)
    np.testing.assert_allclose(linear.eigenvalues.real, 0.0, atol=1e-8)
