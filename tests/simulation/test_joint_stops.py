"""Joint stops: impacts, rest and release against full-state hybrid dynamics and closed forms."""

from __future__ import annotations

import pickle
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from coupled_trees import make_case
from hybrid_reference import HybridMotion, HybridReference
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import IntegrationError
from pinred.forces import Torque
from pinred.simulation.impacts import impulses, solve_complementarity
from pinred.simulation.run_with_stops import first_root


def bouncing_slide() -> pinred.System:
    """Return two masses, 3 kg and 1 kg, on one line: the reduced mass is 0.75 kg."""
    model = pin.Model()
    model.name = "slide"
    model.gravity.setZero()
    for k, mass in enumerate((3.0, 1.0)):
        i = model.addJoint(k, pin.JointModelPX(), pin.SE3.Identity(), ("base", "slide")[k])
        inertia = pin.Inertia(mass, np.zeros(3), 0.1 * np.eye(3))
        model.appendBodyToJoint(i, inertia, pin.SE3.Identity())
    return pinred.load(model)


def reference_of(traj: pinred.Trajectory, torque: Any = None) -> HybridMotion:
    """Return the motion of a trajectory's scene by the full-state code."""
    system, stops = traj.system, dict(traj.scene.stops)
    shape = system.joint_values(traj.x[0])
    names = system.tree.x_names
    positions = {name: float(shape[names.index(name)]) for name in stops}
    reference = HybridReference(system, stops, torque)
    return reference.run(traj.q[0], traj.v[0], positions, traj.t)


def assert_equal_motions(
    traj: pinred.Trajectory, motion: HybridMotion, times: float, states: float
) -> None:
    """Assert that impacts, their order, modes and states of both routes are equal."""
    table = traj.impacts
    hits = [(hit.t, name) for hit in motion.hits for name in hit.joints]
    assert [name for _, name in hits] == list(table.joint)
    np.testing.assert_allclose(table.t, [t for t, _ in hits], rtol=0.0, atol=times)
    impulses_of_reference = np.concatenate([hit.impulses for hit in motion.hits] or [[]])
    # The slowest impacts of a sequence have the relative error of their rates.
    np.testing.assert_allclose(table.impulse, impulses_of_reference, rtol=1e-6, atol=states)
    lost = [table.energy_lost[table.t == t].sum() for t in table.times]
    np.testing.assert_allclose(lost, [hit.lost for hit in motion.hits], rtol=0.0, atol=states)
    modes = traj.motion.modes
    assert len(modes) == len(motion.modes)
    for (t, label), (t_other, names) in zip(modes, motion.modes, strict=True):
        assert abs(t - t_other) <= times
        assert label.count(" at its ") == len(names)
        assert all(name in label for name in names)
    np.testing.assert_allclose(traj.v, np.array(motion.v), rtol=0.0, atol=states)
    np.testing.assert_allclose(traj.q, np.array(motion.q), rtol=0.0, atol=states)


def spatial_momentum(system: pinred.System, q: Array, v: Array) -> Array:
    """Return linear momentum, and angular momentum about the origin, by Pinocchio."""
    data = system.model.createData()
    h = pin.computeCentroidalMomentum(system.model, data, q, v).vector.copy()
    h[3:] += np.cross(data.com[0], h[:3])
    return h


@pytest.mark.parametrize(
    ("robot", "limit", "restitution", "end", "speed"),
    [
        ("falling_cat", 0.3, 0.6, 2.0, 8.0),
        ("solo12", 0.5, 0.3, 0.15, 5.0),
        ("satellite_two_arms", 0.5, 0.9, 0.5, 3.0),
    ],
)
def test_impacts_of_robots_agree_with_full_state_dynamics(
    robot: str, limit: float, restitution: float, end: float, speed: float
) -> None:
    system, rng = pinred.load(robot), np.random.default_rng(1)
    stops = {name: pinred.Stop(-limit, limit, restitution) for name in system.shape_names}
    traj = pinred.simulate(
        system, x0=np.zeros(system.m), xdot0=speed * rng.normal(size=system.m),
        xi0=0.3 * rng.normal(size=6), duration=end, stops=stops,
    )  # fmt: skip
    assert len(traj.impacts.times) >= 3
    assert_equal_motions(traj, reference_of(traj), times=1e-9, states=1e-8)


def test_rest_and_release_agree_with_multipliers_of_the_full_state() -> None:
    system = pinred.load("falling_cat")
    torque = Torque(
        lambda t, x, xdot, mu: ca.vertcat(0.05 * ca.sin(3 * t), 0.04 * ca.cos(2 * t), -0.02 * x[2])
    )

    def generalised(t: float, q: Array, v: Array) -> Array:
        return np.array([*np.zeros(6), 0.05 * np.sin(3 * t), 0.04 * np.cos(2 * t), -0.02 * q[9]])

    traj = pinred.simulate(
        system, x0=[0.1, 0.2, -0.1], xdot0=[1.0, -1.0, 0.5], xi0=[0.1, 0.2, 0.3, 0.1, 0.5, -0.2],
        duration=4.0, forces=[torque], stops=dict.fromkeys(system.shape_names, (-0.5, 0.5)),
    )  # fmt: skip
    assert len(traj.motion.modes) > 10
    assert any(label.count(" at its ") == 2 for _, label in traj.motion.modes)
    motion = reference_of(traj, generalised)
    assert_equal_motions(traj, motion, times=1e-9, states=1e-9)
    balance = traj.energy_balance
    assert balance.labels == ("torque", "joint stops")
    np.testing.assert_allclose(balance.residual, 0.0, atol=1e-11)
    # Inverse dynamics of Pinocchio at an instant of rest gives the torque and the reaction.
    reaction, model = traj.stop_reactions, system.model
    k = int(np.argmax(np.abs(reaction).max(axis=1)))
    t = float(traj.t[k])
    q, v, data = traj.q[k], traj.v[k], model.createData()
    reference = HybridReference(system, dict(traj.scene.stops), generalised)
    rest = tuple(
        n
        for n, row in enumerate(reference.rows)
        if reaction[k, row[1] - 6] * row[2] > 0.0
    )
    a, _ = reference.accelerations(t, q, v, rest)
    needed = pin.rnea(model, data, q, v, a) - generalised(t, q, v)
    np.testing.assert_allclose(needed[6:], reaction[k], atol=1e-9)
    np.testing.assert_allclose(
        traj.torques[k], reaction[k] + generalised(t, q, v)[6:], atol=1e-10
    )


@pytest.mark.parametrize("restitution", [0.5, 0.8])
def test_bouncing_slide_accumulates_at_the_time_of_the_closed_form(restitution: float) -> None:
    force, height, mass = 1.5, 1.0, 0.75
    traj = pinred.simulate(
        bouncing_slide(), x0=[height], xdot0=[0.0], xi0=[0.0], duration=20.0,
        forces=[Torque(lambda t, x, xdot, mu: [-force])],
        stops={"slide": pinred.Stop(0.0, restitution=restitution)},
    )  # fmt: skip
    g = force / mass
    first, e = np.sqrt(2.0 * height / g), restitution
    k = np.arange(len(traj.impacts))
    expected = first * (1.0 + 2.0 * e * (1.0 - e**k) / (1.0 - e))
    np.testing.assert_allclose(traj.impacts.t, expected, rtol=0.0, atol=1e-9)
    rates = -g * first * e**k
    np.testing.assert_allclose(traj.impacts.rate_before, rates, rtol=1e-5)
    accumulation = first * (1.0 + e) / (1.0 - e)
    (_, label), (start, rest) = traj.motion.modes
    assert (label, rest) == ("no joint at rest", "slide at its lower stop")
    assert 0.0 <= accumulation - start <= 2e-6 / (g * (1.0 - e))
    assert traj.impacts.rate_after[-1] == 0.0
    assert traj.impacts.rate_before[-1] * e >= -1e-6  # the first rebound below rest_rate
    assert traj.impacts.rate_before[-2] * e < -1e-6
    # All of the energy is gone, and the table says where.
    np.testing.assert_allclose(traj.impacts.energy_lost.sum(), force * height, rtol=1e-10)
    np.testing.assert_allclose(traj.stop_reactions[-1], force, rtol=1e-12)
    np.testing.assert_allclose(traj.x[-1], 0.0, atol=1e-15)


def test_elastic_stops_keep_the_energy_over_200_impacts() -> None:
    system = pinred.load("falling_cat")
    traj = pinred.simulate(
        system, x0=[0.0, 0.0, 0.0], xdot0=[6.0, -5.0, 4.0], xi0=np.zeros(6), duration=12.0, rtol=1e-12,
        atol=1e-14,
        stops={name: pinred.Stop(-0.3, 0.3, 1.0) for name in system.shape_names},
    )  # fmt: skip
    assert len(traj.impacts.times) >= 200
    np.testing.assert_allclose(traj.energy, traj.energy[0], rtol=1e-11)
    np.testing.assert_allclose(traj.impacts.energy_lost, 0.0, atol=1e-15)
    times = traj.impacts.times
    before, after = traj(times), traj(np.nextafter(times, np.inf))
    J = [[spatial_momentum(system, q, v) for q, v in zip(s.q, s.v, strict=True)]
         for s in (before, after)]  # fmt: skip
    scale = np.abs(before.v).max()
    np.testing.assert_allclose(J[0], J[1], rtol=0.0, atol=1e-13 * scale)
    assert not np.allclose(before.v, after.v, atol=1e-3)
    table = traj.impacts
    np.testing.assert_array_equal(table.momentum_before, table.momentum_after)


def test_prescribed_and_locked_joints_are_equivalent_to_rest() -> None:
    """With restitution 0, a pressed joint moves as one that is locked when it is loaded."""
    system, force = pinred.load("falling_cat"), Torque(lambda t, x, xdot, mu: [0.2, 0.0, 0.0])
    start = {"x0": [0.5, 0.1, -0.2], "xdot0": [0.0, 1.0, -0.7], "duration": 1.0}
    traj = pinred.simulate(
        system, **start, xi0=[0.0, 0.0, 0.0, 0.4, -0.3, 0.2], forces=[force],
        stops={"bend": (-0.5, 0.5)},
    )  # fmt: skip
    assert traj.motion.modes == ((0.0, "bend at its upper stop"),)
    locked = pinred.load("falling_cat", lock={"bend": 0.5})
    other = pinred.simulate(
        locked, x0=[0.1, -0.2], xdot0=[1.0, -0.7], xi0=[0.0, 0.0, 0.0, 0.4, -0.3, 0.2],
        duration=1.0,
    )  # fmt: skip
    np.testing.assert_allclose(traj.x[:, 1:], other.x, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(traj.xi, other.xi, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("method", ["Tsit5", "AdaptiveGauss", "Radau"])
def test_other_methods_find_the_impacts_of_dop853(method: str) -> None:
    system = pinred.load("falling_cat")
    stops = {name: pinred.Stop(-0.6, 0.6, 0.5) for name in system.shape_names}
    run = {"xdot0": [3.0, -2.0, 2.0], "x0": np.zeros(3), "duration": 1.0, "stops": stops}
    first, other = (pinred.simulate(system, method=m, **run) for m in ("DOP853", method))
    assert len(first.impacts) >= 3
    assert first.impacts.joint == other.impacts.joint
    np.testing.assert_allclose(first.impacts.t, other.impacts.t, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_random_trees_agree_with_full_state_dynamics(seed: int) -> None:
    assert_random_tree_agrees(seed)


@pytest.mark.by_hand
@pytest.mark.parametrize("seed", range(4, 100))
def test_many_random_trees_agree_with_full_state_dynamics(seed: int) -> None:
    assert_random_tree_agrees(seed)


def assert_random_tree_agrees(seed: int) -> None:
    """Assert that a random tree, with followers for odd seeds, agrees with the full state."""
    rng = np.random.default_rng(1000 + seed)
    group = ("R", "SO2", "SE2", "SO3", "SE3")[seed % 5]
    joints = int(rng.integers(2, 6))
    if seed % 2:
        system = make_case(group, joints + 1, seed).system
        chosen = [joint.name for joint in system.space.joints]
    else:
        system = pinred.load(random_model(group, joints, seed))
        chosen = [joint.name for joint in system.tree.joints]
    e = float(rng.choice([0.0, 0.5, 0.9, 1.0]))
    values = dict(zip(system.tree.x_names, system.joint_values(np.zeros(system.m)), strict=True))
    stops = {
        name: pinred.Stop(values[name] - rng.uniform(0.2, 0.5), values[name] + rng.uniform(0.2, 0.5), e)
        for name in chosen
    }
    run = {
        "x0": np.zeros(system.m), "xdot0": rng.normal(size=system.m),
        "xi0": 0.3 * rng.normal(size=system.r), "stops": stops,
    }  # fmt: skip
    traj = pinred.simulate(system, duration=2.0, **run)
    if len(traj.impacts) < 3:
        traj = pinred.simulate(system, duration=10.0, **run)
    assert len(traj.impacts) >= 1
    # Long chains of impacts amplify errors: the time is limited to the first 20 impacts.
    if len(traj.impacts) > 20:
        traj = pinred.simulate(system, duration=0.5 * float(traj.impacts.t[19:21].sum()), **run)
    assert_equal_motions(traj, reference_of(traj), times=1e-7, states=1e-6)
