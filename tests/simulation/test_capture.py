"""Captures and releases against multipliers on full mass matrices, and closed forms."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree
from loop_robots import FOUR_BAR, four_bar
from meeting_pairs import Full, Twists, flat_tree, frame_of, framed, make_pair, stop

import pinred
from pinred import InputError, Scene, UnsupportedOperationError
from pinred.common.arrays import Array
from pinred.system.derived_systems import reroot
from pinred.system.loops.loop import Loop
from pinred.system.passive import Spring
from pinred.system.robot_file_contents import Contents, Keyframe

PAIRS = 20
MANY_PAIRS = 50
KINDS = ("trees", "balls", "followers", "loops", "flat")
REST = (0.0, 0.0, 0.0)


def twist_error(found: Twists, expected: Twists, before: Twists) -> float:
    """Return the largest difference of twists, relative to the largest before or after."""
    scale = max(np.abs(w).max() for w in (*before.values(), *expected.values()))
    return float(max(np.abs(found[name] - expected[name]).max() for name in expected) / scale)


@pytest.mark.by_hand("trees", "flat", "loops")
@pytest.mark.parametrize("kind", KINDS)
def test_capture_of_random_pairs_equals_constrained_impulse(kind: str) -> None:
    """Links move as multipliers on both mass matrices say; momentum and energy balance."""
    assert_impulses(kind, range(KINDS.index(kind), PAIRS, len(KINDS)))


@pytest.mark.by_hand
@pytest.mark.parametrize("kind", KINDS)
def test_capture_of_more_random_pairs_equals_constrained_impulse(kind: str) -> None:
    """The same for further pairs."""
    assert_impulses(kind, range(PAIRS + KINDS.index(kind), MANY_PAIRS, len(KINDS)))


def assert_impulses(kind: str, seeds: range) -> None:
    """Assert the velocities, the impulse and the balances of captures."""
    for seed in seeds:
        pair = make_pair(kind, seed)
        capture = pinred.capture(pair.a, pair.b, at="tip", onto="tip")
        a, b = Full(pair.a), Full(pair.b)
        n, k, size = len(a.v), len(a.inner), len(a.v) + len(b.v)
        H, C = np.zeros((size, size)), np.zeros((6 + k + len(b.inner), size))
        H[:n, :n], H[n:, n:] = a.H, b.H
        C[:6, :n], C[:6, n:] = a.rows("tip"), -b.rows("tip")
        C[6 : 6 + k, :n], C[6 + k :, n:] = a.inner, b.inner
        v = np.concatenate([a.v, b.v])
        after, multipliers = stop(H, C, v)
        expected = a.twists(after[:n]) | b.twists(after[n:], capture.prefix)
        before = a.twists(a.v) | b.twists(b.v, capture.prefix)
        joined = Full(capture.scene)
        assert twist_error(joined.twists(joined.v), expected, before) <= 1e-13, seed
        total = np.abs(a.momentum(a.v)) + np.abs(b.momentum(b.v))
        sums = a.momentum(a.v) + b.momentum(b.v) - joined.momentum(joined.v)
        rows = [0, 1, 5] if kind == "flat" else slice(None)
        assert np.abs(sums[rows]).max() <= 1e-13 * total.max()
        change = capture.momentum - capture.momentum_before
        assert np.abs(change).max() <= 1e-13 * np.abs(capture.momentum).max()
        energy = 0.5 * v @ H @ v
        lost = energy - 0.5 * after @ H @ after
        assert capture.energy_before == pytest.approx(energy, rel=1e-13)
        assert abs(capture.energy_lost - lost) <= 1e-13 * energy
        assert abs(0.5 * joined.v @ joined.H @ joined.v - (energy - lost)) <= 1e-13 * energy
        R = frame_of(pair.a.system, pair.a.start.pose, pair.a.start.x).rotation
        impulse = np.concatenate([R @ capture.impulse[:3], R @ capture.impulse[3:]])
        assert np.abs(impulse - multipliers[:6]).max() <= 1e-13 * total.max()


def test_capture_of_two_discs_equals_closed_form() -> None:
    """Two discs that touch at their rims stick: V = Σp / M, ω = L / I about the common centre."""
    m1, m2, r1, r2 = 3.0, 2.0, 0.5, 0.25
    I1, I2 = 0.5 * m1 * r1**2, 0.5 * m2 * r2**2
    discs = []
    for name, m, moment, rim in (("a", m1, I1, r1), ("b", m2, I2, -r2)):
        disc = pinred.Model(name).body(name, mass=m, inertia=moment)
        disc = disc.fixed(f"rim_{name}", parent=name, at=[rim, 0.0, 0.0])
        discs.append(pinred.load(disc, group="SE2", gravity=REST))
    v1, w1, v2, w2 = np.array([0.4, -0.2]), 1.5, np.array([-0.7, 0.3]), -4.0
    capture = pinred.capture(
        Scene(system=discs[0], pose0=[0, 0, 0], xi0=[*v1, w1]),
        Scene(system=discs[1], pose0=[r1 + r2, 0, 0], xi0=[*v2, w2]),
        at="rim_a", onto="rim_b",
    )  # fmt: skip
    d = r1 + r2
    V = (m1 * v1 + m2 * v2) / (m1 + m2)
    reduced = m1 * m2 / (m1 + m2)
    L = I1 * w1 + I2 * w2 + reduced * d * (v2 - v1)[1]
    w = L / (I1 + I2 + reduced * d**2)
    arm = m2 * d / (m1 + m2)  # from the first centre to the common one
    assert capture.system.group.name == "SE2"
    assert capture.system.m == 0
    np.testing.assert_allclose(capture.instant.xi, [V[0], V[1] - w * arm, w], rtol=1e-14)
    before = 0.5 * (m1 * v1 @ v1 + m2 * v2 @ v2 + I1 * w1**2 + I2 * w2**2)
    after = 0.5 * ((m1 + m2) * V @ V + (I1 + I2 + reduced * d**2) * w**2)
    assert capture.energy_lost == pytest.approx(before - after, rel=1e-13)
    force = m1 * (capture.instant.xi[:2] - v1)  # the impulse on the first disc
    np.testing.assert_allclose(capture.impulse[:2], force, rtol=1e-13)
    moment = I1 * (w - w1) - r1 * force[1]
    np.testing.assert_allclose(capture.impulse[[2, 3, 4]], 0.0, atol=1e-15)
    assert capture.impulse[5] == pytest.approx(moment, rel=1e-13)


def test_capture_on_a_rail_and_on_a_shaft_equals_closed_form() -> None:
    """Carts couple, and so do discs on one shaft: v = Σ m v / Σ m, ½ m₁m₂/(m₁+m₂) Δv² is lost."""
    sizes, rates = (3.0, 5.0), (1.2, -0.4)
    for group, inertia in (("R", 1.0), ("SO2", sizes)):
        systems = [
            pinred.load(
                pinred.Model(n).body(n, mass=m, inertia=inertia if group == "R" else m),
                group=group, gravity=REST,
            )
            for n, m in zip("ab", sizes, strict=True)
        ]  # fmt: skip
        scenes = [
            Scene(system=s, pose0=[0.3], xi0=[v]) for s, v in zip(systems, rates, strict=True)
        ]
        capture = pinred.capture(*scenes, at="a", onto="b")
        v = np.dot(sizes, rates) / sum(sizes)
        lost = 0.5 * np.prod(sizes) / sum(sizes) * (rates[0] - rates[1]) ** 2
        assert capture.system.group.name == group
        assert capture.instant.xi[0] == pytest.approx(v, rel=1e-14)
        assert capture.energy_lost == pytest.approx(lost, rel=1e-14)


def test_capture_on_a_shaft_adds_the_rotors_of_both_roots() -> None:
    """Armature of the roots is inertia about the shaft: ω = Σ (I + a) ω / Σ (I + a)."""
    scenes, sizes, rates = [], np.array([3.0, 5.0]), np.array([1.2, -0.4])
    rotors = np.array([0.5, 0.25])
    for name, size, rotor, rate in zip("ab", sizes, rotors, rates, strict=True):
        model = pin.Model()
        model.gravity.setZero()
        root = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "root")
        disc = pin.Inertia(1.0, np.zeros(3), size * np.eye(3))
        model.appendBodyToJoint(root, disc, pin.SE3.Identity())
        model.addFrame(pin.Frame(name, root, 0, pin.SE3.Identity(), pin.FrameType.BODY), False)
        model.armature = np.array([rotor])
        scenes.append(Scene(system=pinred.System(model, name), pose0=[0.3], xi0=[rate]))
    capture = pinred.capture(*scenes, at="a", onto="b")
    total = sizes + rotors
    assert capture.instant.xi[0] == pytest.approx(total @ rates / total.sum(), rel=1e-14)
    assert pinred.Reduction(capture.system).split([]).mass_matrix == pytest.approx(total.sum())


ARM = """<robot name="ARM"><link name="bus"><inertial><origin xyz=".1 0 0"/><mass value="9"/>
<inertia ixx="2" iyy="3" izz="4" ixy=".1" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="revolute"><parent link="bus"/><child link="hand"/>
<origin xyz=".5 0 .1" rpy=".1 .2 .3"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="2" effort="5" velocity="3"/></joint>
<link name="hand"><inertial><origin xyz="0 .2 0"/><mass value="2"/>
<inertia ixx=".2" iyy=".3" izz=".4" ixy="0" ixz="0" iyz=".05"/></inertial></link>BODY</robot>"""
TAIL = """<joint name="JOINT" type="fixed"><parent link="hand"/><child link="ring"/>
<origin xyz="0 .4 0" rpy="0 0 .5"/></joint>
<link name="ring"><inertial><mass value=".5"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="flap" type="prismatic"><parent link="ring"/><child link="panel"/>
<origin xyz=".3 0 0"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="5" velocity="3"/></joint>
<link name="panel"><inertial><origin xyz="0 0 .1"/><mass value="4"/>
<inertia ixx=".5" iyy=".6" izz=".7" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
# The second robot is rooted at its panel, so the capture reverses the flap.
BODY = """<robot name="debris"><link name="panel"><inertial><origin xyz="0 0 .1"/><mass value="4"/>
<inertia ixx=".5" iyy=".6" izz=".7" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="flap" type="prismatic"><parent link="panel"/><child link="ring"/><axis xyz="-1 0 0"/>
<limit lower="-1" upper="1" effort="5" velocity="3"/></joint>
<link name="ring_base"/><joint name="ring_at" type="fixed"><parent link="ring"/>
<child link="ring_base"/></joint><link name="ring"><inertial><origin xyz="-.3 0 0"/>
<mass value=".5"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="grip_at" type="fixed"><parent link="ring"/><child link="grip"/>
<origin xyz="-.3 0 0"/></joint><link name="grip"/></robot>"""


def load_text(text: str) -> pinred.System:
    """Return the robot in a URDF text, in zero gravity."""
    return pinred.load(text=text, group="SE3", gravity=REST)


def test_captured_robot_equals_hand_written_file() -> None:
    """Mass matrices, limits and values of joints are those of a file with both robots as one."""
    tool = '<joint name="tool_at" type="fixed"><parent link="hand"/><child link="tool"/>'
    tool += '<origin xyz="0 .4 0" rpy="0 0 .5"/></joint><link name="tool"/>'
    arm, body = load_text(ARM.replace("BODY", tool)), load_text(BODY)
    by_hand = load_text(ARM.replace("BODY", TAIL))
    x_arm, x_body = np.array([0.4]), np.array([0.2])
    at = frame_of_link(arm, arm.group.identity(), x_arm, "tool")
    onto = frame_of_link(body, body.group.identity(), x_body, "grip")
    scene = Scene(system=body, pose0=pin.SE3ToXYZQUAT(at * onto.inverse()), x0=x_body, xdot0=[0.7])
    capture = pinred.capture(
        Scene(system=arm, x0=x_arm, xdot0=[-0.3], xi0=np.ones(6)), scene, at="tool", onto="grip"
    )
    assert capture.prefix == ""
    assert capture.system.shape_names == by_hand.shape_names == ("elbow", "flap")
    for x in ([0.4, 0.2], [-1.0, 0.5]):
        H, expected = (pinred.Reduction(s).split(x).mass_matrix for s in (capture.system, by_hand))
        assert np.abs(H - expected).max() <= 1e-14 * np.abs(expected).max()
    np.testing.assert_allclose(capture.instant.x, [0.4, 0.2])
    np.testing.assert_array_equal(
        capture.system.model.upperPositionLimit[7:], by_hand.model.upperPositionLimit[7:]
    )
    motions = [pinred.simulate(s, **capture.start, duration=2.0) for s in (capture.system, by_hand)]
    assert np.abs(motions[0].x - motions[1].x).max() <= 1e-9
    assert pinred.compare(motions[0])


def frame_of_link(system: pinred.System, pose: Array, x: Array, name: str) -> pin.SE3:
    """Return the placement of a link in the world."""
    model, data = system.model, system.model.createData()
    pin.framesForwardKinematics(model, data, system.q(pose, x))
    return data.oMf[model.getFrameId(name, pin.FrameType.BODY)].copy()


@pytest.mark.by_hand("trees", "flat")
@pytest.mark.parametrize("kind", KINDS)
def test_release_after_capture_gives_back_both_robots(kind: str) -> None:
    """Mass matrices and poses are those before; links move as those of the joined robot."""
    for seed in range(1 if kind == "loops" else 3):
        pair = make_pair(kind, 100 + seed)
        capture = pinred.capture(pair.a, pair.b, at="tip", onto="tip")
        joint = f"tip+{capture.prefix}tip"
        root = f"{capture.prefix}link 1"
        release = pinred.release(capture, joint, root=root)
        whole = Full(capture.scene)
        links = whole.twists(whole.v)
        parts = (release.carrier, release.released)
        for part, scene, prefix in zip(parts, (pair.a, pair.b), ("", capture.prefix), strict=True):
            old, new = Full(scene), Full(part.scene)
            order = [
                part.system.sorted_model.joints[part.system.sorted_model.getJointId(prefix + n)]
                if k else part.system.sorted_model.joints[1]
                for k, n in enumerate(old.model.names[1:])
            ]  # fmt: skip
            rows = [v for joint in order for v in range(joint.idx_v, joint.idx_v + joint.nv)]
            H = new.H[np.ix_(rows, rows)]
            assert np.abs(H - old.H).max() <= 1e-14 * np.abs(old.H).max()
            assert pin.log6(old.placement().actInv(new.placement())).vector == pytest.approx(
                np.zeros(6), abs=1e-13
            )
            found = new.twists(new.v)
            error = twist_error(found, {name: links[name] for name in found}, links)
            assert error <= 1e-13


def test_release_of_a_fixed_link_of_a_file() -> None:
    """A link that the file fixes to another comes off: both parts are as written by hand."""
    tool: dict[str, Any] = {"mass": 2.0, "inertia": 0.3, "com": [0.0, 0.1, 0.0]}
    arm = pinred.Model().body("bus", mass=9.0, inertia=[2, 3, 4])
    arm = arm.hinge("elbow", parent="bus", axis="y", at=[0.5, 0, 0], mass=3.0, inertia=0.2)
    bare = pinred.load(arm, gravity=REST)
    held = arm.fixed("tool", parent="elbow", at=[0, 0.4, 0], attitude=[0.1, 0.2, 0.3], **tool)
    held = held.slide("lid", parent="tool", axis="x", at=[0.1, 0, 0], mass=1.0, inertia=0.1)
    whole = pinred.load(held, gravity=REST)
    state = Scene(system=whole, seed=3, pose0=pin.SE3ToXYZQUAT(pin.SE3.Random()))
    alone = pinred.Model().body("tool", **tool)
    alone = alone.slide("lid", parent="tool", axis="x", at=[0.1, 0, 0], mass=1.0, inertia=0.1)
    release = pinred.release(state, "tool")
    for part, by_hand in (
        (release.carrier, bare), (release.released, pinred.load(alone, gravity=REST)),
    ):  # fmt: skip
        x = part.instant.x
        H, expected = (pinred.Reduction(s).split(x).mass_matrix for s in (part.system, by_hand))
        assert np.abs(H - expected).max() <= 1e-14 * np.abs(expected).max()
    before, parts = Full(state), [Full(p.scene) for p in (release.carrier, release.released)]
    assert sum(0.5 * p.v @ p.H @ p.v for p in parts) == pytest.approx(
        0.5 * before.v @ before.H @ before.v, rel=1e-13
    )
    momentum = sum(p.momentum(p.v) for p in parts)
    np.testing.assert_allclose(momentum, before.momentum(before.v), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(
    "make", [lambda: framed(ball_tree(1, 5), np.random.default_rng(1)),
             lambda: framed(flat_tree(4, 5), np.random.default_rng(1), flat=True)],
)  # fmt: skip
def test_release_at_moving_joints_keeps_energy_and_momentum(
    make: Callable[[], pinred.System],
) -> None:
    """Each joint can open; momentum and energy are the sums of both parts."""
    system = make()
    state = Scene(system=system, seed=2)
    whole = Full(state)
    for name in system.space.joints:
        release = pinred.release(state, name.name)
        parts = [Full(p.scene) for p in (release.carrier, release.released)]
        energy = sum(0.5 * p.v @ p.H @ p.v for p in parts)
        rotors = rotor_energy(system, state, name.name)
        assert energy == pytest.approx(0.5 * whole.v @ whole.H @ whole.v - rotors, rel=1e-12)
        momentum = sum(p.momentum(p.v) for p in parts)
        np.testing.assert_allclose(momentum, whole.momentum(whole.v), rtol=1e-11, atol=1e-12)


def rotor_energy(system: pinred.System, state: Scene, joint: str) -> float:
    """Return the energy of the armature of a joint, which both parts lose with the joint."""
    model = system.sorted_model
    entry = model.joints[model.getJointId(joint)]
    rows = slice(entry.idx_v, entry.idx_v + entry.nv)
    v = system.sorted_v(state.start.xi, state.start.xdot)[rows]
    return float(0.5 * v @ (model.armature[rows] * v))


def chaser(gravity: tuple[float, float, float] = REST) -> pinred.System:
    """Return a satellite with an arm."""
    model = pinred.Model("chaser").body("bus", mass=9.0, inertia=[2, 3, 4])
    model = model.hinge("arm", parent="bus", axis="y", at=[0.5, 0, 0], mass=3.0, inertia=0.2)
    return pinred.load(model.fixed("tool", parent="arm", at=[0.5, 0, 0]), gravity=gravity)


def start_at(system: pinred.System, **options: object) -> Scene:
    """Return a scene at rest at zero, or with other options."""
    return Scene(system=system, **{"xdot0": np.zeros(system.m), **options})  # type: ignore[arg-type]


@cache
def rejected_captures() -> dict[str, tuple[Callable[[], object], str]]:
    """Return captures that are refused, with words of the message."""
    rock = pinred.Model("rock").body("rock", mass=1.0, inertia=1.0)
    b, flat = pinred.load(rock, gravity=REST), pinred.load(rock, group="SE2", gravity=REST)
    own, there = start_at(chaser()), start_at(b, pose0=[1.0, 0, 0, 0, 0, 0, 1])
    near = start_at(b, pose0=[1.0 + 2e-6, 0, 0, 0, 0, 0, 1])
    turned = start_at(b, pose0=[1, 0, 0, 0, 0, 1, 0])
    heavy, flat_start = start_at(pinred.load(rock)), start_at(flat)
    again = start_at(own.system)
    wrong: Any = "rock"
    named = start_at(chaser(), xi0=np.ones(6))

    def take(second: Any = there, at: str = "tool", onto: str = "rock", **more: Any) -> Any:
        return lambda: pinred.capture(own, second, at=at, onto=onto, **more)

    return {
        "unknown at": (take(at="hand"), "no link 'hand'"),
        "unknown onto": (take(onto="r"), r"onto: .*no link 'r'"),
        "apart": (take(near), r"2e-06 m .*tolerance=1e-06"),
        "turned": (take(turned), r"3\.14 rad"),
        "gravity": (take(heavy), "same gravity="),
        "groups": (take(flat_start), "same group="),
        "same": (take(own, onto="bus"), "same one twice"),
        "same state": (take(again, onto="bus"), "same one twice"),
        "tolerance": (take(tolerance=np.nan), "tolerance"),
        "kind": (take(wrong), "b: expected"),
        "prefix": (take(named, onto="tool", prefix=""), "prefix: with '', .* both have arm"),
        "release of the root": (lambda: pinred.release(own, "bus"), "is the root"),
        "release of a frame": (lambda: pinred.release(own, "nothing"), "no link 'nothing'"),
        "release to another root": (
            lambda: pinred.release(own, "arm", root="bus"),
            "no link 'bus'",
        ),
    }


@pytest.mark.parametrize("case", rejected_captures())
def test_impossible_capture_is_refused_by_name(case: str) -> None:
    """The message names what is wrong, and a remedy."""
    call, words = rejected_captures()[case]
    with pytest.raises((InputError, UnsupportedOperationError), match=words):
        call()


def looped_capture(*, root: str = "frame") -> pinred.Capture:
    """Return the capture of a body by the free tip of a four-bar linkage in the plane."""
    model, loops = four_bar()
    for name in FOUR_BAR:
        joint = model.getJointId("base" if name == "frame" else name)
        model.addFrame(pin.Frame(name, joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    plain = pinred.System(model, "bars", contents=Contents(loops=tuple(loops)))
    assert plain.closure is not None
    # The mirror image of the closed shape that the assembly finds from zero.
    other = Keyframe(plain.group.identity(), -plain.closure.x, np.zeros(3), np.zeros(3))
    contents = Contents(loops=tuple(loops), keyframes={"mirrored": other})
    bars = pinred.System(model, "bars", contents=contents)
    rock = pinred.load(
        pinred.Model("rock").body("rock", mass=2.0, inertia=1.5), group="SE2", gravity=REST
    )
    scene = Scene(system=bars, keyframe="mirrored", xdot0={"crank": 1.0}, xi0=[0.2, 0.1, -0.4])
    place = frame_of(bars, scene.start.pose, scene.start.x, "rocker_tip")
    pose = [*place.translation[:2], np.arctan2(place.rotation[1, 0], place.rotation[0, 0])]
    body = Scene(system=rock, pose0=pose, xi0=[0.3, -0.2, 0.5])
    if root == "rock":
        return pinred.capture(body, scene, at="rock", onto="rocker_tip")
    return pinred.capture(scene, body, at="rocker_tip", onto="rock")


def test_robot_with_a_loop_captures_and_is_captured_alike() -> None:
    """Both roots have the same links, loops and energies; the closed shape is that of the bars."""
    captures = [looped_capture(), looped_capture(root="rock")]
    lost = [capture.energy_lost for capture in captures]
    assert lost[1] == pytest.approx(lost[0], rel=1e-13)
    for capture in captures:
        assert [loop.name for loop in capture.system.loops] == ["tips"]
        bars = capture.a if capture.a.loops else capture.b
        closed, expected = (
            dict(zip(s.x_names, s.closure.x, strict=True))
            for s in (capture.system, bars)
            if s.closure
        )
        assert closed == pytest.approx(expected, rel=1e-13)


def test_captured_robot_starts_its_loops_at_the_known_closed_shape() -> None:
    """Balls that turn over have the inverse attitude; all other joints have the same values."""
    turned = 0
    for seed in (3, 8, 13):
        pair = make_pair("loops", seed)
        capture = pinred.capture(pair.a, pair.b, at="tip", onto="tip")
        known, joined = pair.b.system, capture.system
        assert known.closure is not None
        assert joined.closure is not None
        slots = {joint.name: joint.x for joint in joined.space.joints}
        for joint in known.space.joints:
            expected = known.closure.x[joint.x]
            found = joined.closure.x[slots[capture.prefix + joint.name]]
            if joint.kind.is_ball and np.abs(found - expected).max() > 1e-6:
                expected, turned = expected * [-1.0, -1.0, -1.0, 1.0], turned + 1
            np.testing.assert_allclose(found, expected, atol=1e-9)
    assert turned


def test_release_keeps_a_loop_whole() -> None:
    """The robot keeps its loop; a cut through it, and an end that turns over, are refused."""
    capture = looped_capture()
    release = pinred.release(capture, "rock")
    assert release.carrier.system.loops == capture.a.loops
    assert release.released.system.loops == ()
    with pytest.raises(
        InputError, match=r"Loop 'tips' of .* connects parts that the cut separates"
    ):
        pinred.release(capture, "rocker")
    ends = (Loop("coupler", "rocker_tip", "3d", "ends"),)
    model, _ = four_bar(lengths={**FOUR_BAR, "rocker": 0.6})
    bars = pinred.System(model, "bars", contents=Contents(loops=ends))
    with pytest.raises(UnsupportedOperationError, match="loop 'ends' ends at joint 'coupler'"):
        reroot(bars, link="coupler_tip")


def test_capture_with_tolerance_keeps_the_offset() -> None:
    """Frames that are apart by less than the tolerance stay apart; no body jumps."""
    rock = pinred.load(pinred.Model("rock").body("rock", mass=1.0, inertia=1.0), gravity=REST)
    scene = start_at(rock, pose0=[1.05, 0, 0, 0, 0, 0, 1], xi0=[0, 1, 0, 0, 0, 0])
    capture = pinred.capture(
        start_at(chaser()), scene, at="tool", onto="rock", tolerance=0.1, name="both"
    )
    assert capture.system.name == "both"
    place = frame_of_link(capture.system, capture.instant.pose, capture.instant.x, "rock")
    np.testing.assert_allclose(place.translation, [1.05, 0, 0], atol=1e-15)
    np.testing.assert_allclose(capture.momentum, [0, 1, 0, 0, 0, 1.05], atol=1e-14)


def test_planar_robot_refuses_a_joint_that_leaves_the_plane() -> None:
    """A hinge across the plane carries the frame out of SE2."""
    model = pinred.Model("arm").body("base", mass=2.0, inertia=1.0)
    arm = model.hinge("tilt", parent="base", axis="y", at=[1, 0, 0], mass=1.0, inertia=1.0)
    a = pinred.load(arm, group="SE2", gravity=REST)
    b = pinred.load(
        pinred.Model("rock").body("rock", mass=1.0, inertia=1.0), group="SE2", gravity=REST
    )
    scenes = start_at(a, x0=[0.0]), start_at(b, pose0=[1, 0, 0])
    with pytest.raises(
        InputError, match="joint 'tilt' of 'arm' moves the frame out of the group SE2"
    ):
        pinred.capture(*scenes, at="tilt", onto="rock")
    with pytest.raises(InputError, match="cannot float on its own: joint 'tilt'"):
        pinred.release(pinred.release(scenes[0], "tilt").carrier, "tilt")


def test_joined_robot_keeps_springs_couplings_and_names() -> None:
    """Springs and followers of both robots act; colliding names get the name of the second."""
    system = chaser()
    contents = replace(system.contents, passive=(Spring("arm", 3.0, 0.1),))
    a = pinred.System(system.model, "chaser", contents=contents)
    b = start_at(a, pose0=[1.0, 0, 0, 0, 0, 0, 1], x0=[0.3])
    capture = pinred.capture(start_at(a), b, at="tool", onto="bus")
    assert capture.system.shape_names == ("arm", "chaser_arm")
    assert [spring.joint for spring in capture.system.passive] == ["arm", "chaser_arm"]  # type: ignore[attr-defined]
    motion = pinred.simulate(capture.system, **capture.start, duration=1.0, passive=True)
    energy = 0.5 * 3.0 * (0.1**2 + 0.2**2)
    assert motion.energy[0] == pytest.approx(energy, rel=1e-14)
    again = pinred.capture(
        capture, start_at(a, pose0=[-1.0, 0, 0, 0, 0, 0, 1]), at="bus", onto="tool", tolerance=2.0
    )
    assert again.prefix == "chaser2_"


def test_reversed_ball_with_a_spring_is_refused() -> None:
    """A spring about axes of the child would act about those of the parent."""
    system = ball_tree(1, 1)
    contents = replace(system.contents, passive=(Spring("j0.x", 3.0),))
    a = framed(pinred.System(system.model, "balls", contents=contents), np.random.default_rng(0))
    names = [f.name for f in a.model.frames if f.name.startswith("link")]
    scene = Scene(system=a, seed=1)
    rock = pinred.load(pinred.Model("rock").body("rock", mass=1.0, inertia=1.0), gravity=REST)
    pose = pin.SE3ToXYZQUAT(frame_of_link(a, scene.start.pose, scene.start.x, names[1]))
    with pytest.raises(UnsupportedOperationError, match="ball 'j0' changes its direction"):
        pinred.capture(
            Scene(system=rock, pose0=pose, xi0=np.zeros(6)), scene, at="rock", onto=names[1]
        )


def test_capture_prints_impulse_energy_and_momenta() -> None:
    """The text states the balances, and says which frames are joined."""
    rock = pinred.load(pinred.Model("rock").body("rock", mass=1.0, inertia=1.0), gravity=REST)
    scene = start_at(rock, pose0=[1.0, 0, 0, 0, 0, 0, 1], xi0=[0, 2, 0, 0, 0, 0])
    text = str(pinred.capture(start_at(chaser()), scene, at="tool", onto="rock"))
    assert text.startswith("chaser captures rock: rock fixed to tool")
    assert re.search(r"energy lost \[J\] +\S+ of 2\n", text)
