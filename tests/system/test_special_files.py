"""MJCF files name no pipes or devices, because MuJoCo would wait for them."""

from __future__ import annotations

import os
from pathlib import Path

import mujoco
import pytest

import pinred

BODY = '<worldbody><body name="b"><freejoint/><geom size=".1"/></body></worldbody>'
MESH = '<worldbody><body name="b"><freejoint/><geom type="mesh" mesh="m"/></body></worldbody>'
SOFT = BODY.replace("</body>", '<flexcomp name="f" type="gmsh" dim="2" file="pipe"/></body>')
FILES = {
    "include": f'<include file="pipe"/>{BODY}',
    "model": f'<asset><model name="x" file="pipe"/></asset>{BODY}',
    "flexible body": SOFT,
    "mesh": f'<asset><mesh name="m" file="pipe"/></asset>{MESH}',
    "folder of meshes": '<asset><mesh name="m" file="pipe"/></asset>'
    f'<compiler meshdir="inner"/>{MESH}',
    "stripped path": '<compiler strippath="true"/>'
    f'<asset><mesh name="m" file="/gone/pipe"/></asset>{MESH}',
}


@pytest.mark.parametrize("name", FILES)
def test_mjcf_that_names_a_pipe_is_refused(name: str, tmp_path: Path) -> None:
    """Wherever MuJoCo may find it."""
    folder = tmp_path / ("inner" if name == "folder of meshes" else ".")
    folder.mkdir(exist_ok=True)
    os.mkfifo(folder / "pipe")
    path = tmp_path / "robot.xml"
    path.write_text(f"<mujoco>{FILES[name]}</mujoco>")
    with pytest.raises(pinred.LoadError, match=r"pipe is a pipe or a device, not a regular file"):
        pinred.load(path)


def test_pipe_in_a_specification_is_refused(tmp_path: Path) -> None:
    """An MjSpec has no text that is checked."""
    os.mkfifo(tmp_path / "pipe.stl")
    source = FILES["mesh"].replace("pipe", str(tmp_path / "pipe.stl"))
    with pytest.raises(pinred.LoadError, match="is a pipe or a device"):
        pinred.load(mujoco.MjSpec.from_string(f"<mujoco>{source}</mujoco>"))


def test_number_of_mesh_folders_is_limited(tmp_path: Path) -> None:
    """Every file name is looked up in each of them."""
    folders = "".join(f'<compiler meshdir="folder{k}"/>' for k in range(51))
    path = tmp_path / "robot.xml"
    path.write_text(f"<mujoco>{folders}{BODY}</mujoco>")
    with pytest.raises(pinred.LoadError, match="more than 50 folders of meshes"):
        pinred.load(path)


@pytest.mark.parametrize("name", ["texture", "hfield", "skin"])
def test_files_that_are_not_read_may_be_anything(name: str, tmp_path: Path) -> None:
    """Textures, height fields and skins affect no motion."""
    os.mkfifo(tmp_path / "pipe.png")
    options = {"texture": 'type="2d" name="t"', "hfield": 'name="t" size="1 1 1 1"', "skin": ""}
    path = tmp_path / "robot.xml"
    asset = f'<asset><{name} {options[name]} file="pipe.png"/></asset>'
    body = BODY.replace("/></body>", ' contype="0" conaffinity="0"/></body>')
    path.write_text(f"<mujoco>{asset}{body}</mujoco>")
    assert pinred.load(path).m == 0
