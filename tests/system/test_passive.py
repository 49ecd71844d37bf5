"""Dampers and friction of URDF files and pin.Models in System.passive and left_out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.forces import Damper, Friction
from pinred.system.passive import BASE, UNEVEN

_INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'


def link(name: str, mass: float = 1.0) -> str:
    """Return a link with or without mass."""
    heavy = f'<inertial><mass value="{mass}"/>{_INERTIA}</inertial>' if mass else ""
    return f'<link name="{name}">{heavy}</link>'


def joint(name: str, ends: str, dynamics: str = "", kind: str = "continuous") -> str:
    """Return a joint between the links of two letters."""
    said = f"<dynamics {dynamics}/>" if dynamics else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{ends[0]}"/><child link="{ends[1]}"/>'
        f'<axis xyz="0 0 1"/><limit effort="1" velocity="1" lower="-1" upper="1"/>{said}</joint>'
    )


def write(folder: Path, *parts: str) -> Path:
    """Write a file."""
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{"".join(parts)}</robot>', "utf-8")
    return path


def test_urdf_dynamics_become_passive_forces(tmp_path: Path) -> None:
    """Damping and friction are those of a joint's <dynamics>, without any warning."""
    path = write(
        tmp_path, link("a"), link("b"), link("c"), link("d"),
        joint("j", "ab", 'damping="0.5" friction="0.2"'),
        joint("k", "bc", 'damping="0.25"', "prismatic"),
        joint("l", "cd"),
    )  # fmt: skip
    system = pinred.load(path)
    wanted = (Damper("j", 0.5), Friction("j", 0.2), Damper("k", 0.25))
    assert system.passive == wanted
    assert all(left.demanded for left in system.left_out)
    assert pinred.load(path, lock=["j"]).passive == wanted[2:]
    said = str(pinred.inspect(system))
    assert (
        "the file has 2 dampers and 1 joint with dry friction; a run leaves them out "
        "(passive=True uses springs and dampers, friction=WIDTH uses the friction)"
    ) in said
    assert "2 dampers" in pinred.inspect(system)._repr_html_()


@pytest.mark.parametrize("kind", ["continuous", "planar", "floating"])
def test_urdf_dynamics_of_base_are_left_out(tmp_path: Path, kind: str) -> None:
    """This includes planar and floating joints, whose <dynamics> Pinocchio does not read."""
    path = write(
        tmp_path, link("a", 0.0), link("b"), link("c"),
        joint("base", "ab", 'damping="0.5"', kind), joint("j", "bc", 'friction="0.2"'),
    )  # fmt: skip
    with pytest.warns(pinred.LeftOutWarning, match=rf"{BASE} \(1\)"):
        system = pinred.load(path)
    assert (BASE, ("base",)) in [(left.what, left.names) for left in system.left_out]
    assert system.passive == (Friction("j", 0.2),)


def test_passive_forces_match_joints_in_any_order() -> None:
    """Forces belong to the right joints for any joint order of the model."""
    model, ball = pin.Model(), pin.Inertia.FromSphere(1.0, 0.2)
    model.inertias[0] = ball
    for name, parent in (("a", 0), ("b", 0), ("c", 1), ("d", 2)):
        index = model.addJoint(parent, pin.JointModelRZ(), pin.SE3.Random(), name)
        model.appendBodyToJoint(index, ball, pin.SE3.Random())
    model.damping[:] = [1.0, 2.0, 0.0, 4.0]
    model.upperDryFrictionLimit[:] = [0.0, 0.0, 0.3, 0.4]
    model.lowerDryFrictionLimit[:] = [0.0, 0.0, -0.3, -0.1]
    with pytest.warns(pinred.LeftOutWarning, match=UNEVEN):
        system = pinred.load(model, group="SE3")
    assert system.shape_names == ("a", "c", "b", "d")
    assert set(system.passive) == {
        Damper("a", 1.0), Damper("b", 2.0), Damper("d", 4.0), Friction("c", 0.3)
    }  # fmt: skip
    assert [(left.what, left.names) for left in system.left_out] == [(UNEVEN, ("d",))]
    model.damping[1] = np.nan
    with pytest.raises(pinred.ModelError, match="joint 'b' has damping or friction"):
        pinred.load(model, group="SE3")
