"""What a scene lets the simulation skip, in words."""

from __future__ import annotations

from .cyclic import cyclic_joints
from .flow import ReducedFlow
from .potential import Potential, falling
from .reduction import Reduction
from .scene import Scene


def explain_scene(scene: Scene) -> str:
    """Return what is skipped and how many numbers are integrated, as lines of text.

    Raises SymmetryError if gravity breaks the symmetry.
    """
    system = scene.system
    lines = [f"skipped: {line}" for line in skipped(scene)]
    full = system.model.nq + system.n
    return "\n".join([*lines, f"integrated: {full} → {reduced_size(scene)} numbers"])


def reduced_size(scene: Scene) -> int:
    """Return how many numbers the compiled engine integrates."""
    red = Reduction(scene.system, springs=scene.springs)
    return ReducedFlow(scene).y0.size - len(cyclic_joints(red))


def skipped(scene: Scene) -> list[str]:
    """Return what is not integrated or not computed, a line each."""
    system, red = scene.system, Reduction(scene.system, springs=scene.springs)
    potential = Potential(system, scene.springs)
    lines = []
    if system.group.linear:
        lines.append("translation of the base: the centre of mass moves on a known path")
        if falling(system).any():
            lines.append("gravity along it: it only makes the centre of mass fall")
    if system.group.linear < system.r:
        if ReducedFlow(scene).has_spin:
            lines.append("angular momentum: it follows from the attitude, or is constant")
        else:
            lines.append("all terms with momentum: it is zero, and the base follows the shape")
    names = [system.shape_names[k] for k in cyclic_joints(red)]
    if names:
        lines.append(f"momenta of the cyclic joints, which are constant: {', '.join(names)}")
    if potential.is_zero:
        lines.append("potential: nothing acts on the shape")
    elif not red.system.m:
        lines.append("shape: there is none")
    return lines
