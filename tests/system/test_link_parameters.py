"""Inertias of links that are fixed to others, changed in the file or by name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred import InputError
from pinred.cli.command_line import main
from pinred.system.body_parameters import body_parameter, link_inertias

ARM = """<robot name="arm">
<link name="bus"><inertial><origin xyz="0.1 0 0.05"/><mass value="100"/>
  <inertia ixx="10" iyy="12" izz="9" ixy="0.1" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="bus"/><child link="upper"/>
  <origin xyz="0.5 0 0.3" rpy="0.1 0.2 0.3"/><axis xyz="0 0 1"/>
  <limit lower="-9" upper="9" effort="10" velocity="9"/></joint>
<link name="upper"><inertial><origin xyz="0.3 0 0" rpy="0.1 0 0.2"/><mass value="5"/>
  <inertia ixx="0.1" iyy="0.3" izz="0.3" ixy="0" ixz="0" iyz="0.01"/></inertial></link>
<joint name="j2" type="revolute"><parent link="upper"/><child link="hand"/>
  <origin xyz="0.6 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-9" upper="9" effort="10" velocity="9"/></joint>
<link name="hand"><inertial><origin xyz="0.3 0 0"/><mass value="2"/>
  <inertia ixx="0.1" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="grip" type="fixed"><parent link="hand"/><child link="payload"/>
  <origin xyz="0.7 0.1 0" rpy="0.3 -0.2 0.5"/></joint>
<link name="payload"><inertial><origin xyz="0.1 0.02 0.03"/><mass value="25"/>
  <inertia ixx="1" iyy="1.5" izz="1.2" ixy="0.1" ixz="0" iyz="0"/></inertial></link>
<joint name="stick" type="fixed"><parent link="hand"/><child link="tool"/>
  <origin xyz="0.1 0.2 0.3"/></joint>
<link name="tool"/>
</robot>"""
MOTION: dict[str, Any] = {"x0": [0.1, 0.2], "xdot0": [0.5, -0.7], "duration": 1.0}
# Parameters, and the same change in the text of the file.
CHANGES: list[tuple[dict[str, Any], str, str]] = [
    ({"payload.mass": 40.0}, '<mass value="25"/>', '<mass value="40"/>'),
    ({"payload.mass": 1e-6}, '<mass value="25"/>', '<mass value="1e-6"/>'),
    ({"hand.mass": 3.0}, '<mass value="2"/>', '<mass value="3"/>'),
    ({"payload.com": [0.2, 0.0, 0.1]}, 'xyz="0.1 0.02 0.03"', 'xyz="0.2 0 0.1"'),
    (
        {"payload.inertia": [2.0, 0.1, 0.0, 1.5, 0.3, 1.2]},
        '<inertia ixx="1" iyy="1.5" izz="1.2" ixy="0.1" ixz="0" iyz="0"/>',
        '<inertia ixx="2" iyy="1.5" izz="1.2" ixy="0.1" ixz="0" iyz="0.3"/>',
    ),
    (
        {"tool.mass": 0.5, "tool.com": [0.1, 0.0, 0.0]},
        '<link name="tool"/>',
        '<link name="tool"><inertial><origin xyz="0.1 0 0"/><mass value="0.5"/>'
        '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>',
    ),
]


def arm(text: str = ARM) -> pinred.System:
    """Load the arm on a floating bus."""
    return pinred.load(text=text, group="SE3")


@pytest.mark.parametrize(("values", "old", "new"), CHANGES, ids=lambda value: str(value)[:30])
@pytest.mark.sampled
def test_values_of_links_are_those_of_a_file_edited_by_hand(
    values: dict[str, Any], old: str, new: str
) -> None:
    """Pinocchio merges the links of the edited file."""
    assert old in ARM
    edited = arm(ARM.replace(old, new))
    named = pinred.simulate(arm(), parameters=values, **MOTION)
    read = pin.buildModelFromXML(ARM.replace(old, new), pin.JointModelFreeFlyer())
    for own, other in zip(named.system.model.inertias, read.inertias, strict=True):
        np.testing.assert_allclose(own.matrix(), other.matrix(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(named.q, pinred.simulate(edited, **MOTION).q, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "name",
    ["payload.mass", "hand.com", "payload.inertia", "hand.link.mass", "j2.body.mass", "upper.mass"],
)
@pytest.mark.sampled
def test_value_equal_to_the_file_changes_no_bit(name: str) -> None:
    """Also where another value changes."""
    system = arm()
    from pinred.system.model_parameters import ModelParameters

    own = ModelParameters(system, [name]).own()
    plain = pinred.simulate(system, **MOTION)
    for other in (
        pinred.simulate(system, parameters=own, **MOTION),
        pinred.simulate(pinred.load(text=ARM, group="SE3", parameters=own), **MOTION),
    ):
        np.testing.assert_array_equal(other.q, plain.q)
        np.testing.assert_array_equal(other.v, plain.v)
    light = pinred.simulate(system, parameters={"bus.mass": 90.0}, **MOTION)
    both = pinred.simulate(system, parameters={"bus.mass": 90.0, **own}, **MOTION)
    np.testing.assert_array_equal(both.q, light.q)


# Every run has values of links below, and masses in test_many_derivatives.
@pytest.mark.by_hand
def test_members_and_derivatives_agree_with_edited_files() -> None:
    """The payload's mass varies among members and in a flow."""
    system, masses = arm(), np.array([1.0, 25.0, 40.0])
    many = pinred.simulate_many(system, members={"payload.mass": masses}, **MOTION)

    def ends(mass: float) -> Any:
        edited = arm(ARM.replace('"25"', f'"{mass!r}"'))
        return pinred.simulate(edited, rtol=1e-12, **MOTION).x[-1]

    for k, mass in enumerate(masses):
        np.testing.assert_allclose(many[k].x[-1], ends(float(mass)), rtol=0, atol=1e-9)
    flow = pinred.flow(system, wrt=["payload.mass", "payload.com"], **MOTION)
    slope, h = flow.jacobian()["payload.mass"], 1e-3
    differences = (ends(25.0 + h) - ends(25.0 - h)) / (2.0 * h)
    np.testing.assert_allclose(slope[:2], differences, rtol=1e-6)


def test_links_of_models_and_mjcf_have_own_inertias(tmp_path: Path) -> None:
    """A pin.Model keeps them in its frames; in MJCF, bodies without joint are fixed."""
    model = pinred.load(pin.buildModelFromXML(ARM, pin.JointModelFreeFlyer()))
    heavy = pinred.simulate(model, parameters={"payload.mass": 40.0}, **MOTION)
    edited = pinred.simulate(arm(ARM.replace('"25"', '"40"')), **MOTION)
    np.testing.assert_allclose(heavy.q, edited.q, rtol=0, atol=1e-9)
    text = (
        '<mujoco><compiler angle="radian"/><worldbody><body name="bus"><freejoint/>'
        '<inertial pos="0 0.1 0" mass="10" diaginertia="1 1 1"/>'
        '<body name="link" pos="0.5 0 0"><joint name="hinge" axis="0 0 1" pos="0.1 0 0"/>'
        '<inertial pos="0.2 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>'
        '<body name="load" pos="0.3 0.1 0" euler="0.3 0 0.1">'
        '<inertial pos="0 0.1 0" mass="MASS" diaginertia="0.2 0.1 0.15"/></body></body></body>'
        "</worldbody></mujoco>"
    )
    path = tmp_path / "robot.xml"
    path.write_text(text.replace("MASS", "2"), encoding="utf-8")
    system = pinred.load(path, parameters={"load.mass": 3.0, "link.com": [0.25, 0.0, 0.0]})
    edited_text = text.replace("MASS", "3").replace('pos="0.2 0 0"', 'pos="0.25 0 0"')
    mujoco_model = mujoco.MjModel.from_xml_string(edited_text)
    data = mujoco.MjData(mujoco_model)
    mujoco.mj_forward(mujoco_model, data)
    M = np.zeros((7, 7))
    mujoco.mj_fullM(mujoco_model, data, M)
    crba = pin.crba(system.model, system.model.createData(), pin.neutral(system.model))
    np.testing.assert_allclose(np.triu(crba)[6, 6], M[6, 6], rtol=1e-12)
    np.testing.assert_allclose(np.trace(crba[:3, :3]), np.trace(M[:3, :3]), rtol=1e-12)


@pytest.mark.parametrize("armature", [0.3, 8e-9])
def test_rotors_of_the_base_stay_with_a_link_that_changes(armature: float, tmp_path: Path) -> None:
    """The armature of a base belongs to no link, even if it is small."""
    text = (
        '<mujoco><worldbody><body name="bus">'
        f'<joint name="turn" type="ball" armature="{armature}"/>'
        '<inertial pos="0 0 0" mass="10" diaginertia="1 1 1"/>'
        '<body name="arm" pos="0.5 0 0"><joint name="hinge" axis="0 0 1"/>'
        '<inertial pos="0.2 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></body>'
        "</worldbody></mujoco>"
    )
    path = tmp_path / "robot.xml"
    path.write_text(text, encoding="utf-8")
    system = pinred.load(path, parameters={"bus.inertia": [2.0, 0.0, 0.0, 2.0, 0.0, 2.0]})
    moments = np.diag(system.model.inertias[1].inertia)
    np.testing.assert_allclose(moments, 2.0 + armature, rtol=1e-14)


def test_round_off_is_no_rotor() -> None:
    """A link that is alone on its joint is the whole body, so files need no further word."""
    system = pinred.load("falling_cat")
    for link in ("front", "back"):
        parameter = body_parameter(system, f"{link}.com")
        assert parameter is not None
        assert parameter.link == ""


@pytest.mark.parametrize(
    ("own", "fixed", "stated"),
    [
        (2.0, (25.0,), True),
        (2.0, (1e-12,), True),  # a light part
        (8e-9, (1.0,), True),  # a light link
        (0.0, (0.1, 0.2, 0.3), False),  # whose sum has round-off
    ],
)
def test_mass_of_a_link_is_what_its_parts_leave(
    own: float, fixed: tuple[float, ...], stated: bool
) -> None:
    """Pinocchio stores the mass of a body, and those of the links that are fixed to another."""

    def link(name: str, mass: float) -> str:
        moments = f'ixx="{mass}" iyy="{mass}" izz="{mass}" ixy="0" ixz="0" iyz="0"'
        inertial = f'<inertial><mass value="{mass!r}"/><inertia {moments}/></inertial>'
        return f'<link name="{name}">{inertial if mass else ""}</link>'

    text = f'<robot name="arm">{link("bus", 10.0)}{link("hand", own)}'
    text += '<joint name="j" type="continuous"><parent link="bus"/><child link="hand"/></joint>'
    for k, mass in enumerate(fixed):
        text += link(f"part{k}", mass) + f'<joint name="fix{k}" type="fixed"><parent link="hand"/>'
        text += f'<child link="part{k}"/><origin xyz="0.{k} 0.1 0"/></joint>'
    model = pin.buildModelFromXML(text + "</robot>", pin.JointModelFreeFlyer())
    assert ("hand" in link_inertias(model)) is stated
    if stated:
        system = pinred.load(model, parameters={"hand.link.mass": 3.0})
        assert system.mass == pytest.approx(13.0 + sum(fixed), rel=1e-14)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"j2.mass": 3.0}, "'j2' moves the links hand, payload. Write 'j2.body.mass'"),
        ({"payload.mass": 1.0, "hand.body.mass": 3.0}, "'hand.body.mass' sets the whole body"),
        ({"payload.mass": 1.0, "payload.link.mass": 3.0}, "belong to the same body"),
        ({"payload.mass": 0.0}, "must be above zero, got 0"),
        ({"tool.mass": -1.0}, "must be above zero, got -1"),
        ({"payload.inertia": [1, 0, 0, 9, 0, 1]}, "'payload.inertia' is not physical"),
        ({"payload.log_cholesky": np.zeros(10), "payload.mass": 1.0}, "all parameters of a link"),
    ],
    ids=str,
)
def test_vague_and_unphysical_values_are_refused(values: dict[str, Any], message: str) -> None:
    """Each message names the parameter."""
    with pytest.raises(InputError, match=re.escape(message)):
        pinred.simulate(arm(), parameters=values, **MOTION)


def test_files_state_whether_they_mean_the_link_or_the_body(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Earlier versions read "payload.mass" as the mass of the whole body."""
    (tmp_path / "arm.urdf").write_text(ARM, encoding="utf-8")
    scene = tmp_path / "scene.toml"
    lines = (
        'robot = "arm.urdf"\nstart = { x0 = [0.1, 0.2], xdot0 = [0.5, -0.7] }\n'
        "run = { duration = 0.1, samples = 2 }\nload = { group = 'SE3' }\n[parameters]\n"
    )
    scene.write_text(lines + "payload.mass = 40.0\n", encoding="utf-8")
    assert main(["run", str(scene)]) == 2
    error = capsys.readouterr().err
    assert "payload.link.mass" in error
    assert "payload.body.mass" in error
    scene.write_text(lines + "payload.link.mass = 40.0\nupper.mass = 6.0\n", encoding="utf-8")
    assert main(["run", str(scene), "--out", str(tmp_path / "traj.npz")]) == 0
    system = pinred.read_recording(tmp_path / "traj.npz").system
    assert system.mass == pytest.approx(148.0, rel=1e-12)
    arrays = dict(np.load(tmp_path / "traj.npz"))
    arrays["parameter_names"] = np.array(
        [str(name).replace(".link", "") for name in arrays["parameter_names"]]
    )
    np.savez(tmp_path / "old.npz", **arrays)
    with pytest.raises(pinred.LoadError, match=re.escape("payload.link.mass")):
        _ = pinred.read_recording(tmp_path / "old.npz").system
    scene.write_text(
        lines.replace("[parameters]\n", "")
        + '[sweep]\nstore = "r.zarr"\npoints = 2\n[sweep.vary]\n"payload.mass" = "Normal(25, 1)"\n',
        encoding="utf-8",
    )
    assert main(["sweep", str(scene)]) == 2
    assert "payload.link.mass" in capsys.readouterr().err
