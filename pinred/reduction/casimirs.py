"""Casimirs: functions of the base momentum that are constant for every Hamiltonian.

The variables w are the body momentum μ, and, if gravity rotates a pivoted base, also the direction
Γ of gravity in the body (the semidirect product so(3) ⋉ ℝ³).  Their bracket is linear,
{w_i, w_j} = C_ij^k w_k.  A polynomial is a Casimir if its bracket with every w_i vanishes, which is
a linear system for its coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays, vector
from ..common.errors import InputError
from ..lie.group import Group
from ..lie.rotations import hat
from ..system.system import System, checked_system
from .potential import pivot_weight

_ZERO = 1e-9  # coefficients and singular values below this bound count as zero


@checks_arguments
@dataclass(frozen=True)
class Casimir(FrozenArrays):
    """A Casimir c·w + wᵀQ w of w = μ, or w = (μ, Γ); arrays are read-only.

    Attributes:
        name: Formula, with P for linear and L for angular momenta.
        linear: Coefficients c, (k,).
        quadratic: Coefficients Q, (k, k), symmetric.
        r: Number of momenta in w.
    """

    name: str
    linear: Array
    quadratic: Array
    r: int

    def __call__(self, mu: ArrayLike, gamma: ArrayLike | None = None) -> float:
        """Evaluate the Casimir.

        Args:
            mu: Body momentum, (r,).
            gamma: Direction of gravity in the body, (3,), if gravity rotates a pivoted base.
        Returns:
            The value.
        """
        w = self._variables(mu, gamma)
        return float(self.linear @ w + w @ self.quadratic @ w)

    def gradient(self, mu: ArrayLike, gamma: ArrayLike | None = None) -> Array:
        """Compute the derivative with respect to w.

        Args:
            mu: Body momentum, (r,).
            gamma: Direction of gravity in the body, (3,), if gravity rotates a pivoted base.
        Returns:
            Derivative, (k,).
        """
        return np.asarray(self.linear + 2.0 * self.quadratic @ self._variables(mu, gamma))

    def _variables(self, mu: ArrayLike, gamma: ArrayLike | None) -> Array:
        w, k = vector(mu, self.r, "mu"), len(self.linear) - self.r
        if (gamma is not None) != bool(k):
            need = (
                "depends on gamma (3,), the direction of gravity in the body. Give gamma as well."
                if k
                else "does not depend on gamma. Omit gamma."
            )
            raise InputError(f"gamma: the Casimir {self.name} {need}")
        return w if gamma is None else np.append(w, vector(gamma, k, "gamma"))

    def __str__(self) -> str:
        return self.name


@checks_arguments
def casimirs(system: System) -> tuple[Casimir, ...]:
    """Return independent Casimirs of the base momentum, of degree one and two.

    ℝ, SO(2): μ.  SE(2): |P|².  SO(3): |μ|².  SE(3): |P|², P·L.  ℝ × SE(2): P3, |P|².  A pivot in
    gravity: μ·Γ, |Γ|².

    Args:
        system: The system.
    Returns:
        The Casimirs.
    """
    system = checked_system(system, "casimirs", loops=True)  # functions of μ alone
    heavy = bool(pivot_weight(system).any())
    return system.workspace((casimirs, heavy), lambda: _solve(system.group, heavy=heavy))


def momentum_tensor(group: Group, mu: Array, gamma: Array | None = None) -> Array:
    """Return the Poisson tensor {w_i, w_j} at w = μ or (μ, Γ); {μ_i, μ_j} = −⟨μ, [e_i, e_j]⟩."""
    r = group.dim
    of_mu = -np.einsum("k,ikj->ij", mu, group.ad(np.eye(r)))
    if gamma is None:
        return np.asarray(of_mu)
    G = hat(gamma)
    return np.block([[of_mu, G], [G, np.zeros((3, 3))]])


def _solve(group: Group, *, heavy: bool) -> tuple[Casimir, ...]:
    """Return the Casimirs of a group; `heavy`: whether w contains the direction Γ of gravity."""
    r = group.dim
    k = r + 3 * heavy
    names = [_momentum_name(name) for name in group.twist_names]
    names += [f"Γ{i + 1}" for i in range(3 * heavy)]

    def tensor(w: Array) -> Array:
        return momentum_tensor(group, w[:r], w[r:] if heavy else None)

    C = np.array([tensor(e) for e in np.eye(k)])  # [l, i, j]: coefficient of w_l in {w_i, w_j}
    linear = _null_space(C.reshape(k * k, k))
    pairs = list(combinations_with_replacement(range(k), 2))
    columns = []
    for i, j in pairs:
        Q = np.zeros((k, k))
        Q[i, j] += 0.5
        Q[j, i] += 0.5
        half = np.einsum("aij,jb->aib", C, Q)  # the coefficient of w_a w_b in {w_i, wᵀQw}/2
        columns.append((half + half.transpose(2, 1, 0)).ravel())
    quadratic = _null_space(np.array(columns).T)
    # Products of linear Casimirs are Casimirs, too; keep only Casimirs independent of these
    # products.
    independent = [
        [a[i] * b[j] + (a[j] * b[i] if i != j else 0.0) for i, j in pairs]
        for a, b in combinations_with_replacement(linear, 2)
    ]
    casimirs = [Casimir(_formula(row, names), row, np.zeros((k, k)), r) for row in linear]
    for row in quadratic:
        candidates = np.array([*independent, row])
        if np.linalg.matrix_rank(candidates, tol=_ZERO) < len(candidates):
            continue
        independent.append(list(row))
        Q = np.zeros((k, k))
        for value, (i, j) in zip(row, pairs, strict=True):
            Q[i, j] += 0.5 * value
            Q[j, i] += 0.5 * value
        monomials = [names[i] + "²" if i == j else f"{names[i]} {names[j]}" for i, j in pairs]
        casimirs.append(Casimir(_formula(row, monomials), np.zeros(k), Q, r))
    return tuple(casimirs)


def _momentum_name(twist: str) -> str:
    return twist.replace("v", "P").replace("ω", "L")


def _null_space(matrix: Array) -> Array:
    """Return a basis of the null space, in rows, in reduced echelon form."""
    _, singular, rows = np.linalg.svd(matrix)
    rank = int((singular > _ZERO).sum())
    basis = rows[rank:].copy()
    k = 0
    for column in range(basis.shape[1]):
        if k == len(basis):
            break
        pivot = k + int(np.argmax(np.abs(basis[k:, column])))
        if abs(basis[pivot, column]) < _ZERO:
            continue
        basis[[k, pivot]] = basis[[pivot, k]]
        basis[k] /= basis[k, column]
        is_other = np.arange(len(basis)) != k
        basis[is_other] -= np.outer(basis[is_other, column], basis[k])
        k += 1
    integers = np.round(basis)
    return np.asarray(np.where(np.abs(basis - integers) < _ZERO, integers, basis))


def _formula(coefficients: Array, monomials: Sequence[str]) -> str:
    terms = []
    for value, name in zip(coefficients.tolist(), monomials, strict=True):
        if value:
            size = "" if abs(abs(value) - 1.0) < _ZERO else f"{abs(value):.6g} "
            sign = "−" if value < 0 else "+"
            terms.append(f"{sign} {size}{name}")
    return " ".join(terms).removeprefix("+ ")
