"""The full simulation at one state: momenta added up body by body, rates by ABA under what acts.

What forces see of a state, and energies, are found here from the motions of the bodies alone.
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
from pinred.judge.hairer import Hairer
from pinred.judge.reference_solution import FINEST, PERTURBATION, FullState
from pinred.lie import GROUPS
from pinred.system.joints import axes_of


@dataclass(frozen=True)
class Bodies:
    """A state as the motions of all bodies tell it, in the root joint's fixed frame.

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
    """Return what all bodies have together."""
    data, root = model.createData(), model.jointPlacements[1]
    pin.forwardKinematics(model, data, q, v)
    whole, moment, mass, kinetic, height = np.zeros(6), np.zeros(3), 0.0, 0.0, 0.0
    for i in range(1, model.njoints):
        body, own = model.inertias[i], data.v[i]
        place = root.inverse() * data.oMi[i]
        h = body * own
        whole += place.act(h).vector
        kinetic += 0.5 * float(h.vector @ own.vector)
        moment += body.mass * place.act(body.lever)
        mass += body.mass
        height -= body.mass * float(model.gravity.linear @ data.oMi[i].act(body.lever))
    linear, com = whole[:3], moment / mass
    return Bodies(mass, com, linear / mass, linear, whole[3:], kinetic, height)


def handed(group: str) -> pinred.System:
    """Return a tree with a link on its last body; a hinge on which it turns has a rotor."""
    model = tree(group, 3, 5).model.copy()
    if group == "SO2":
        model.armature = np.append(0.3, model.armature[1:])
    place = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.1, -0.2, 0.3]))
    model.addFrame(pin.Frame("hand", model.njoints - 1, place, pin.FrameType.BODY))
    return pinred.load(model)


def case(group: str, **options: Any) -> tuple[FullState, Array, Array, Array]:
    """Return the full simulation of a tree, a state y, and Pinocchio's q and v of it."""
    system, rng = handed(group), np.random.default_rng(5)
    full = FullState(pinred.Scene(system=system, seed=0, duration=1.0, **options))
    pose = system.group.exp(rng.normal(size=system.r))
    x, v = rng.normal(size=system.m), rng.normal(size=system.n)
    y = full.state(pose, x, v[: system.r], v[system.r :])
    return full, y, full.q(y), v


def along(system: pinred.System) -> Array:
    """Return the twists of the group in its fixed frame, (6, r)."""
    return axes_of(system.model.joints[1])


@pytest.mark.parametrize("group", GROUPS)
def test_what_forces_see(group: str) -> None:
    """Twist and momentum about the centre of mass, or the pivot; the base's own as well."""
    full, y, q, v = case(group)
    system = full.system
    r, k, S = system.r, system.group.linear, along(system)
    all_of = bodies(system.model, q, v)
    data = system.model.createData()
    pin.forwardKinematics(system.model, data, q)
    turn = system.model.jointPlacements[1].rotation.T @ data.oMi[1].rotation
    seen = full.sample(y)
    assert seen.x == pytest.approx(y[full.root.size : full.root.size + system.m])
    assert seen.xdot == pytest.approx(v[r:])
    slides = S[:3, :k]
    within = slides.T @ turn @ slides  # in the body's axes
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
    own = system.group.spatial_momentum(pose, seen.base.mu)
    assert own == pytest.approx(J)
    if group == "SE3":
        longer = y.copy()
        longer[3:7] *= 1.3
        assert full.sample(longer).base.pose == pytest.approx(pose)  # type: ignore[union-attr]


@pytest.mark.parametrize("group", GROUPS)
def test_energies(group: str) -> None:
    """Of all bodies and rotors; the part that the centre of mass has along the slides."""
    full, _, q, v = case(group)
    system = full.system
    all_of = bodies(system.model, q, v)
    other_shape = system.model_q(system.group.identity(), np.zeros(system.m))
    full.totals.radius_of_gyration(other_shape)
    S = along(system)[:3]
    velocity = S.T @ all_of.velocity
    carried = 0.5 * all_of.mass * float(velocity @ velocity)
    assert full.totals.com_kinetic_energy(q, v) == pytest.approx(carried)
    rotors = 0.5 * float(system.model.armature @ v**2)
    assert full.totals.kinetic_energy(q, v) == pytest.approx(all_of.kinetic + rotors)
    assert full.totals.potential_energy(q) == pytest.approx(all_of.potential)


@pytest.mark.parametrize("group", GROUPS)
def test_momentum_about_the_pivot_and_the_centre_of_mass(group: str) -> None:
    """Linear momentum is less what a fall has given; angular momentum is as it is."""
    full, _, q, v = case(group)
    system = full.system
    all_of, turn = bodies(system.model, q, v), system.model.jointPlacements[1].rotation
    fall, S = np.array([0.3, -0.5, 0.7]), along(system)
    rotor = system.model.armature[: system.r] * v[: system.r]
    for about in (True, False):
        angular = all_of.angular - (not about) * np.cross(all_of.com, all_of.linear)
        expected = S.T @ np.append(all_of.linear - turn.T @ fall, angular) + rotor
        assert full.totals.momentum(q, v, fall, about_pivot=about) == pytest.approx(expected)


def torques(names: tuple[str, ...], m: int, sizes: dict[str, int]) -> dict[str, Array]:
    """Return how much each of some numbers counts for each joint."""
    rng = np.random.default_rng(1)
    return {name: rng.normal(size=(m, sizes[name])) for name in names}


@pytest.mark.parametrize("names", [("pose",), ("xi", "pose"), ("mu", "J")])
@pytest.mark.parametrize("group", ["SO2", "SE2", "SO3", "SE3"])
def test_rates_under_forces_that_see_the_base(group: str, names: tuple[str, ...]) -> None:
    """By ABA, under torques from what all bodies have together."""
    system = handed(group)
    sizes = {"pose": system.group.size, **dict.fromkeys(("xi", "mu", "J"), system.r)}
    A = torques(names, system.m, sizes)

    def torque(s: SeenState) -> ca.SX:
        return ca.SX(sum(ca.DM(A[name]) @ getattr(s, name) for name in names))

    full, y, q, v = case(group, forces=[Torque(torque)])
    all_of, r = bodies(system.model, q, v), system.r
    rotor = system.model.armature[:r] * v[:r]
    J = along(system).T @ np.append(all_of.linear, all_of.angular) + rotor
    pose = y[: full.root.size]
    back = system.group.Ad(pose).T  # μ = Ad*_g J
    seen = {"pose": pose, "xi": v[:r], "mu": back @ J, "J": J}
    tau = np.append(np.zeros(r), sum(A[name] @ seen[name] for name in names))
    a = pin.aba(system.model, system.model.createData(), q, v, tau)
    assert full.rate(0.2, y)[full.root.size + system.m :] == pytest.approx(a)


def test_rates_under_forces_that_see_momentum() -> None:
    """The body's about the centre of mass, and a wrench on a link that sees nothing."""
    system = handed("SE3")
    A = np.random.default_rng(2).normal(size=(3, 6))
    free = Torque(lambda _t, _x, _xdot, mu: ca.SX(ca.DM(A) @ mu))
    push = Wrench([1.0, -2.0, 3.0, 0.1, 0.2, -0.3], link="hand")
    full, y, q, v = case("SE3", forces=[free, push])
    mu = full.sample(y).mu  # see test_what_forces_see
    data = system.model.createData()
    frame = system.model.getFrameId("hand")
    jacobian = pin.computeFrameJacobian(system.model, data, q, frame, pin.ReferenceFrame.LOCAL)
    tau = np.append(np.zeros(6), A @ mu)
    tau += jacobian.T @ [1.0, -2.0, 3.0, 0.1, 0.2, -0.3]
    a = pin.aba(system.model, data, q, v, tau)
    assert full.rate(0.2, y)[full.root.size + 3 :] == pytest.approx(a)


@pytest.mark.parametrize("method", ["dop853", "dopri5"])
@pytest.mark.parametrize(("size", "relative"), [(1.0, 3.5e-14), (1e-3, 4e-13)])
def test_the_finest_tolerances(method: str, size: float, relative: float) -> None:
    """An oscillator is followed to some units of round-off by either code, small ones as well."""
    y0 = np.array([size, 0.0])
    solver = Hairer(lambda _, y: np.array([y[1], -y[0]]), method, y0, 0.0, *FINEST, 10.0)
    y = solver.integrate(10.0)
    assert y is not None
    assert np.abs(y / size - [np.cos(10.0), -np.sin(10.0)]).max() < relative


@pytest.mark.parametrize("method", ["dop853", "dopri5"])
def test_times_that_differ_by_round_off_are_one(method: str) -> None:
    """No step is so short; a joint that turns steadily is where it should be at all of them."""
    system, end = pinred.load("coupled_planar"), 1e4
    scene = pinred.Scene(system=system, xdot0=[1e-3], duration=end)
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    times = np.array([0.0, 0.5 * end, np.nextafter(0.5 * end, end), end])
    found = full.run(y0, times, 1e-8, 1e-10, method=method).x[:, 0]
    assert found == pytest.approx(1e-3 * times)


def test_growth_is_at_least_one() -> None:
    """A kick is a smaller part of a motion that goes far; bounds do not shrink for that."""
    system = pinred.load("cartpole", gravity=np.zeros(3))
    scene = pinred.Scene(system=system, x0=[1.0], xdot0=[10.0], xi0=[20.0], duration=1.0)
    full, start, times = FullState(scene), scene.start, np.linspace(0.0, 1.0, 5)
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    motion = full.run(y0, times, 1e-10, 1e-12)
    kicked = full.run(full.perturb(y0, 1.0, PERTURBATION), times, 1e-10, 1e-12)
    assert full.distance(motion, kicked).relative(full.size(motion))[0] < 0.5 * PERTURBATION
    assert full.growth(y0, motion, times, 1e-10, 1e-12)[0] == 1.0


def test_rates_of_prescribed_joints() -> None:
    """Their plan's, whatever the state says of them; the others go as H a + b = 0 says."""
    system, t = handed("SE3"), 0.4
    plans = {1: "0.3*sin(2*t)", 2: "0.2*cos(3*t)"}
    given = {system.shape_names[k]: pinred.signals.Expression(f) for k, f in plans.items()}
    full, y, _, v = case("SE3", prescribed=given)
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
def test_forces_that_jump_between_times(method: str) -> None:
    """A slide on a slide, of 1 kg each, pushed by 0.4 N and from 0.5 s on by −0.2 N."""
    model = pin.Model()
    for i, name in enumerate(("root", "slide")):
        at = model.addJoint(i, pin.JointModelPX(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(at, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.gravity.setZero()
    push = Torque({"slide": pinred.signals.Hold([0.0, 0.5], [0.4, -0.2])})
    scene = pinred.Scene(system=pinred.load(model), x0=[0.0], forces=push, duration=1.0)
    full, times = FullState(scene), np.array([0.0, 0.3, 1.0])
    found = full.run(np.zeros(4), times, 1e-10, 1e-12, method=method).x[:, 0]
    speed = 2.0 * 0.4 * 0.5  # both masses move
    last = 0.5 * 0.8 * 0.5**2 + speed * 0.5 - 0.5 * 0.4 * 0.5**2
    assert found == pytest.approx([0.0, 0.5 * 0.8 * 0.3**2, last])
