"""Motions of robots with follower joints: both engines against ABA with multipliers."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import aba
import numpy as np
import pinocchio as pin
import pytest
from coupled_trees import make_case, multipliers
from robot_texts import joint, link, robot, write
from trees import limbed_model, unequal_limbs_model

import pinred
from pinred import InputError
from pinred.common.arrays import Array
from pinred.forces import PD, ComputedTorque, Controller, Damper, Limit, Spring, Torque
from pinred.kernels.build import model_bytes
from pinred.reduction.tree.body_frames import bodies_of
from pinred.reduction.tree.coupled_groups import Groups
from pinred.reduction.tree.identical_branches import Lanes, links_of
from pinred.system.robot_file_contents import Contents, Coupling

Engine = Literal["compiled", "pinocchio"]
ENGINES: list[Engine] = ["compiled", "pinocchio"]


@pytest.mark.by_hand("compiled-SE3-1", "compiled-SO3-3", "compiled-R-5")
@pytest.mark.sampled
@pytest.mark.parametrize(
    ("group", "seed"),
    [("SE3", 0), ("SE3", 1), ("SE2", 2), ("SO3", 3), ("SO2", 4), ("R", 5), ("RxSE2", 6)],
)
@pytest.mark.parametrize("engine", ENGINES)
def test_coupled_trees_agree_with_aba_with_multipliers(
    group: str, seed: int, engine: Engine
) -> None:
    """Random trees have random couplings, with gravity where the group allows it."""
    case = make_case(group, 6, seed, heavy=True)
    system = case.system
    traj = pinred.simulate(system, seed=seed, duration=0.4, engine=engine, rtol=1e-11, atol=1e-13)
    tau = multipliers(system)
    q, v = aba.integrate(system.model, traj.q[0], traj.v[0], traj.t, tau, rtol=1e-12)
    assert aba.max_difference(system.model, q, traj.q) < 1e-8
    np.testing.assert_allclose(traj.v, v, atol=1e-8 * max(1.0, np.abs(v).max()))
    # q and v of all joints, each where its leader puts it.
    names = list(system.model.names)[2:]
    every = system.joint_values(traj.x)
    for each in system.couplings:
        leaders = every[:, [names.index(name) for name in each.leaders]]
        follower = leaders @ [*each.ratios.values()] + each.offset
        np.testing.assert_allclose(every[:, names.index(each.follower)], follower, atol=1e-13)


@pytest.fixture
def crank() -> pinred.System:
    """Return two wheels on parallel axes, the second geared to the first."""
    return _geared(-2.5)


def _geared(ratio: float, armature: float = 0.0, offset: float = 0.3) -> pinred.System:
    model = pin.Model()
    model.gravity.setZero()
    base = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, _wheel(3.0), pin.SE3.Identity())
    for name, moment in (("first", 1.0), ("second", 2.0)):
        place = pin.SE3(np.eye(3), np.zeros(3))
        wheel = model.addJoint(base, pin.JointModelRZ(), place, name)
        model.appendBodyToJoint(wheel, _wheel(moment), pin.SE3.Identity())
    model.armature = np.array([0.0, 0.0, armature])
    contents = Contents(couplings=(Coupling("second", {"first": ratio}, offset),))
    return pinred.System(model, "geared", contents=contents)


def _wheel(moment: float) -> pin.Inertia:
    return pin.Inertia(1.0, np.zeros(3), moment * np.eye(3))


@pytest.mark.parametrize("engine", ENGINES)
def test_geared_wheels_agree_with_closed_form(engine: Engine) -> None:
    """A spring between the base and the first: θ̈ = −k θ / M, in closed form.

    With moments I, J₁, J₂ and rotors a on the second: M̃ = J₁ + k² (J₂ + a), I A = J₁ + k J₂ and
    M = M̃ − (J₁ + k J₂)² / (I + J₁ + J₂).
    """
    ratio, armature, stiffness = -2.5, 0.4, 5.0
    system = _geared(ratio, armature)
    whole = 1.0 + ratio**2 * (2.0 + armature)
    M = whole - (1.0 + ratio * 2.0) ** 2 / 6.0
    red = pinred.Reduction(system)
    assert red.reduced_metric([0.1])[0, 0] == pytest.approx(M, rel=1e-14)
    traj = pinred.simulate(
        system, x0=[0.7], springs={"first": (stiffness, 0.0)}, momentum=0, duration=2.0,
        engine=engine,
    )  # fmt: skip
    expected = 0.7 * np.cos(np.sqrt(stiffness / M) * traj.t)
    np.testing.assert_allclose(traj.x[:, 0], expected, atol=1e-8)
    np.testing.assert_allclose(traj.q[:, 2], ratio * expected + 0.3, atol=1e-8)
    # The base turns against both: ξ = −A ẋ.
    turned = -(1.0 + ratio * 2.0) / 6.0 * (expected - 0.7)
    np.testing.assert_allclose(traj.pose[:, 0], turned, atol=1e-8)


@pytest.mark.parametrize("engine", ENGINES)
def test_spring_on_follower_agrees_with_closed_form(engine: Engine) -> None:
    """V = ½ c (k y + b − rest)² acts on the leader with the stiffness c k²."""
    system = _geared(-2.5)
    own = {"second": (5.0, 0.5)}
    through = {"first": (5.0 * 2.5**2, (0.5 - 0.3) / -2.5)}
    a, b = (
        pinred.simulate(system, x0=[0.7], springs=s, duration=2.0, engine=engine)
        for s in (own, through)
    )
    np.testing.assert_allclose(a.x, b.x, atol=1e-12)
    np.testing.assert_allclose(a.energy, b.energy, atol=1e-11)


@pytest.mark.slow
def test_forces_on_follower_act_on_leader_times_ratio(crank: pinred.System) -> None:
    """Torque, damper, PD, limits and controllers act on the leader, multiplied by the ratio."""
    k, b = -2.5, 0.3
    pairs = [
        (Torque({"second": 2.0}), Torque({"first": 2.0 * k})),
        (Torque({"second": 2.0, "first": 1.0}), Torque({"first": 2.0 * k + 1.0})),
        (Damper("second", 0.7), Damper("first", 0.7 * k**2)),
        (
            PD({"second": 0.9}, kp=3.0, kd=0.5),
            PD({"first": (0.9 - b) / k}, kp=3.0 * k**2, kd=0.5 * k**2),
        ),
        (
            Torque({"second": lambda _t, x, xdot, _mu: x["second"] - xdot["second"]}),
            Torque({"first": lambda _t, x, xdot, _mu: k * (k * x[0] + b - k * xdot[0])}),
        ),
        (
            Torque({"second": 9.0}, limit=Limit({"second": 2.0})),
            Torque({"first": 2.0 * k}),
        ),
        (
            Controller(lambda t, *_: [0.5 * t], period=0.1, joints=("second",)),
            Controller(lambda t, *_: [0.5 * t * k], period=0.1, joints=("first",)),
        ),
        (Spring("second", 2.0, to="first"), Spring("first", 2.0 * (k - 1) ** 2, b / (1 - k))),
    ]
    for through, direct in pairs:
        a, c = (
            pinred.simulate(crank, x0=[0.2], xdot0=[1.0], duration=0.5, forces=[force])
            for force in (through, direct)
        )
        np.testing.assert_allclose(a.x, c.x, atol=1e-11, err_msg=str(through))
        assert a.energy_balance.residual == pytest.approx(0.0, abs=1e-9)


@pytest.mark.by_hand("pinocchio")
@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_followers_of_prescribed_leader_follow_the_plan(engine: Engine) -> None:
    """One torque on the prescribed leader drives all its followers."""
    system = make_case("SE3", 6, 1).system
    leads = [n for each in system.couplings for n, ratio in each.ratios.items() if ratio != 0.0]
    chosen = next(name for name in leads if name in system.shape_names)
    traj = pinred.simulate(
        system, seed=1, duration=0.5, prescribed={chosen: "0.3*sin(2*t)"}, rtol=1e-11,
        atol=1e-13, engine=engine,
    )  # fmt: skip
    i = system.shape_names.index(chosen)
    np.testing.assert_allclose(traj.x[:, i], 0.3 * np.sin(2.0 * traj.t), atol=1e-13)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    # The drive acts on the leader alone; the multipliers carry it to the others.
    at = system.r + system.tree.names.index(chosen)
    for k in (0, len(traj.t) // 2, -1):
        tau = np.zeros(system.model.nv)
        tau[at] = traj.driving_torques[k, 0]
        a = _tied_acceleration(system, traj.q[k], traj.v[k], tau)
        assert a[at] == pytest.approx(-1.2 * np.sin(2.0 * traj.t[k]), abs=1e-7)


def _tied_acceleration(system: pinred.System, q: Array, v: Array, tau: Array) -> Array:
    """Return the acceleration under forces, by ABA with multipliers."""
    model = system.model
    upper = np.triu(pin.crba(model, model.createData(), q))
    H = upper + np.triu(upper, 1).T
    names, r = list(model.names)[2:], system.r
    J = np.zeros((len(system.couplings), model.nv))
    for row, each in zip(J, system.couplings, strict=True):
        row[r + names.index(each.follower)] = 1.0
        for leader, ratio in each.ratios.items():
            row[r + names.index(leader)] -= ratio
    bias = pin.nonLinearEffects(model, model.createData(), q, v)
    whole = np.block([[H, J.T], [J, np.zeros((len(J), len(J)))]])
    return np.asarray(np.linalg.solve(whole, np.append(tau - bias, np.zeros(len(J))))[: model.nv])


def test_options_of_followers_name_the_leader(crank: pinred.System) -> None:
    """Followers are no coordinates; the message names the leader."""
    words = r"'second' follows 'first' \(second = -2\.5·first \+ 0\.3\)"
    for options in (
        {"x0": {"second": 0.1}},
        {"xdot0": {"second": 0.1}},
        {"x0": [0.1], "prescribed": {"second": "t"}},
        {"x0": [0.1], "forces": [ComputedTorque({"second": 0.1}, kp=1.0, kd=1.0)]},
        {"q0": [0.0, 0.1, 0.1]},
        {"v0": [0.0, 0.1, 0.1]},
    ):
        with pytest.raises(InputError, match=words):
            pinred.Scene(system=crank, duration=1.0, **options)
    with pytest.raises(InputError, match=words):
        pinred.Reduction(crank, springs={"second": (1.0, 0.0)})


def test_q0_and_v0_of_all_joints_are_accepted(crank: pinred.System) -> None:
    """Pinocchio's coordinates are accepted if the followers agree with their leaders."""
    scene = pinred.Scene(system=crank, duration=1.0, q0=[0.2, 0.1, 0.05], v0=[1.0, 2.0, -5.0])
    assert (scene.start.x.tolist(), scene.start.xdot.tolist()) == ([0.1], [2.0])
    np.testing.assert_allclose(pinred.simulate(scene).q[0], [0.2, 0.1, 0.05], atol=1e-15)


def test_computed_torque_of_leader_tracks_exactly(crank: pinred.System) -> None:
    """The leader follows its reference under inverse dynamics of the coupled system."""
    force = ComputedTorque({"first": 0.1}, kp=0.0, kd=0.0)
    traj = pinred.simulate(crank, x0=[0.2], xdot0=[1.0], duration=0.5, forces=[force])
    np.testing.assert_allclose(traj.x[:, 0], 0.2 + traj.t, atol=1e-9)


# Every run has computed torques of test_controllers and coupled trees above.
@pytest.mark.by_hand
@pytest.mark.slow
def test_computed_torque_of_coupled_tree_gives_zero_accelerations() -> None:
    """With zero gains, the joints of a branched tree move at constant rates."""
    system = make_case("SE3", 5, 3).system
    force = ComputedTorque(dict.fromkeys(system.shape_names, 0.0), kp=0.0, kd=0.0)
    x0, xdot0 = np.full(system.m, 0.3), np.linspace(-0.5, 0.5, system.m)
    traj = pinred.simulate(system, x0=x0, xdot0=xdot0, duration=0.3, forces=[force])
    np.testing.assert_allclose(traj.x, x0 + traj.t[:, None] * xdot0, atol=1e-8)


def test_file_of_coupled_robot_restores_robot_and_motion(tmp_path: Path) -> None:
    """A file contains q of all joints, and the robot."""
    text = robot(
        *(link(name) for name in "abc"), joint("a", "b"),
        joint("b", "c", content='<axis xyz="1 0 0"/><mimic joint="a-b" multiplier="-2"/>'),
    )  # fmt: skip
    traj = pinred.simulate(pinred.load(write(tmp_path, text)), seed=1, duration=0.2)
    for suffix in ("npz", "csv"):
        traj.save(tmp_path / f"motion.{suffix}")
    recording = pinred.read_recording(tmp_path / "motion.npz")
    assert recording.system.followers == ("b-c",)
    np.testing.assert_array_equal(recording.states.q, traj.q)
    assert traj.q.shape[1] == 9
    np.testing.assert_allclose(traj.q[:, 8], -2.0 * traj.q[:, 7], atol=1e-14)
    np.testing.assert_allclose(traj.v[:, 7], -2.0 * traj.v[:, 6], atol=1e-13)


def test_members_of_coupled_robot_agree_with_simulate(crank: pinred.System) -> None:
    """Members, also those given by q0, agree with single simulations."""
    q0 = np.array([[0.0, y, -2.5 * y + 0.3] for y in (0.1, 0.2, 0.3)])
    springs = {"first": (2.0, 0.0)}
    many = pinred.simulate_many(crank, q0=q0, duration=0.5, springs=springs)
    for k in range(3):
        alone = pinred.simulate(crank, q0=q0[k], duration=0.5, springs=springs)
        np.testing.assert_allclose(many[k].x[-1], alone.x[-1], atol=1e-10)


def test_file_with_broken_coupling_is_rejected(tmp_path: Path) -> None:
    """The robot file now has another ratio than q in the recording."""
    text = robot(*(link(name) for name in "abc"), joint("a", "b"), "{}")
    last = joint("b", "c", content='<axis xyz="1 0 0"/><mimic joint="a-b" multiplier="{}"/>')
    path = write(tmp_path, text.format(last.format(2)))
    pinred.simulate(pinred.load(path), seed=1, duration=0.2).save(tmp_path / "motion.npz")
    write(tmp_path, text.format(last.format(2.001)))
    with pytest.raises(InputError, match="'q' is not the configuration"):
        _ = pinred.read_recording(tmp_path / "motion.npz").system


def test_couplings_have_separate_kernels() -> None:
    """Robots that differ only in a ratio or an offset have separate kernels."""
    digests = {model_bytes(_geared(ratio, offset=b)) for ratio in (2.0, 3.0) for b in (0.0, 0.3)}
    assert len(digests) == 4


def test_random_states_respect_limits_of_followers(tmp_path: Path) -> None:
    """A finger may open by a centimetre at three times the rate of its leader."""
    slide = '<axis xyz="0 1 0"/>'
    follower = joint("a", "c", "prismatic", f'{slide}<mimic joint="a-b" multiplier="-3"/>')
    text = robot(
        *(link(name) for name in "abc"), joint("a", "b", "prismatic", slide),
        follower.replace('lower="-1" upper="1"', 'lower="0" upper="0.01"'),
    )  # fmt: skip
    system = pinred.load(write(tmp_path, text))
    x = np.array([pinred.Scene(system=system, seed=k).start.x for k in range(20)])
    assert (x <= 0.0).all()
    assert (x >= -0.01 / 3.0).all()


# Identical branches with couplings share lanes, too.
@pytest.mark.by_hand
@pytest.mark.sampled
@pytest.mark.parametrize("seed", [5, 11])
def test_joined_limbs_beside_couplings_agree_with_aba(seed: int) -> None:
    """Limbs without couplings are joined; a coupling joins another limb and the trunk."""
    model, rng = unequal_limbs_model("SE3", 6, 4, seed), np.random.default_rng(seed)
    names = [name for name in model.names if name.startswith("limb5")]
    pair = (names[-1], names[0]) if len(names) > 1 else (names[0], "trunk1")
    coupling = Coupling(pair[0], {pair[1]: float(rng.normal())}, 0.2)
    system = pinred.System(model, "limbs", contents=Contents(couplings=(coupling,)))
    members = Groups(bodies_of(system), {}, system.coupled).members
    links = links_of(bodies_of(system), Lanes(), (), members)
    assert any(len({i for i, _ in link.parents}) > 1 for link in links)
    x0, xdot0 = rng.normal(size=(2, system.m))
    a, b = (pinred.simulate(system, x0=x0, xdot0=xdot0, duration=0.2, engine=e) for e in ENGINES)
    np.testing.assert_allclose(a.q, b.q, atol=1e-9)


# Case 1 has couplings inside branches and across them.
@pytest.mark.by_hand("3")
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.sampled
def test_identical_branches_with_couplings_agree_with_aba(seed: int) -> None:
    """Couplings are inside branches, across them, or on one branch only."""
    model, rng = limbed_model("SE3", 3, 3, seed), np.random.default_rng(seed)
    pairs = [
        [("limb0.1", "limb0.0"), ("limb1.1", "limb1.0"), ("limb2.1", "limb2.0")],
        [("limb0.2", "limb0.0")],
        [("limb0.1", "limb1.1"), ("limb0.2", "limb2.2")],
        [("limb0.0", "trunk"), ("limb1.2", "limb1.0")],
    ]
    couplings = tuple(
        Coupling(pair[0], {pair[1]: float(rng.normal())}, 0.2) for pair in pairs[seed]
    )
    system = pinred.System(model, "limbs", contents=Contents(couplings=couplings))
    x0, xdot0 = rng.normal(size=(2, system.m))
    a, b = (pinred.simulate(system, x0=x0, xdot0=xdot0, duration=0.2, engine=e) for e in ENGINES)
    np.testing.assert_allclose(a.q, b.q, atol=1e-9)
