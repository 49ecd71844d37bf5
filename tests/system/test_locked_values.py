"""Varying values of locked joints gives the robot that is loaded with these values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from robot_texts import joint, link, robot, write

import pinred
from pinred import InputError
from pinred.kernels import build

# A free base with two arms: hinges and slides with references, three joints on one body, a ball,
# and on each arm a joint that follows another.  BENT gives one follower a quadratic law.
MJCF = """<mujoco><option gravity="0 0 -9.81"/>
<default><geom type="box" size=".1 .07 .05" density="800" contype="0" conaffinity="0"/></default>
<worldbody><body name="base" pos="1 2 3"><freejoint/><geom/>
 <body name="a" pos=".2 .1 0" euler="20 10 5">
  <joint name="a1" axis="1 2 .5" pos=".05 0 .1" ref="20"/>
  <joint name="a2" type="slide" axis="0 1 1" ref=".1"/><joint name="a3" axis="0 0 1"/>
  <geom pos=".1 .02 .03" euler="3 4 5"/>
  <body name="b" pos=".3 0 .1" euler="0 40 0"><joint name="ball" type="ball"/><geom/>
   <body name="c" pos=".2 .2 0"><joint name="c1" axis="0 1 0" armature=".02" damping=".1"/><geom/>
    <body name="d" pos=".1 0 .2"><joint name="d1" axis="1 0 0" ref="15"/><geom/></body>
 </body></body></body>
 <body name="e" pos="-.2 .1 0"><joint name="e1" axis="0 0 1" pos="0 .1 0"/><geom/>
  <body name="f" pos="-.2 .1 0"><joint name="f1" axis="0 1 0" ref="-10"/><geom/>
   <body name="g" pos="-.2 .1 0"><joint name="g1" axis="0 1 1"/><geom/></body>
 </body></body>
</body></worldbody>
<equality>
 <joint joint1="f1" joint2="e1" polycoef=".1 -2 0 0 0"/>
 <joint joint1="d1" joint2="c1" polycoef=".1 .5 BENT 0 0"/>
</equality></mujoco>"""
CASES: dict[str, tuple[str, dict[str, float], dict[str, float]]] = {
    "one of three on a body": ("0", {"a2": 0.2}, {"a2": -0.3}),
    "beside followers": ("0", {"a1": 0.2, "a3": 0.1}, {"a1": -0.3, "a3": 0.5}),
    "a leader": ("0", {"e1": 0.2}, {"e1": -0.3}),
    "a leader behind another": ("0", {"c1": 0.2, "a3": 0.0}, {"c1": -0.3, "a3": 1.0}),
    "one that leads by a parabola": ("0.7", {"c1": 0.2}, {"c1": -0.6}),
    "all": ("0", {"a1": 0, "a2": 0, "a3": 0, "c1": 0, "e1": 0}, {"a2": 0.4, "c1": 0.3, "e1": 1.0}),
}


def by_name(values: Mapping[str, float]) -> dict[str, float]:
    """Return values of locked joints as parameters."""
    return {f"{name}.lock": value for name, value in values.items()}


def assert_same_robot(one: pinred.System, other: pinred.System) -> None:
    """Check that two systems have the same inertias, placements, and frames on bodies."""
    assert list(one.model.names) == list(other.model.names)
    for ours, theirs in zip(one.model.inertias, other.model.inertias, strict=True):
        np.testing.assert_allclose(ours.matrix(), theirs.matrix(), rtol=0, atol=2e-12)
    # The placement of the root only moves the world.
    places = zip(one.model.jointPlacements, other.model.jointPlacements, strict=True)
    for here, there in list(places)[2:]:
        np.testing.assert_allclose(here.homogeneous, there.homogeneous, rtol=0, atol=1e-14)
    for own, their in zip(one.model.frames, other.model.frames, strict=True):
        assert (own.name, own.parentJoint) == (their.name, their.parentJoint)
        if own.parentJoint:
            here, there = own.placement, their.placement
            np.testing.assert_allclose(here.homogeneous, there.homogeneous, rtol=0, atol=1e-13)


def compiled(case: str) -> tuple[Any, dict[str, float], dict[str, float]]:
    """Return MuJoCo's model of a case, the locked joints, and other values."""
    bent, lock, values = CASES[case]
    model = mujoco.MjModel.from_xml_string(MJCF.replace("BENT", bent))
    return model, {"ball": 0.0, **lock}, values


@pytest.mark.parametrize("case", CASES)
def test_mjcf_with_varied_locks_matches_mujoco(case: str) -> None:
    """Inertias and placements equal the loaded ones, and the mass matrix equals MuJoCo's."""
    model, lock, values = compiled(case)
    system = pinred.load(model, lock=lock, parameters=by_name(values))
    assert_same_robot(system, pinred.load(model, lock={**lock, **values}))
    data, free = mujoco.MjData(model), [*range(6)]
    at: dict[str, float] = {**lock, **values}
    x = np.random.default_rng(0).uniform(-1.0, 1.0, system.m)
    at |= dict(zip(list(system.model.names)[2:], system.joint_values(x), strict=True))
    for number, leader in ((1, "c1"), (0, "e1")):  # MuJoCo's law gives the follower's value.
        first, second = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        refs = [float(model.qpos0[model.jnt_qposadr[j]]) for j in (first, second)]
        by = at[leader] - refs[1]
        at[model.joint(first).name] = refs[0] + float(
            np.polynomial.Polynomial(model.eq_data[number, :5])(by)
        )
    data.qpos[:3], data.qpos[3:7] = 0.0, [1.0, 0.0, 0.0, 0.0]
    for name, value in at.items():
        if name != "ball":
            data.qpos[model.jnt_qposadr[model.joint(name).id]] = value
    mujoco.mj_forward(model, data)
    H = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, H)
    free += [int(model.joint(name).dofadr[0]) for name in list(system.model.names)[2:]]
    pose = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    ours = pin.crba(system.model, system.model.createData(), system.q(pose, x))
    ours = np.triu(ours) + np.triu(ours, 1).T
    np.testing.assert_allclose(ours, H[np.ix_(free, free)], rtol=0, atol=1e-10 * np.abs(H).max())


# Varied locks are compared with MuJoCo, and share one kernel, by default.
@pytest.mark.by_hand
@pytest.mark.slow
def test_motion_with_varied_locks_matches_aba() -> None:
    """Motions agree with ABA, and derivatives with differences of the flow."""
    model, lock, values = compiled("one that leads by a parabola")
    system, named = pinred.load(model, lock=lock), by_name(values)
    options: dict[str, Any] = {"seed": 1, "duration": 0.2, "method": "DOP853", "rtol": 1e-12}
    flow = pinred.flow(system, wrt=[*named], of=["xdot"], **options)
    assert pinred.compare(pinred.simulate(flow.scene, parameters=named)).passed
    ((name, value),), h = named.items(), 1e-5
    low, high = (flow(**{name: value + s * h}).xdot for s in (-1.0, 1.0))
    expected = (high - low) / (2.0 * h)
    found = flow.jvp({name: 1.0}, **named)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.slow
def test_all_lock_values_share_one_kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All values of a locked leader and its follower need one kernel."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path))
    made: list[str] = []
    whole: Any = vars(build)["compile_object"]

    def counted(function: Any, name: str, *args: Any, **options: Any) -> Any:
        made.append(name)
        return whole(function, name, *args, **options)

    monkeypatch.setattr(build, "compile_object", counted)
    model, lock, _ = compiled("a leader")
    system = pinred.load(model, lock=lock)
    ends = [
        pinred.simulate(
            system, seed=1, duration=0.02, times=[0.02], rtol=1e-6, parameters={"e1.lock": value}
        ).x[-1]
        for value in np.linspace(
            0.3, 1.0, 8
        )  # At the loaded value 0.2 more terms would be constants.
    ]
    assert made == ["rate", "outputs"]
    assert len(np.unique(ends, axis=0)) == 8


def arm(*mimics: str) -> str:
    """Return a URDF of links a to f in a chain, with further content in its joints."""
    links = [link(name) for name in "abcdef"]
    pairs = zip("abcde", "bcdef", (*mimics, "", "", "", "")[:5], strict=True)
    return robot(*links, *(joint(p, c, content='<axis xyz="0 1 1"/>' + m) for p, c, m in pairs))


def test_followers_of_locked_leader_move_with_it(tmp_path: Path) -> None:
    """Direct and indirect followers move with a locked leader; other joints do not."""
    follows = '<mimic joint="a-b" multiplier="-0.5" offset="0.2"/>'
    further = '<mimic joint="b-c" multiplier="3"/>'
    text = arm("", follows, further)
    path = write(tmp_path, text)
    system = pinred.load(path, lock={"a-b": 0.3}, parameters={"a-b.lock": -0.4})
    assert_same_robot(system, pinred.load(path, lock={"a-b": -0.4}))
    assert not np.allclose(
        system.model.inertias[1].matrix(),
        pinred.load(path, lock={"a-b": 0.3}).model.inertias[1].matrix(),
    )
    with pytest.raises(InputError, match=r"it follows 'a-b', with which it is locked; vary"):
        pinred.load(path, lock={"a-b": 0.3}, parameters={"b-c.lock": 0.1})
    path = write(tmp_path, arm("", "", "", "", '<mimic joint="a-b"/>'))
    system = pinred.load(path, lock={"b-c": 0.3}, parameters={"b-c.lock": -0.4})
    assert_same_robot(system, pinred.load(path, lock={"b-c": -0.4}))


def test_lock_varies_behind_root_and_not_ahead(tmp_path: Path) -> None:
    """Locked joints vary behind the joints of the root, and not ahead of them."""
    chain = [joint("w", "c", "prismatic"), joint("c", "d", "planar").replace("0 0.2 0.3", "0 0 0")]
    chain[1] = chain[1].replace("0.1 0.2 0.3", "0 0 0")
    links = [link("w", 0.0), link("c", 0.0), link("d"), link("e"), link("f")]
    path = write(tmp_path, robot(*links, *chain, joint("d", "e"), joint("e", "f")))
    system = pinred.load(path, lock={"d-e": 0.3}, parameters={"d-e.lock": -0.4})
    assert system.group.name == "RxSE2"
    assert_same_robot(system, pinred.load(path, lock={"d-e": -0.4}))
    links = [link("w", 0.0), link("c", 0.0), link("d"), link("e")]
    joints = [joint("w", "c"), joint("c", "d", "continuous"), joint("d", "e")]
    path = write(tmp_path, robot(*links, *joints))
    with pytest.raises(InputError, match=r"'w-c.lock' does not vary: it carries the root"):
        pinred.load(path, lock={"w-c": 0.3}, parameters={"w-c.lock": 0.1}, gravity=[0, 0, 0])
    model, lock, _ = compiled("a leader")
    with pytest.raises(InputError, match=r"'ball.lock' does not vary: it is a ball, whose"):
        pinred.load(model, lock=lock, parameters={"ball.lock": 0.1})
    with pytest.raises(InputError, match=r"'f1.lock' does not vary: it follows 'e1'"):
        pinred.load(model, lock=lock, parameters={"f1.lock": 0.1})
