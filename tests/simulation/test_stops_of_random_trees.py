"""Random trees with joint stops against full-state dynamics, to the growth of perturbations.

Both routes integrate with tight tolerances, so the remaining errors are those of the impacts and
rests. The growth of perturbations is measured with the full-state code, whose initial velocity is
changed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from coupled_trees import make_case
from hybrid_reference import AnyStop, HybridMotion, HybridReference, stops_of
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.simulation.impacts import ImpactTable

GROUPS = ("R", "SO2", "SE2", "SO3", "SE3")
KINDS = ("hinges and slides", "followers", "balls")
BOUNDED = 100  # first seed of trees whose balls have stops, too
PERTURBATION = 1e-9  # change of the initial rates [rad/s | m/s]
CLOSEST = 1e-6  # smallest time between impacts whose order is certain [s]
SLOWEST = 1e-3  # slowest impact that is compared, because accumulations have infinitely many
MOST = 60  # largest number of compared impacts


def stopped_tree(seed: int) -> tuple[pinred.System, dict[str, Any]]:
    """Return a random system, and its initial state and stops."""
    rng, joints = np.random.default_rng(1000 + seed), 2 + seed % 4
    group, kind = GROUPS[seed % 5], "balls" if seed >= BOUNDED else KINDS[seed // 5 % 3]
    if kind == "followers":
        system = make_case(group, joints + 1, seed).system
    elif kind == "balls":
        model = random_model(group, joints + 1, seed, armature=False, balls=0.4)
        system = pinred.load(model)
    else:
        system = pinred.load(random_model(group, joints, seed))
    # On a line without forces, nothing presses a joint that has come to rest, or pulls it away.
    e = float(rng.choice([0.5, 0.9, 1.0] if group == "R" else [0.0, 0.5, 0.9, 1.0]))
    x0 = system.space.neutral
    values = dict(zip(system.tree.x_names, system.joint_values(x0), strict=True))
    stops: dict[str, AnyStop] = {}
    for joint in system.space.joints:
        if joint.kind.is_ball and seed >= BOUNDED:
            limits: Any = {"angle": rng.uniform(0.3, 0.6)}
            if rng.random() < 0.7:
                limits = {"swing": rng.uniform(0.3, 0.6), "twist": (-0.4, rng.uniform(0.3, 0.6))}
            axis = tuple(rng.normal(size=3))
            stops[joint.name] = pinred.BallStop(**limits, axis=axis, restitution=e)
        elif not joint.kind.is_ball:
            lower, upper = values[joint.name] + rng.uniform(0.1, 0.5, 2) * [-1.0, 1.0]
            stops[joint.name] = pinred.Stop(lower, upper, e)
    start = {
        "x0": x0, "xdot0": 1.5 * rng.normal(size=system.m),
        "xi0": 0.5 * rng.normal(size=system.r), "stops": stops, "rtol": 1e-12, "atol": 1e-14,
    }  # fmt: skip
    return system, start


def certain_motion(seed: int) -> pinred.Trajectory:
    """Return a motion of 3 to 60 impacts, which ends before two of them are too close."""
    system, start = stopped_tree(seed)
    for duration in (2.0, 8.0, 32.0):
        traj = pinred.simulate(system, **start, duration=duration)
        times = traj.impacts.times
        close = np.append(np.diff(times) < CLOSEST, True)
        slow = [speeds_of(traj.impacts)[traj.impacts.t == t][0] < SLOWEST for t in times]
        most = min(MOST, *np.flatnonzero(close)[:1] + 1, *np.flatnonzero(slow)[:1])
        if len(times) > most:
            end = 0.5 * float(times[most] + (times[most - 1] if most else 0.0))
            traj = pinred.simulate(system, **start, duration=end)
        if len(traj.impacts.times) >= 3:
            return traj
    return traj


def speeds_of(table: ImpactTable) -> Array:
    """Return the speed of the fastest joint of each impact, for each row, (K,)."""
    speeds = np.abs(table.rate_before)
    return np.array([speeds[table.t == t].max() for t in table.t])


def motion_by_full_state(traj: pinred.Trajectory, v: Array) -> HybridMotion:
    """Return the motion of a trajectory's scene from an initial velocity, by full-state code."""
    system, stops = traj.system, stops_of(traj)
    shape, names = system.joint_values(traj.x[0]), system.tree.x_names
    positions = {name: float(shape[names.index(name)]) for name in stops if name in names}
    reference = HybridReference(system, stops, tolerance=3e-13)
    return reference.run(traj.q[0], v, positions, traj.t)


def assert_random_tree_agrees(seed: int) -> None:
    """Assert that impacts, modes and states of a random tree equal those of full-state code."""
    traj = certain_motion(seed)
    table, system = traj.impacts, traj.system
    _, start = stopped_tree(seed)
    direction = np.random.default_rng(seed).normal(size=system.m)
    change = PERTURBATION * direction / np.linalg.norm(direction)
    perturbed = start | {"xdot0": start["xdot0"] + change, "stops": None, "duration": 1e-9}
    v = pinred.simulate(system, **perturbed).v[0]
    motion, other = motion_by_full_state(traj, traj.v[0]), motion_by_full_state(traj, v)

    def distance(states: list[Array], others: Any) -> float:
        return float(np.abs(np.array(states) - np.array(others)).max())

    growth = max(distance(motion.q, other.q), distance(motion.v, other.v)) / PERTURBATION
    hits = [(hit.t, name) for hit in motion.hits for name in hit.joints]
    assert [name for _, name in hits] == list(table.joint)
    assert [name for hit in other.hits for name in hit.joints] == list(table.joint)
    modes = traj.motion.modes
    assert [label.count(" at its ") for _, label in modes] == [len(n) for _, n in motion.modes]
    assert all(n in a for (_, a), (_, b) in zip(modes, motion.modes, strict=True) for n in b)
    # A time has the error of the position, divided by the speed.
    errors = np.abs(table.t - [t for t, _ in hits]) * np.minimum(1.0, speeds_of(table))
    changed = abs(np.array([a - b for (a, _), (b, _) in zip(modes, motion.modes, strict=True)]))
    released = [k for k, (t, _) in enumerate(modes) if t not in set(table.t.tolist())]
    bound = 1e-9 * max(1.0, growth)
    assert errors.max() <= bound
    assert changed[released].max(initial=0.0) <= bound
    assert max(distance(motion.q, traj.q), distance(motion.v, traj.v)) <= bound
    assert momentum_jump(traj) <= 1e-13


def momentum_jump(traj: pinred.Trajectory) -> float:
    """Return the largest change of the momentum at an impact, relative to its terms."""
    system, model, data = traj.system, traj.system.model, traj.system.model.createData()
    times, momenta, terms = traj.impacts.times, [], []
    for states in (traj(times), traj(np.nextafter(times, np.inf))):
        for q, v in zip(states.q, states.v, strict=True):
            upper = np.triu(pin.crba(model, data, q))
            rows = (upper + np.triu(upper, 1).T)[: system.r]
            momenta.append(rows @ v)
            terms.append((np.abs(rows) @ np.abs(v)).max())
    before, after = np.split(np.array(momenta), 2)
    return float(np.abs(before - after).max() / max(terms))


# Trees of other groups run by default, with impacts, rests and releases.
@pytest.mark.by_hand("9", "12", "97", "51", "84")
@pytest.mark.parametrize("seed", [2, 9, 12, 51, 84, 97])
def test_random_trees_agree_with_full_state_dynamics(seed: int) -> None:
    """Trees of all kinds, with 3 to 36 impacts and some releases."""
    assert_random_tree_agrees(seed)


# The same group and restitution occur in case 32.
@pytest.mark.by_hand("2", "34")
@pytest.mark.parametrize("seed", [2, 32, 34])
def test_joints_that_follow_several_others_rest_at_their_stops(seed: int) -> None:
    """The full-state code has the follower as a joint of its own, with a multiplier."""
    system, rng = (
        make_case(("SE3", "SE2", "SO3")[seed % 3], 5, seed).system,
        np.random.default_rng(seed),
    )
    zero, names = np.zeros(system.m), system.tree.x_names
    values = dict(zip(names, system.joint_values(zero), strict=True))
    own = [coupling.follower for coupling in system.couplings if len(coupling.ratios) > 1]
    e = (0.0, 0.5)[seed % 2]
    stops = {name: pinred.Stop(values[name] - 0.3, values[name] + 0.25, e) for name in own}
    first = system.space.joints[0].name
    stops[first] = pinred.Stop(values[first] - 0.4, values[first] + 0.4)
    traj = pinred.simulate(
        system, x0=zero, xdot0=1.5 * rng.normal(size=system.m), xi0=0.5 * rng.normal(size=system.r),
        stops=stops, duration=2.0, rtol=1e-12, atol=1e-14,
    )  # fmt: skip
    assert {*traj.impacts.joint} & {*own}
    motion = motion_by_full_state(traj, traj.v[0])
    hits = [(hit.t, name) for hit in motion.hits for name in hit.joints]
    assert [name for _, name in hits] == list(traj.impacts.joint)
    np.testing.assert_allclose(traj.impacts.t, [t for t, _ in hits], rtol=0.0, atol=1e-9)
    assert len(traj.motion.modes) == len(motion.modes)
    np.testing.assert_allclose(traj.q, motion.q, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(traj.v, motion.v, rtol=0.0, atol=1e-9)


def test_continuous_joint_that_follows_several_others_has_no_stops() -> None:
    """Its coordinates are a cosine and a sine, which no equation of rest reads."""
    system = make_case("SO3", 5, 8).system
    (name,) = (coupling.follower for coupling in system.couplings)
    with pytest.raises(pinred.InputError, match=f"'{name}' follows 2 joints, and {name} is contin"):
        pinred.simulate(system, duration=0.1, stops={name: (-0.5, 0.5)}, x0=np.zeros(system.m))


@pytest.mark.by_hand
@pytest.mark.parametrize("seed", range(BOUNDED, BOUNDED + 40))
def test_random_trees_of_bounded_balls_agree_with_full_state_dynamics(seed: int) -> None:
    """Balls rest on cones and other surfaces, beside hinges and slides."""
    assert_random_tree_agrees(seed)


@pytest.mark.by_hand
@pytest.mark.parametrize("seed", range(100))
def test_many_random_trees_agree_with_full_state_dynamics(seed: int) -> None:
    """A hundred trees with 2 to 60 impacts each."""
    assert_random_tree_agrees(seed)
