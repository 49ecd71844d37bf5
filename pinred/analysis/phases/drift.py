"""Drift: what momentum adds to the lift of a path, and how it carries small changes to the end.

With a spatial momentum J, ξ = −A x′ + I⁻¹μ, μ = Ad_gᵀ J.  If such a motion is varied,
η = δg g⁻¹ obeys η′ = Ad_g (δξ at the same g) + K η with K η = Ad_g I⁻¹ Ad_gᵀ ad_ηᵀ J.
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
    """Spatial momentum J (r,) of a free system, which is the body's where the base starts.

    momentum: J if the path takes a second; T J if it takes T, since I⁻¹μ dt is what counts.
    """

    system: System
    momentum: Array

    def __post_init__(self) -> None:
        freeze(self)

    def inverse(self, x: Array) -> Array:
        """Return I⁻¹ at shapes (N, m), (N, r, r)."""
        return np.asarray(np.linalg.inv(mechanical_code(self.system).locals(x).P))

    def slopes(self, x: Array, inverse: Array, mu: Array) -> Array:
        """Return ∂(I⁻¹μ)/∂x = −I⁻¹ ∂I I⁻¹μ at fixed μ (N, r), (N, r, m)."""
        omega = (inverse @ mu[..., None])[..., 0]
        return np.asarray(-inverse @ mechanical_code(self.system).locked_derivatives(x, omega))

    def carriers(self, group: Group, h: Array, adjoints: Array, inverse: Array) -> Array:
        """Return Ψ (N, r, r): η at the end by η at the nodes, of pieces of length h (P,).

        adjoints: Ad_g, and inverse: I⁻¹, (N, r, r).  Ψ′ = −Ψ K, by Gauss's method of order 16.
        """
        count, r, table = len(h), self.system.r, tables(STAGES)
        co = np.swapaxes(group.ad(np.eye(r)), 1, 2) @ self.momentum  # rows ad_eᵀ J
        back = np.swapaxes(adjoints, 1, 2)
        K = (adjoints @ inverse @ back @ co.T).reshape(count, STAGES, r, r)
        # From the end of a piece: Y_iᵀ = 1 + h Σ_j (b_j − a_ij) K_jᵀ Y_jᵀ.
        share = table.b - table.mu * table.b
        turned = h[:, None, None, None] * np.moveaxis(K, 3, 1)  # h K_jᵀ, (P, r, 8, r)
        blocks = share[None, :, None, :, None] * turned[:, None]
        size = STAGES * r
        stages = np.linalg.solve(
            np.eye(size) - blocks.reshape(count, size, size),
            np.broadcast_to(np.tile(np.eye(r), (STAGES, 1)), (count, size, r)),
        ).reshape(count, STAGES, r, r)
        own = np.swapaxes(stages, 2, 3)
        weights = h[:, None, None, None] * table.b[:, None, None]
        whole = np.eye(r) + (weights * (own @ K)).sum(axis=1)
        out, after = np.empty((count, STAGES, r, r)), np.eye(r)
        for p in range(count - 1, -1, -1):
            out[p] = after @ own[p]
            after = after @ whole[p]
        return out.reshape(-1, r, r)
