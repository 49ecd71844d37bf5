"""The reduced state of a scene by names, and the directions in which it can change.

The compiled kernel's state is y = (x, π) of the active joints, x of the cyclic ones, parts of the
base, and the time.  Angles of cyclic joints and the time are left out, as nothing depends on them;
the momentum of the base stays on its leaf, where the Casimirs are constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...kernels.kernel import Kernel
from ...reduction.base_parts import BaseParts
from ...reduction.inertia_split import usual_inertias
from ...system.system import System

_NONE = 1e-12  # of the inertia at a usual rate; less momentum is none


@dataclass(frozen=True)
class Leaf:
    """The tangent of the symplectic leaf at a reduced state.

    kept: indices of y that count, (k,).  scales: (k,) usual sizes of these entries: 1, and of a
    momentum the inertia it belongs to.  basis: (k, d) of z/scales, orthonormal.  names: of the kept
    entries.  places, momenta: where x and π of the active joints stand among the kept entries.
    """

    kept: Array
    scales: Array
    basis: Array
    names: tuple[str, ...]
    places: slice
    momenta: slice

    def restricted(self, matrix: Array) -> Array:
        """Return what a matrix (k, k) on z does on the leaf, (d, d)."""
        return np.asarray(self.basis.T @ (matrix / self.scales[:, None] * self.scales) @ self.basis)

    def outward(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """Return vectors (k, …) in z from those on the leaf, (d, …)."""
        return np.asarray((self.scales * (self.basis @ vectors).T).T)


def leaf_of(kernel: Kernel, y: Array, rate: float = 1.0) -> Leaf:
    """Return the leaf through a reduced state (size,) of a kernel.  rate: a usual one [rad/s]."""
    system, layout = kernel.system, kernel.layout
    active, base = len(layout.active), layout.base
    kept = np.r_[: 2 * active, layout.base_at : layout.base_at + base.size].astype(np.intp)
    scales = _scales(kernel, rate)[kept]
    basis = np.eye(len(kept))
    if not base.attitude:
        rows = _casimir_slopes(y[kept] / scales, 2 * active, base)
        basis = _null_space(rows) if len(rows) else basis
    return Leaf(
        kept,
        scales,
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


def _scales(kernel: Kernel, rate: float) -> Array:
    """Return usual sizes of the reduced state's entries, (size,)."""
    system, layout, base = kernel.system, kernel.layout, kernel.layout.base
    usual, active, r = rate * usual_inertias(system), len(layout.active), system.r
    out = np.ones(layout.base_at + base.size)
    out[active : 2 * active] = usual[r:][list(layout.active)]
    if base.momentum:
        at = layout.base_at + base.attitude + base.down
        out[at : at + base.momentum] = usual[r - base.momentum : r].max()
    return np.where(out > 0.0, out, 1.0)


def _casimir_slopes(z: Array, at: int, base: BaseParts) -> Array:
    """Return the slopes of the Casimirs at z (k,), in scaled entries, each in a row.

    at: where the base's entries begin.  Where there is no momentum, the leaf is that point alone.
    """
    if base.down:
        rows = np.zeros((2, len(z)))
        down, momentum = z[at : at + 3], z[at + 3 : at + 6]
        rows[0, at : at + 3] = down
        rows[1, at : at + 3], rows[1, at + 3 : at + 6] = momentum, down
        return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))
    if base.momentum != 3:
        return np.zeros((0, len(z)))
    rows, momentum = np.zeros((3, len(z))), z[at : at + 3]
    if np.linalg.norm(momentum) <= _NONE:
        rows[:, at : at + 3] = np.eye(3)
        return rows
    rows[0, at : at + 3] = momentum / np.linalg.norm(momentum)
    return rows[:1]


def _null_space(rows: Array) -> Array:
    _, singular, vectors = np.linalg.svd(rows)
    rank = int((singular > 1e-12 * singular[0]).sum())
    return np.asarray(vectors[rank:].T)
