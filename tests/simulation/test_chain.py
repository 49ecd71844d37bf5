"""Chains: states of all phases in one system, files, playback, and the comparison."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from meeting_pairs import Full, make_pair

import pinred
from pinred import Chain, InputError, LoadError, Scene
from pinred.judge.impact_checks import judge_impact
from pinred.judge.verdict import Verdict

REST = (0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def chaser() -> pinred.System:
    """Return a satellite with an arm and a tool."""
    model = pinred.Model("chaser").body("bus", mass=9.0, inertia=[2, 3, 4], com=[0.1, 0, 0])
    model = model.hinge("arm", parent="bus", axis="y", at=[0.5, 0, 0], mass=3.0, inertia=0.2)
    model = model.ball("wrist", parent="arm", at=[0.4, 0, 0], mass=1.0, inertia=0.1)
    return pinred.load(model.fixed("tool", parent="wrist", at=[0.2, 0, 0]), gravity=REST)


@pytest.fixture(scope="module")
def target() -> pinred.System:
    """Return a body with a panel, whose names are those of the satellite."""
    model = pinred.Model("target").body("bus", mass=4.0, inertia=[1, 2, 1.5])
    model = model.hinge("arm", parent="bus", axis="z", at=[0.2, 0, 0], mass=1.0, inertia=0.1)
    return pinred.load(model, gravity=REST)


@pytest.fixture(scope="module")
def motions(chaser: pinred.System, target: pinred.System) -> dict[str, Any]:
    """Return approach, capture, common motion, release and separation."""
    rng = np.random.default_rng(2)
    approach = pinred.simulate(chaser, seed=4, xi0=None, duration=1.0)
    tool = frame_of_link(chaser, approach, "tool")
    x, xdot, xi = np.array([0.4]), np.array([0.5]), rng.normal(size=6)
    model, data = target.model, target.model.createData()
    pin.framesForwardKinematics(model, data, target.q(target.group.identity(), x))
    link = data.oMf[model.getFrameId("arm", pin.FrameType.BODY)]
    pose = pin.SE3ToXYZQUAT(tool * link.inverse())
    # The target's approach is its motion backwards in time from the contact.
    back = pinred.simulate(target, pose0=pose, x0=x, xdot0=-xdot, xi0=-xi, duration=1.0)(1.0)
    other = pinred.simulate(
        target, pose0=back.pose, x0=back.x, xdot0=-back.xdot, xi0=-back.xi, duration=1.0
    )
    capture = pinred.capture(approach, other, at="tool", onto="arm", tolerance=1e-7)
    together = pinred.simulate(capture.system, **capture.start, duration=0.5)
    release = pinred.release(together, "target_arm", root="target_bus")
    apart = [
        pinred.simulate(p.system, **p.start, duration=0.25)
        for p in (release.carrier, release.released)
    ]
    return {
        "approach": [approach, other], "capture": capture, "together": together,
        "release": release, "apart": apart,
    }  # fmt: skip


def frame_of_link(system: pinred.System, motion: pinred.Trajectory, name: str) -> pin.SE3:
    """Return the placement of a link at the end of a motion."""
    model, data = system.model, system.model.createData()
    pin.framesForwardKinematics(model, data, motion.q[-1])
    return data.oMf[model.getFrameId(name, pin.FrameType.BODY)].copy()


@pytest.fixture(scope="module")
def chain(motions: dict[str, Any]) -> Chain:
    """Return the chain of all motions."""
    return pinred.chain(*motions.values())


def test_chain_has_the_states_of_all_phases(chain: Chain, motions: dict[str, Any]) -> None:
    """Links move as in each motion; energy falls at the capture; momentum stays."""
    assert chain.end == 1.75
    assert (np.diff(chain.t) > 0.0).all()
    J = chain.spatial_momentum
    assert np.abs(J - J[0]).max() <= 1e-9 * np.abs(J).max()
    model = chain.system.model
    data = model.createData()
    for k in range(0, len(chain.t), 37):
        upper = np.triu(
            pin.crba(
                chain.system.sorted_model, chain.system.sorted_data, chain.system.sort_q(chain.q[k])
            )
        )
        v = chain.system.sort_v(chain.v[k])
        energy = 0.5 * v @ (upper + np.triu(upper, 1).T) @ v
        assert energy == pytest.approx(chain.energy[k], rel=1e-12)
    first = int(np.searchsorted(chain.t, 1.0))
    assert chain.t[first] == 1.0
    assert chain.t[first + 1] == np.nextafter(1.0, 2.0)
    lost = chain.energy[first] - chain.energy[first + 1]
    assert lost == pytest.approx(motions["capture"].energy_lost, rel=1e-12)
    np.testing.assert_allclose(chain.x[first], chain.x[first + 1], atol=1e-12)
    np.testing.assert_allclose(chain.pose[first], chain.pose[first + 1], atol=1e-12)
    pin.framesForwardKinematics(model, data, chain.q[-1])
    for motion, prefix, name in zip(motions["apart"], ("", ""), ("bus", "target_bus"), strict=True):
        place = frame_of_link(motion.system, motion, prefix + name)
        found = data.oMf[model.getFrameId(name, pin.FrameType.BODY)]
        np.testing.assert_allclose(found.homogeneous, place.homogeneous, atol=1e-12)


def test_chain_passes_the_comparison(chain: Chain) -> None:
    """Five motions and two impacts pass; the text ends with the verdict."""
    report = pinred.compare(chain)
    assert report
    assert len(report.phases) == 5
    assert len(report.impacts) == 2
    assert str(report).endswith("verdict of the chain: PASSED")
    assert repr(report) == "<ChainReport of 5 motions and 2 impacts: PASSED>"
    worst = max(max(impact.values.values()) for impact in report.impacts)
    assert worst <= 1e-13


def test_chain_may_end_with_an_impact(motions: dict[str, Any], chain: Chain) -> None:
    """The last state is the one after the impact, as in a chain that goes on."""
    short = pinred.chain(motions["approach"], motions["capture"])
    first = len(short.t)
    assert short.t[-1] == np.nextafter(1.0, 2.0) == chain.t[first - 1]
    for name in ("q", "v", "energy", "spatial_momentum"):
        values, expected = getattr(short, name), getattr(chain, name)[:first]
        np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)
    report = pinred.compare(short)
    assert report
    assert len(report.impacts) == 1


def test_chain_saves_loads_plots_and_plays(chain: Chain, tmp_path: Path) -> None:
    """A file has the recipe of the robot; the robot that it makes has the same mass matrix."""
    chain.save(tmp_path / "chain.npz")
    recording = pinred.read_recording(tmp_path / "chain.npz")
    assert recording.system.x_names == chain.system.x_names
    for a, b in zip(recording.system.model.inertias, chain.system.model.inertias, strict=True):
        np.testing.assert_array_equal(a.toDynamicParameters(), b.toDynamicParameters())
    np.testing.assert_array_equal(recording.q, chain.q)
    for kind in ("energy", "momentum", "base", "shape"):
        assert pinred.plot(chain, kind).axes
    assert pinred.save_html(chain, tmp_path / "chain.html") > 10_000
    assert pinred.save_html(recording, tmp_path / "recording.html") > 10_000


@pytest.mark.parametrize(
    ("recipe", "words"),
    [
        ("{", "is made of others"),
        ('{"function": "exec", "arguments": {}, "systems": []}', "is made of others"),
        ('{"function": "join", "arguments": {}, "systems": []}', "is made of others"),
        ('{"function": "pair", "arguments": {"prefix": ""}, "systems": [{"robot": "a", '
         '"group": "SE3", "source": "/etc/a.urdf"}]}', "another"),
    ],
)  # fmt: skip
def test_damaged_recipe_is_refused(chain: Chain, tmp_path: Path, recipe: str, words: str) -> None:
    """A recipe that another program wrote neither executes anything nor names any file."""
    chain.save(tmp_path / "chain.npz")
    arrays = dict(np.load(tmp_path / "chain.npz"))
    arrays["derivation"] = np.array(recipe)
    np.savez(tmp_path / "chain.npz", **arrays)
    with pytest.raises(LoadError, match=words):
        _ = pinred.read_recording(tmp_path / "chain.npz").system


# `test_file_with_a_landing_goes_on_in_stance` has such a chain.
@pytest.mark.by_hand
def test_landing_in_a_chain_goes_on_in_stance(tmp_path: Path) -> None:
    """A flight, a landing and the motion about the foot are one motion of the robot in flight."""
    rng = np.random.default_rng(0)
    model = pinred.Model("hopper").body("trunk", mass=3.0, inertia=[0.1, 0.2, 0.3])
    model = model.hinge(
        "leg", parent="trunk", axis="y", at=[0, 0, -0.1], mass=1.0, inertia=0.02, com=[0, 0, -0.2]
    )
    system = pinred.load(model.fixed("foot", parent="leg", at=[0, 0, -0.4]))
    event = pinred.Event("height['foot']", "touch", terminal=True, direction=-1)
    flight = pinred.simulate(
        system, pose0=[0, 0, 1, 0.1, 0, 0, 0.995], x0=[0.3], xi0=rng.normal(size=6), duration=2.0,
        events=event,
    )  # fmt: skip
    landing = pinred.land(flight, "foot")
    assert landing.stance is not None
    stance = pinred.simulate(landing.stance.system, **landing.stance.start, duration=0.2)
    chain = pinred.chain(flight, landing, stance)
    assert chain.system is system
    touch = int(np.searchsorted(chain.t, flight.scene.end))
    np.testing.assert_array_equal(chain.q[:touch], flight.q[:touch])
    lost = chain.energy[touch] - chain.energy[touch + 1]
    assert lost == pytest.approx(landing.energy_lost, rel=1e-9)
    jump = chain.spatial_momentum[touch + 1] - chain.spatial_momentum[touch]
    np.testing.assert_allclose(jump, landing.momentum_jump, rtol=1e-8, atol=1e-9)
    for k in range(touch, len(chain.t), 20):
        data = system.model.createData()
        pin.framesForwardKinematics(system.model, data, chain.q[k])
        foot = data.oMf[system.model.getFrameId("foot", pin.FrameType.BODY)].translation
        start = frame_of_link(system, flight, "foot").translation
        np.testing.assert_allclose(foot, start, atol=1e-12)
    assert pinred.compare(chain)
    stance.save(tmp_path / "stance.npz")
    recording = pinred.read_recording(tmp_path / "stance.npz", None)
    assert recording.system.shape_names == stance.system.shape_names


# The next test with loops judges a right chain and a changed one.
@pytest.mark.by_hand
def test_chain_of_a_robot_with_loops_passes_the_comparison(tmp_path: Path) -> None:
    """A linkage catches a disc and lets it go, or lands; a file makes the robot again."""
    bars = pinred.load("four_bar", gravity=REST)
    model = pinred.Model("disc").body("disc", mass=2.0, inertia=1.5)
    disc = pinred.load(model, group="SE2", gravity=REST)
    approach = pinred.simulate(bars, seed=3, duration=0.2)
    tip = frame_of_link(bars, approach, "rocker_tip")
    angle = np.arctan2(tip.rotation[1, 0], tip.rotation[0, 0])
    pose = [*tip.translation[:2], angle - 0.1]
    other = pinred.simulate(disc, pose0=pose, xi0=[0.0, 0.0, 0.5], duration=0.2)
    capture = pinred.capture(approach, other, at="rocker_tip", onto="disc")
    together = pinred.simulate(capture.system, **capture.start, duration=0.2)
    release = pinred.release(together, "disc")
    apart = [
        pinred.simulate(p.system, **p.start, duration=0.1)
        for p in (release.carrier, release.released)
    ]
    chain = pinred.chain([approach, other], capture, together, release, apart)
    assert pinred.compare(chain)
    chain.save(tmp_path / "chain.npz")
    assert pinred.read_recording(tmp_path / "chain.npz").system.loops == bars.loops
    landing = pinred.land(approach, "rocker_tip")
    assert landing.stance is not None
    stance = pinred.simulate(landing.stance.system, **landing.stance.start, duration=0.1)
    assert pinred.compare(pinred.chain(approach, landing, stance))


SLIGHT = 6e-11  # relative change that the bound of 1e-11 finds, and a tenfold bound would not


def largest_speed(impact: Any) -> float:
    """Return the largest speed before or after an impact."""
    states = [(impact.system, impact.instant)]
    if isinstance(impact, pinred.Capture):
        states += [(impact.a, impact.before_a), (impact.b, impact.before_b)]
    else:
        states += [(impact.system, impact.before)]
    speeds = list[float]()
    for system, state in states:
        options: dict[str, Any] = {f"{k}0": v for k, v in vars(state).items()}
        full = Full(Scene(system=system, **options))
        speeds += [np.abs(w).max() for w in full.twists(full.v).values()] + [np.abs(full.v).max()]
    return max(speeds)


def changed(impact: Any, name: str) -> Any:
    """Return an impact with one value slightly changed, relative to its size."""
    if name in ("xi", "xdot"):
        values, size = getattr(impact.instant, name), largest_speed(impact)
        state = replace(impact.instant, **{name: values + SLIGHT * size * np.eye(len(values))[0]})
        return replace(impact, instant=state)
    size = {"impulse": np.abs(impact.impulse).max(), "energy_lost": impact.energy_before}[name]
    return replace(impact, **{name: getattr(impact, name) + SLIGHT * size})


@pytest.mark.parametrize("kind", ["trees", "balls", "followers", "loops", "flat"])
def test_comparison_finds_a_wrong_impact(kind: str) -> None:
    """A slight change of a capture or landing fails, and the impact itself passes."""
    pair = make_pair(kind, 300)
    capture = pinred.capture(pair.a, pair.b, at="tip", onto="tip")
    for impact in (capture, pinred.land(pair.a, "tip"), pinred.land(pair.a, "tip", contact="flat")):
        assert judge_impact(impact).verdict is Verdict.PASSED
        for name in ("xi", "xdot", "impulse", "energy_lost"):
            report = judge_impact(changed(impact, name))
            assert report.verdict is Verdict.FAILED, name
            assert max(report.values.values()) < 10.0 * report.bound or name != "energy_lost"


def failed(impact: Any) -> set[str]:
    """Return the first words of the checks of an impact that fail."""
    checks = judge_impact(impact).checks.items()
    return {name.removesuffix(" [relative]") for name, (value, most) in checks if value > most}


def heavier(model: pin.Model, joint: int) -> pin.Model:
    """Return a copy of a model with a slightly heavier body."""
    copy, body = model.copy(), model.inertias[joint]
    copy.inertias[joint] = pin.Inertia(body.mass * (1.0 + 1e-8), body.lever, body.inertia)
    return copy


def test_comparison_finds_a_wrong_joined_robot() -> None:
    """A heavier body, a joint that is elsewhere, or a rotor fail by their own checks."""
    pair = make_pair("trees", 300)
    capture = pinred.capture(pair.a, pair.b, at="tip", onto="tip")
    model = capture.system.model
    other = pinred.System(heavier(model, 1), "other")
    assert failed(replace(capture, system=other)) == {"momentum across it", "energy after"}
    moved, last = model.copy(), model.njoints - 1
    shift = pin.SE3(np.eye(3), 1e-8 * np.ones(3))
    moved.jointPlacements[last] = moved.jointPlacements[last] * shift
    assert "velocities after" in failed(replace(capture, system=pinred.System(moved)))
    rotor = model.copy()
    rotor.armature = np.array(rotor.armature) + 1e-8 * (np.arange(rotor.nv) == rotor.nv - 1)
    assert failed(replace(capture, system=pinred.System(rotor))) == {"energy after"}


def test_comparison_finds_a_wrong_stance() -> None:
    """A stance that turns otherwise, or is heavier, fails by its own checks."""
    landing = pinred.land(make_pair("trees", 300).a, "tip")
    stance = landing.stance
    assert stance is not None
    assert failed(landing) == set()
    state = replace(stance.instant, xi=stance.instant.xi * (1.0 + 1e-8))
    assert "velocities in stance" in failed(replace(landing, stance=replace(stance, instant=state)))
    system = pinred.System(heavier(stance.system.model, 1), "heavier")
    assert failed(replace(landing, stance=replace(stance, system=system))) == {"energy in stance"}


def test_recipe_that_names_a_file_elsewhere_is_refused(chain: Chain, tmp_path: Path) -> None:
    """A recording loads no file from another folder, also as part of a robot."""
    (tmp_path / "here").mkdir()
    source = pinred.Model("rock").body("rock", mass=1.0, inertia=1.0).save(tmp_path / "rock.urdf")
    robot = {"robot": "rock", "group": "SE3", "source": str(source)}
    recipe = {"function": "reroot", "arguments": {"link": "rock"}, "systems": [robot]}
    chain.save(tmp_path / "here/chain.npz")
    arrays = dict(np.load(tmp_path / "here/chain.npz"))
    arrays["derivation"] = np.array(json.dumps(recipe))
    np.savez(tmp_path / "here/chain.npz", **arrays)
    with pytest.raises(LoadError, match="in another folder"):
        _ = pinred.read_recording(tmp_path / "here/chain.npz").system


@pytest.fixture(scope="module")
def rejected_chains(motions: dict[str, Any]) -> dict[str, tuple[Callable[[], object], str]]:
    """Return chains that are refused, with words of the message."""
    approach, capture, together = (motions[n] for n in ("approach", "capture", "together"))
    longer = pinred.simulate(approach[1].scene, duration=1.5)
    moved = pinred.simulate(capture.system, **{**capture.start, "xi0": np.zeros(6)}, duration=0.5)
    speed = max(1.0, np.abs(together.v[0]).max())
    start = {**capture.start, "xi0": capture.instant.xi + 5e-9 * speed * np.eye(6)[3]}
    slightly = pinred.simulate(capture.system, **start, duration=0.5)
    later = pinred.simulate(approach[1].scene, duration=1.0 + 5e-12)
    rock = pinred.load(pinred.Model("rock").body("rock", mass=1.0, inertia=1.0), gravity=REST)
    alone = pinred.simulate(rock, xi0=np.ones(6), duration=1.0)
    return {
        "no motion first": (lambda: pinred.chain(capture, together), "a motion before each"),
        "wrong end": (
            lambda: pinred.chain([pinred.simulate(traj.scene, duration=0.5) for traj in approach],
                                 capture), "does not have the state",
        ),
        "ends": (lambda: pinred.chain([approach[0], longer], capture, together), "end together"),
        "jump": (lambda: pinred.chain(approach, capture, moved), "does not start where"),
        "without impact": (lambda: pinred.chain(approach, together), "does not start where"),
        "one of two": (lambda: pinred.chain(approach[0], capture, together), "all links of"),
        "other links": (lambda: pinred.chain(approach, capture, alone), "all links of"),
        "lacks": (lambda: pinred.chain(approach, [approach[0]]), "lacks"),
        "other end": (
            lambda: pinred.chain(
                [pinred.simulate(approach[0].scene, duration=0.5),
                 pinred.simulate(approach[1].scene, duration=0.5)], capture, together,
            ), "does not have the state",
        ),
        "slight jump": (lambda: pinred.chain(approach, capture, slightly), "does not start where"),
        "delay": (lambda: pinred.chain([approach[0], later], capture, together), "end together"),
        "empty": (lambda: pinred.chain(), "expected a motion"),
    }  # fmt: skip


@pytest.mark.parametrize(
    "case",
    ["no motion first", "wrong end", "ends", "jump", "without impact", "one of two",
     "other links", "lacks", "other end", "slight jump", "delay", "empty"],
)  # fmt: skip
def test_chain_with_a_gap_is_refused_by_name(
    case: str, rejected_chains: dict[str, tuple[Callable[[], object], str]]
) -> None:
    """The message says which part does not fit, and when."""
    call, words = rejected_chains[case]
    with pytest.raises(InputError, match=words):
        call()


# Turns in space contain turns in the plane.
@pytest.mark.by_hand("SE2")
@pytest.mark.parametrize("group", ["SE2", "SE3"])
def test_chain_goes_on_over_many_turns(group: str) -> None:
    """Neither angles nor quaternions of the relative motion jump, also across the capture."""
    rock = pinred.Model("rock").body("rock", mass=1.0, inertia=1.0)
    a, b = (pinred.load(replace(rock, name=name), group=group, gravity=REST) for name in ("a", "b"))
    still, ahead = a.group.identity(), a.group.exp(15.0 * np.eye(a.r)[-1])
    slow = pinred.simulate(b, pose0=ahead, xi0=5.0 * np.eye(b.r)[-1], duration=1.0)
    fast = pinred.simulate(a, pose0=still, xi0=20.0 * np.eye(a.r)[-1], duration=1.0)
    capture = pinred.capture(slow, fast, at="rock", onto="rock", tolerance=1e-8)
    after = pinred.simulate(capture.system, **capture.start, duration=1.0)
    chain = pinred.chain([slow, fast], capture, after)
    assert np.abs(np.diff(chain.x, axis=0)).max() <= 0.2
    assert capture.instant.xi[-1] == pytest.approx(12.5)
