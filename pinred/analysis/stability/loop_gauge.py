"""Perturbations of reduced states with closed loops: closed shapes, and momenta up to gauge.

With closed loops the reduced state contains all joints and an impetus p = π + Jᵀν.  A perturbation
keeps the loops closed, J δx = 0.  Changes of p by Jᵀα change no velocity (gauge); see
reduction/tree/loop_constraints.py.  The linearised flow maps closed perturbations to closed ones
and gauge to gauge, so it acts on closed perturbations that are orthogonal to the gauge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...kernels.state_layout import Layout
from ...reduction.inertia_split import mass_matrix
from ...reduction.tree.loop_constraints import GAUGE_RATE
from ...simulation.sample import Sample
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
        own = [k for k in range(v, v + 3) if k in layout.ball_pi]
        rates += own
        momenta += [2 * active + layout.ball_pi.index(k) for k in own]
        displacements.append(block[[k - v for k in own]])
    return LoopGauge(
        system, np.array(rates, dtype=np.intp), np.array(momenta, dtype=np.intp),
        np.concatenate(displacements),
    )  # fmt: skip
