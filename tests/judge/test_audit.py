"""What Pinocchio says of states, in its units: each change and each difference shows as it is."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from tampering import offset, tampered
from trees import random_model

import pinred
from pinred import forces
from pinred.common.arrays import Array
from pinred.judge.audit import Audit, audit_states, audit_trajectory
from pinred.judge.reference_solution import FullState


@cache
def tree() -> pinred.System:
    """A tree on a free base, without gravity."""
    return pinred.load(random_model("SE3", 3, 1, armature=False))


def held(speed: float = 1.0, fall: float = 0.0) -> pinred.State:
    """Three times one state.  speed: of all its rates.  fall: of the whole, up [m/s]."""
    state = pinred.simulate(tree(), seed=0, times=[0.0, 0.1]).states
    rates = {"xi", "xdot", "v", "body_momentum", "spatial_momentum"}
    given = {
        each.name: np.repeat(getattr(state, each.name)[:1], 3, axis=0)
        * (speed if each.name in rates else 1.0)
        for each in fields(state)
    }
    q, turn = given["q"][0], pin.Quaternion(state.q[0, 3:7]).matrix()
    given["v"][:, :3] += turn.T @ [0.0, 0.0, fall]
    given["xi"] = given["v"][:, :6].copy()
    inertia = pin.crba(tree().model, tree().data, q)
    H = np.triu(inertia) + np.triu(inertia, 1).T
    given["energy"] = 0.5 * np.einsum("ti,ij,tj->t", given["v"], H, given["v"])
    given["body_momentum"] = given["v"] @ H[:6].T
    to_root = pin.SE3(turn, q[:3]).toDualActionMatrix()
    given["spatial_momentum"] = given["body_momentum"] @ to_root.T
    return pinred.State(**given)


def audit(state: pinred.State, work: float = 0.0, impulse: Array | None = None) -> Audit:
    """The audit, if so much had been done until the second time."""
    given = None if impulse is None else np.array([0.0 * impulse, impulse, 0.0 * impulse])
    scene = pinred.Scene(system=tree(), seed=0)
    return audit_states(FullState(scene), state, np.array([0.0, work, 0.0]), given)


def measures(state: pinred.State) -> tuple[float, float, float, float]:
    """Mass, radius of gyration, kinetic energy, and the part of it about the centre of mass."""
    model, data, q, v = tree().model, tree().data, state.q[0], state.v[0]
    kinetic = pin.computeKineticEnergy(model, data, q, v)
    pin.ccrba(model, data, q, v)
    mass = data.Ig.mass
    carried = 0.5 * data.hg.linear @ data.hg.linear / mass
    return mass, np.sqrt(np.trace(data.Ig.inertia) / mass), kinetic, kinetic - carried


def test_states_agree() -> None:
    """With those that Pinocchio's q and v have."""
    found = audit(held())
    assert found.energy == 0.0
    assert found.momentum == 0.0
    assert found.fields < 1e-14


def test_slow_states_are_compared_in_their_own_size() -> None:
    """A twist of 1e-4 that is off by a tenth is off by as much of the largest rate."""
    state = held(speed=1e-4)
    xi = state.xi.copy()
    xi[1] *= 1.1
    found = audit(replace(state, xi=xi)).fields
    assert found == pytest.approx(0.1 * np.abs(xi[0]).max() / np.abs(state.v).max())


def test_rest_drifts_by_nothing() -> None:
    """Without energy there is no unit of momenta, and no change of them."""
    state = held(speed=0.0)
    found = audit(state)
    assert found.momentum == found.energy == 0.0
    momenta = state.body_momentum.copy()
    momenta[1, 2] = 1e-3  # where nothing moves, in kg m/s
    assert audit(replace(state, body_momentum=momenta)).fields == pytest.approx(1e-3)


@pytest.mark.parametrize("part", [1e-9, 0.3])
def test_energy_that_nobody_gave(part: float) -> None:
    """Relative to the kinetic energy about the centre of mass, however fast that moves."""
    for fall in (0.0, 20.0):
        state = held(fall=fall)
        internal = measures(state)[3]
        assert audit(state, part * internal).energies == pytest.approx([0.0, -part, 0.0])


@pytest.mark.parametrize(("part", "seen"), [(0.5, False), (1.6, True)])
def test_round_off_of_energies(part: float, seen: bool) -> None:
    """Of twice the kinetic energy and of the whole, 1e-14 are nothing."""
    state = held(fall=20.0)
    kinetic = measures(state)[2]
    assert (audit(state, part * 1e-14 * 3.0 * kinetic).energy > 0.0) is seen


@pytest.mark.parametrize(("ratio", "of_all"), [(3e-9, False), (0.6e-9, True)])
def test_what_only_falls(ratio: float, of_all: bool) -> None:
    """Where hardly anything moves inside, changes are those of the energy of falling."""
    state = held()
    mass, _, kinetic, internal = measures(state)
    state = held(fall=np.sqrt(2.0 * internal / (ratio * mass)))
    _, _, kinetic, internal = measures(state)
    scale = kinetic if of_all else internal
    assert audit(state, 0.1 * kinetic).energies[1] * scale == pytest.approx(-0.1 * kinetic, rel=0.1)


@pytest.mark.parametrize(("energy", "relative"), [(3e-290, True), (0.2e-290, False)])
def test_energies_that_are_hardly_numbers(energy: float, relative: bool) -> None:
    """They count in joules."""
    state = held()
    state = held(speed=np.sqrt(energy / measures(state)[3]))
    internal = measures(state)[3]
    assert internal == pytest.approx(energy, rel=0.3)
    found = audit(state, 0.5 * internal).energies[1]
    assert found == pytest.approx(-0.5 if relative else -0.5 * internal, rel=1e-3, abs=0.0)
    own = float(state.energy[0])
    doubled = audit(replace(state, energy=2.0 * state.energy)).fields
    assert doubled == pytest.approx(own / max(own, 1e-290))


@pytest.mark.parametrize("axis", range(6))
def test_momentum_that_nobody_gave(axis: int) -> None:
    """Relative to √(2mT), of the turn times the radius of gyration."""
    state = held()
    mass, radius, _, internal = measures(state)
    scale = np.sqrt(2.0 * mass * internal) * (1.0 if axis < 3 else radius)
    model, data = tree().model, tree().data
    of_v = pin.computeCentroidalMap(model, data, state.q[0])  # about the centre of mass, in world
    of_v = np.kron(np.eye(2), model.jointPlacements[1].rotation.T) @ of_v
    v = state.v.copy()
    v[1] += np.linalg.pinv(of_v)[:, axis] * 1e-6 * scale
    found = audit(replace(state, v=v)).momenta[1]
    assert found == pytest.approx(1e-6 * np.eye(6)[axis], rel=1e-4, abs=1e-10)


@pytest.mark.parametrize("axis", range(6))
def test_impulses_are_cleared(axis: int) -> None:
    """About the origin then, and relative to the largest momentum there, if that is more."""
    impulse = 1e-3 * np.eye(6)[axis]
    for fall in (0.0, 20.0):
        state = held(fall=fall)
        mass, radius, _, internal = measures(state)
        own = np.sqrt(2.0 * mass * internal) * (1.0 if axis < 3 else radius)
        scale = max(own, np.abs(state.spatial_momentum).max())
        assert audit(state, 0.0, impulse).momenta[1] * scale == pytest.approx(-impulse)


def test_work_of_wrenches_is_what_energy_is_a_part_of() -> None:
    """Where they push all of it, in parts of the work, if that is more than moves inside."""
    state = held()
    work = 5.0 * measures(state)[3]
    assert audit(state, work, np.zeros(6)).energies == pytest.approx([0.0, -1.0, 0.0])
    assert audit(state, work).energies == pytest.approx([0.0, -5.0, 0.0])


@pytest.mark.parametrize("impulse", [None, np.zeros((3, 6))])
def test_work_is_counted_from_the_first_state(impulse: Array | None) -> None:
    """What had been done before that is no drift, and none of what energy is a part of."""
    state = held()
    work = measures(state)[3] * np.array([3.0, 3.5, 3.0])
    scene = pinred.Scene(system=tree(), seed=0)
    found = audit_states(FullState(scene), state, work, impulse)
    assert found.energies == pytest.approx([0.0, -0.5, 0.0])


@pytest.mark.parametrize(
    "name", ["pose", "xi", "xdot", "body_momentum", "spatial_momentum", "energy"]
)
def test_each_field_is_compared(name: str) -> None:
    """For itself, relative to the largest number of its kind."""
    state = held()
    mass, radius, _, internal = measures(state)
    of_momentum = np.sqrt(2.0 * mass * internal) * max(1.0, radius)
    least = {"pose": 1.0, "energy": internal, "xi": 0.0, "xdot": 0.0}.get(name, of_momentum)
    kind = state.v if name in ("xi", "xdot") else getattr(state, name)
    largest = max(least, float(np.abs(kind).max()))
    for change, seen in ((1e-6 * largest, 1e-6), (np.nan, np.nan)):
        values = getattr(state, name).copy()
        values[1] += change
        found = audit(replace(state, **{name: values})).fields
        assert found == pytest.approx(seen, rel=1e-3, nan_ok=True)


def test_small_angles_are_compared_in_radians() -> None:
    """Of two hinges that hardly turn, 1e-5 rad are 1e-5."""
    model = pin.Model()
    for i, joint in enumerate((pin.JointModelRZ(), pin.JointModelRX())):
        at = model.addJoint(i, joint, pin.SE3.Identity(), f"hinge{i}")
        model.appendBodyToJoint(at, pin.Inertia.FromSphere(1.0, 0.2), pin.SE3(1))
    model.gravity.setZero()
    traj = pinred.simulate(pinred.load(model), x0=[0.02], xdot0=[0.01], xi0=[0.0], times=[0.0, 0.1])
    wrong = replace(traj.states, pose=traj.states.pose + 1e-5)
    found = audit_states(FullState(traj.scene), wrong, np.zeros(2), None).fields
    assert found == pytest.approx(1e-5, rel=1e-6)


def pushed() -> pinred.Trajectory:
    """A tree with a thruster."""
    thruster = forces.Wrench([0.3, 0.1, 0.0, 0.2, 0.0, 0.1])
    return pinred.simulate(tree(), seed=0, duration=1.0, forces=thruster)


def hanging() -> pinred.Trajectory:
    """A tree on a pivot beside its centre of mass, in gravity."""
    model = random_model("SO3", 2, 1)
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    return pinred.simulate(pinred.load(model), seed=0, duration=1.0)


def falling() -> pinred.Trajectory:
    """A tree on a planar base that falls, with springs."""
    model = random_model("SE2", 2, 3)
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    system = pinred.load(model)
    springs = dict.fromkeys(system.shape_names, (3.0, 0.2))
    return pinred.simulate(system, seed=1, duration=1.0, springs=springs)


@pytest.mark.parametrize("make", [pushed, hanging, falling])
def test_work_impulse_and_fall_are_cleared(make: object) -> None:
    """What forces and gravity do is no drift; what is not theirs is."""
    assert callable(make)
    traj = make()
    found = audit_trajectory(traj, traj.states)
    assert max(found.energy, found.momentum, found.fields) < 1e-9
    wrong = tampered(traj, offset("v", traj.system.r - 1, 1e-4))
    found = audit_trajectory(wrong, wrong(traj.t))
    assert min(found.energy, found.momentum) > 1e-6
