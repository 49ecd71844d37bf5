"""Refusals of MJCF: constraints by name with a way out, and texts that are too large."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mjcf_constructs import BOX
from mujoco_judge import read_tree
from test_mjcf_loading import SIDE, arm, base, loaded, text, with_warning, write

import pinred
from pinred import InputError, LoadError, ModelError, PinredError
from pinred.system.mjcf import compile as mjcf_compilation
from pinred.system.mjcf.equality_constraints import constraints_of
from pinred.system.robot_file_contents import Coupling

TWO = base(arm("left") + arm("right"))
# Constraint between left and right, or one of them and the ground; words of the refusal.
LOOPS = {
    "weld to the ground": ('<weld name="tie" body1="left"/>', ["weld 'tie'", "'left'", "'world'"]),
    "weld to a table": ('<weld name="tie" body1="left" body2="table"/>', ["weld 'tie'", "'table'"]),
}


def with_loop(constraint: str, **options: str) -> str:
    """Return a robot of two arms with a constraint."""
    sites = TWO.replace('<body name="left"', '<site name="a"/><body name="left"').replace(
        '<joint name="left"', '<site name="b"/><joint name="left"'
    )
    said = "".join(f' {key}="{value}"' for key, value in options.items())
    equality = f"<equality>{constraint.replace('/>', said + '/>')}</equality>"
    return text(f'{sites}<body name="table" pos="0 5 0">{BOX}</body>', equality)


@pytest.mark.parametrize("name", LOOPS)
def test_loop_through_the_world_is_refused_unless_inactive(name: str) -> None:
    """The message names the constraint."""
    constraint, words = LOOPS[name]
    with pytest.raises(ModelError) as caught:
        loaded(with_loop(constraint))
    message = str(caught.value)
    assert [
        word for word in [*words, "closed loops", "lock=", "remove it"] if word not in message
    ] == []
    assert loaded(with_loop(constraint, active="false")).m == 2
    off = '<option><flag equality="disable"/></option><equality>'
    assert loaded(with_loop(constraint).replace("<equality>", off)).m == 2


def test_loop_between_links_is_read_unless_inactive_or_locked() -> None:
    """A weld of two arms with a common axis is a coupling, because they turn equally."""
    weld = '<weld name="tie" body1="left" body2="right"/>'
    system = loaded(with_loop(weld))
    assert (system.m, system.loops, system.contents.coupled_loops[0].name) == (1, (), "tie")
    assert str(system.couplings[0]) == "right = 1·left"
    assert not loaded(with_loop(weld, active="false")).contents.coupled_loops
    assert loaded(with_loop(weld), lock=["left", "right"]).m == 0


def test_constraint_without_relative_motion_is_accepted() -> None:
    """The bodies are fixed to each other, or are not the robot's."""
    constraint = '<weld body1="table"/>'
    assert loaded(with_loop(constraint)).m == 2
    system, _ = with_warning(
        with_loop('<weld body1="side"/>').replace("</worldbody>", SIDE + "</worldbody>"),
        root="base",
    )
    assert [left.what for left in system.left_out] == ["other bodies"]


def coupled(constraints: str) -> str:
    """Return two hinges with constraints on joints; one hinge has a reference position."""
    right = '<joint name="right" axis="0 1 0" ref=".4"/>'
    left = '<joint name="left" type="slide" ref=".3"/>'
    return text(
        base(arm("left", left) + arm("right", right)),
        f'<compiler angle="radian"/><equality>{constraints}</equality>',
    )


def test_joint_constraint_becomes_coupling() -> None:
    """Offsets are in shape coordinates, while MuJoCo's are relative to the references."""
    content = coupled('<joint name="gear" joint1="left" joint2="right" polycoef=".1 2"/>')
    tree = read_tree(mujoco.MjSpec.from_string(content))
    (coupling,), _, _ = constraints_of(tree)
    assert coupling == Coupling("left", {"right": 2.0}, coupling.offset)
    assert coupling.offset == pytest.approx(0.3 + 0.1 - 2.0 * 0.4)
    # MuJoCo's residual of the constraint is zero there.
    model = tree.world.model
    data = mujoco.MjData(model)
    leader = 0.9
    data.qpos[model.joint("right").qposadr] = leader
    data.qpos[model.joint("left").qposadr] = coupling.ratios["right"] * leader + coupling.offset
    mujoco.mj_forward(model, data)
    assert data.nefc == 1
    assert data.efc_pos[0] == pytest.approx(0.0, abs=1e-15)
    system = loaded(content)
    assert system.shape_names == ("right",)
    assert system.q(np.zeros(7), [leader])[-2:] == pytest.approx(
        [data.qpos[model.joint(name).qposadr].item() for name in ("left", "right")]
    )


@pytest.mark.parametrize(("polycoef", "value"), [("0", 0.3), (".5", 0.8)])
def test_joint_that_an_equality_holds_is_locked(polycoef: str, value: float) -> None:
    """It is locked where MuJoCo's residual is zero, unless `lock` states another value."""
    content = coupled(f'<joint joint1="left" polycoef="{polycoef}"/>')
    model = mujoco.MjSpec.from_string(content).compile()
    data = mujoco.MjData(model)
    data.qpos[model.joint("left").qposadr] = value
    mujoco.mj_forward(model, data)
    assert data.efc_pos[0] == pytest.approx(0.0, abs=1e-15)
    system = loaded(content)
    assert system.shape_names == ("right",)
    H = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, H)
    free = [k for k in range(model.nv) if k != model.joint("left").dofadr[0]]
    right = data.qpos[model.joint("right").qposadr]
    np.testing.assert_allclose(
        pinred.Reduction(system).mass_matrix(right)[-1, -1], H[np.ix_(free, free)][-1, -1]
    )
    other = loaded(content, lock={"left": 0.1})
    plain = loaded(
        content.replace('joint1="left"', 'joint1="left" active="false"'), lock={"left": 0.1}
    )
    np.testing.assert_array_equal(
        pinred.Reduction(other).mass_matrix(right), pinred.Reduction(plain).mass_matrix(right)
    )


def test_follower_of_locked_leader_is_locked() -> None:
    """It is locked where the leader puts it, and cannot be locked alone."""
    content = coupled('<joint joint1="left" joint2="right" polycoef=".1 2"/>')
    whole, system = loaded(content), loaded(content, lock={"right": 0.7})
    assert system.m == 0
    H = pinred.Reduction(whole).locked_inertia([0.7])
    np.testing.assert_allclose(pinred.Reduction(system).locked_inertia([]), H, atol=1e-14)
    with pytest.raises(InputError, match=r"'left' follows 'right'.*Lock 'right'"):
        loaded(content, lock=["left"])
    with pytest.raises(InputError, match=r"'left' follows 'right', which requires the value 1"):
        loaded(content, lock={"left": 0.5, "right": 0.7})
    bent = coupled('<joint joint1="left" joint2="right" polycoef="0 1 1"/>')
    held = loaded(bent, lock={"right": 0.7})
    put = loaded(bent, lock={"right": 0.7, "left": 0.3 + 0.3 + 0.09})
    assert held.m == 0
    assert held.model.inertias[1].isApprox(put.model.inertias[1], 1e-14)
    assert loaded(bent, lock=["left", "right"]).m == 0


@pytest.mark.parametrize(
    "said",
    [
        '<tendon><fixed name="line" armature="2"><joint joint="left" coef="1"/></fixed></tendon>',
        '<tendon><fixed name="line"><joint joint="left" coef="1"/></fixed></tendon>'
        '<actuator><motor tendon="line" armature="2"/></actuator>',
    ],
)
def test_tendon_with_armature_is_refused(said: str) -> None:
    """It couples joints in the mass matrix, unless its joints are locked."""
    content = text(TWO, said)
    with pytest.raises(ModelError, match=r"tendon 'line' has armature"):
        loaded(content)
    assert loaded(content, lock=["left"]).m == 1


# ---- texts


def deep(count: int) -> str:
    """Return nested bodies."""
    return text("<body>" * count + BOX + "</body>" * count)


LAUGHS = "".join(
    f'<body name="b{k}"><attach body="b{k - 1}" prefix="x{k}_"/>'
    f'<attach body="b{k - 1}" prefix="y{k}_"/></body>'
    for k in range(1, 40)
)
PREFIXED = "".join(
    f'<body name="b{k}"><attach body="b{k - 1}" prefix="x"/><attach body="xb{k - 1}" prefix="y"/>'
    "</body>"
    for k in range(1, 60)
)
# Texts that would exhaust the stack or the memory, take hours, or expand to many elements.
BOMBS = {
    "deep": (deep(20_000), "nested"),
    "defaults": (
        f"<mujoco>{'<default>' * 9_000}{'</default>' * 9_000}</mujoco>", "nested",
    ),
    "wide": (text("<site/>" * 120_000), "more than 100000 elements"),
    "replicated": (
        text(f'<body><replicate count="1000000000">{BOX}</replicate></body>'), "elements",
    ),
    "replicated as numbers go": (
        text(f'<replicate count="1e9"><body>{BOX}</body></replicate>'), "elements",
    ),
    "replicates in replicates": (
        text('<replicate count="99">' * 9 + f"<body>{BOX}</body>" + "</replicate>" * 9), "elements",
    ),
    "grid": (
        text('<body name="b"><flexcomp name="f" type="grid" count="900 900 900" dim="3"/></body>'),
        "elements",
    ),
    "attached": (text(f'<body name="b0">{BOX}</body>{LAUGHS}'), "elements"),
    "attached under new names": (text(f'<body name="b0">{BOX}</body>{PREFIXED}'), "elements"),
    "attributes": (
        text("<body " + " ".join(f'a{k}="1"' for k in range(30_000)) + "/>"), "attributes",
    ),
    "itself": ('<mujoco><include file="robot.xml"/></mujoco>', "includes itself"),
    "itself as a model": (
        '<mujoco><asset><model name="m" file="robot.xml"/></asset><worldbody><body>'
        '<attach model="m" prefix="a"/></body></worldbody></mujoco>',
        "includes itself",
    ),
    "cut": (text(base())[:90], "is not XML"),
    "entities": ('<!DOCTYPE m [<!ENTITY a "b">]><mujoco/>', "document type"),
    "landscape": (
        text(base(), '<asset><hfield name="h" nrow="90000" ncol="90000" size="1 1 1 1"/></asset>'),
        "elements",
    ),
    "ready-made plate": (
        text(base(), '<asset><mesh name="m" builtin="plate" params="9000 9000"/></asset>'),
        "elements",
    ),
    "ready-made torus": (
        text(base(), '<asset><mesh name="m" builtin="supertorus" params="9000 .5 1 1"/></asset>'),
        "elements",
    ),
    "cells": (
        text('<body name="b"><flexcomp name="f" cellcount="900 900 900" count="2 2 2"/></body>'),
        "elements",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_oversized_text_is_refused_at_once(tmp_path: Path, name: str) -> None:
    """The message has one line and names the file."""
    content, words = BOMBS[name]
    with pytest.raises(LoadError, match=words) as caught:
        pinred.load(write(tmp_path, content))
    assert "robot.xml" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("tag", ["include", "INCLUDE", "model"])
def test_oversized_include_is_refused(tmp_path: Path, tag: str) -> None:
    """The included file may be in either folder, and the tag in any case."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/bomb.xml").write_text(deep(5_000))
    (tmp_path / "parts/fuse.xml").write_text(
        f'<mujoco><asset><{tag} name="m" file="bomb.xml"/></asset></mujoco>'
    )
    content = f'<mujoco><include file="parts/fuse.xml"/><worldbody>{base()}</worldbody></mujoco>'
    with pytest.raises(LoadError, match=r"bomb\.xml.*nested"):
        pinred.load(write(tmp_path, content))


def test_include_of_same_name_in_other_folder(tmp_path: Path) -> None:
    """It is another file, except with strippath, which refers to the file beside."""
    (tmp_path / "parts").mkdir()
    part = f"<mujoco><worldbody>{base()}</worldbody></mujoco>"
    (tmp_path / "parts/robot.xml").write_text(part)
    (tmp_path / "parts/bomb.xml").write_text(part)
    path = write(tmp_path, '<mujoco><include file="parts/robot.xml"/></mujoco>')
    with pytest.warns(pinred.LeftOutWarning, match="contact"):
        assert pinred.load(path).m == 0
    (tmp_path / "bomb.xml").write_text(deep(5_000))
    strip = '<mujoco><compiler strippath="true"/><include file="parts/bomb.xml"/></mujoco>'
    with pytest.raises(LoadError, match="nested"):
        pinred.load(write(tmp_path, strip))


def test_too_many_nested_includes_are_refused(tmp_path: Path) -> None:
    """Each file includes the next."""
    for k in range(200):
        (tmp_path / f"f{k}.xml").write_text(f'<mujoco><include file="f{k + 1}.xml"/></mujoco>')
    with pytest.raises(LoadError, match="too many files"):
        pinred.load(tmp_path / "f0.xml")


def test_too_much_text_in_all_files_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit counts all files together."""
    content = text(base())
    path = write(tmp_path, content)
    monkeypatch.setattr(mjcf_compilation, "_MOST_LETTERS", len(content))
    assert pinred.load(path).m == 0
    monkeypatch.setattr(mjcf_compilation, "_MOST_LETTERS", len(content) - 1)
    with pytest.raises(LoadError, match="characters of MJCF"):
        pinred.load(path)


@pytest.mark.slow
def test_too_large_file_is_not_read(tmp_path: Path) -> None:
    """This holds for URDF, too."""
    for name in ("robot.xml", "robot.urdf"):
        path = tmp_path / name
        with path.open("wb") as file:
            file.truncate(300_000_000)
        with pytest.raises(LoadError, match="larger than 256 MB"):
            pinred.load(path)


ROOMS = '<size memory="9000G" nuserdata="2000000000" nkey="2000000000" nuser_body="2000000000"/>'
PICTURES = (
    '<asset><texture name="t" type="2d" builtin="flat" width="99999" height="99999"/></asset>'
)


@pytest.mark.parametrize("head", [ROOMS, PICTURES])
def test_unneeded_memory_is_not_reserved(head: str) -> None:
    """Neither memory for simulation nor textures and height fields."""
    assert loaded(text(base(arm()), head)).m == 1


@pytest.mark.slow
def test_random_text_gives_system_or_one_line_error(tmp_path: Path) -> None:
    """Randomly changed texts never crash the process."""
    code = f"""
import random, warnings
from pathlib import Path
import pinred
warnings.simplefilter("ignore")
seed = Path({str(tmp_path / "seed.xml")!r}).read_text()
path = Path({str(tmp_path / "robot.xml")!r})
words = ["-1", "0", "1e300", "nan", "", "x", "99999999", "1 2", "world", "base", "<", "&", '"']
rng = random.Random(1)
for k in range(150):
    parts = seed.split('"')
    for _ in range(rng.randint(1, 3)):
        parts[rng.randrange(len(parts))] = rng.choice(words)
    path.write_text('"'.join(parts))
    try:
        pinred.load(path)
    except pinred.PinredError as error:
        assert "\\n" not in str(error), error
"""
    seed = text(
        base(arm("left") + arm("right")) + SIDE,
        '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1" face="0 2 1 0 1 3 1 2 3 2 0 3"/>'
        '</asset><actuator><motor name="a" joint="left" gear="2" armature=".1"/></actuator>'
        '<equality><joint joint1="left" joint2="right" polycoef="0 1"/></equality>'
        '<tendon><fixed name="t"><joint joint="left" coef="1"/></fixed></tendon>'
        '<keyframe><key name="k" time="1"/></keyframe>',
    )
    (tmp_path / "seed.xml").write_text(seed)
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["robot.xml", "seed.xml"]


def test_nonfinite_numbers_are_refused() -> None:
    """In a model that was changed, and in one that overflows."""
    model = mujoco.MjModel.from_xml_string(text(base(arm())))
    for name in ("body_mass", "jnt_axis", "dof_armature", "qpos0"):
        changed = model.__copy__()
        getattr(changed, name)[-1] = np.nan
        with pytest.raises(ModelError, match=name):
            pinred.load(changed)
    with pytest.raises(PinredError):
        loaded(text(base(arm().replace('mass="1.3"', 'mass="inf"'))))
