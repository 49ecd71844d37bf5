"""What a scene lets the simulation skip, in words."""

from __future__ import annotations

from ..forces.model import touched_by
from ..reduction.cyclic_joints import cyclic_of
from ..reduction.potential import falling, pivot_weight, shape_gravity
from ..scene.scene import Scene
from .compiled.choose_method import choose
from .pinocchio.flow import ReducedFlow


def explain_scene(scene: Scene) -> str:
    """Return what is skipped and how many numbers are integrated, as lines of text.

    Raises SymmetryError if gravity breaks the symmetry.
    """
    system = scene.system
    lines = [f"skipped: {line}" for line in skipped(scene)]
    full = system.model.nq + system.n
    lines.append(f"integrated: {full} → {reduced_size(scene)} numbers")
    choice = choose(scene)
    return "\n".join([*lines, f"method: {choice.method.name} ({choice.why})"])


def reduced_size(scene: Scene) -> int:
    """Return how many numbers the compiled engine integrates."""
    forces = scene.force_model
    clock = int(forces is not None and forces.needs_time)
    return ReducedFlow(scene).y0.size - len(cyclic_of(scene.system, touched_by(forces))) + clock


def skipped(scene: Scene) -> list[str]:
    """Return what is not integrated or not computed, a line each."""
    system, flow, forces = scene.system, ReducedFlow(scene), scene.force_model
    names = system.shape_names
    lines = []
    if scene.outputs == "shape":
        lines.append("the base: nobody asks for it")
    if system.group.linear:
        if forces is not None and forces.has_wrench and scene.outputs == "all":
            lines.append("translation of the base: it follows the centre of mass")
        else:
            lines.append("translation of the base: the centre of mass moves on a known path")
        if falling(system).any():
            lines.append("gravity along it: it only makes the centre of mass fall")
    if flow.base.turns and not flow.base.parts.momentum:
        if flow.base.has_momentum:
            lines.append("angular momentum: it follows from the attitude, or is constant")
        else:
            lines.append("all terms with momentum: it is zero, and the base follows the shape")
    driven = [names[k] for k in forces.joints] if forces is not None else []
    if driven:
        lines.append(f"dynamics of the prescribed joints: {', '.join(driven)}")
    cyclic = [names[k] for k in cyclic_of(system, touched_by(forces))]
    if cyclic:
        lines.append(f"momenta of the cyclic joints, which are constant: {', '.join(cyclic)}")
    if not system.m:
        lines.append("shape: there is none")
    elif shape_gravity(system).is_zero and forces is None and not pivot_weight(system).any():
        lines.append("potential: nothing acts on the shape")
    return lines
