"""A Scene as a notebook shows it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..forces.force import Force
    from .scene import Scene


def scene_card(scene: Scene) -> str:
    """Return the start of a scene, and what acts in it, as HTML."""
    from ..common.html import card, line, numbers, table

    system, start = scene.system, scene.start
    rows = zip(system.shape_names, start.x.tolist(), start.xdot.tolist(), strict=True)
    forces: tuple[Force, ...] = vars(scene)["forces"]
    acting = [
        *((f"spring {name}", str(spring)) for name, spring in scene.springs.items()),
        *((force.label, repr(force)) for force in forces),
        *((f"{force.label}, of the file", repr(force)) for force in scene.own_forces),
        *((f"prescribed {name}", repr(plan)) for name, plan in scene.prescribed.items()),
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
