"""Casimirs: functions of the momentum that no motion of the base changes, whatever its energy.

Of body momenta μ, and where gravity turns a pivoted base also of its direction Γ in the body (the
semidirect product so(3) ⋉ ℝ³), the bracket is linear, {w_i, w_j} = C_ij^k w_k.  A polynomial is a
Casimir if its bracket with every w_i vanishes, which is a linear system for its coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike

from ..common.arrays import Array, freeze, vector
from ..common.errors import InputError
from ..lie.group import Group
from ..lie.rotations import hat
from ..system.system import System, checked_system
from .potential import pivot_weight

_NOTHING = 1e-9  # of a coefficient, and of singular values


@dataclass(frozen=True)
class Casimir:
    """A Casimir c·w + wᵀQ w of w = μ, or w = (μ, Γ); arrays are read-only.

    name: as a formula, P of linear momenta, L of angular ones.  linear: (k,) c.  quadratic: (k, k)
    Q, symmetric.  r: how many of w are momenta.
    """

    name: str
    linear: Array
    quadratic: Array
    r: int

    def __post_init__(self) -> None:
        freeze(self)

    def __call__(self, mu: ArrayLike, gamma: ArrayLike | None = None) -> float:
        """Return the value at body momentum mu (r,), and gamma (3,) where gravity turns a pivot."""
        w = self._variables(mu, gamma)
        return float(self.linear @ w + w @ self.quadratic @ w)

    def gradient(self, mu: ArrayLike, gamma: ArrayLike | None = None) -> Array:
        """Return the derivative by w, (k,)."""
        return np.asarray(self.linear + 2.0 * self.quadratic @ self._variables(mu, gamma))

    def _variables(self, mu: ArrayLike, gamma: ArrayLike | None) -> Array:
        w, k = vector(mu, self.r, "mu"), len(self.linear) - self.r
        if (gamma is not None) != bool(k):
            need = (
                "needs gamma (3,), the direction of gravity in the body," if k else "has no gamma"
            )
            raise InputError(f"the Casimir {self.name} {need} beside mu")
        return w if gamma is None else np.append(w, vector(gamma, k, "gamma"))

    def __str__(self) -> str:
        return self.name


def casimirs(system: System) -> tuple[Casimir, ...]:
    """Return the Casimirs of the base's momenta, of degree one and two, independent of each other.

    ℝ, SO(2): μ.  SE(2): |P|².  SO(3): |μ|².  SE(3): |P|², P·L.  ℝ × SE(2): P3, |P|².  A pivot in
    gravity: μ·Γ, |Γ|².
    """
    system = checked_system(system, "casimirs")
    heavy = bool(pivot_weight(system).any())
    return system.workspace((casimirs, heavy), lambda: _found(system.group, heavy=heavy))


def momentum_tensor(group: Group, mu: Array, gamma: Array | None = None) -> Array:
    """Return {w_i, w_j} = −⟨μ, [e_i, e_j]⟩ at w = μ (r,), or w = (μ, Γ) with {Γ, μ} = Γ × ·."""
    r = group.dim
    turned = -np.einsum("k,ikj->ij", mu, group.ad(np.eye(r)))
    if gamma is None:
        return np.asarray(turned)
    G = hat(gamma)
    return np.block([[turned, G], [G, np.zeros((3, 3))]])


def _found(group: Group, *, heavy: bool) -> tuple[Casimir, ...]:
    r = group.dim
    k = r + 3 * heavy
    names = [_momentum_name(name) for name in group.twist_names]
    names += [f"Γ{i + 1}" for i in range(3 * heavy)]

    def tensor(w: Array) -> Array:
        return momentum_tensor(group, w[:r], w[r:] if heavy else None)

    C = np.array([tensor(e) for e in np.eye(k)])  # [of w_k, i, j]
    ones = _null_space(C.reshape(k * k, k))
    pairs = list(combinations_with_replacement(range(k), 2))
    columns = []
    for i, j in pairs:
        Q = np.zeros((k, k))
        Q[i, j] += 0.5
        Q[j, i] += 0.5
        changed = np.einsum("aij,jb->aib", C, Q)  # the coefficient of w_a w_b in {w_i, wᵀQw}/2
        columns.append((changed + changed.transpose(2, 1, 0)).ravel())
    twos = _null_space(np.array(columns).T)
    products = [
        [a[i] * b[j] + (a[j] * b[i] if i != j else 0.0) for i, j in pairs]
        for a, b in combinations_with_replacement(ones, 2)
    ]
    known = len(products)
    out = [Casimir(_formula(row, names), row, np.zeros((k, k)), r) for row in ones]
    for row in twos:
        products.append(list(row))
        known += 1
        if np.linalg.matrix_rank(np.array(products), tol=_NOTHING) < known:
            products.pop()
            known -= 1
            continue
        Q = np.zeros((k, k))
        for value, (i, j) in zip(row, pairs, strict=True):
            Q[i, j] += 0.5 * value
            Q[j, i] += 0.5 * value
        monomials = [names[i] + "²" if i == j else f"{names[i]} {names[j]}" for i, j in pairs]
        out.append(Casimir(_formula(row, monomials), np.zeros(k), Q, r))
    return tuple(out)


def _momentum_name(twist: str) -> str:
    return twist.replace("v", "P").replace("ω", "L")


def _null_space(matrix: Array) -> Array:
    """Return a basis of the null space, in rows, reduced so that each begins with an own 1."""
    _, singular, rows = np.linalg.svd(matrix)
    rank = int((singular > _NOTHING).sum())
    basis = rows[rank:].copy()
    done = 0
    for column in range(basis.shape[1]):
        if done == len(basis):
            break
        lead = done + int(np.argmax(np.abs(basis[done:, column])))
        if abs(basis[lead, column]) < _NOTHING:
            continue
        basis[[done, lead]] = basis[[lead, done]]
        basis[done] /= basis[done, column]
        others = np.arange(len(basis)) != done
        basis[others] -= np.outer(basis[others, column], basis[done])
        done += 1
    whole = np.round(basis)
    return np.asarray(np.where(np.abs(basis - whole) < _NOTHING, whole, basis))


def _formula(coefficients: Array, monomials: Sequence[str]) -> str:
    terms = []
    for value, name in zip(coefficients.tolist(), monomials, strict=True):
        if value:
            size = "" if abs(abs(value) - 1.0) < _NOTHING else f"{abs(value):.6g} "
            sign = "−" if value < 0 else "+"
            terms.append(f"{sign} {size}{name}")
    return " ".join(terms).removeprefix("+ ")
