"""Every MJCF construct that affects masses or motions, compared with MuJoCo at random states."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from mjcf_constructs import (
    BOX,
    CONSTRUCTS,
    HEADS,
    HINGE,
    INERTIAL,
    ROOTS,
    mixed,
    of_construct,
    robot,
)
from mujoco_judge import Errors, Judge, read_tree
from strategies import seeds

from pinred.system.mjcf.tree import Tree

EXACT = 1e-12  # relative to the largest entry of M, and to the terms of a force
ARMS = [CONSTRUCTS[name][1] for name in ("Euler angles", "branches", "reference of a hinge", "box")]


def worst(tree: Tree, seed: int = 0) -> Errors:
    """Return the largest errors at three random states."""
    judge, rng = Judge(tree), np.random.default_rng(seed)
    return max((judge.errors(rng) for _ in range(3)), key=lambda errors: errors.worst)


def agrees(folder: Path, text: str) -> Tree:
    """Read a file and compare it with MuJoCo."""
    path = folder / "robot.xml"
    path.write_text(text, encoding="utf-8")
    tree = read_tree(path)
    errors = worst(tree)
    assert errors.worst < EXACT, errors
    return tree


@pytest.mark.parametrize("root", ["fixed", "free", "plane", "ball"])
@pytest.mark.parametrize("name", CONSTRUCTS)
@pytest.mark.sampled(3)
def test_construct_matches_mujoco(tmp_path: Path, name: str, root: str) -> None:
    """Each construct alone, on four roots."""
    agrees(tmp_path, of_construct(name, root))


def test_constructs_are_many_and_distinct() -> None:
    """There are at least sixty constructs, and no two have the same text."""
    assert len(CONSTRUCTS) >= 60
    assert len({of_construct(name) for name in CONSTRUCTS}) == len(CONSTRUCTS)


@pytest.mark.parametrize("name", HEADS)
def test_setting_matches_mujoco(tmp_path: Path, name: str) -> None:
    """Each setting of a whole file."""
    agrees(tmp_path, robot(HEADS[name], "free", ARMS))


@pytest.mark.parametrize("root", ROOTS)
def test_root_matches_mujoco(tmp_path: Path, root: str) -> None:
    """Each motion of the carrying body."""
    agrees(tmp_path, robot("", root, ARMS))


@given(seeds)
@settings(max_examples=25)
def test_random_mixture_matches_mujoco(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    """Several constructs, settings and a root, drawn at random."""
    agrees(tmp_path_factory.mktemp("mixed"), mixed(np.random.default_rng(seed)))


def test_included_and_attached_files_are_found(tmp_path: Path) -> None:
    """Files and models are found beside the including file, or beside the first file."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/arm.xml").write_text(
        '<mujocoinclude><include file="finger.xml"/><include file="parts/thumb.xml"/>'
        "</mujocoinclude>"
    )
    for k, name in enumerate(("finger", "thumb")):
        (tmp_path / f"parts/{name}.xml").write_text(
            f'<mujocoinclude><body pos="{k} 1 0">{HINGE}{INERTIAL}</body></mujocoinclude>'
        )
    (tmp_path / "tool.xml").write_text(
        '<mujoco model="tool"><compiler angle="radian"/><default><geom density="50"/></default>'
        f'<worldbody><body name="tip" euler="0 0 1">{HINGE}{BOX}</body></worldbody></mujoco>'
    )
    tree = agrees(
        tmp_path,
        '<mujoco><asset><model name="tool" file="tool.xml"/></asset><worldbody><body name="base">'
        f'<freejoint/>{BOX}<include file="parts/arm.xml"/><frame pos="0 0 1">'
        '<attach model="tool" body="tip" prefix="its_"/></frame></body></worldbody></mujoco>',
    )
    assert tree.model.njoints == 5
    assert tree.world.body_names[-1] == "its_tip"


def test_mesh_with_mass_is_read_and_texture_is_not(tmp_path: Path) -> None:
    """A mesh with mass is read from the mesh folder; a missing texture is no error."""
    corners = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.4, 0], [0.05, 0.1, 0.5]])
    faces = [(1, 3, 2), (1, 2, 4), (2, 3, 4), (3, 1, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c}" for a, b, c in faces]
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes/part.obj").write_text("\n".join(lines))
    tree = agrees(
        tmp_path,
        '<mujoco><compiler meshdir="shapes" texturedir="none"/><asset><mesh file="part.obj"/>'
        '<texture name="skin" type="2d" file="none.png"/><material name="skin" texture="skin"/>'
        f'</asset><worldbody><body name="base"><freejoint/>{BOX}<body>{HINGE}'
        '<geom type="mesh" mesh="part" material="skin" density="2000"/></body></body></worldbody>'
        "</mujoco>",
    )
    volume = 0.3 * 0.4 * 0.5 / 6.0  # MuJoCo stores meshes in single precision.
    assert tree.model.inertias[2].mass == pytest.approx(2000 * volume, rel=1e-6)


@pytest.mark.parametrize("kind", ["MjSpec", "MjModel"])
def test_spec_and_model_in_memory(kind: str) -> None:
    """Reading does not change a spec; a model is used with its present numbers."""
    spec = mujoco.MjSpec.from_string(robot("", "plane", ARMS))
    if kind == "MjSpec":
        before = spec.to_xml()
        tree = read_tree(spec)
        assert spec.to_xml() == before
    else:
        model = spec.compile()
        model.body_mass[2] *= 3.0
        model.dof_armature[3] = 0.7
        mujoco.mj_setConst(model, mujoco.MjData(model))
        tree = read_tree(model)
    assert worst(tree).worst < EXACT


@pytest.mark.parametrize(
    "what", ["mass", "moment", "lever", "place", "axis", "armature", "gravity"]
)
def test_comparison_detects_small_fault(what: str) -> None:
    """A relative error of 1e-8 in one number exceeds the tolerance by ten or more."""
    tree = read_tree(
        mujoco.MjSpec.from_string(robot("", "free", [*ARMS, CONSTRUCTS["armature"][1]]))
    )
    model, off = tree.model, 1.0 + 1e-8
    inertia = model.inertias[2]
    mass, lever, moment = inertia.mass, np.array(inertia.lever), np.array(inertia.inertia)
    if what in ("mass", "moment", "lever"):
        parts = {"mass": mass, "lever": lever, "moment": moment}
        parts[what] = parts[what] * off
        model.inertias[2] = pin.Inertia(parts["mass"], parts["lever"], parts["moment"])
    elif what == "place":
        model.jointPlacements[2] = pin.SE3(
            model.jointPlacements[2].rotation, off * model.jointPlacements[2].translation
        )
    elif what == "axis":
        turn = pin.exp3(np.full(3, 1e-8))
        model.jointPlacements[2] = pin.SE3(
            turn @ model.jointPlacements[2].rotation, model.jointPlacements[2].translation
        )
    elif what == "armature":
        model.armature = model.armature * off
    else:
        model.gravity.linear = model.gravity.linear * off
    assert worst(tree).worst > 10.0 * EXACT
