"""Which kernel a kind of scene needs."""

from __future__ import annotations

from dataclasses import replace

from ...kernels.build import build_kernel, structure_of
from ...kernels.kernel import Kernel
from ...reduction.potential import pivot_weight
from ...scene.scene import Scene


def kernel_for(scene: Scene, *, zero_momentum: bool, lifted: bool = False) -> Kernel:
    """Return the kernel of a kind of scene, built at most once for a System.

    zero_momentum: whether the angular momentum of its base is exactly zero.  lifted: see
    Structure.
    """
    system, forces = scene.system, scene.force_model
    kernels: dict[tuple[object, ...], Kernel] = system.__dict__.setdefault("_kernels", {})
    lifted = lifted and _can_be_lifted(scene, zero_momentum=zero_momentum)
    kind = (zero_momentum, lifted, scene.outputs, None if forces is None else forces.key)
    if kind not in kernels:
        structure = structure_of(
            system, forces, zero_momentum=zero_momentum, base=scene.outputs == "all"
        )
        structure = replace(structure, lifted=lifted)
        kernels[kind] = build_kernel(system, structure, forces)
    return kernels[kind]


def _can_be_lifted(scene: Scene, *, zero_momentum: bool) -> bool:
    """Return whether a scene has a constant angular momentum that turns in the body."""
    forces, group = scene.force_model, scene.system.group
    changing = bool(pivot_weight(scene.system).any()) or (forces is not None and forces.has_wrench)
    return group.dim - group.linear == 3 and not (zero_momentum or changing)
