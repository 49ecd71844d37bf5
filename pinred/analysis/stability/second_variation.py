"""Definiteness of the second variation at a relative equilibrium, across the family it is in.

The Hessian of the amended potential on shapes × directions is one block of the second variation of
the energy–momentum function, the reduced kinetic energy the other, which is positive: where both
are positive definite, the motion stays close for ever.  A body without joints has no other block,
so that a maximum is as good as a minimum.

Where gravity turns a pivoted body, the momentum about the vertical is kept, and a top that sleeps
upright is no minimum of what that leaves.  A top that is symmetric about an axis a of its own
through the pivot also keeps μ·a.  So does one with rotors whose angles nothing depends on: with
K = K_bb − K_bc K_cc⁻¹ K_cb, the inertia of base and cyclic rotors b, c that these leave, and the
momentum k that stays when the body stands still,

    h(Γ, μ) = ½ (μ − k)ᵀ K⁻¹ (μ − k) − m |g| c·Γ,     k = H_bd ν + K_bc K_cc⁻¹ (π − H_cd ν),

for momenta π of the cyclic rotors and rates ν of the driven ones.

Source: D. Lewis, T. Ratiu, J. C. Simo, J. E. Marsden, "The heavy top: a geometric treatment",
Nonlinearity 5, 1992.

Source: J. C. Simo, D. Lewis, J. E. Marsden, "Stability of relative equilibria. Part I: The reduced
energy–momentum method", 1991.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ...lie.rotations import hat
from ...reduction.inertia_split import mass_matrix
from ...reduction.tree.second_derivatives import inertia_derivatives
from ..equilibria.amended_energy import AmendedEnergy, Points, tangents
from ..equilibria.problem import Problem
from ..equilibria.search import critical_points, residuals

_NULL = 1e-7  # of the largest curvature; below it a direction is flat
_ALONG = 0.1  # rad | m, how far a family is followed to see that it is one
_SAME = 1e-9  # of the size of the energies; equilibria of one family have the same

_SYMMETRIC = 1e-12  # of the inertia, by which a body may miss being symmetric
_CRITICAL = 1e-8  # of the slope of the energy, what may be left of it at an equilibrium
_RANK = 1e-10  # of the largest singular value
_DEFINITE = 1e-14  # of the largest entry, the least curvature that counts
_REACH = 1e3  # times the rates of the body, to which multipliers are tried


@dataclass(frozen=True)
class SecondVariation:
    """Curvatures of the amended potential at an equilibrium.

    values: (u,) of its Hessian, in units of the kinetic energy [1/s²].  dimension: of the family
    of equilibria.  index: number of negative curvatures across it.  definite: whether the second
    variation is, across the family.
    """

    values: Array
    dimension: int
    index: int
    definite: bool

    def __post_init__(self) -> None:
        freeze(self)


def second_variation(energy: AmendedEnergy, point: Points, J: float) -> SecondVariation:
    """Return the second variation at one equilibrium, a Points of length one."""
    problem = energy.problem
    e = energy(point, J)
    W = weights(problem, point)
    values, vectors = np.linalg.eigh(W @ e.hessian[0] @ W)
    largest = float(np.abs(values).max(initial=0.0))
    # What round-off leaves of a rigid body's energy, where there is nothing else.
    floor = max(_NULL * largest, 1e-13 * float(e.scale[0]) * float(np.max(W, initial=0.0)) ** 2)
    flat = np.abs(values) <= floor
    dimension = _family(energy, point, J, W @ vectors[:, flat]) if flat.any() else 0
    rest = values[~flat] if dimension == int(flat.sum()) else values
    index = int((rest < -floor).sum())
    positive = bool((rest > floor).all())
    # A free body without joints has nothing but its direction; a heavy one swings about it.
    negative = bool((rest < -floor).all()) and not problem.active and problem.kind == "free"
    definite = positive or negative
    if not definite and problem.kind == "heavy" and not problem.active:
        definite = definite_with_own_axis(heavy_top(problem, J), point.n[0], J)
    return SecondVariation(values, dimension, index, definite)


def weights(problem: Problem, point: Points) -> Array:
    """Return W with W² the inverse of a metric on the unknowns: the kinetic one, and of turns."""
    ma, system = len(problem.active), problem.system
    rows = [*range(system.r), *(system.r + k for k in problem.cyclic)]
    active = [system.r + k for k in problem.active]
    H = mass_matrix(system, problem.shapes(point.x)[0])
    K, side = H[np.ix_(rows, rows)], H[np.ix_(rows, active)]
    metric = np.zeros((problem.unknowns, problem.unknowns))
    metric[:ma, :ma] = H[np.ix_(active, active)] - side.T @ np.linalg.solve(K, side)
    if problem.directional:
        T = tangents(point.n)[0]
        I = K[system.r - 3 : system.r, system.r - 3 : system.r]
        metric[ma:, ma:] = T.T @ I @ T
    values, vectors = np.linalg.eigh(metric)
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


def _family(energy: AmendedEnergy, point: Points, J: float, flat: Array) -> int:
    """Return in how many of the flat directions (u, k), each in a column, equilibria go on."""
    here = energy(point, J)
    count = 0
    for direction in (flat / np.linalg.norm(flat, axis=0)).T:
        there, e = critical_points(energy, point.moved(_ALONG * direction[None]), J)
        if not len(there):
            continue
        apart = np.concatenate([there.x - point.x, there.n - point.n], axis=1)
        gone = float(np.linalg.norm(apart)) > 0.5 * _ALONG
        same = abs(float(e.U[0] - here.U[0])) <= _SAME * float(here.scale[0])
        count += bool(gone and same and residuals(e)[0] <= 1e-9)
    return count


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
