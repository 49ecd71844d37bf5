"""The reduced state of a scene by names, and the directions in which it can change.

The compiled kernel's state is y = (x, π) of the active joints, x of the cyclic ones, parts of the
base, and the time.  Angles of cyclic joints and the time are left out, as nothing depends on them;
the momentum of the base stays on its leaf, where the Casimirs are constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array
from ...kernels.kernel import Kernel
from ...system.system import System


@dataclass(frozen=True)
class Leaf:
    """The tangent of the symplectic leaf at a reduced state.

    kept: indices of y that count, (k,).  basis: (k, d) orthonormal.  names: of the kept entries.
    places, momenta: where x and π of the active joints stand among the kept entries.
    """

    kept: Array
    basis: Array
    names: tuple[str, ...]
    places: slice
    momenta: slice


def leaf_of(kernel: Kernel, y: Array) -> Leaf:
    """Return the leaf through a reduced state (size,) of a kernel."""
    system, layout = kernel.system, kernel.layout
    active, base = len(layout.active), layout.base
    kept = np.r_[: 2 * active, layout.base_at : layout.base_at + base.size].astype(np.intp)
    basis = np.eye(len(kept))
    if not base.attitude:
        at, z = 2 * active, y[kept]
        down, momentum = z[at : at + base.down], z[at + base.down : at + base.down + base.momentum]
        rows = np.zeros((0, len(kept)))
        if base.down:
            rows = np.zeros((2, len(kept)))
            rows[0, at : at + 3] = down
            rows[1, at : at + 3], rows[1, at + 3 : at + 6] = momentum, down
        elif base.momentum == 3:
            rows = np.zeros((1, len(kept)))
            rows[0, at : at + 3] = momentum
        if rows.size and rows.any():
            basis = _null_space(rows)
    return Leaf(
        kept,
        basis,
        reduced_names(system, kernel, kept),
        slice(0, active),
        slice(active, 2 * active),
    )


def reduced_names(system: System, kernel: Kernel, kept: Array) -> tuple[str, ...]:
    """Return the names of some entries of the reduced state."""
    layout, base = kernel.layout, kernel.layout.base
    joints = system.shape_names
    names = [joints[k] for k in layout.active]
    names += [f"π {joints[k]}" for k in layout.active]
    names += [joints[k] for k in layout.cyclic]
    turns = [name.replace("ω", "L") for name in system.group.twist_names[system.group.linear :]]
    names += [*system.group.pose_names[system.group.linear :]][: base.attitude]
    names += [f"Γ{k + 1}" for k in range(base.down)] + turns[: base.momentum]
    names += [f"push {k + 1}" for k in range(base.push)] + ["t"] * layout.clock
    return tuple(names[int(k)] for k in kept)


def _null_space(rows: Array) -> Array:
    _, singular, vectors = np.linalg.svd(rows)
    rank = int((singular > 1e-12 * singular[0]).sum())
    return np.asarray(vectors[rank:].T)
