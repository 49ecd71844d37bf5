"""The kernel that a plan needs."""

from __future__ import annotations

from ...common.memo import once
from ...kernels.build import build_kernel
from ...kernels.kernel import Kernel
from ...system.variants import nominal
from ..plan import Kind, Plan


def kernel_of(plan: Plan, *, zero_momentum: bool, generic: bool = False) -> Kernel:
    """Return the kernel of a plan, built at most once for a System.

    zero_momentum: whether the angular momentum of the base is exactly zero at the start.
    generic: whether numbers of the robot that vary may become any.
    """
    kind = plan.kind(zero_momentum=zero_momentum, generic=generic)
    return once(kind, Kernel, lambda: _kernel(kind))


def _kernel(kind: Kind) -> Kernel:
    """Return the kernel of a kind, which others of the same structure and expressions share."""
    system, structure, forces = kind.system, kind.structure, kind.forces
    key = (Kernel, structure, None if forces is None else forces.key)
    # Numbers that vary are inputs: what is built for some of them serves all.
    owner = nominal(system)
    return once(owner, key, lambda: build_kernel(system, structure, forces))
