"""SDF files against Drake, which reads them, with Drake's own mass matrix and forces."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import ChoiceError
from pinred.system.copy_model import split_joints
from pinred.system.independent_reader import mass_difference
from pinred.system.passive import Damper, Friction, Spring
from pinred.system.read_sdf import read_sdf

HAS_DRAKE = find_spec("pydrake") is not None
needs_drake = pytest.mark.skipif(not HAS_DRAKE, reason="drake is not installed")
BODY = (
    "<inertial><pose>0.1 0.02 -0.03 0.1 0.2 0.3</pose><mass>1.3</mass><inertia><ixx>0.2</ixx>"
    "<iyy>0.3</iyy><izz>0.4</izz><ixy>0.01</ixy></inertia></inertial>"
)


def link(name: str, pose: str = "0.1 0.2 0.3 0.4 0.5 0.6") -> str:
    """Return a link with mass."""
    return f'<link name="{name}"><pose>{pose}</pose>{BODY}</link>'


def joint(name: str, kind: str, parent: str, child: str, content: str = "") -> str:
    """Return a joint off the origin of its child."""
    return (
        f'<joint name="{name}" type="{kind}"><pose>0.05 0 0.1 0 0.3 0</pose>'
        f"<parent>{parent}</parent><child>{child}</child>{content}</joint>"
    )


def axis(xyz: str, inside: str = "", tag: str = "axis") -> str:
    """Return the axis of a joint."""
    return f"<{tag}><xyz>{xyz}</xyz>{inside}</{tag}>"


def sdf(*elements: str) -> str:
    """Return a file with one model."""
    return f'<sdf version="1.9"><model name="m">{"".join(elements)}</model></sdf>'


def write(folder: Path, text: str) -> Path:
    """Write a file; return its path."""
    path = folder / "arm.sdf"
    path.write_text(text, encoding="utf-8")
    return path


LINKS = [link(name, f"0.{k} 0 0.2 0.{k} 0.1 0") for k, name in enumerate("abcdefg")]
ALL = sdf(
    *LINKS,
    joint("pivot", "revolute", "world", "a", axis("0 1 0")),
    joint("hinge", "revolute", "a", "b", axis("0.6 0.8 0", "<limit><lower>-1</lower></limit>")),
    joint(
        "slide", "prismatic", "b", "c", axis("0 0 1", "<dynamics><damping>.3</damping></dynamics>")
    ),
    joint("cross", "universal", "a", "d", axis("1 0 0") + axis("0 1 0", tag="axis2")),
    joint("neck", "ball", "d", "e"),
    joint(
        "thread", "screw", "e", "f", axis("0 0 1") + "<screw_thread_pitch>.7</screw_thread_pitch>"
    ),
    joint("glue", "fixed", "f", "g"),
)


@needs_drake
def test_masses_and_forces_agree_with_drake(tmp_path: Path) -> None:
    """Every joint type, with fixed links, at random states."""
    path = write(tmp_path, ALL)
    robot = read_sdf(path)
    assert mass_difference(path, robot) <= 1e-13
    robot.model.inertias[3].mass *= 1.0 + 1e-9
    assert 1e-12 < mass_difference(path, robot) < 1e-6


@needs_drake
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.sampled(3)
def test_forces_agree_with_drake(tmp_path: Path, seed: int) -> None:
    """Bias forces at random states."""
    path, rng = write(tmp_path, ALL), np.random.default_rng(seed)
    plant: Any = import_module("pydrake.multibody.plant").MultibodyPlant(0.0)
    import_module("pydrake.multibody.parsing").Parser(plant).AddModels(str(path))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    model, q, v, J = read_sdf(path).model, [], [], np.zeros((9, plant.num_velocities()))
    for name in list(model.names)[1:]:
        drake, k = plant.GetJointByName(name), model.joints[model.getJointId(name)].idx_v
        value, rate = (
            rng.uniform(-1, 1, drake.num_positions()),
            rng.normal(size=drake.num_velocities()),
        )
        plant.SetPositions(
            context, _place(plant.GetPositions(context), drake.position_start(), value)
        )
        rates = _place(plant.GetVelocities(context), drake.velocity_start(), rate)
        plant.SetVelocities(context, rates)
        # Drake's angular velocity of a ball is in the axes of its parent.
        turn = pin.rpy.rpyToMatrix(*value).T if name == "neck" else np.eye(len(rate))
        J[k : k + len(rate), drake.velocity_start() : drake.velocity_start() + len(rate)] = turn
        q += [*pin.Quaternion(turn.T).coeffs()] if name == "neck" else [*value]
        v += [*(turn @ rate)]
    data, q_, v_ = model.createData(), np.array(q), np.array(v)
    bias = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
    own = J.T @ pin.nonLinearEffects(model, data, q_, v_)
    assert np.abs(own - bias).max() <= 1e-12 * np.abs(bias).max()


def _place(values: Array, start: int, part: Array) -> Array:
    values = values.copy()
    values[start : start + len(part)] = part
    return values


@needs_drake
def test_joints_have_names_limits_and_damping(tmp_path: Path) -> None:
    """Fixed links are part of their carriers."""
    model = read_sdf(write(tmp_path, ALL)).model
    assert list(model.names)[1:] == [
        "pivot", "hinge", "slide", "cross", "neck", "thread",
    ]  # fmt: skip
    hinge, slide = (model.joints[model.getJointId(name)] for name in ("hinge", "slide"))
    assert model.lowerPositionLimit[hinge.idx_q] == -1.0
    assert model.damping[slide.idx_v] == 0.3
    parts = list(split_joints(model).model.names)[2:]
    assert parts == ["hinge", "slide", "cross.1", "cross.2", "neck", "thread", "thread.slide"]


@needs_drake
def test_limits_are_left_out_by_kind(tmp_path: Path) -> None:
    """Limits of positions, rates and efforts that the file states, and no others."""
    limits = (
        "<limit><lower>-1</lower><upper>1</upper></limit>",
        "<limit><velocity>2</velocity></limit>",
        "<limit><effort>3</effort></limit>",
        "",
    )
    links = [link(f"b{k}") for k in range(5)]
    joints = [
        joint(f"j{k}", "revolute", f"b{k}", f"b{k + 1}", axis("0.6 0.8 0", text))
        for k, text in enumerate(limits)
    ]
    system = pinred.load(write(tmp_path, sdf(*links, *joints)))
    assert [(left.what, left.names) for left in system.left_out] == [
        ("joint limits", ("j0",)), ("velocity limits", ("j1",)), ("effort limits", ("j2",)),
    ]  # fmt: skip


@needs_drake
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.sampled
def test_floating_model_is_loaded_and_simulated(tmp_path: Path, kind: str) -> None:
    """With springs, dampers and friction."""
    dynamics = (
        "<dynamics><damping>.3</damping><friction>.2</friction><spring_stiffness>3</spring_stiffness>"
        "<spring_reference>.4</spring_reference></dynamics>"
    )
    hinge = joint("hinge", kind, "a", "b", axis("0.6 0.8 0", dynamics))
    system = pinred.load(write(tmp_path, sdf(*LINKS[:2], hinge)))
    assert system.group.name == "SE3"
    assert system.shape_names == ("hinge",)
    assert set(system.passive) == {
        Spring("hinge", 3.0, 0.4), Damper("hinge", 0.3), Friction("hinge", 0.2),
    }  # fmt: skip
    assert pinred.compare(pinred.simulate(system, seed=0, duration=0.2)).passed


REFUSED = {
    "several robots": (
        sdf(*LINKS[:2]), ChoiceError, r"several robots \(a, b\); choose one with root="
    ),
    "a loop of slides": (
        sdf(
            *LINKS[:3],
            joint("one", "prismatic", "a", "b", axis("1 0 0")),
            joint("two", "prismatic", "a", "c", axis("1 0 0")),
            joint("three", "prismatic", "b", "c", axis("1 0 0")),
        ),
        pinred.ModelError,
        r"line 1: link 'c' closes a loop .*\(here 'three'\).* use a revolute, ball or fixed joint",
    ),
    "a loop with a screw": (
        sdf(
            *LINKS[:3],
            joint("one", "prismatic", "a", "b", axis("1 0 0")),
            joint("two", "prismatic", "a", "c", axis("1 0 0")),
            joint("three", "screw", "b", "c", axis("1 0 0")),
        ),
        pinred.ModelError,
        r"link 'c' closes a loop .*\(here 'three'\)",
    ),
    "revolute2": (
        sdf(*LINKS[:2], "\n", joint("one", "revolute2", "a", "b", axis("1 0 0"))),
        pinred.ModelError,
        r"line 2: joint 'one' is of type revolute2, .*; use revolute, ",
    ),
    "a curvilinear joint": (
        sdf(*LINKS[:2], '<drake:joint name="one" type="curvilinear"/>'),
        pinred.ModelError,
        r"line 1: joint 'one' is of type curvilinear, .*; use revolute, ",
    ),
    "no axis": (
        sdf(*LINKS[:2], joint("one", "universal", "a", "b", axis("1 0 0"))),
        pinred.LoadError,
        "line 1: universal joint 'one' has no <axis2>; add it",
    ),
    "no model": ('<sdf version="1.9"/>', pinred.LoadError, "Drake cannot read|no model"),
    "no parent": (
        sdf(*LINKS[:2], "\n", joint("one", "fixed", "nobody", "b")),
        pinred.LoadError,
        r"Drake cannot read .*arm.sdf, line 2: parent frame with name\[nobody\]",
    ),
    "a word without number": (
        sdf(*LINKS[:2], joint("one", "revolute", "a", "b", axis(
            "1 0 0", "\n<limit><upper>a</upper></limit>"
        ))),
        pinred.LoadError,
        "arm.sdf, line 2: <upper>: expected 1 number, got 'a'",
    ),
    "negative damping": (
        sdf(*LINKS[:2], joint("one", "revolute", "a", "b", axis(
            "1 0 0", "<dynamics><damping>-1</damping></dynamics>"
        ))),
        pinred.LoadError,
        "line 1: damping must not be negative, got -1",
    ),
    "crossed limits": (
        sdf(*LINKS[:2], joint("one", "revolute", "a", "b", axis(
            "1 0 0", "<limit><lower>1</lower><upper>0.5</upper></limit>"
        ))),
        pinred.LoadError,
        "line 1: limits 1 > 0.5; exchange lower and upper",
    ),
    "two joints of one name": (
        sdf(*LINKS[:3], joint("one", "fixed", "a", "b"), "\n", joint("one", "fixed", "b", "c")),
        pinred.LoadError,
        "line 2: a second joint is called 'one'; rename it",
    ),
    "a zero pitch": (
        sdf(*LINKS[:2], joint(
            "one", "screw", "a", "b", axis("1 0 0") + "<thread_pitch>0</thread_pitch>"
        )),
        pinred.LoadError,
        "line 1: <thread_pitch> must not be zero",
    ),
    "a follower of a third axis": (
        sdf(
            *LINKS[:3],
            joint("one", "revolute", "a", "b", axis("1 0 0")),
            joint("two", "revolute", "b", "c", axis("1 0 0", '<mimic joint="one" axis="axis3"/>')),
        ),
        pinred.LoadError,
        "line 1: <mimic>: axis must be axis or axis2, got 'axis3'",
    ),
    "a follower of a missing axis": (
        sdf(
            *LINKS[:3],
            joint("one", "revolute", "a", "b", axis("1 0 0")),
            joint("two", "revolute", "b", "c", axis("1 0 0", '<mimic joint="one" axis="axis2"/>')),
        ),
        pinred.ModelError,
        "line 1: <mimic> of 'one': axis 2 of a revolute joint has no coordinate",
    ),
    "a follower of nobody": (
        sdf(
            *LINKS[:2], joint("two", "revolute", "a", "b", axis("1 0 0", "<mimic/>")),
        ),
        pinred.LoadError,
        "line 1: <mimic> names no joint; add the attribute joint=",
    ),
    "a follower that closes a loop": (
        sdf(
            *LINKS[:3],
            joint("one", "prismatic", "a", "b", axis("1 0 0")),
            joint("two", "prismatic", "b", "c", axis("1 0 0")),
            joint("three", "revolute", "a", "c", axis("1 0 0", '<mimic joint="one"/>')),
        ),
        pinred.ModelError,
        "line 1: joint 'three' closes a loop and follows another joint; remove its <mimic>",
    ),
    "a leader that closes a loop": (
        sdf(
            *LINKS[:3],
            joint("one", "prismatic", "a", "b", axis("1 0 0")),
            joint("two", "prismatic", "b", "c", axis("1 0 0", '<mimic joint="three"/>')),
            joint("three", "revolute", "a", "c", axis("1 0 0")),
        ),
        pinred.ModelError,
        "line 1: joint 'two' follows 'three', which closes a loop; let it follow another",
    ),
    "a reserved name": (
        sdf(*LINKS[:2], joint("universe", "revolute", "a", "b", axis("1 0 0"))),
        pinred.ModelError,
        "line 1: joint 'universe' has a reserved name; rename it",
    ),
    "a rod": (
        sdf(*LINKS[:1], "\n<drake:distance_constraint/>"),
        pinred.ModelError,
        "line 2: <drake:distance_constraint> is not supported; pinred has no rod",
    ),
    "a fixed leader": (
        sdf(
            *LINKS[:3],
            joint("one", "fixed", "a", "b"),
            joint("two", "revolute", "b", "c", axis("1 0 0", '<mimic joint="one"/>')),
        ),
        pinred.ModelError,
        "line 1: joint 'two' follows 'one', which is fixed; fix the follower, too",
    ),
    "an unknown leader": (
        sdf(
            *LINKS[:2],
            joint("two", "revolute", "a", "b", axis("1 0 0", '<mimic joint="one"/>')),
        ),
        pinred.ModelError,
        "line 1: joint 'two' follows 'one', which is no joint of the robot; name a joint",
    ),
    "nothing that moves": (
        sdf("<static>true</static>", *LINKS[:2]), pinred.ModelError, "nothing moves in "
    ),
}  # fmt: skip


@needs_drake
@pytest.mark.parametrize("name", REFUSED)
def test_invalid_file_is_refused(tmp_path: Path, name: str) -> None:
    """By the name of the joint or link."""
    text, error, words = REFUSED[name]
    with pytest.raises(error, match=words):
        pinred.load(write(tmp_path, text))


@needs_drake
def test_body_fixed_to_the_world_floats_with_a_warning(tmp_path: Path) -> None:
    """As in URDF and MJCF."""
    text = sdf(LINKS[0], joint("bolt", "fixed", "world", "a"))
    with pytest.warns(pinred.ModelWarning, match="the file fixes a to the world, but here it is"):
        assert pinred.load(write(tmp_path, text)).group.name == "SE3"


def test_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the command that installs it."""
    monkeypatch.setitem(sys.modules, "pydrake.multibody.plant", None)
    with pytest.raises(pinred.MissingPackageError, match=r"SDF is read by Drake.*pinred\[sdf\]"):
        pinred.load(write(tmp_path, ALL))
