"""Poisson brackets of the reduced phase space, in the two forms that reduction gives it.

In the local trivialisation T*Q/G = T*B × 𝔤*, with z = (x, π, μ), canonical × Lie–Poisson,

    {f, g} = ∂f/∂x · ∂g/∂π − ∂f/∂π · ∂g/∂x − ⟨μ, [∂f/∂μ, ∂g/∂μ]⟩

and on T*B ⊕ 𝔤̃*, with z = (x, p, μ) and the connection, p = π − Aᵀμ,

    {x^α, p_β} = δ,   {p_α, p_β} = ⟨μ, B_αβ⟩,   {p_α, ⟨μ, η⟩} = ⟨μ, [A_α, η]⟩,
    {⟨μ, ξ⟩, ⟨μ, η⟩} = −⟨μ, [ξ, η]⟩.

Where gravity turns a pivoted base, its direction Γ in the body is a variable too (so(3) ⋉ ℝ³):
{Γ, ⟨μ, ξ⟩} = Γ × ξ, {Γ, Γ} = 0, {p_α, Γ} = −{⟨μ, A_α⟩, Γ}.  Along motions, ḟ = {f, h}; gravity
that only makes the robot fall is left out: momenta are those in the falling frame.

Source: Cendra, Marsden, Pekarsky, Ratiu, "Variational principles for Lie–Poisson and
Hamilton–Poincaré equations", 2003; Montgomery, Marsden, Ratiu, "Gauged Lie–Poisson structures",
1984.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias, overload
from weakref import WeakValueDictionary

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..common.arrays import Array, vector
from ..common.errors import InputError, ShapeError
from ..common.memo import once
from ..system.system import System, checked_system
from .at_a_shape import PointwiseReduction
from .base_parts import root_of
from .casimirs import Casimir as Casimir
from .casimirs import casimirs as casimirs
from .casimirs import momentum_tensor
from .potential import pivot_weight, shape_gravity
from .tree.all_joints import joint_values
from .tree.body_frames import bodies_of
from .tree.casadi_reduction import casadi_reduction
from .tree.momenta import centre_of_mass

Form: TypeAlias = Literal["connection", "canonical"]
FORMS = ("connection", "canonical")

_spaces: WeakValueDictionary[int, PhaseSpace] = WeakValueDictionary()


@dataclass(frozen=True, eq=False)
class PhaseSpace:
    """The variables of a system's reduced phase space as CasADi symbols.

    x: (m,).  p: (m,), M ẋ in the form "connection", π = ∂L/∂ẋ in "canonical".  mu: (r,) body
    momentum.  gamma: (3,) direction of gravity in the body where it turns a pivoted base, else
    (0,).
    """

    system: System
    form: Form
    x: ca.SX
    p: ca.SX
    mu: ca.SX
    gamma: ca.SX

    @property
    def z(self) -> ca.SX:
        """All variables, (2m + r,), or three more."""
        return ca.vertcat(self.x, self.p, self.mu, self.gamma)

    @cached_property
    def tensor(self) -> ca.SX:
        """The Poisson tensor {z_i, z_j}, antisymmetric."""
        m, r, k = self.system.m, self.system.r, self.gamma.numel()
        C = [momentum_tensor(self.system.group, e) for e in np.eye(r)]
        turned = sum((self.mu[i] * ca.SX(C[i]) for i in range(r)), ca.SX(r, r))
        W = ca.SX(r + k, r + k)
        W[:r, :r] = turned
        if k:
            W[:r, r:] = W[r:, :r] = ca.skew(self.gamma)
        P = ca.SX(2 * m + r + k, 2 * m + r + k)
        P[:m, m : 2 * m], P[m : 2 * m, :m] = ca.SX.eye(m), -ca.SX.eye(m)
        P[2 * m :, 2 * m :] = W
        if self.form == "connection" and m:
            across = -self._terms.A.T @ W[:r, :]  # {p_α, w} = −A_α · {μ, w}
            P[m : 2 * m, 2 * m :], P[2 * m :, m : 2 * m] = across, -across.T
            P[m : 2 * m, m : 2 * m] = ca.reshape(self.mu.T @ self._terms.B, m, m).T
        return P

    @cached_property
    def hamiltonian(self) -> ca.SX:
        """The energy h, without springs: those are functions of x to be added."""
        m, r = self.system.m, self.system.r
        if self.form == "canonical":
            momentum = ca.vertcat(self.mu, self.p)
            h = 0.5 * ca.dot(momentum, ca.solve(self._terms.H, momentum))
        else:
            h = 0.5 * ca.dot(self.mu, ca.solve(self._terms.I, self.mu)) if r else ca.SX(0)
            h += 0.5 * ca.dot(self.p, ca.solve(self._terms.M, self.p)) if m else 0.0
        com = centre_of_mass(
            bodies_of(self.system), joint_values(self.system, ca.vertsplit(self.x) if m else [])
        )
        place = ca.vertcat(*com)
        weight, origin = pivot_weight(self.system), root_of(self.system).origin
        if weight.any():
            size = float(np.linalg.norm(weight))
            return h - size * ca.dot(self.gamma, place) - float(weight @ origin)
        acting = shape_gravity(self.system).direction
        if acting is None:
            return h
        return h - self.system.mass * ca.dot(ca.DM(acting), place + ca.DM(origin))

    @cached_property
    def _terms(self) -> CasadiTerms:
        found = casadi_reduction(self.system)
        named = [ca.substitute(part, found.x, self.x) for part in (found.H, found.I, found.A)]
        rest = [ca.substitute(part, found.x, self.x) for part in (found.M, found.B)]
        return CasadiTerms(*named, *rest)


@dataclass(frozen=True)
class CasadiTerms:
    """H, I, A, M and B of one phase space, in its x."""

    H: ca.SX
    I: ca.SX
    A: ca.SX
    M: ca.SX
    B: ca.SX


@dataclass(frozen=True)
class Observable:
    """A function on the reduced phase space by numbers.

    red: whose.  value: (x, p, mu), and gamma where gravity turns a pivoted base, → number.
    gradient: the same → derivative by z = (x, p, mu, gamma), one vector or its parts.
    form: as of `tensor`.
    """

    red: PointwiseReduction
    value: Callable[..., float]
    gradient: Callable[..., ArrayLike]
    form: Form = "connection"


def phase_space(system: System, *, form: Form = "connection") -> PhaseSpace:
    """Return the reduced phase space of a system, as CasADi symbols for `bracket`.

    form: "connection" for (x, p, μ), "canonical" for (x, π, μ).
    """
    system = checked_system(system, "phase_space")
    return once(system, (phase_space, _form(form)), lambda: _space(system, form))


@overload
def bracket(f: ca.SX, g: ca.SX) -> ca.SX: ...


@overload
def bracket(f: Observable, g: Observable) -> Callable[..., float]: ...


def bracket(f: ca.SX | Observable, g: ca.SX | Observable) -> ca.SX | Callable[..., float]:
    """Return the Poisson bracket {f, g}.

    f, g: CasADi expressions in the symbols of one `phase_space`, whose bracket is another; or two
    Observables of one Reduction, whose bracket is a function of the same arguments.
    Raises InputError for symbols of no phase space, or for f and g of two of them.
    """
    if isinstance(f, Observable) and isinstance(g, Observable):
        return _of_observables(f, g)
    if isinstance(f, Observable) or isinstance(g, Observable):
        raise InputError("bracket takes two CasADi expressions or two Observables, not one of each")
    space = _space_of(f, g)
    df, dg = (ca.jacobian(ca.SX(each), space.z) for each in (f, g))
    return df @ space.tensor @ dg.T


def tensor(
    red: PointwiseReduction,
    x: ArrayLike,
    p: ArrayLike,
    mu: ArrayLike,
    gamma: ArrayLike | None = None,
    *,
    form: Form = "connection",
) -> Array:
    """Return the Poisson tensor {z_i, z_j} at z = (x, p, μ), antisymmetric.

    x, p: (m,).  mu: (r,).  gamma: (3,), direction of gravity in the body, where it turns a pivoted
    base, and only there; then z = (x, p, μ, Γ).  form: "connection", p = M ẋ, or "canonical",
    p = π; p itself does not enter, as the bracket is linear in momenta beside it.
    Raises ShapeError for wrong lengths, InputError without gamma where it is needed.
    """
    system, m, r = red.system, red.system.m, red.system.r
    _ = vector(p, m, "p")
    mu = vector(mu, r, "mu")
    heavy = bool(pivot_weight(system).any())
    if heavy != (gamma is not None):
        raise InputError(
            f"gravity turns '{system.name}' about its pivot: give gamma (3,)"
            if heavy
            else f"gravity turns no pivoted base of '{system.name}'; leave gamma out"
        )
    W = momentum_tensor(red.group, mu, None if gamma is None else vector(gamma, 3, "gamma"))
    P = np.zeros((2 * m + len(W), 2 * m + len(W)))
    P[:m, m : 2 * m], P[m : 2 * m, :m] = np.eye(m), -np.eye(m)
    P[2 * m :, 2 * m :] = W
    if _form(form) == "connection" and m:
        across = -red.local_connection(x).T @ W[:r]
        P[m : 2 * m, 2 * m :], P[2 * m :, m : 2 * m] = across, -across.T
        P[m : 2 * m, m : 2 * m] = np.einsum("i,iab->ab", mu, red.curvature(x))
    return 0.5 * (P - P.T)


def _of_observables(f: Observable, g: Observable) -> Callable[..., float]:
    if not f.red.same_section(g.red) or f.form != g.form:
        raise InputError("bracket takes Observables of one system, one section and one form")

    def value(x: ArrayLike, p: ArrayLike, mu: ArrayLike, gamma: ArrayLike | None = None) -> float:
        P = tensor(f.red, x, p, mu, gamma, form=f.form)
        state = (x, p, mu) if gamma is None else (x, p, mu, gamma)
        slopes = [_slope(each.gradient(*state), len(P)) for each in (f, g)]
        return float(slopes[0] @ P @ slopes[1])

    return value


def _slope(given: ArrayLike, size: int) -> Array:
    parts = given if isinstance(given, tuple) else (given,)
    out = np.concatenate([np.atleast_1d(np.asarray(part, dtype=float)) for part in parts])
    if out.shape != (size,):
        raise ShapeError(f"a gradient by z must have shape ({size},), got {out.shape}")
    return out


def _form(form: str) -> Form:
    if form not in FORMS:
        raise InputError(f"form must be {' or '.join(map(repr, FORMS))}, got {form!r}")
    return form  # type: ignore[return-value]


def _space(system: System, form: Form) -> PhaseSpace:
    m, r = system.m, system.r
    heavy = bool(pivot_weight(system).any())
    sizes = {"x": m, "p" if form == "connection" else "pi": m, "mu": r, "gamma": 3 * heavy}
    made = PhaseSpace(system, form, *(ca.SX.sym(name, size) for name, size in sizes.items()))
    for symbol in ca.vertsplit(made.z):
        _spaces[symbol.element_hash()] = made
    return made


def _space_of(*expressions: ca.SX) -> PhaseSpace:
    """Return the phase space whose symbols stand in expressions.  Raises InputError."""
    found: list[PhaseSpace] = []
    for symbol in ca.symvar(ca.vertcat(*(ca.vec(ca.SX(each)) for each in expressions))):
        space = _spaces.get(symbol.element_hash())
        if space is None:
            raise InputError(
                f"'{symbol}' is no variable of a phase space; take those of "
                "pinred.poisson.phase_space(system)"
            )
        found.append(space)
    if not found or any(space is not found[0] for space in found):
        raise InputError("f and g must be expressions in the symbols of one phase space")
    return found[0]
