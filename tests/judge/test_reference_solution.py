"""The full simulation at one state: inputs of forces, totals, and rates under forces.

Momenta and energies are computed here by sums over bodies.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from forced_trees import tree

import pinred
from pinred.common.arrays import Array
from pinred.forces import SeenState, Torque, Wrench
from pinred.judge.reference_integrators import Hairer
from pinred.judge.reference_solution import (
    FINEST,
    PERTURBATION,
    Distance,
    FullMotion,
    FullState,
    Size,
)
from pinred.lie import GROUPS
from pinred.system.joints import axes_of


@dataclass(frozen=True)
class Bodies:
    """Totals of a state from the motions of all bodies, in the root joint's fixed frame.

    mass [kg].  com, velocity, linear: (3,) of the centre of mass.  angular: (3,) about the frame's
    origin.  kinetic, potential: energies without rotors, in the model's gravity [J].
    """

    mass: float
    com: Array
    velocity: Array
    linear: Array
    angular: Array
    kinetic: float
    potential: float


def bodies(model: pin.Model, q: Array, v: Array) -> Bodies:
    """Sum over all bodies."""
    data, root = model.createData(), model.jointPlacements[1]
    pin.forwardKinematics(model, data, q, v)
    expected, moment, mass, kinetic, height = np.zeros(6), np.zeros(3), 0.0, 0.0, 0.0
    for i in range(1, model.njoints):
        body, unit = model.inertias[i], data.v[i]
        place = root.inverse() * data.oMi[i]
        h = body * unit
        expected += place.act(h).vector
        kinetic += 0.5 * float(h.vector @ unit.vector)
        moment += body.mass * place.act(body.lever)
        mass += body.mass
        height -= body.mass * float(model.gravity.linear @ data.oMi[i].act(body.lever))
    linear, com = expected[:3], moment / mass
    return Bodies(mass, com, linear / mass, linear, expected[3:], kinetic, height)


def tree_with_hand(group: str) -> pinred.System:
    """Build a tree with a link on its last body; a hinge at the root has a rotor."""
    model = tree(group, 3, 5).model.copy()
    if group == "SO2":
        model.armature = np.append(0.3, model.armature[1:])
    place = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.1, -0.2, 0.3]))
    model.addFrame(pin.Frame("hand", model.njoints - 1, place, pin.FrameType.BODY))
    return pinred.load(model)


def case(group: str, **options: Any) -> tuple[FullState, Array, Array, Array]:
    """Return the full simulation of a tree, a state y, and Pinocchio's q and v."""
    system, rng = tree_with_hand(group), np.random.default_rng(5)
    full = FullState(pinred.Scene(system=system, seed=0, duration=1.0, **options))
    pose = system.group.exp(rng.normal(size=system.r))
    x, v = rng.normal(size=system.m), rng.normal(size=system.n)
    y = full.state(pose, x, v[: system.r], v[system.r :])
    return full, y, full.q(y), v


def group_axes(system: pinred.System) -> Array:
    """Return the twists of the group in its fixed frame, (6, r)."""
    return axes_of(system.model.joints[1])


@pytest.mark.parametrize("group", GROUPS)
def test_sample_has_twist_and_momentum_about_centre_of_mass_or_pivot(group: str) -> None:
    """The base data are relative to the world."""
    full, y, q, v = case(group)
    system = full.system
    r, k, S = system.r, system.group.linear, group_axes(system)
    all_of = bodies(system.model, q, v)
    data = system.model.createData()
    pin.forwardKinematics(system.model, data, q)
    turn = system.model.jointPlacements[1].rotation.T @ data.oMi[1].rotation
    seen = full.sample(y)
    assert seen.x == pytest.approx(y[full.root.size : full.root.size + system.m])
    assert seen.xdot == pytest.approx(v[r:])
    slides = S[:3, :k]
    within = slides.T @ turn @ slides  # rotation within the translations
    xi = v[:r].copy()
    xi[:k] -= within.T @ slides.T @ all_of.velocity
    assert seen.xi == pytest.approx(xi)
    rotor = system.model.armature[:r] * v[:r]
    about = np.zeros(3) if not system.group.turns_about_com else all_of.com
    angular = all_of.angular - np.cross(about, all_of.linear)
    mu = np.zeros(r)
    mu[k:] = S[3:, k:].T @ turn.T @ angular + rotor[k:]
    assert seen.mu == pytest.approx(mu)
    J = S.T @ np.append(all_of.linear, all_of.angular) + rotor
    assert seen.base is not None
    assert pytest.approx(J) == seen.base.J
    assert seen.base.xi == pytest.approx(v[:r])
    pose = y[: full.root.size].copy()
    assert seen.base.pose == pytest.approx(pose)
    unit = system.group.spatial_momentum(pose, seen.base.mu)
    assert unit == pytest.approx(J)
    if group == "SE3":
        longer = y.copy()
        longer[3:7] *= 1.3
        assert full.sample(longer).base.pose == pytest.approx(pose)  # type: ignore[union-attr]


@pytest.mark.parametrize("group", GROUPS)
def test_energies_equal_sums_over_bodies(group: str) -> None:
    """Rotors are included; the centre of mass counts group_axes the group's translations."""
    full, _, q, v = case(group)
    system = full.system
    all_of = bodies(system.model, q, v)
    other_shape = system.q(system.group.identity(), np.zeros(system.m))
    full.totals.radius_of_gyration(other_shape)
    S = group_axes(system)[:3]
    velocity = S.T @ all_of.velocity
    carried = 0.5 * all_of.mass * float(velocity @ velocity)
    assert full.totals.com_kinetic_energy(full.totals.centroidal(q, v)) == pytest.approx(carried)
    rotors = 0.5 * float(system.model.armature @ v**2)
    assert full.totals.kinetic_energy(q, v) == pytest.approx(all_of.kinetic + rotors)
    assert full.totals.potential_energy(q) == pytest.approx(all_of.potential)


@pytest.mark.parametrize("group", GROUPS)
def test_momentum_equals_sum_over_bodies(group: str) -> None:
    """About the pivot and about the centre of mass, less the momentum of the fall."""
    full, _, q, v = case(group)
    system = full.system
    all_of, turn = bodies(system.model, q, v), system.model.jointPlacements[1].rotation
    fall, S = np.array([0.3, -0.5, 0.7]), group_axes(system)
    rotor = system.model.armature[: system.r] * v[: system.r]
    for about in (True, False):
        angular = all_of.angular - (not about) * np.cross(all_of.com, all_of.linear)
        expected = S.T @ np.append(all_of.linear - turn.T @ fall, angular) + rotor
        assert full.totals.momentum(q, v, fall, about_pivot=about) == pytest.approx(expected)


def random_gains(names: tuple[str, ...], m: int, sizes: dict[str, int]) -> dict[str, Array]:
    """Return random gains (m, size) of each input of the random_gains."""
    rng = np.random.default_rng(1)
    return {name: rng.normal(size=(m, sizes[name])) for name in names}


@pytest.mark.parametrize("names", [("pose",), ("xi", "pose"), ("mu", "J")])
@pytest.mark.parametrize("group", ["SO2", "SE2", "SO3", "SE3"])
@pytest.mark.sampled(3)
def test_rate_under_forces_that_depend_on_base(group: str, names: tuple[str, ...]) -> None:
    """Compared with ABA under random_gains from sums over bodies."""
    system = tree_with_hand(group)
    sizes = {"pose": system.group.size, **dict.fromkeys(("xi", "mu", "J"), system.r)}
    A = random_gains(names, system.m, sizes)

    def torque(s: SeenState) -> ca.SX:
        return ca.SX(sum(ca.DM(A[name]) @ getattr(s, name) for name in names))

    full, y, q, v = case(group, forces=[Torque(torque)])
    all_of, r = bodies(system.model, q, v), system.r
    rotor = system.model.armature[:r] * v[:r]
    J = group_axes(system).T @ np.append(all_of.linear, all_of.angular) + rotor
    pose = y[: full.root.size]
    back = system.group.Ad(pose).T  # μ = Ad*_g J
    seen = {"pose": pose, "xi": v[:r], "mu": back @ J, "J": J}
    tau = np.append(np.zeros(r), sum(A[name] @ seen[name] for name in names))
    a = pin.aba(system.model, system.model.createData(), q, v, tau)
    assert full.rate(0.2, y)[full.root.size + system.m :] == pytest.approx(a)


def test_rate_under_forces_that_depend_on_momentum() -> None:
    """Torques depend on the body momentum about the centre of mass; a wrench acts on a link."""
    system = tree_with_hand("SE3")
    A = np.random.default_rng(2).normal(size=(3, 6))
    free = Torque(lambda _t, _x, _xdot, mu: ca.SX(ca.DM(A) @ mu))
    push = Wrench([1.0, -2.0, 3.0, 0.1, 0.2, -0.3], link="hand")
    full, y, q, v = case("SE3", forces=[free, push])
    mu = full.sample(y).mu  # see test_sample_has_twist_and_momentum_about_centre_of_mass_or_pivot
    data = system.model.createData()
    frame = system.model.getFrameId("hand")
    jacobian = pin.computeFrameJacobian(system.model, data, q, frame, pin.ReferenceFrame.LOCAL)
    tau = np.append(np.zeros(6), A @ mu)
    tau += jacobian.T @ [1.0, -2.0, 3.0, 0.1, 0.2, -0.3]
    a = pin.aba(system.model, data, q, v, tau)
    assert full.rate(0.2, y)[full.root.size + 3 :] == pytest.approx(a)


@pytest.mark.parametrize("method", ["dop853", "dopri5"])
@pytest.mark.parametrize(("size", "relative"), [(1.0, 3.5e-14), (1e-3, 4e-13)])
def test_finest_tolerance_reaches_round_off(method: str, size: float, relative: float) -> None:
    """An oscillator is exact to a few units of round-off with both methods, at any amplitude."""
    y0 = np.array([size, 0.0])
    solver = Hairer(lambda _, y: np.array([y[1], -y[0]]), method, y0, 0.0, *FINEST, 10.0)
    y = solver.integrate(10.0)
    assert y is not None
    assert np.abs(y / size - [np.cos(10.0), -np.sin(10.0)]).max() < relative


@pytest.mark.parametrize("method", ["dop853", "dopri5"])
def test_run_accepts_times_that_differ_by_round_off(method: str) -> None:
    """A steadily rotating joint has the right angle at all times."""
    system, end = pinred.load("coupled_planar"), 1e4
    scene = pinred.Scene(system=system, xdot0=[1e-3], duration=end)
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    times = np.array([0.0, 0.5 * end, np.nextafter(0.5 * end, end), end])
    result = full.run(y0, times, 1e-8, 1e-10, method=method).x[:, 0]
    assert result == pytest.approx(1e-3 * times)


def test_growth_is_at_least_one() -> None:
    """A perturbation may shrink relative to a long motion, but the growth stays 1."""
    system = pinred.load("cartpole", gravity=np.zeros(3))
    scene = pinred.Scene(system=system, x0=[1.0], xdot0=[10.0], xi0=[20.0], duration=1.0)
    full, start, times = FullState(scene), scene.start, np.linspace(0.0, 1.0, 5)
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    motion = full.run(y0, times, 1e-10, 1e-12)
    kicked = full.run(full.perturb(y0, 1.0, PERTURBATION), times, 1e-10, 1e-12)
    assert full.distance(motion, kicked).relative(full.size(motion))[0] < 0.5 * PERTURBATION
    assert full.growth(y0, motion, times, 1e-10, 1e-12)[0] == 1.0


def test_rate_of_prescribed_joints_follows_plan() -> None:
    """Other joints obey H a + b = 0."""
    system, t = tree_with_hand("SE3"), 0.4
    plans = {1: "0.3*sin(2*t)", 2: "0.2*cos(3*t)"}
    values = {system.shape_names[k]: pinred.signals.Expression(f) for k, f in plans.items()}
    full, y, _, v = case("SE3", prescribed=values)
    x, v = y[7:10].copy(), v.copy()
    x[1:] = 0.3 * np.sin(2 * t), 0.2 * np.cos(3 * t)
    v[7:9] = 0.6 * np.cos(2 * t), -0.6 * np.sin(3 * t)
    a = np.zeros(9)
    a[7:9] = -1.2 * np.sin(2 * t), -1.8 * np.cos(3 * t)
    model, data = system.model, system.model.createData()
    q = full.q(full.state(y[:7], x, v[:6], v[6:]))
    upper = np.triu(pin.crba(model, data, q))
    H = upper + np.triu(upper, 1).T
    bias = pin.nonLinearEffects(model, data, q, v)
    a[:7] = np.linalg.solve(H[:7, :7], -(bias + H @ a)[:7])
    rate = full.rate(t, y)
    assert rate[7:10] == pytest.approx(v[6:])
    assert rate[10:] == pytest.approx(a)


@pytest.mark.parametrize("method", ["dop853", "dopri5"])
def test_run_stops_at_jumps_of_forces(method: str) -> None:
    """Two slides of 1 kg, pushed by 0.4 N, and by −0.2 N after 0.5 s."""
    model = pin.Model()
    for i, name in enumerate(("root", "slide")):
        at = model.addJoint(i, pin.JointModelPX(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(at, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.gravity.setZero()
    push = Torque({"slide": pinred.signals.Hold([0.0, 0.5], [0.4, -0.2])})
    scene = pinred.Scene(system=pinred.load(model), x0=[0.0], forces=push, duration=1.0)
    full, times = FullState(scene), np.array([0.0, 0.3, 1.0])
    result = full.run(np.zeros(4), times, 1e-10, 1e-12, method=method).x[:, 0]
    speed = 2.0 * 0.4 * 0.5  # both masses move
    last = 0.5 * 0.8 * 0.5**2 + speed * 0.5 - 0.5 * 0.4 * 0.5**2
    assert result == pytest.approx([0.0, 0.5 * 0.8 * 0.3**2, last])


@pytest.mark.parametrize("method", ["dop853", "dopri5"])
def test_run_continues_behind_a_stop_close_to_its_end(method: str) -> None:
    """A slide at 3 m/s moves 15 pm after a stop that is 5e-12 of the duration before the end."""
    system = pinred.load("coupled_planar")
    push = Torque({system.shape_names[0]: pinred.signals.Hold([0.0, 1.0 - 5e-12], [0.0, 1.0])})
    scene = pinred.Scene(system=system, xdot0=[3.0], x0=[0.0], forces=push, duration=1.0)
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    x = full.run(y0, np.array([0.0, 1.0]), 1e-10, 1e-12, method=method).x[-1, 0]
    assert x == pytest.approx(3.0, abs=3e-12)


SIZE = Size(joints=np.array([2.0, 5.0]), position=4.0, away=1e3)


@pytest.mark.parametrize(
    ("joints", "rotation", "position"),
    [
        ((6.0, 5.0), 1.0, 4.0),
        ((2.0, 15.0), 1.0, 4.0),
        ((2.0, 5.0), 3.0, 4.0),
        ((2.0, 5.0), 1.0, 12.0),
    ],
)
def test_relative_distance_is_largest_of_all_kinds(
    joints: tuple[float, float], rotation: float, position: float
) -> None:
    """Joints, rotation and position have separate units; NaN stays NaN."""
    distance = Distance(
        joints=np.array([[0.0, 0.0], joints]),
        rotation=np.array([0.0, rotation]),
        position=np.array([0.0, position]),
    )
    assert distance.relative(SIZE).tolist() == [0.0, 3.0]
    assert distance.worst(SIZE) == 3.0
    assert distance.shape.tolist() == [0.0, max(joints)]
    assert np.isnan(
        Distance(distance.joints, distance.rotation * np.nan, distance.position).worst(SIZE)
    )


def test_size_of_motion_is_largest_of_travel_radius_and_round_off() -> None:
    """A small ball that rests at the origin has its radius of gyration as the unit of positions."""
    ball = pinred.Model("ball").body("ball", mass=2.0, inertia=2.0 * 1e-6)  # r² = 3 I/m = 3e-6 m²
    full = FullState(pinred.Scene(system=pinred.load(ball, group="SE3"), seed=0, duration=1.0))
    q = np.zeros((2, 7))
    q[:, 6] = 1.0

    def size(start: float, end: float) -> Size:
        q[:, 1] = start, end
        return full.size(FullMotion(x=np.empty((2, 0)), q=q))

    assert size(0.0, 0.0).position == pytest.approx(np.sqrt(3e-6), rel=1e-12)
    assert size(0.0, 0.0).away == 0.0
    assert size(0.01, 0.03).position == pytest.approx(0.02, rel=1e-12)
    assert size(0.01, -0.03).away == 0.03
    assert size(1e4, 1e4).position == pytest.approx(1e4 * 1e-5, rel=1e-12)
