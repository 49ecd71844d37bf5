"""The kernel that a plan needs."""

from __future__ import annotations

from ...common.memo import once
from ...kernels.build import build_kernel
from ...kernels.kernel import Kernel
from ..plan import Plan


def kernel_of(plan: Plan, *, zero_momentum: bool) -> Kernel:
    """Return the kernel of a plan, built at most once for a System.

    zero_momentum: whether the angular momentum of the base is exactly zero at the start.
    """
    system, forces = plan.system, plan.forces
    structure = plan.kind(zero_momentum=zero_momentum).structure
    kind = (Kernel, structure, None if forces is None else forces.key)
    return once(system, kind, lambda: build_kernel(system, structure, forces))
