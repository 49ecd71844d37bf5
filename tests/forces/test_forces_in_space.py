"""Forces that depend on the base in space, and wrenches on links: ABA and Jacobians."""

# ruff: noqa: ARG005  # functions are told apart by their arguments, used or not

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from coupled_trees import make_case
from forced_trees import against_aba, tree

import pinred
from pinred.common.arrays import Array
from pinred.forces import SeenState, Torque, Wrench
from pinred.forces.force_model import ForceModel
from pinred.forces.force_numbers import BaseInSpace, ForceInputs
from pinred.lie import GROUPS
from pinred.scene.scene import ENGINES, Engine
from pinred.simulation.plan import plan_of
from pinred.system.joints import axes_of

OPTIONS: dict[str, Any] = {"seed": 2, "duration": 0.4, "rtol": 1e-9, "atol": 1e-11}


def seen_by_pinocchio(system: pinred.System, q: Array, v: Array) -> dict[str, Array]:
    """Pose, twist, body momentum and spatial momentum, from Pinocchio's q and v alone."""
    model, group = system.model, system.group
    data, r = model.createData(), system.r
    still = model.copy()
    still.gravity.setZero()
    mu = np.array(pin.rnea(still, data, q, np.zeros(model.nv), v)[:r])
    pin.ccrba(model, data, q, v)  # about the centre of mass, in the world's axes
    root = model.jointPlacements[1]
    linear = root.rotation.T @ data.hg.linear
    angular = root.rotation.T @ (
        data.hg.angular + np.cross(data.com[0] - root.translation, data.hg.linear)
    )
    S = axes_of(model.joints[1])
    pose = q[: model.joints[1].nq]
    if group.turns == 1 and len(pose) > group.size:
        pose = np.append(pose[:-2], np.arctan2(pose[-1], pose[-2]))
    rotor = model.armature[:r] * v[:r]
    J = S.T @ np.append(linear, angular) + rotor
    return {"pose": pose, "xi": v[:r], "mu": mu, "J": J}


def weights(system: pinred.System) -> dict[str, Array]:
    """Return the weight of each number of the base for each joint."""
    rng = np.random.default_rng(4)
    sizes = {"pose": system.group.size, **dict.fromkeys(("xi", "mu", "J"), system.r)}
    return {name: rng.normal(size=(system.m, size)) for name, size in sizes.items()}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.sampled(6)
def test_torques_of_base_equal_aba(group: str, engine: Engine) -> None:
    """Pose, twist and both momenta for every group, under gravity."""
    system, names = tree(group, 2, 5), ("pose", "xi", "mu", "J")
    A = weights(system)

    def torque(s: SeenState) -> ca.SX:
        torques = sum(ca.DM(A[name]) @ getattr(s, name) for name in names)
        return ca.SX(0.3 * ca.tanh(torques))

    traj = pinred.simulate(system, forces=[Torque(torque)], engine=engine, **OPTIONS)

    def tau(_t: float, q: Array, v: Array) -> Array:
        base_state = seen_by_pinocchio(system, q, v)
        if group == "SO3" or group == "SE3":
            end = len(base_state["pose"])
            flip = np.sign(base_state["pose"][end - 4 :] @ traj(_t).pose[-4:])
            base_state["pose"] = np.append(
                base_state["pose"][: end - 4], flip * base_state["pose"][end - 4 :]
            )
        torques = sum(A[name] @ base_state[name] for name in names)
        return np.append(np.zeros(system.r), 0.3 * np.tanh(torques))

    assert against_aba(traj, tau) < 1e-6


LOADS = {
    "body": lambda s: [1.0 + s.x[0], ca.sin(3 * s.t), -0.5, 0.2, 0.1 * s.xi[-1], 0.3],
    "world": lambda s: [1.0, ca.sin(3 * s.t), -0.5 * s.x[0], 0.2, 0.1 * s.J[-1], 0.3],
}


# Both engines run by default with both frames on other groups.
@pytest.mark.by_hand("SO3-world-compiled", "SE2-world-pinocchio", "SO2-body-pinocchio")
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("axes", LOADS)
@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.sampled(7)
def test_wrenches_on_links_equal_jacobians(group: str, axes: Any, engine: Engine) -> None:
    """At a point of the last link, in its axes or the world's: τ = Jᵀ (F, N)."""
    bare = tree(group, 3, 5).model
    placement = pin.SE3.Random()
    bare.addFrame(pin.Frame("hand", bare.njoints - 1, placement, pin.FrameType.BODY))
    system = pinred.load(bare)
    model, data = system.model, system.model.createData()
    frame, point = model.getBodyId("hand"), [0.1, -0.2, 0.3]
    force = Wrench(LOADS[axes], link="hand", at=point, frame=axes)
    traj = pinred.simulate(system, forces=[force], engine=engine, **OPTIONS)
    turn = model.jointPlacements[1].rotation

    def tau(t: float, q: Array, v: Array) -> Array:
        base_state = seen_by_pinocchio(system, q, v)
        state = SeenState(t, system.configuration(q).x, None, **base_state)
        load = np.array([float(value) for value in LOADS[axes](state)])
        pin.framesForwardKinematics(model, data, q)
        R = data.oMf[frame].rotation
        axes_of = R if axes == "body" else turn
        F, N = axes_of @ load[:3], axes_of @ load[3:]
        jacobian = pin.computeFrameJacobian(
            model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        return np.asarray(jacobian.T @ np.append(F, N + np.cross(R @ point, F)))

    assert against_aba(traj, tau) < 1e-6


@pytest.mark.slow
def test_compare_passes_with_forces_in_space() -> None:
    """The reference computes the base by its own kinematics and links by Jacobians."""
    system = pinred.load("coupled_planar")
    last, first = system.model.frames[-1].name, system.shape_names[0]
    forces = [
        Torque(lambda s: {first: -0.2 * ca.sin(s.pose[2]) - 0.1 * s.xi[0] + 0.1 * s.J[2]}),
        Wrench(lambda s: [-0.2 * s.xi[0], 0.1, 0.0], link=last, at=(0.1, 0.2, 0.0)),
        Wrench([0.1, -0.2, 0.02], frame="world", name="tug"),
    ]
    traj = pinred.simulate(system, seed=0, duration=0.2, rtol=1e-8, forces=forces)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    np.testing.assert_allclose(traj.momentum_balance.residual, 0.0, atol=1e-8)
    np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-8)


def test_momentum_is_integrated_only_for_wrenches() -> None:
    """A torque of the attitude does not enlarge the state."""
    satellite = pinred.load("satellite_two_arms")
    joint = satellite.shape_names[0]

    def numbers(force: Any) -> int:
        scene = pinred.Scene(system=satellite, seed=0, forces=[force])
        return plan_of(scene).layout(zero_momentum=False).size

    blind = numbers(Torque(lambda t, x, xdot, mu: {joint: -x[0]}))
    assert numbers(Torque(lambda s: {joint: -s.pose[3] - s.xi[3]})) == blind
    assert numbers(Torque(lambda s: {joint: -s.xi[5]})) == blind
    assert numbers(Torque(lambda s: {joint: -s.pose[0]})) == blind + 1  # the clock
    assert numbers(Wrench(lambda s: [0, 0, 0, -s.pose[3], 0, 0])) == blind + 3 + 6
    traj = pinred.simulate(
        satellite, seed=0, duration=0.5, forces=[Torque(lambda s: {joint: -s.pose[3] - s.xi[3]})]
    )
    J = traj.spatial_momentum
    np.testing.assert_allclose(J, np.broadcast_to(J[0], J.shape), atol=1e-13)


ODD_FRAME: dict[str, Any] = {"frame": "hand"}
ODD_LINK: dict[str, Any] = {"link": 3}


def scene_with_torque(function: Any) -> pinred.Scene:
    """Return a scene with a torque of this function."""
    return pinred.Scene(
        system=pinred.load("elroys_beanie"), forces=[Torque({"beanie": function})], seed=0
    )


def test_number_of_arguments_selects_the_form() -> None:
    """Names of arguments do not matter."""
    four: list[Any] = [
        lambda t, x, xdot, mu: -x[0],
        lambda *a: -a[1][0],
        lambda t, *rest: -rest[0][0],
        lambda t, x, xdot, mu, gain=1.0: -gain * x[0],
        lambda a, b, c, d: -b[0],
    ]
    one: list[Any] = [
        lambda s: -s.x["beanie"],
        lambda s, gain=1.0: -gain * s.x[0],
        lambda t: -t.x[0],
        lambda s, *, a=1.0, b=2.0, c=3.0: -s.x[0],
    ]
    models = [scene_with_torque(f).force_model for f in (*four, *one)]
    assert not any(model.sees_base for model in models if model)
    same = [models[k] for k in (0, 1, 4, 5, 7)]
    assert len({model.key for model in same if model}) == 1


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda t, x=0, xdot=0, mu=0: 0.0, r"one argument and also four"),
        (lambda s, a=1, b=2, c=3, d=4: 0.0, r"one argument and also four"),
        (lambda t, x: 0.0, r"must be a function of \(t, x, xdot, mu\), or one state s .* takes 2"),
        (lambda: 0.0, r"takes 0 arguments"),
        (
            lambda s: s.twist[0],
            r"a state has no 'twist'; its fields are t, x, xdot, pose, xi, mu, J",
        ),
        (lambda s, *, k: 0.0, r"keyword-only argument without a default"),
        (min, r"no signature|\*args|one argument and also four"),
    ],
)
def test_ambiguous_functions_are_rejected(function: Any, message: str) -> None:
    """The message states both forms and how to choose one."""
    with pytest.raises(pinred.InputError, match=message):
        scene_with_torque(function)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Wrench([0, 0, 0], link="nose"), r"no link 'nose'; .*the links are"),
        (lambda: Wrench([0, 0, 0, 0], link="beanie"), r"must have 6 values, got 4"),
        (lambda: Wrench([0], at=[0, 0, 0]), r"at= is a point of a link; pass link="),
        (lambda: Wrench([0, 0, 0], link="beanie", at=[0, 0]), r"at of wrench must be 3 finite"),
        (lambda: Wrench([0], **ODD_FRAME), r"frame of wrench must be one of body, world"),
        (lambda: Wrench([0], **ODD_LINK), r"link of wrench must be a name"),
    ],
)  # fmt: skip
def test_invalid_wrenches_are_rejected(make: Any, message: str) -> None:
    """Unknown names, points and axes."""
    with pytest.raises(pinred.InputError, match=message):
        pinred.Scene(system=pinred.load("elroys_beanie"), seed=0, forces=[make()])


def test_forces_of_base_need_base() -> None:
    """The base cannot be omitted."""
    force = Torque(lambda s: {"beanie": -s.pose[0]})
    with pytest.raises(pinred.InputError, match="outputs='shape' omits"):
        pinred.Scene(system=pinred.load("elroys_beanie"), seed=0, forces=[force], outputs="shape")


@pytest.mark.parametrize("axes", ["body", "world"])
@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.sampled(4)
def test_wrench_on_follower_link_acts_on_leader(group: str, axes: Any, seed: int) -> None:
    """Through couplings: Gᵀ Jᵀ (F, N)."""
    case = make_case(group, 4, seed)
    bare = case.system.model.copy()
    bare.addFrame(pin.Frame("hand", bare.njoints - 1, pin.SE3.Random(), pin.FrameType.BODY))
    system = pinred.System(bare, "tied", contents=case.system.contents)
    load, point, rng = case.rng.normal(size=6), case.rng.normal(size=3).tolist(), case.rng
    force = ForceModel(system, [Wrench(load.tolist(), link="hand", at=point, frame=axes)], {})
    pose, x = system.group.exp(rng.normal(size=system.r)), rng.normal(size=system.m)
    base = BaseInSpace(pose, *np.zeros((3, system.r)))
    xdot, xi = np.zeros(system.m), np.zeros(system.r)
    acting = force.acting(ForceInputs(0.0, x, xdot, xi, xi, force.numbers, base))
    model, data = system.model, system.model.createData()
    hand, q = model.getBodyId("hand"), system.q(pose, x)
    jacobian = pin.computeFrameJacobian(
        model, data, q, hand, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    )
    link_axes = data.oMf[hand].rotation
    R = link_axes if axes == "body" else model.jointPlacements[1].rotation
    F, N = R @ load[:3], R @ load[3:]
    expected = case.whole.T @ jacobian.T @ np.append(F, N + np.cross(link_axes @ point, F))
    result = np.append(acting.wrench, acting.torque)
    np.testing.assert_allclose(result, expected, atol=1e-12 * np.abs(expected).max())


def test_push_on_body_without_joints() -> None:
    """A cart by F t²/2m; a rigid body by ABA."""
    cart = pinred.load("cartpole", lock=["pole_pivot"])
    mass = sum(inertia.mass for inertia in cart.model.inertias)
    pushed = pinred.simulate(cart, xi0=[0.0], duration=2.0, forces=[Wrench([0.3])])
    np.testing.assert_allclose(pushed.pose[-1], [0.6 / mass], rtol=1e-10)
    assert pinred.compare(pushed)
    drag = Wrench(lambda s: -s.xi)
    body = pinred.simulate(pinred.load("rigid_body"), seed=0, duration=0.5, forces=[drag])
    assert pinred.compare(body)
