"""The card that a notebook shows for a scene."""

from __future__ import annotations

from typing import Any

from ..common.html import card, line, numbers, table
from ..forces.controller import Controller
from ..forces.force import Force


def _controls(controls: Any) -> list[tuple[str, str]]:
    """Return a row for each control, or for the controller of all actuators."""
    if isinstance(controls, Controller):
        return [("controls", repr(controls.name))]
    return [(f"control {name}", repr(control)) for name, control in controls.items()]


def scene_card(scene: Any) -> str:
    """Return the initial state, the forces and the settings of a Scene as HTML."""
    system, start = scene.system, scene.start
    rows = [
        (joint.name, numbers(start.x[joint.x]), numbers(start.xdot[joint.v]))
        if joint.kind.is_ball
        else (joint.name, float(start.x[joint.x][0]), float(start.xdot[joint.v][0]))
        for joint in system.space.joints
    ]
    forces: tuple[Force, ...] = vars(scene)["forces"]
    acting = [
        *((f"spring {name}", str(spring)) for name, spring in scene.springs.items()),
        *((force.label, repr(force)) for force in forces),
        *((f"{force.label}, of the file", repr(force)) for force in scene.own_forces),
        *_controls(scene.controls),
        *((f"prescribed {name}", repr(plan)) for name, plan in scene.prescribed.items()),
        *([("hold", scene.hold)] if scene.hold else []),
    ]
    method = scene.integrator or scene.method
    return card(
        f"Scene of {system.name}",
        f"{scene.end:g} s, {len(scene.report_times)} times, rtol {scene.rtol:g}, "
        f"atol {scene.atol:g}, {method}, outputs '{scene.outputs}'",
        table("start", ["joint", "x", "rate"], rows),
        line(f"twist of the base: {numbers(start.xi)}"),
        line(f"pose of the base: {numbers(start.pose)}"),
        table("acting", ["", ""], acting),
    )
