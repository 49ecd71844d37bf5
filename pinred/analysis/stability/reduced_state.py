"""The reduced state of a compiled flow: names, scales, and tangent space of its leaf.

The state of the compiled kernel is y = (x, π) of the active joints, x of the cyclic joints, entries
of the balls, entries of the base, and time. Cyclic angles and time are left out, because the flow
does not depend on them. The momentum of the base stays on its symplectic leaf, where the Casimirs
are constant. The quaternion q of a ball stays on the sphere |q| = 1; with a conjugate momentum p,
q · p is constant, too.  With closed loops, perturbations keep the loops closed and are orthogonal
to the gauge of the impetus (see `loop_gauge`).

Perturbations of reduced states with closed loops: closed shapes, and momenta up to gauge.

With closed loops the reduced state contains all joints and an impetus p = π + Jᵀν.  A perturbation
keeps the loops closed, J δx = 0.  Changes of p by Jᵀα change no velocity (gauge); see
reduction/tree/loop_constraints.py.  The linearised flow maps closed perturbations to closed ones
and gauge to gauge, so it acts on closed perturbations that are orthogonal to the gauge.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...kernels.kernel import Kernel, Layout
from ...reduction.base_parts import BaseParts
from ...reduction.inertia_split import mass_matrix, usual_inertias
from ...reduction.tree.loop_constraints import GAUGE_RATE
from ...simulation.reduced_flow import Sample
from ...system.joints import BALL
from ...system.loops.looped_system import loop_jacobian, loop_jacobian_rate
from ...system.system import System


@dataclass(frozen=True)
class LoopGauge:
    """Where the reduced state z of a kernel has shapes and momenta of joints with loops.

    Attributes:
        system: The system, with loops.
        rates: Indices of the rates whose momenta are in z, (a,).
        momenta: Positions of these momenta in z, (a,).
        displacements: Map from changes of z to displacements of these rates, (a, k).
    """

    system: System
    rates: NDArray[np.intp]
    momenta: NDArray[np.intp]
    displacements: Array

    def gradients(self, x: Array, scales: Array) -> Array:
        """Return the gradients of the equations, and the gauge, at a shape.

        Args:
            x: Shape, (nx,) [rad | m].
            scales: Typical sizes of z, (k,).
        Returns:
            Unit vectors in z/scales, (2c, k).
        """
        J = self._jacobian(x)
        gauge = np.zeros((len(J), len(scales)))
        gauge[:, self.momenta] = J
        rows = np.concatenate([J @ self.displacements * scales, gauge / scales])
        return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))

    def at_rest(self, x: Array, z: Array, rates: Array) -> tuple[Array, Array]:
        """Return the state in the gauge that does not change with time at rest.

        The forces λ of the loops are missing in ṗ, so in the gauge ν = 0 the impetus of a steady
        motion grows by −Jᵀλ.  It is constant for ν = −λ over the rate of the gauge.

        Args:
            x: Shape, (nx,) [rad | m].
            z: Entries of the reduced state with ν = 0, (k,).
            rates: Their derivatives, (k,).
        Returns:
            The state, (k,), and the map of perturbations from the gauge ν = 0, (k, k).
        """
        J, z = self._jacobian(x), z.copy()
        nu = np.asarray(np.linalg.lstsq(J.T, rates[self.momenta] / GAUGE_RATE, rcond=None)[0])
        z[self.momenta] += J.T @ nu
        return z, np.eye(len(z)) + self._shear(x, nu)

    def reset(self, sample: Sample, z: Array, Z: Array) -> tuple[Array, Array]:
        """Return the state and its perturbations after the change of gauge p → π = p − Jᵀν.

        Args:
            sample: Shape and velocities of the state.
            z: Entries of the reduced state, (k,).
            Z: Perturbations, (k, d).
        Returns:
            The same in the gauge ν = 0.
        """
        system, J, z = self.system, self._jacobian(sample.x), z.copy()
        v = np.concatenate([sample.xi, sample.xdot])
        pi = (mass_matrix(system, sample.x) @ v)[system.r + self.rates]
        nu = np.asarray(np.linalg.lstsq(J.T, z[self.momenta] - pi, rcond=None)[0])
        z[self.momenta] -= J.T @ nu
        return z, Z - self._shear(sample.x, nu) @ Z

    def _shear(self, x: Array, nu: Array) -> Array:
        """Return the derivative of Jᵀν with respect to the shape at constant ν, (k, k)."""
        system, count = self.system, len(self.rates)
        assert system.closure is not None
        by_rate = np.zeros((count, count))
        for column, k in zip(by_rate.T, self.rates.tolist(), strict=True):
            rate = loop_jacobian_rate(system, x, np.eye(system.m)[k])[system.closure.rows]
            column[:] = rate[:, self.rates].T @ nu
        shear = np.zeros((self.displacements.shape[1],) * 2)
        shear[self.momenta] = by_rate @ self.displacements
        return shear

    def _jacobian(self, x: Array) -> Array:
        assert self.system.closure is not None
        J = loop_jacobian(self.system, x)[self.system.closure.rows][:, self.rates]
        return np.asarray(J)


def loop_gauge(
    system: System, layout: Layout, quaternions: tuple[slice, ...], z: Array
) -> LoopGauge | None:
    """Return the gauge of a kernel with loops; None without loops.

    Args:
        system: The system.
        layout: Layout of the kernel, without conjugate momenta of quaternions.
        quaternions: Positions of the quaternions in z.
        z: Entries of the reduced state, (k,).
    """
    if not system.loops:
        return None
    assert not layout.lifted_balls, "of_smooth_momenta() avoids conjugate momenta of quaternions"
    active = len(layout.active)
    rates, momenta = [*layout.active], [*range(active, 2 * active)]
    displacements = [np.eye(active, len(z))]
    for (_, v), entries in zip(layout.balls, quaternions, strict=True):
        block = np.zeros((3, len(z)))
        block[:, entries] = 4.0 * BALL.rate_map(z[entries]).T
        pi_rates = [k for k in range(v, v + 3) if k in layout.ball_pi]
        rates += pi_rates
        momenta += [2 * active + layout.ball_pi.index(k) for k in pi_rates]
        displacements.append(block[[k - v for k in pi_rates]])
    return LoopGauge(
        system, np.array(rates, dtype=np.intp), np.array(momenta, dtype=np.intp),
        np.concatenate(displacements),
    )  # fmt: skip


_ZERO_MOMENTUM = 1e-12  # largest scaled momentum that counts as zero


@dataclass(frozen=True)
class Leaf:
    """The tangent space of the symplectic leaf at a reduced state.

    Attributes:
        indices: Indices of the entries z of y that the flow depends on, (k,).
        scales: Typical sizes of the entries of z, (k,): 1, or an inertia for a momentum.
        basis: Orthonormal basis in z/scales, (k, d).
        names: Names of the entries of z.
        places: Position of x of the active joints in z.
        momenta: Position of π of the active joints in z.
        quaternions: Position of the quaternion of each ball in z.
        gauge: Gauge of closed loops; None without loops.
    """

    indices: Array
    scales: Array
    basis: Array
    names: tuple[str, ...]
    places: slice
    momenta: slice
    quaternions: tuple[slice, ...] = ()
    gauge: LoopGauge | None = None

    def restrict(self, matrix: Array) -> Array:
        """Restrict a matrix (k, k) on z to the leaf, (d, d)."""
        return np.asarray(self.basis.T @ (matrix / self.scales[:, None] * self.scales) @ self.basis)

    def embed(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """Embed vectors on the leaf, (d, …), in z, (k, …)."""
        return np.asarray((self.scales * (self.basis @ vectors).T).T)


def leaf_of(kernel: Kernel, y: Array, x: Array, rate: float = 1.0) -> Leaf:
    """Return the leaf through a reduced state.

    Args:
        kernel: Compiled kernel of the flow.
        y: Reduced state, (size,).
        x: Shape of this state, (nx,), with prescribed joints.
        rate: Typical rate [rad/s], which scales momenta.
    Returns:
        The leaf.
    """
    system, layout = kernel.system, kernel.layout
    active, pairs, base = len(layout.active), layout.pairs, layout.base
    size = layout.base_at + base.size
    indices = np.r_[: 2 * pairs, layout.balls_at : size].astype(np.intp)
    scales = _scales(kernel, rate)[indices]
    basis, z = np.eye(len(indices)), y[indices] / scales
    quaternions = _quaternions(layout)
    gradients = _sphere_gradients(layout, y[indices], scales, quaternions)
    gauge = loop_gauge(system, layout, quaternions, y[indices])
    if gauge is not None:
        gradients = np.vstack([gradients, gauge.gradients(x, scales)])
    if not base.attitude:
        gradients = np.vstack([_casimir_gradients(z, len(z) - base.size, base), gradients])
    basis = _null_space(gradients) if len(gradients) else basis
    return Leaf(
        indices,
        scales,
        basis,
        reduced_names(system, kernel, indices),
        slice(0, active),
        slice(pairs, pairs + active),
        quaternions,
        gauge,
    )


def reduced_names(system: System, kernel: Kernel, indices: Array) -> tuple[str, ...]:
    """Return the names of some entries of the reduced state.

    Args:
        system: The system.
        kernel: Kernel whose layout orders the entries.
        indices: Indices of the entries.
    Returns:
        One name per index.
    """
    layout, base = kernel.layout, kernel.layout.base
    joints = system.shape_names
    attitudes = [system.x_names[k] for k in layout.ball_x]
    names = [joints[k] for k in layout.active] + attitudes * layout.lifted_balls
    names += [f"π {joints[k]}" for k in layout.active]
    names += [f"p {name}" for name in attitudes * layout.lifted_balls]
    names += [joints[k] for k in layout.cyclic]
    if not layout.lifted_balls:
        names += [*(f"π {joints[k]}" for k in layout.ball_pi), *attitudes]
    momentum_names = [
        name.replace("ω", "L") for name in system.group.twist_names[system.group.linear :]
    ]
    names += [*system.group.pose_names[system.group.linear :]][: base.attitude]
    names += [f"Γ{k + 1}" for k in range(base.down)] + momentum_names[: base.momentum]
    names += [f"push {k + 1}" for k in range(base.push)] + ["t"] * layout.clock
    return tuple(names[int(k)] for k in indices)


def _scales(kernel: Kernel, rate: float) -> Array:
    """Return the typical sizes of the reduced-state entries, (size,)."""
    system, layout, base = kernel.system, kernel.layout, kernel.layout.base
    momenta, pairs, r = rate * usual_inertias(system), layout.pairs, system.r
    scales = np.ones(layout.base_at + base.size)
    scales[pairs : pairs + len(layout.active)] = momenta[r:][list(layout.active)]
    first = layout.balls_at
    for k, (_, v) in enumerate(layout.balls):
        width = sum(j in layout.ball_pi for j in range(v, v + 3))
        if layout.lifted_balls:
            first, width = pairs + len(layout.active) + 4 * k, 4
        scales[first : first + width] = momenta[r + v : r + v + 3].max()
        first += width
    if base.momentum:
        offset = layout.base_at + base.attitude + base.down
        scales[offset : offset + base.momentum] = momenta[r - base.momentum : r].max()
    return np.where(scales > 0.0, scales, 1.0)


def _quaternions(layout: Layout) -> tuple[slice, ...]:
    """Return the positions in z of the quaternions of balls."""
    first = 2 * layout.pairs + len(layout.ball_pi)
    if layout.lifted_balls:
        first = len(layout.active)
    return tuple(slice(first + 4 * k, first + 4 * k + 4) for k in range(len(layout.balls)))


def _sphere_gradients(
    layout: Layout, z: Array, scales: Array, quaternions: tuple[slice, ...]
) -> Array:
    """Return the gradients in z/scales of |q|² and of q · p of the balls, one per row.

    Args:
        layout: Layout of the kernel.
        z: Entries of the reduced state, (k,).
        scales: Typical sizes of z, (k,).
        quaternions: Positions of the quaternions in z.
    Returns:
        Unit gradients, (c, k).
    """
    rows = []
    for entries in quaternions:
        row = np.zeros(len(z))
        row[entries] = z[entries]
        rows.append(row)
        if layout.lifted_balls:
            momenta = slice(entries.start + layout.pairs, entries.stop + layout.pairs)
            row = np.zeros(len(z))
            row[entries], row[momenta] = z[momenta], z[entries]
            rows.append(row)
    gradients = np.array(rows).reshape(len(rows), len(z)) * scales
    return np.asarray(gradients / np.linalg.norm(gradients, axis=1, keepdims=True))


def _casimir_gradients(z: Array, at: int, base: BaseParts) -> Array:
    """Return the gradients of the Casimirs in scaled entries z (k,), one per row.

    At zero momentum the leaf is a single point, so that all momenta are constrained.

    Args:
        z: Scaled reduced state, (k,).
        at: Index of the first entry of the base.
        base: Entries of the base.
    Returns:
        Gradients, (c, k).
    """
    if base.down:
        gradients = np.zeros((2, len(z)))
        down, momentum = z[at : at + 3], z[at + 3 : at + 6]
        gradients[0, at : at + 3] = down
        gradients[1, at : at + 3], gradients[1, at + 3 : at + 6] = momentum, down
        return np.asarray(gradients / np.linalg.norm(gradients, axis=1, keepdims=True))
    if base.momentum != 3:
        return np.zeros((0, len(z)))
    gradients, momentum = np.zeros((3, len(z))), z[at : at + 3]
    if np.linalg.norm(momentum) <= _ZERO_MOMENTUM:
        gradients[:, at : at + 3] = np.eye(3)
        return gradients
    gradients[0, at : at + 3] = momentum / np.linalg.norm(momentum)
    return gradients[:1]


def _null_space(matrix: Array) -> Array:
    _, singular, vectors = np.linalg.svd(matrix)
    rank = int((singular > 1e-12 * singular[0]).sum())
    return np.asarray(vectors[rank:].T)
