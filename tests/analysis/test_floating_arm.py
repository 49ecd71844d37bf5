"""Free-floating arms: the generalised Jacobian, against simulations and published numbers."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pinocchio as pin
import pytest
from assertions import close
from scipy.integrate import solve_ivp

import pinred
from pinred.analysis.phases.gait import FourierArc
from pinred.common.arrays import Array
from pinred.signals import Fourier
from pinred.system.robot_file_contents import Contents, Coupling

Q1 = np.radians(-65.0)


def planar() -> pinred.FloatingArm:
    """The two-link arm of Papadopoulos and Dubowsky."""
    return pinred.FloatingArm(pinred.load("floating_arm"), "hand")


def spatial() -> pinred.FloatingArm:
    """The last link of a six-joint arm on a free base in space."""
    return pinred.FloatingArm(pinred.load("ur5", gravity=[0.0, 0.0, 0.0]), "tool0")


ARMS = pytest.mark.parametrize("make", [planar, spatial])


def gait_of(m: int) -> pinred.Gait:
    """Return a smooth motion of m joints."""
    rng = np.random.default_rng(6)
    return pinred.Gait.fourier(
        rng.uniform(-0.5, 0.5, m), rng.uniform(-0.4, 0.4, (2, m)), rng.uniform(-0.4, 0.4, (2, m))
    )


@ARMS
@pytest.mark.sampled
def test_jacobian_matches_hand_motion_of_simulation(make: object) -> None:
    """The integral of J_g ẋ gives the hand motion of a simulation to 1e-9."""
    arm: pinred.FloatingArm = make()  # type: ignore[operator]
    system, gait = arm.system, gait_of(arm.system.m)
    t1 = 0.4
    (arc,) = gait.arcs
    assert isinstance(arc, FourierArc)
    plans = {
        name: Fourier(arc.mean[k], arc.cos[:, k], arc.sin[:, k], gait.period)
        for k, name in enumerate(system.shape_names)
    }
    traj = pinred.simulate(
        system, prescribed=plans, momentum=0, duration=t1, rtol=1e-12, atol=1e-12
    )
    start = arm.hand_pose(traj.x[0], pose=traj.pose[0])
    end = arm.hand_pose(traj.x[-1], pose=traj.pose[-1])

    def rate(t: float, y: Array) -> Array:
        x, xdot = gait.at(t)
        g = pin.XYZQUATToSE3(y)
        V = arm.generalized_jacobian(x) @ xdot
        turn = np.append(V[3:], 0.0)
        q = pin.Quaternion(y[3:])
        whole = (q * pin.Quaternion(*[0.0, *turn[:3]])).coeffs()
        return np.concatenate([g.rotation @ V[:3], 0.5 * whole])

    y0 = pin.SE3ToXYZQUAT(start)
    solution = solve_ivp(rate, (0.0, t1), y0, method="DOP853", rtol=1e-11, atol=1e-11)
    y = solution.y[:, -1]
    y[3:] /= np.linalg.norm(y[3:])
    close(pin.log6(pin.XYZQUATToSE3(y).actInv(end)).vector, np.zeros(6), 1e-9)


@ARMS
@pytest.mark.parametrize("axes", ["local", "world"])
def test_jacobian_rate_matches_differences(make: object, axes: str) -> None:
    """J̇_g equals differences along the horizontal motion to 1e-9."""
    arm: pinred.FloatingArm = make()  # type: ignore[operator]
    system = arm.system
    rng = np.random.default_rng(7)
    x, xdot = rng.uniform(-0.8, 0.8, system.m), rng.uniform(-1.0, 1.0, system.m)
    g0 = system.group.exp(rng.normal(size=system.r))
    h = 1e-3

    def moved(t: float) -> Array:
        """J_g after a time, along x + t ẋ, with the base carried along by Pinocchio's A."""
        red = pinred.Reduction(system)

        def rate(s: float, y: Array) -> Array:
            shape = x + s * xdot
            xi = -red.local_connection(shape) @ xdot
            return system.group.rate(system.group.normalize(y), xi)

        solution = solve_ivp(rate, (0.0, t), g0, method="DOP853", rtol=1e-13, atol=1e-14)
        pose = system.group.normalize(solution.y[:, -1])
        return arm.generalized_jacobian(x + t * xdot, axes=axes, pose=pose)  # type: ignore[arg-type]

    weights = [(1, 45.0), (-1, -45.0), (2, -9.0), (-2, 9.0), (3, 1.0), (-3, -1.0)]
    expected = np.sum([w / (60.0 * h) * moved(k * h) for k, w in weights], axis=0)
    found = arm.rate(x, xdot, axes=axes, pose=g0)  # type: ignore[arg-type]
    close(found, expected, 1e-9)


def test_drift_matches_rigid_motion_of_locked_arm() -> None:
    """With locked joints the hand moves with a rigid body, by Pinocchio's velocities."""
    arm = spatial()
    system = arm.system
    rng = np.random.default_rng(8)
    x, mu = rng.uniform(-0.8, 0.8, 6), rng.normal(size=6)
    H = pinred.Reduction(system).mass_matrix(x)
    xi = np.linalg.solve(H[:6, :6], mu)
    model, data = system.model, system.model.createData()
    q, v = system.q(system.group.identity(), x), system.v(xi, np.zeros(6))
    pin.forwardKinematics(model, data, q, v)
    expected = pin.getFrameVelocity(model, data, model.getFrameId("tool0"), pin.LOCAL)
    close(arm.drift(x, mu), expected.vector, 1e-12)


def test_singularities_match_published_values() -> None:
    """At q1 = −65° it is singular at q2 = −11.410803°; at q1 = 0 only stretched or folded."""
    arm = planar()
    angles = np.degrees(arm.singular_values_of("q2", [Q1, 0.0], limits=(-1.5, 1.5)))
    close(angles, [-11.410803], 1e-6)
    (share,) = arm.singular_along([Q1, -1.0], [Q1, 1.0])
    assert np.degrees(-1.0 + 2.0 * share) == pytest.approx(-11.410803, abs=1e-6)
    for low, high in ((-3.14, -1e-3), (1e-3, 3.14)):
        assert not len(arm.singular_values_of("q2", [0.0, 0.0], limits=(low, high)))
    at = arm.singularity([Q1, np.radians(-11.410803)])
    assert at.least < 1e-8
    assert at.condition > 1e6
    J = arm.generalized_jacobian([Q1, np.radians(-11.410803)])[:2]
    close(at.lost @ J, np.zeros(2), 1e-8)
    close(J @ at.joints, np.zeros(2), 1e-8)


def test_planar_jacobian_matches_manual_computation() -> None:
    """The Jacobian equals differences of positions relative to the fixed centre of mass.

    At zero momentum the centre of mass is at rest, and the base rotates by −A_θ ẋ.
    """
    arm = planar()
    x, h = np.array([0.7, -0.9]), 1e-4
    J = arm.generalized_jacobian(x, axes="world")

    def hand(q1: float, q2: float, base: float) -> Array:
        """Hand from the centre of mass, with the base at an angle."""
        masses = np.array([40.0, 4.0, 3.0])
        a, b = base + q1, base + q1 + q2
        e = [np.array([np.cos(angle), np.sin(angle)]) for angle in (base, a, b)]
        first = 0.5 * e[0] + 0.5 * e[1]
        second = first + 0.5 * e[1] + 0.5 * e[2]
        com = (masses[1] * first + masses[2] * second) / masses.sum()
        return np.asarray(second + 0.5 * e[2] - com)

    moments = np.array([6.667, 0.333, 0.25])
    masses = np.array([40.0, 4.0, 3.0])

    def momentum(rates: Array) -> float:
        """Angular momentum about the centre of mass of rates (q̇1, q̇2, base), by differences."""

        def places(s: float) -> Array:
            q1, q2, base = x[0] + s * rates[0], x[1] + s * rates[1], s * rates[2]
            e = [np.array([np.cos(v), np.sin(v)]) for v in (base, base + q1, base + q1 + q2)]
            first = 0.5 * e[0] + 0.5 * e[1]
            all_ = np.array([np.zeros(2), first, first + 0.5 * e[1] + 0.5 * e[2]])
            return np.asarray(all_ - masses @ all_ / masses.sum())

        v = (places(h) - places(-h)) / (2.0 * h)
        p = places(0.0)
        orbital = masses @ (p[:, 0] * v[:, 1] - p[:, 1] * v[:, 0])
        turns = np.array([rates[2], rates[2] + rates[0], rates.sum()])
        return float(orbital + moments @ turns)

    whole = momentum(np.array([0.0, 0.0, 1.0]))
    for k in range(2):
        rates = np.zeros(3)
        rates[k] = 1.0
        rates[2] = -momentum(rates) / whole
        ahead, behind = (hand(*(np.array([*x, 0.0]) + s * rates)) for s in (h, -h))
        close(J[:2, k], (ahead - behind) / (2.0 * h), 1e-7)
        assert J[5, k] == pytest.approx(rates.sum(), abs=1e-7)


def test_null_space_leaves_base_at_rest() -> None:
    """Joint rates in the null space move two arms and keep the base at rest."""
    system = pinred.load("satellite_two_arms")
    arm = pinred.FloatingArm(system, [f.name for f in system.model.frames][-1])
    x = np.array([0.3, -0.5, 0.4, -0.2, 0.6, 0.3])
    assert arm.null_space(x).shape[1] == 0
    free = arm.null_space(x, of="attitude")
    assert free.shape == (6, 3)
    close(free.T @ free, np.eye(3), 1e-12)
    A = pinred.Reduction(system).local_connection(x)
    close(A[3:] @ free, np.zeros((3, 3)), 1e-12)
    # One joint of a planar chain always moves the base.
    assert planar().null_space([0.3, 0.2]).shape == (2, 0)
    assert planar().null_space([0.3, 0.2], of="attitude").shape == (2, 1)


@pytest.mark.parametrize(("factor", "free"), [(3.0, 0), (0.3, 1)])
def test_reactions_below_1e_10_of_the_largest_count_as_none(
    monkeypatch: pytest.MonkeyPatch, factor: float, free: int
) -> None:
    """A joint that moves the base 1e-10 times as far as another is in the null space."""
    A = np.zeros((3, 2))
    A[0, 0], A[2, 1] = 7.0, 7.0 * factor * 1e-10
    arm = planar()
    monkeypatch.setattr(type(arm._reduction), "local_connection", lambda *_: A)
    null = arm.null_space([0.1, 0.2])
    assert null.shape == (2, free)
    close(np.abs(null), np.array([[0.0], [1.0]])[:, :free], 1e-9)


def test_singular_shapes_are_in_dependent_ranges() -> None:
    """Separately computed singular shapes have path-dependent distances."""
    arm = planar()
    workspace = arm.workspace(samples=61)
    step = 2.0 * float(np.ptp(workspace.reach)) / 61
    rng = np.random.default_rng(2)
    seen = []
    for q1 in rng.uniform(-np.pi, np.pi, 12):
        for q2 in arm.singular_values_of("q2", [q1, 0.0]):
            hand = arm.hand_pose([q1, q2]).translation
            q = arm.system.q(arm.system.group.identity(), [q1, q2])
            com = pin.centerOfMass(arm.system.model, arm.system.model.createData(), q)
            seen.append(float(np.linalg.norm(hand - com)))
    inside = [any(a - step <= r <= b + step for a, b in workspace.dependent) for r in seen]
    assert all(inside)
    free = [any(a + step < r < b - step for a, b in workspace.independent) for r in seen]
    assert not any(free)
    assert len(workspace.independent) >= 1
    # The hand is farthest with the arm stretched away from the base.
    assert workspace.reach[1] == pytest.approx(2.5 - (4.0 * 1.0 + 3.0 * 2.0) / 47.0, abs=1e-3)


@pytest.mark.slow
def test_workspace_of_six_joints_contains_sampled_shapes() -> None:
    """Separately computed singular and random shapes are within the ranges."""
    arm = spatial()
    workspace = arm.workspace(samples=60)
    model, data, system = arm.system.model, arm.system.model.createData(), arm.system
    g, rng = system.group.identity(), np.random.default_rng(5)

    def radius(x: Array) -> float:
        com = pin.centerOfMass(model, data, system.q(g, x))
        return float(np.linalg.norm(arm.hand_pose(x).translation - com))

    random = [radius(x) for x in rng.uniform(-np.pi, np.pi, (500, 6))]
    assert workspace.reach[0] <= min(random)
    assert max(random) <= workspace.reach[1] <= 1.2 * max(random)
    gap = 4.0 * float(np.ptp(workspace.reach)) / 60
    seen = []
    for start in rng.uniform(-2.0, 2.0, (4, 6)):
        for value in arm.singular_values_of(system.shape_names[2], start):
            x = np.array([*start[:2], value, *start[3:]])
            assert arm.singularity(x).condition > 1e6
            seen.append(radius(x))
    assert len(seen) >= 4
    assert all(any(a - gap <= r <= b + gap for a, b in workspace.dependent) for r in seen)
    # At the farthest point no small step increases the distance.
    slope, h = arm._radius_gradient(start), 1e-6
    ahead = [(radius(start + h * e) - radius(start - h * e)) / (2.0 * h) for e in np.eye(6)]
    close(slope, ahead, 1e-8)


def test_unknown_frames_rows_and_axes_are_refused() -> None:
    """Missing frames, rows and axes are refused by name."""
    system = pinred.load("floating_arm")
    with pytest.raises(pinred.InputError, match="did you mean 'hand'"):
        pinred.FloatingArm(system, "hnad")
    with pytest.raises(pinred.InputError, match="rows of a twist"):
        pinred.FloatingArm(system, "hand", task=(0, 9))
    with pytest.raises(pinred.InputError, match="axes must be local or world"):
        planar().generalized_jacobian([0.0, 0.0], axes="fixed")  # type: ignore[arg-type]
    with pytest.raises(pinred.InputError, match="expected 'base' or 'attitude'"):
        planar().null_space([0.0, 0.0], of="hand")  # type: ignore[arg-type]
    with pytest.raises(pinred.InputError, match="as many joints as task rows"):
        pinred.FloatingArm(planar().system, "hand", task=(0, 1, 5)).workspace()
    for wrong in ([(1.0, -1.0)] * 2, [(0.0, np.nan)] * 2, [(0.0, 1.0)]):
        with pytest.raises(pinred.InputError, match="limits"):
            planar().workspace(limits=wrong)
    with pytest.raises(pinred.InputError, match="samples must be"):
        planar().workspace(samples=1)


def coupled_arm() -> pinred.FloatingArm:
    """An arm in the plane whose last joint follows the first with ratio −1.5."""
    model = pin.Model()
    model.gravity.setZero()
    joint, place = 0, pin.SE3.Identity()
    body = pin.Inertia(1.0, np.array([0.4, 0.1, 0.0]), 0.1 * np.eye(3))
    kinds = [pin.JointModelPlanar(), *[pin.JointModelRZ()] * 3]
    for name, kind in zip(("base", "one", "two", "three"), kinds, strict=True):
        joint = model.addJoint(joint, kind, place, name)
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
        place = pin.SE3(np.eye(3), np.array([0.8, 0.1, 0.0]))
    model.addFrame(pin.Frame("hand", joint, 0, place, pin.FrameType.OP_FRAME))
    contents = Contents(couplings=(Coupling("three", {"one": -1.5}, 0.2),))
    return pinred.FloatingArm(pinred.System(model, "coupled_arm", contents=contents), "hand")


@pytest.mark.parametrize("axes", ["local", "world"])
def test_jacobian_and_its_rate_follow_couplings(axes: Literal["local", "world"]) -> None:
    """J_g ẋ is the hand's velocity by Pinocchio, and J̇_g its difference along the motion."""
    arm = coupled_arm()
    system, group = arm.system, arm.system.group
    x, xdot, g0 = np.array([0.4, -0.7]), np.array([0.9, -0.6]), np.array([0.2, 0.1, 0.8])
    red, model = pinred.Reduction(system), system.model

    def at(t: float) -> tuple[Array, Array]:
        """Return the shape and the pose after a time of the horizontal motion."""
        solution = solve_ivp(
            lambda s, y: group.rate(y, -red.local_connection(x + s * xdot) @ xdot),
            (0.0, t), g0, method="DOP853", rtol=1e-13, atol=1e-14,
        )  # fmt: skip
        return x + t * xdot, np.asarray(solution.y[:, -1])

    def jacobian(t: float) -> Array:
        shape, pose = at(t)
        return arm.generalized_jacobian(shape, axes=axes, pose=pose)

    data = model.createData()
    xi = -red.local_connection(x) @ xdot
    pin.forwardKinematics(model, data, system.q(g0, x), system.v(xi, xdot))
    frame = {"local": pin.LOCAL, "world": pin.LOCAL_WORLD_ALIGNED}[axes]
    velocity = pin.getFrameVelocity(model, data, model.getFrameId("hand"), frame).vector
    close(jacobian(0.0) @ xdot, velocity, 1e-13)
    h, weights_of = 1e-2, [(1, 672.0), (2, -168.0), (3, 32.0), (4, -3.0)]
    expected = sum(w / (840.0 * h) * (jacobian(k * h) - jacobian(-k * h)) for k, w in weights_of)
    close(arm.rate(x, xdot, axes=axes, pose=g0), expected, 1e-10)


@pytest.mark.parametrize("make", [planar, coupled_arm])
def test_radius_and_its_gradient_agree_with_pinocchio_and_differences(make: object) -> None:
    """The distance of the hand from the centre of mass, also with a joint that follows."""
    arm: pinred.FloatingArm = make()  # type: ignore[operator]
    system = arm.system
    x = np.array([0.5, -0.8])
    pose, q = system.group.identity(), system.q(system.group.identity(), x)
    com = pin.centerOfMass(system.model, system.model.createData(), q)
    radius = np.linalg.norm(arm.hand_pose(x, pose=pose).translation - com)
    assert arm._radius(x) == pytest.approx(radius, rel=1e-14)
    h = 1e-2
    steps = np.array([[k * h * e for e in np.eye(2)] for k in (1, 2, 3, 4)])
    weights = np.array([672.0, -168.0, 32.0, -3.0]) / (840.0 * h)
    expected = weights @ (arm._radius(x + steps) - arm._radius(x - steps))
    close(arm._radius_gradient(x), expected, 1e-12)


def test_gradient_of_radius_is_finite_where_hand_is_at_centre_of_mass() -> None:
    """A hand at the only body's centre of mass: the distance is zero, and so is its gradient."""
    model = pin.Model()
    model.gravity.setZero()
    model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "base")
    model.addJoint(1, pin.JointModelRZ(), pin.SE3.Identity(), "one")
    for joint in (1, 2):
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("hand", 2, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    arm = pinred.FloatingArm(pinred.load(model), "hand")
    assert arm._radius(np.array([0.3])) == 0.0
    close(arm._radius_gradient(np.array([0.3])), [0.0], 0.0)


def test_singular_points_are_all_sign_changes_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """Roots on samples, between them, and at both ends."""
    roots = np.array([0.0, 0.01, 0.25, 1.0 / 3.0 + 1e-5, 0.5, 0.777, 1.0])

    def determinants(_arm: pinred.FloatingArm, shapes: Array) -> Array:
        fraction = np.asarray(shapes)[..., 0]
        return np.asarray(np.prod([fraction - root for root in roots], axis=0))

    monkeypatch.setattr(pinred.FloatingArm, "determinants", determinants)
    found = planar().singular_along([0.0, 0.0], [1.0, 0.3])
    close(found, roots, 1e-15)
    with pytest.raises(ValueError, match="read-only"):
        found[0] = 1.0
    fine = planar().singular_values_of("q1", [0.3, 0.3], limits=(-1.0, 1.0))
    close(fine, roots, 4e-15)
