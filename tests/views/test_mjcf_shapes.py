"""Shapes of MJCF files have MuJoCo's placements."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.views.playback.drawn_bodies import drawn_bodies

LOOKS = (
    '<material name="red" rgba="1 0 0 .5"/><mesh name="tip" vertex="0 0 0 .3 0 0 0 .4 0 0 0 .5"/>'
)
SHAPES = """
<geom name="ball" type="sphere" size=".1" pos=".1 .2 .3"/>
<geom name="pill" type="capsule" size=".1 .3" euler="10 20 30" rgba=".1 .2 .3 .4"/>
<geom name="can" type="cylinder" size=".1 .3" fromto="0 0 0 .1 .2 .3" material="red"/>
<geom name="egg" type="ellipsoid" size=".1 .2 .3" pos="0 0 1"/>
<geom name="brick" type="box" size=".1 .2 .3" zaxis="1 1 1"/>
<geom name="tip" type="mesh" mesh="tip" pos=".1 0 0" euler="0 90 0" mass="0"/>
<geom name="hull" type="sphere" size=".9" group="3"/>
<geom name="ghost" type="sphere" size=".9" rgba="1 1 1 0"/>
"""
TEXT = f"""<mujoco><default><geom contype="0" conaffinity="0"/></default><asset>{LOOKS}</asset>
<worldbody><geom type="plane" size="1 1 1"/>
<body name="base" pos="1 2 3"><freejoint/><geom name="trunk" size=".2"/>
<body name="arm" pos=".5 0 0" euler="10 0 0">
<joint name="elbow" ref="10" axis="0 1 1"/>{SHAPES}</body>
<body name="hand" pos="-.5 0 0">
<joint name="wrist" type="slide"/><geom name="palm" size=".3"/></body>
</body></worldbody></mujoco>"""
DRAWN = {
    "trunk": ("sphere", (0.2,)), "ball": ("sphere", (0.1,)), "pill": ("capsule", (0.1, 0.3)),
    "can": ("cylinder", (0.1, np.sqrt(0.14) / 2)), "egg": ("ellipsoid", (0.1, 0.2, 0.3)),
    "brick": ("box", (0.1, 0.2, 0.3)), "tip": ("mesh", (0.0,)), "palm": ("sphere", (0.3,)),
}  # fmt: skip


def write(folder: Path, text: str) -> Path:
    """Write a file."""
    path = folder / "robot.xml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("locked", [False, True])
def test_shapes_have_mujoco_placements(tmp_path: Path, locked: bool) -> None:
    """At a random state, with a frozen joint or not; hidden groups are not drawn."""
    path = write(tmp_path, TEXT)
    system = pinred.load(path, lock={"elbow": 0.6} if locked else {})
    drawn = drawn_bodies(system)
    assert drawn.note == ""
    for solid, (category, size) in zip(drawn.solids, DRAWN.values(), strict=True):
        assert solid.kind == category
        assert solid.size == pytest.approx(size)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    pose = np.concatenate([[0.3, -0.2, 0.5], np.full(4, 0.5)])
    x = {"elbow": 0.6, "wrist": -0.3}
    data.qpos[:7] = [*pose[:3], pose[6], *pose[3:6]]
    data.qpos[7:] = list(x.values())
    mujoco.mj_forward(model, data)
    placed = system.model.createData()
    pin.forwardKinematics(system.model, placed, system.q(pose, [x[n] for n in system.shape_names]))
    for solid, name in zip(drawn.solids, DRAWN, strict=True):
        result = placed.oMi[solid.joint] * pin.XYZQUATToSE3(solid.placement)
        geom = data.geom(name)
        assert result.translation == pytest.approx(geom.xpos, abs=1e-12)
        assert result.rotation == pytest.approx(geom.xmat.reshape(3, 3), abs=1e-12)


def test_mesh_vertices_and_material_colours(tmp_path: Path) -> None:
    """A material colours shapes without a colour."""
    system = pinred.load(write(tmp_path, TEXT))
    drawn = drawn_bodies(system)
    by_name = dict(zip(DRAWN, drawn.solids, strict=True))
    assert by_name["pill"].colour == pytest.approx((0.1, 0.2, 0.3, 0.4))
    assert by_name["can"].colour == pytest.approx((1.0, 0.0, 0.0, 0.5))
    assert by_name["ball"].colour == pytest.approx((0.5, 0.5, 0.5, 1.0))
    (mesh,) = drawn.meshes
    arm = system.model.frames[system.model.getFrameId("arm", pin.FrameType.BODY)].placement
    on_arm = arm.inverse() * pin.XYZQUATToSE3(by_name["tip"].placement)
    result = np.array([on_arm.act(vertex) for vertex in mesh.vertices.astype(float)])
    turn = pin.SE3(pin.exp3(np.array([0.0, np.pi / 2, 0.0])), np.array([0.1, 0.0, 0.0]))
    corners = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.4, 0], [0, 0, 0.5]])
    assert result == pytest.approx(np.array([turn.act(corner) for corner in corners]), abs=1e-6)
    assert mesh.faces.shape == (4, 3)


def test_collision_shapes_are_drawn_without_visual_shapes(tmp_path: Path) -> None:
    """They are in groups that MuJoCo's viewer hides by default."""
    text = TEXT.replace("<geom contype", '<geom group="4" contype')
    system = pinred.load(write(tmp_path, text))
    assert len(drawn_bodies(system).solids) == len(DRAWN) + 1


def test_missing_mesh_is_reported(tmp_path: Path) -> None:
    """The mesh carries no mass, so the robot loads and is drawn from its inertias."""
    text = TEXT.replace(
        '<mesh name="tip" vertex="0 0 0 .3 0 0 0 .4 0 0 0 .5"/>', '<mesh file="tip.stl"/>'
    )
    system = pinred.load(write(tmp_path, text))
    drawn = drawn_bodies(system)
    assert "tip.stl" in drawn.note
    assert {solid.kind for solid in drawn.solids} == {"ellipsoid", "capsule"}


def test_chosen_robot_has_its_shapes_only(tmp_path: Path) -> None:
    """Of several bodies in the world, only one is drawn."""
    ball = '<body name="toy"><freejoint/><geom name="toy" size=".7"/></body></worldbody>'
    path = write(tmp_path, TEXT.replace("</worldbody>", ball))
    with pytest.warns(pinred.LeftOutWarning):
        drawn = drawn_bodies(pinred.load(path, root="toy"))
    assert [solid.size for solid in drawn.solids] == [(0.7,)]
