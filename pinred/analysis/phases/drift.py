"""The effect of momentum on the lift of a path, and the propagation of variations to its end.

With a spatial momentum J, ξ = −A x′ + I⁻¹μ and μ = Ad_gᵀ J. A variation η = δg g⁻¹ of such a motion
obeys η′ = Ad_g δξ + K η, with δξ at fixed g and K η = Ad_g I⁻¹ Ad_gᵀ ad_ηᵀ J.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ...integrators.gauss.tables import tables
from ...lie.group import Group
from ...system.system import System
from ..connections.mechanical import mechanical_code
from .lift import STAGES


@dataclass(frozen=True, eq=False)
class Drift:
    """The drift I⁻¹μ of a free system with constant spatial momentum.

    Attributes:
        system: System without external wrench.
        momentum: Spatial momentum J, (r,), in the initial frame of the base. For a path that takes
            T seconds but is parametrised over [0, 1], this is T J.
    """

    system: System
    momentum: Array

    def __post_init__(self) -> None:
        freeze(self)

    def inverse(self, x: Array) -> Array:
        """Compute the inverse locked inertia I⁻¹.

        Args:
            x: Shapes, (N, m).
        Returns:
            (N, r, r).
        """
        return np.asarray(np.linalg.inv(mechanical_code(self.system).locals(x).P))

    def slopes(self, x: Array, inverse: Array, mu: Array) -> Array:
        """Compute the shape derivative of the drift, ∂(I⁻¹μ)/∂x = −I⁻¹ ∂I I⁻¹μ, at fixed μ.

        Args:
            x: Shapes, (N, m).
            inverse: I⁻¹ at these shapes, (N, r, r).
            mu: Body momenta, (N, r).
        Returns:
            (N, r, m).
        """
        omega = (inverse @ mu[..., None])[..., 0]
        return np.asarray(-inverse @ mechanical_code(self.system).locked_derivatives(x, omega))

    def carriers(self, group: Group, h: Array, adjoints: Array, inverse: Array) -> Array:
        """Compute the propagators Ψ of variations, η(end) = Ψ η(node).

        They obey Ψ′ = −Ψ K, which is solved backward by Gauss's method of order 16.

        Args:
            group: Symmetry group.
            h: Lengths of the P segments, (P,).
            adjoints: Ad_g at the N = 8 P Gauss nodes, (N, r, r).
            inverse: I⁻¹ at the nodes, (N, r, r).
        Returns:
            (N, r, r).
        """
        count, r, table = len(h), self.system.r, tables(STAGES)
        co = np.swapaxes(group.ad(np.eye(r)), 1, 2) @ self.momentum  # rows ad_eᵀ J
        coadjoints = np.swapaxes(adjoints, 1, 2)
        K = (adjoints @ inverse @ coadjoints @ co.T).reshape(count, STAGES, r, r)
        # Integrate from the end of a segment: Y_iᵀ = 1 + h Σ_j (b_j − a_ij) K_jᵀ Y_jᵀ.
        backward_weights = table.b - table.mu * table.b
        scaled_K = h[:, None, None, None] * np.moveaxis(K, 3, 1)  # h K_jᵀ, (P, r, 8, r)
        blocks = backward_weights[None, :, None, :, None] * scaled_K[:, None]
        size = STAGES * r
        stages = np.linalg.solve(
            np.eye(size) - blocks.reshape(count, size, size),
            np.broadcast_to(np.tile(np.eye(r), (STAGES, 1)), (count, size, r)),
        ).reshape(count, STAGES, r, r)
        node_propagators = np.swapaxes(stages, 2, 3)
        weights = h[:, None, None, None] * table.b[:, None, None]
        segment_propagators = np.eye(r) + (weights * (node_propagators @ K)).sum(axis=1)
        propagators, to_end = np.empty((count, STAGES, r, r)), np.eye(r)
        for p in range(count - 1, -1, -1):
            propagators[p] = to_end @ node_propagators[p]
            to_end = to_end @ segment_propagators[p]
        return propagators.reshape(-1, r, r)
