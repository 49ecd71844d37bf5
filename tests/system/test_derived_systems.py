"""Systems made from others: links, frames, and the limits of what can be joined or cut."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from meeting_pairs import random_robot
from trees import placement

import pinred
from pinred import InputError, System
from pinred.common.arrays import Array
from pinred.system.assembly import take_apart
from pinred.system.copy_model import rebuild
from pinred.system.derived_systems import Instant, Moving, carry_state, join, pair, reroot

REST = (0.0, 0.0, 0.0)
HERE = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def mass_matrix(system: System, x: Array) -> Array:
    """Return the mass matrix of all joints, (nv, nv)."""
    model = system.sorted_model
    upper = np.triu(
        pin.crba(model, model.createData(), system.sorted_q(system.group.identity(), x))
    )
    return np.asarray(upper + np.triu(upper, 1).T)


@pytest.mark.parametrize("name", ["satellite_two_arms", "gripper", "diver", "falling_cat_ball"])
def test_assembly_of_a_system_makes_the_same_model(name: str) -> None:
    """Taking a robot apart and building it again keeps mass matrices, bit by bit."""
    system = pinred.load(name)
    model = take_apart(system).model(name)
    x = system.space.normalized(np.random.default_rng(0).normal(size=system.nx), "x", near=False)
    q = system.sorted_q(system.group.identity(), x)
    found = np.triu(pin.crba(model, model.createData(), q))
    np.testing.assert_array_equal(found, np.triu(mass_matrix(system, x)))
    assert list(model.names) == list(system.sorted_model.names)
    for kind in ("lowerPositionLimit", "upperVelocityLimit", "upperEffortLimit", "armature"):
        np.testing.assert_array_equal(getattr(model, kind), getattr(system.sorted_model, kind))


@pytest.mark.parametrize("kind", ["trees", "balls", "followers", "flat"])
@pytest.mark.sampled
def test_other_root_keeps_energy_momentum_and_places(kind: str) -> None:
    """A robot with each link as its root moves alike; back at its own root it is the same."""
    rng = np.random.default_rng(3)
    system = random_robot(kind, 11, rng)
    start = pinred.Scene(system=system, seed=1, pose0=system.group.exp(np.ones(system.r))).start
    state = Instant(start.pose, start.x, start.xdot, start.xi)
    for joint in range(1, system.model.njoints):
        other = reroot(system, link=f"link {joint}")
        moved = carry_state([Moving(system, state)], other)
        energies, momenta, centres = zip(
            *(totals(s, i) for s, i in ((system, state), (other, moved))), strict=True
        )
        assert energies[0] == pytest.approx(energies[1], rel=1e-13)
        np.testing.assert_allclose(momenta[0], momenta[1], rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(centres[0], centres[1], rtol=1e-12, atol=1e-13)
        back = reroot(other, link="link 1")
        again = carry_state([Moving(other, moved)], back)
        for joint_again in back.space.joints:
            own = next(j for j in system.space.joints if j.name == joint_again.name)
            np.testing.assert_allclose(again.x[joint_again.x], state.x[own.x], atol=1e-15)
            np.testing.assert_allclose(again.xdot[joint_again.v], state.xdot[own.v], atol=1e-13)
        np.testing.assert_allclose(again.xi, state.xi, atol=1e-12)


def totals(system: System, state: Instant) -> tuple[float, Array, Array]:
    """Return kinetic energy, momentum about the centre of mass, and the centre of mass."""
    model, data = system.sorted_model, system.sorted_model.createData()
    q, v = system.sorted_q(state.pose, state.x), system.sorted_v(state.xi, state.xdot)
    pin.computeCentroidalMomentum(model, data, q, v)
    H = mass_matrix(system, state.x)
    return float(0.5 * v @ H @ v), data.hg.vector.copy(), pin.centerOfMass(model, data, q).copy()


@pytest.mark.parametrize("group", ["R", "SO2", "SE2", "SO3", "SE3", "RxSE2"])
def test_pair_of_robots_has_both_energies(group: str) -> None:
    """Both robots move freely in one system: energy and momentum are the sums."""
    systems, states = [], []
    for name in "ab":
        rock = pinred.Model(name).body(name, mass=2.0, inertia=[1, 2, 2.5], com=[0.1, 0.2, 0.3])
        systems.append(pinred.load(rock, group=group, gravity=REST))
        rng = np.random.default_rng(ord(name))
        r = systems[-1].r
        pose = systems[-1].group.exp(rng.normal(size=r))
        states.append(Instant(pose, np.empty(0), np.empty(0), rng.normal(size=r)))
    both = pair(*systems, prefix="")
    parts = [Moving(s, i) for s, i in zip(systems, states, strict=True)]
    state = carry_state(parts, both)
    alone = [totals(s, i) for s, i in zip(systems, states, strict=True)]
    energy, _, com = totals(both, state)
    assert energy == pytest.approx(sum(entry[0] for entry in alone), rel=1e-14)
    np.testing.assert_allclose(com, np.mean([entry[2] for entry in alone], axis=0), atol=1e-15)


def test_rebuilt_model_keeps_the_links_above_frames() -> None:
    """A new root does not lose which link carries a frame, on which cuts depend."""
    model = pinred.Model().body("bus", mass=1.0, inertia=1.0)
    model = model.fixed("mast", parent="bus", at=[0, 0, 1], mass=0.5, inertia=0.1)
    model = model.hinge("arm", parent="mast", axis="y", mass=1.0, inertia=1.0)
    raw = pin.buildModelFromXML(model.urdf())
    new = rebuild(raw, root=pin.JointModelFreeFlyer())

    def above(m: pin.Model, frame: str) -> str:
        entry = m.frames[m.getFrameId(frame, pin.FrameType.BODY)]
        joint = m.frames[entry.parentFrame]
        return f"{joint.name} on {m.frames[joint.parentFrame].name}"

    for frame in ("mast", "arm"):
        assert above(new, frame) == above(raw, frame)
    assert [*take_apart(pinred.load(model, gravity=REST)).links] == ["bus", "mast", "arm"]


def test_body_stays_whole_if_the_link_below_a_joint_is_unknown() -> None:
    """Without the frame of a joint, nothing says which of two fixed links carries it."""
    model = pinred.Model().body("bus", mass=1.0, inertia=1.0)
    model = model.fixed("mast", parent="bus", at=[0, 0, 1], mass=0.5, inertia=0.1)
    model = model.hinge("arm", parent="mast", axis="y", mass=1.0, inertia=1.0)
    system = pinred.load(model, gravity=REST)
    joint = system.model.getFrameId("arm", pin.FrameType.JOINT)
    bare = rebuild(system.model, without_frames={joint})
    assert [*take_apart(System(bare, contents=system.contents)).links] == ["bus", "arm"]


def test_links_whose_inertias_do_not_add_up_stay_together() -> None:
    """A body that is not the sum of its links cannot be cut between them."""
    model = pinred.Model().body("bus", mass=1.0, inertia=1.0)
    system = pinred.load(model.fixed("mast", parent="bus", mass=0.5, inertia=0.1), gravity=REST)
    assert [*take_apart(system).links] == ["bus", "mast"]
    other = system.model.copy()
    other.inertias[1] = pin.Inertia(
        other.inertias[1].mass * (1.0 + 4e-9), other.inertias[1].lever, other.inertias[1].inertia
    )
    heavier = System(other, contents=system.contents)
    assert [*take_apart(heavier).links] == ["bus"]
    with pytest.raises(InputError, match=r"frame on link 'bus'.*states no inertia of its own"):
        pinred.release(pinred.Scene(system=heavier, xi0=np.ones(6)), "mast")


def planar_robot(tilt: float, root_tilt: float) -> System:
    """Return a planar robot with a hinge and a root that are tilted out of the plane [rad]."""
    model = pin.Model()
    model.gravity.setZero()
    place = pin.SE3(pin.utils.rotate("x", root_tilt), np.zeros(3))
    root = model.addJoint(0, pin.JointModelPlanar(), place, "root")
    at = pin.SE3(pin.utils.rotate("x", tilt), np.zeros(3))
    hinge = model.addJoint(root, pin.JointModelRZ(), at, "hinge")
    for joint in (root, hinge):
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"link {joint}", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    return System(model, "flat")


def test_slightly_tilted_planes_are_refused() -> None:
    """Axes that differ by 5e-9 leave the group; round-off does not."""
    flat = planar_robot(0.0, 0.0)
    options: dict[str, Any] = {"at": "link 2", "onto": "link 1", "offset": HERE, "prefix": "b_"}
    assert join(flat, planar_robot(0.0, 1e-12), **options).group.name == "SE2"
    with pytest.raises(InputError, match="about different axes"):
        join(flat, planar_robot(0.0, 5e-9), **options)
    assert join(planar_robot(1e-12, 0.0), flat, **options).m == 2
    with pytest.raises(InputError, match="joint 'hinge' of 'flat' moves the frame out"):
        join(planar_robot(5e-9, 0.0), flat, **options)


def test_coupled_joints_cannot_be_separated() -> None:
    """A cut between a follower and its leader is refused by name."""
    text = """<robot name="r"><link name="a">I</link><link name="b">I</link><link name="c">I</link>
    <joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <origin xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
    <joint name="k" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
    <origin xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
    <mimic joint="j" multiplier="2"/></joint></robot>"""
    inertia = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
    inertia += 'iyz="0"/></inertial>'
    system = pinred.load(text=text.replace("I<", f"{inertia}<"), group="SE3", gravity=REST)
    with pytest.raises(InputError, match=r"Coupling of 'r' connects parts.*k, j"):
        pinred.release(pinred.Scene(system=system, xdot0=[1.0]), "c")


@pytest.mark.filterwarnings("ignore:.*singular at single shapes")
def test_cut_drops_joints_that_move_nothing_any_more() -> None:
    """A massless link on a joint goes with the body that it carried; frames without mass stay."""
    model = pinred.Model().body("bus", mass=1.0, inertia=1.0).fixed("eye", parent="bus")
    model = model.ball("wrist", parent="bus", at=[1, 0, 0], mass=1.0, inertia=1.0)
    system = pinred.load(model, balls=[], gravity=REST)  # a ball as three hinges
    assert system.m == 3
    release = pinred.release(pinred.Scene(system=system, seed=1), "wrist")
    assert release.carrier.system.m == 0
    assert [*take_apart(release.carrier.system).links] == ["bus", "eye"]
    assert release.released.system.mass == 1.0


def test_joined_robot_of_any_place_is_symmetric() -> None:
    """Joining a to b or b to a gives the same robot but for its root."""
    rng = np.random.default_rng(5)
    a, b = (random_robot("balls", seed, rng) for seed in (21, 22))
    offset = placement(rng)
    first = join(a, b, at="tip", onto="tip", offset=pin.SE3ToXYZQUAT(offset), prefix="b_")
    second = join(
        b, a, at="tip", onto="tip", offset=pin.SE3ToXYZQUAT(offset.inverse()), prefix="a_"
    )
    assert first.n == second.n
    assert first.mass == pytest.approx(second.mass, rel=1e-15)
    assert len(take_apart(first).links) == len(take_apart(second).links)
