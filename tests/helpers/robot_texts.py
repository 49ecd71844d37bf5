"""Build small URDF and MJCF files from elements."""

from __future__ import annotations

from pathlib import Path

AXIS = '<axis xyz="0 0 1"/>'

MASS = '<inertial pos="0.1 0 0" mass="2" diaginertia="1 2 2.5"/>'

HINGE = '<joint name="hinge" axis="0 1 1" armature="0.3"/>'


def link(name: str, mass: float = 2.0) -> str:
    """Return a URDF link; it has no inertia if the mass is zero."""
    inertial = (
        f'<inertial><origin xyz="0.1 0 0"/><mass value="{mass}"/><inertia ixx="1" iyy="2" '
        'izz="2.5" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    return f'<link name="{name}">{inertial if mass else ""}</link>'


def joint(parent: str, child: str, kind: str = "revolute", content: str = AXIS) -> str:
    """Return a URDF joint with the name parent-child."""
    return (
        f'<joint name="{parent}-{child}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="0 0.2 0.3" rpy="0.1 0.2 0.3"/>{content}'
        f'<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )


def robot(*elements: str) -> str:
    """Return a URDF file with the given elements."""
    return f'<robot name="r">{"".join(elements)}</robot>'


def mjcf(world: str, head: str = "") -> str:
    """Return an MJCF file with the given bodies."""
    return f'<mujoco model="m">{head}<worldbody>{world}</worldbody></mujoco>'


def body(inside: str, name: str = "base") -> str:
    """Return an MJCF body with mass."""
    return f'<body name="{name}">{inside}{MASS}</body>'


def write(folder: Path, text: str) -> Path:
    """Write a robot file with the suffix of its format; return its path."""
    path = folder / ("arm.xml" if text.startswith("<mujoco") else "arm.urdf")
    path.write_text(text, encoding="utf-8")
    return path


FLOATING = robot(link("a"), link("b"), joint("a", "b"))
