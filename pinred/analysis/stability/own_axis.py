"""The symmetry of a heavy body about its own axis, whose momentum decides where height does not.

Where gravity turns a pivoted body, the momentum about the vertical is kept, and a top that sleeps
upright is no minimum of what that leaves.  A top that is symmetric about an axis a of its own
through the pivot also keeps μ·a.  So does one with rotors whose angles nothing depends on: with
K = K_bb − K_bc K_cc⁻¹ K_cb, the inertia of base and cyclic rotors b, c that these leave, and the
momentum k that stays when the body stands still,

    h(Γ, μ) = ½ (μ − k)ᵀ K⁻¹ (μ − k) − m |g| c·Γ,     k = H_bd ν + K_bc K_cc⁻¹ (π − H_cd ν),

for momenta π of the cyclic rotors and rates ν of the driven ones.

Source: D. Lewis, T. Ratiu, J. C. Simo, J. E. Marsden, "The heavy top: a geometric treatment",
Nonlinearity 5, 1992.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ...lie.rotations import hat
from ...reduction.tree.second_derivatives import inertia_derivatives
from ..equilibria.problem import Problem

_SYMMETRIC = 1e-12  # of the inertia, by which a body may miss being symmetric
_CRITICAL = 1e-8  # of the slope of the energy, what may be left of it at an equilibrium
_RANK = 1e-10  # of the largest singular value
_DEFINITE = 1e-14  # of the largest entry, the least curvature that counts
_REACH = 1e3  # times the rates of the body, to which multipliers are tried


@dataclass(frozen=True)
class HeavyTop:
    """A body on a pivot in gravity, with rotors that turn steadily; arrays are read-only.

    inertia: (3, 3) K.  offset: (3,) k.  com: (3,) c.  weight: m |g|.  scales: (6,) usual sizes of
    (Γ, μ).  rate: a usual one [rad/s].
    """

    inertia: Array
    offset: Array
    com: Array
    weight: float
    scales: Array
    rate: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def axis(self) -> Array | None:
        """The direction (3,) about which inertia, centre of mass and rotors are symmetric."""
        axis = self.com / np.linalg.norm(self.com)
        bent = np.abs(hat(axis) @ self.inertia - self.inertia @ hat(axis)).max()
        aside = np.abs(np.cross(axis, self.offset)).max()
        if bent > _SYMMETRIC * np.abs(self.inertia).max():
            return None
        return None if aside > _SYMMETRIC * self.scales[3] else axis


def heavy_top(problem: Problem, J: float) -> HeavyTop:
    """Return the top that a problem without active joints is; J sets its usual momentum."""
    system, cyclic = problem.system, list(problem.cyclic)
    d = inertia_derivatives(system, problem.shapes(np.zeros((1, 0))), of=())
    H, c = d.H[0], d.com[0]
    spins = [3 + k for k in cyclic]
    across, own = H[:3, spins], H[np.ix_(spins, spins)]
    driven = [3 + k for k in problem.driven]
    momenta = problem.cyclic_momenta - H[np.ix_(spins, driven)] @ problem.driven_rate
    K = H[:3, :3] - across @ np.linalg.solve(own, across.T)
    offset = H[:3][:, driven] @ problem.driven_rate + across @ np.linalg.solve(own, momenta)
    weight = system.mass * float(np.linalg.norm(system.gravity))
    least, most = np.linalg.eigvalsh(K)[[0, -1]]
    pull = weight * float(np.linalg.norm(c))
    momentum = abs(J) + float(np.linalg.norm(offset)) + float(np.sqrt(most * pull))
    scales = np.repeat([1.0, momentum], 3)
    return HeavyTop(K, offset, c, weight, scales, momentum / float(least))


def definite_with_own_axis(top: HeavyTop, up: Array, J: float) -> bool:
    """Return whether the momentum about the top's own axis makes a steady motion stable.

    up: (3,) the upward vertical in the body.  In z = (Γ, μ), Γ = −up, the second variation of
    h − λ₁ μ·Γ − λ₂ ½|Γ|² − κ μ·a on the leaf, where μ·a is constant, is tried for all multipliers
    that leave the equilibrium critical.
    """
    axis = top.axis
    if axis is None:
        return False
    D, K, gamma = top.scales, top.inertia, -up
    omega = (J - float(up @ top.offset)) / float(up @ K @ up) * up
    mu = K @ omega + top.offset
    slope_h = D * np.concatenate([-top.weight * top.com, omega])
    slopes = D * np.array([np.r_[mu, gamma], np.r_[gamma, np.zeros(3)], np.r_[np.zeros(3), axis]])
    first = np.linalg.lstsq(slopes.T, slope_h, rcond=None)[0]
    if np.linalg.norm(slopes.T @ first - slope_h) > _CRITICAL * np.linalg.norm(slope_h):
        return False
    _, singular, right = np.linalg.svd(slopes.T)
    free = singular[2] <= _RANK * singular[0]  # upright: a is along the vertical
    other = right[2] / right[2][0] if free else np.zeros(3)
    turn = np.concatenate([np.cross(axis, gamma), np.cross(axis, mu)]) / D  # about the own axis
    rows = np.vstack([slopes, turn]) if np.linalg.norm(turn) > _RANK else slopes
    _, singular, right = np.linalg.svd(rows)
    B = right[int((singular > _RANK * singular[0]).sum()) :].T

    def quadratic(multiplier: float) -> Array:
        one, two, _ = first + multiplier * other
        whole = np.block(
            [[-two * np.eye(3), -one * np.eye(3)], [-one * np.eye(3), np.linalg.inv(K)]]
        )
        return np.asarray(B.T @ (D[:, None] * whole * D) @ B)

    return _definite(quadratic, _REACH * top.rate if free else 0.0)


def _definite(quadratic: Callable[[float], Array], reach: float) -> bool:
    """Return whether some multiplier within reach makes a quadratic form definite."""
    from scipy.optimize import minimize_scalar

    for sign in (1.0, -1.0):  # the least eigenvalue is concave in the multiplier
        best = 0.0
        if reach:
            best = minimize_scalar(
                lambda k, s=sign: -np.linalg.eigvalsh(s * quadratic(k))[0],
                bounds=(-reach, reach), method="bounded", options={"xatol": 1e-12 * reach},
            ).x  # fmt: skip
        matrix = sign * quadratic(best)
        if np.linalg.eigvalsh(matrix)[0] > _DEFINITE * np.abs(matrix).max():
            return True
    return False
