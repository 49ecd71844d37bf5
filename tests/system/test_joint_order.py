"""Models whose joints are not in depth-first order: q and v keep the original order."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import groups, seeds
from trees import random_model

import pinred
from pinred.forces import Damper
from pinred.judge.reference_solution import FullState
from pinred.system.rebuild import depth_first


def shuffled(model: pin.Model, seed: int) -> pin.Model:
    """Return the same tree with its joints in another order, parents before children."""
    rng = np.random.default_rng(seed)
    other = pin.Model()
    other.name, other.gravity = model.name, model.gravity
    place = {0: 0}
    waiting = list(range(1, model.njoints))
    rotors = []
    while waiting:
        ready = [i for i in waiting if model.parents[i] in place]
        i = int(rng.choice(ready))
        waiting.remove(i)
        at = model.jointPlacements[i]
        place[i] = other.addJoint(place[model.parents[i]], model.joints[i], at, model.names[i])
        other.appendBodyToJoint(place[i], model.inertias[i], pin.SE3.Identity())
        joint = model.joints[i]
        rotors.append(model.armature[joint.idx_v : joint.idx_v + joint.nv])
    other.armature = np.concatenate(rotors)
    return other


@given(groups, st.integers(1, 7), seeds)
def test_q_and_v_use_order_of_original_model(group: str, joints: int, seed: int) -> None:
    """The kinematics of the original model places each joint for system.q as system.model does."""
    model = shuffled(random_model(group, joints, seed), seed)
    system = pinred.load(model)
    rng = np.random.default_rng(seed)
    pose = system.group.exp(rng.normal(size=system.r))
    x, xi, xdot = rng.normal(size=joints), rng.normal(size=system.r), rng.normal(size=joints)
    data, inside = model.createData(), system.model.createData()
    pin.forwardKinematics(model, data, system.q(pose, x), system.v(xi, xdot))
    q, v = system.model_q(pose, x), system.model_v(xi, xdot)
    pin.forwardKinematics(system.model, inside, q, v)
    for k, name in enumerate(model.names):
        mine = system.model.getJointId(name)
        assert data.oMi[k].isApprox(inside.oMi[mine], 1e-12)
        assert data.v[k].isApprox(inside.v[mine], 1e-12)
    at = system.configuration(system.q(pose, x))
    rate = system.velocity(system.v(xi, xdot))
    assert at.pose == pytest.approx(pose, abs=1e-14)
    assert np.cos(at.x) == pytest.approx(np.cos(x), abs=1e-14)
    assert np.array_equal(rate.xi, xi)
    assert np.array_equal(rate.xdot, xdot)


@pytest.mark.slow
def test_trajectory_uses_order_of_original_model() -> None:
    """The trajectory agrees with ABA, and the original model conserves energy along its q and v.

    Pinocchio's kinetic energy needs no depth-first order, unlike crba.
    """
    ordered = random_model("SE3", 6, seed=3)
    model = shuffled(ordered, 1)
    assert list(model.names) != list(ordered.names)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    system = pinred.load(model)
    assert system.shape_names != tuple(model.names)[2:]
    name = str(system.shape_names[0])
    for engine in ("compiled", "pinocchio"):
        traj = pinred.simulate(
            system, seed=1, duration=0.5, forces=[Damper(name, 0.1)], engine=engine
        )
        assert pinred.compare(traj).passed
        data, bare = model.createData(), model.copy()
        bare.armature = np.zeros(model.nv)
        for q, v, energy in zip(traj.q, traj.v, traj.energy, strict=True):
            kinetic = pin.computeKineticEnergy(bare, data, q, v) + 0.5 * model.armature @ v**2
            potential = pin.computePotentialEnergy(model, data, q)
            assert kinetic + potential == pytest.approx(energy, rel=1e-9, abs=1e-9)
    assert (
        np.abs(FullState(traj.scene).q(np.concatenate([traj.pose[0], traj.x[0]])) - traj.q[0]).max()
        > 0.01
    )


def test_depth_first_order_takes_linear_time() -> None:
    """Each joint occurs once, followed by its subtree, also in long chains and large stars."""
    assert depth_first([0, 0, 1, 1, 2, 3, 2]) == [1, 2, 4, 6, 3, 5]
    assert depth_first([0, *range(100_000)]) == list(range(1, 100_001))
    assert depth_first([0] * 100_001) == list(range(1, 100_001))
