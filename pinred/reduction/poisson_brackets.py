"""Poisson brackets of the reduced phase space, in two forms, and its Casimirs.

In the local trivialisation T*Q/G = T*B × 𝔤*, with z = (x, π, μ), the bracket is canonical ×
Lie–Poisson,

    {f, g} = ∂f/∂x · ∂g/∂π − ∂f/∂π · ∂g/∂x − ⟨μ, [∂f/∂μ, ∂g/∂μ]⟩

and on T*B ⊕ 𝔤̃*, with z = (x, p, μ) and the connection, p = π − Aᵀμ,

    {x^α, p_β} = δ,   {p_α, p_β} = ⟨μ, B_αβ⟩,   {p_α, ⟨μ, η⟩} = ⟨μ, [A_α, η]⟩,
    {⟨μ, ξ⟩, ⟨μ, η⟩} = −⟨μ, [ξ, η]⟩.

If gravity rotates a pivoted base, its direction Γ in the body is a variable too (so(3) ⋉ ℝ³):
{Γ, ⟨μ, ξ⟩} = Γ × ξ, {Γ, Γ} = 0, {p_α, Γ} = −{⟨μ, A_α⟩, Γ}.  Along motions, ḟ = {f, h}.  Gravity
along the group's translations does not appear, because momenta are measured in the falling frame.

With balls, ∂f/∂x is the derivative e_αf along the frame of the shape: {x, p_α} = E e_α with the map
E of `ShapeSpace.rate_map`.  The frame adds −c^γ_αβ p_γ to {p_α, p_β}, in the form "canonical"
{π_α, π_β} = −c^γ_αβ π_γ.

Source: Cendra, Marsden, Pekarsky, Ratiu, "Variational principles for Lie–Poisson and
Hamilton–Poincaré equations", 2003; Montgomery, Marsden, Ratiu, "Gauged Lie–Poisson structures",
1984.

Casimirs are functions of the base momentum that are constant for every Hamiltonian.

The variables w are the body momentum μ, and, if gravity rotates a pivoted base, also the direction
Γ of gravity in the body (the semidirect product so(3) ⋉ ℝ³).  Their bracket is linear,
{w_i, w_j} = C_ij^k w_k.  A polynomial is a Casimir if its bracket with every w_i vanishes, which is
a linear system for its coefficients.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from typing import Literal, TypeAlias, overload
from weakref import WeakValueDictionary

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays, vector
from ..common.errors import InputError, ShapeError
from ..common.memo import once
from ..lie.group import Group
from ..lie.rotations import hat
from ..system.system import System, checked_system
from .base_parts import root_of
from .pointwise_reduction import PointwiseReduction
from .potential import pivot_weight, shape_gravity
from .tree.all_joints import joint_values, rate_map
from .tree.body_frames import bodies_of
from .tree.momenta import CasadiReduction, casadi_reduction, centre_of_mass
from .tree.scalars import solve_spd

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
    names = [name.replace("v", "P").replace("ω", "L") for name in group.twist_names]
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


Form: TypeAlias = Literal["connection", "canonical"]
FORMS = ("connection", "canonical")

# Maps the hash of each symbol to its phase space.
_spaces: WeakValueDictionary[int, PhaseSpace] = WeakValueDictionary()


@checks_arguments
@dataclass(frozen=True, eq=False)
class PhaseSpace:
    """The variables of a system's reduced phase space as CasADi symbols.

    Attributes:
        system: The system.
        form: "connection" or "canonical".
        x: Shape, (nx,); the quaternion of a ball takes four entries and has length one.
        p: Shape momentum, (m,): M ẋ in the form "connection", π = ∂L/∂ẋ in "canonical".
        mu: Body momentum, (r,).
        gamma: Direction of gravity in the body, (3,), if gravity rotates a pivoted base, else (0,).
    """

    system: System
    form: Form
    x: ca.SX
    p: ca.SX
    mu: ca.SX
    gamma: ca.SX

    @property
    def z(self) -> ca.SX:
        """All variables (x, p, μ, Γ), (nx + m + r,), or (nx + m + r + 3,) with Γ."""
        return ca.vertcat(self.x, self.p, self.mu, self.gamma)

    @cached_property
    def tensor(self) -> ca.SX:
        """The Poisson tensor {z_i, z_j}, antisymmetric."""
        m, r, k = self.system.m, self.system.r, self.gamma.numel()
        of_p, of_w = self.system.nx, self.system.nx + m  # first rows of p and of (μ, Γ)
        C = [momentum_tensor(self.system.group, e) for e in np.eye(r)]
        of_mu = sum((self.mu[i] * ca.SX(C[i]) for i in range(r)), ca.SX(r, r))
        W = ca.SX(r + k, r + k)
        W[:r, :r] = of_mu
        if k:
            W[:r, r:] = W[r:, :r] = ca.skew(self.gamma)
        P, E = ca.SX(of_w + r + k, of_w + r + k), rate_map(self.system, self.x)
        P[:of_p, of_p:of_w], P[of_p:of_w, :of_p] = E, -E.T
        P[of_w:, of_w:] = W
        if self.form == "connection" and m:
            across = -self._terms.A.T @ W[:r, :]  # {p_α, w} = −A_α · {μ, w}
            P[of_p:of_w, of_w:], P[of_w:, of_p:of_w] = across, -across.T
            P[of_p:of_w, of_p:of_w] = ca.reshape(self.mu.T @ self._terms.B, m, m).T
        if self.system.space.balls:
            c = ca.SX(ca.DM(self.system.space.structure.reshape(m, m * m)))
            P[of_p:of_w, of_p:of_w] -= ca.reshape(self.p.T @ c, m, m).T
        return P

    @cached_property
    def hamiltonian(self) -> ca.SX:
        """The energy h without springs; add the energy of springs as a function of x."""
        m = self.system.m
        if self.form == "canonical":
            momentum = ca.vertcat(self.mu, self.p)
            h = 0.5 * ca.dot(momentum, solve_spd(self._terms.H, momentum))
        else:
            h = 0.5 * ca.dot(self.mu, solve_spd(self._terms.I, self.mu))
            h += 0.5 * ca.dot(self.p, solve_spd(self._terms.M, self.p))
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
    def _terms(self) -> CasadiReduction:
        return casadi_reduction(self.system, self.x)


@checks_arguments
@dataclass(frozen=True)
class Observable:
    """A numerical function on the reduced phase space.

    Attributes:
        red: Reduction of the system.
        value: Function (x, p, mu) that returns a number, or (x, p, mu, gamma) if gravity rotates a
            pivoted base.
        gradient: Function of the same arguments that returns the derivative with respect to
            z = (x, p, mu, gamma), as one vector or as a tuple of vectors.  The derivative with
            respect to x has nx entries, four for the quaternion of a ball.
        form: "connection" or "canonical", see `tensor`.
    """

    red: PointwiseReduction
    value: Callable[..., float]
    gradient: Callable[..., ArrayLike]
    form: Form = "connection"


@checks_arguments
def phase_space(system: System, *, form: Form = "connection") -> PhaseSpace:
    """Return the reduced phase space of a system, as CasADi symbols for `bracket`.

    Args:
        system: The system.
        form: "connection" for (x, p, μ), "canonical" for (x, π, μ).
    Returns:
        The phase space; the same object at every call.
    """
    remedy = "The brackets of its tree are those of system.open_tree()."
    system = checked_system(system, "phase_space", remedy=remedy)
    return once(system, (phase_space, _form(form)), lambda: _space(system, form))


@overload
def bracket(f: ca.SX, g: ca.SX) -> ca.SX: ...


@overload
def bracket(f: Observable, g: Observable) -> Callable[..., float]: ...


@checks_arguments
def bracket(f: ca.SX | Observable, g: ca.SX | Observable) -> ca.SX | Callable[..., float]:
    """Return the Poisson bracket {f, g}.

    Args:
        f: CasADi expression in the symbols of one `phase_space`, or an Observable.
        g: Expression or Observable like f, with the same phase space or Reduction.
    Returns:
        A CasADi expression, or, for Observables, a function of the same arguments.
    Raises:
        InputError: The arguments are of different types, or not in the symbols of one phase space.
    """
    if isinstance(f, Observable) and isinstance(g, Observable):
        return _of_observables(f, g)
    if isinstance(f, Observable) or isinstance(g, Observable):
        raise InputError("bracket takes two CasADi expressions or two Observables, not one of each")
    space = _space_of(f, g)
    df, dg = (ca.jacobian(ca.SX(expression), space.z) for expression in (f, g))
    return df @ space.tensor @ dg.T


@checks_arguments
def tensor(
    red: PointwiseReduction,
    x: ArrayLike,
    p: ArrayLike,
    mu: ArrayLike,
    gamma: ArrayLike | None = None,
    *,
    form: Form = "connection",
) -> Array:
    """Compute the Poisson tensor {z_i, z_j} at z = (x, p, μ), or z = (x, p, μ, Γ).

    Args:
        red: Reduction of the system.
        x: Shape, (nx,) [rad | m | 1].
        p: Shape momentum, (m,).  The tensor depends only on the momenta of balls.
        mu: Body momentum, (r,) [N s | N m s].
        gamma: Direction of gravity in the body, (3,); required if and only if gravity rotates a
            pivoted base.
        form: "connection", p = M ẋ, or "canonical", p = π.
    Returns:
        The tensor, antisymmetric.
    Raises:
        InputError: gamma is missing or superfluous, or the form is unknown.
    """
    system, m, r = red.system, red.system.m, red.system.r
    of_p, of_w = system.nx, system.nx + m  # first rows of p and of (μ, Γ)
    space, what = system.space, f"shape x of {system.name!r}"
    x = space.normalized(vector(x, space.nx, what, space.x_names), what)
    p = vector(p, m, "p")
    mu = vector(mu, r, "mu")
    heavy = bool(pivot_weight(system).any())
    if heavy != (gamma is not None):
        raise InputError(
            f"gravity rotates '{system.name}' about its pivot: give gamma (3,)"
            if heavy
            else f"gravity rotates no pivoted base of '{system.name}'; leave gamma out"
        )
    W = momentum_tensor(red.group, mu, None if gamma is None else vector(gamma, 3, "gamma"))
    P, E = np.zeros((of_w + len(W), of_w + len(W))), space.rate_map(x)
    P[:of_p, of_p:of_w], P[of_p:of_w, :of_p] = E, -E.T
    P[of_w:, of_w:] = W
    if _form(form) == "connection" and m:
        across = -red.local_connection(x).T @ W[:r]
        P[of_p:of_w, of_w:], P[of_w:, of_p:of_w] = across, -across.T
        P[of_p:of_w, of_p:of_w] = np.einsum("i,iab->ab", mu, red.curvature(x))
    if space.balls:
        P[of_p:of_w, of_p:of_w] -= np.einsum("gab,g->ab", space.structure, p)
    return 0.5 * (P - P.T)


def _of_observables(f: Observable, g: Observable) -> Callable[..., float]:
    if not f.red.same_section(g.red) or f.form != g.form:
        raise InputError("bracket takes Observables of one system, one section and one form")

    def value(x: ArrayLike, p: ArrayLike, mu: ArrayLike, gamma: ArrayLike | None = None) -> float:
        P = tensor(f.red, x, p, mu, gamma, form=f.form)
        state = (x, p, mu) if gamma is None else (x, p, mu, gamma)
        df, dg = (_gradient(h.gradient(*state), len(P)) for h in (f, g))
        return float(df @ P @ dg)

    return value


def _gradient(value: ArrayLike, size: int) -> Array:
    """Validate a gradient with respect to z, one vector or a tuple of vectors; return (size,)."""
    blocks = value if isinstance(value, tuple) else (value,)
    gradient = np.concatenate([np.atleast_1d(np.asarray(b, dtype=float)) for b in blocks])
    if gradient.shape != (size,):
        raise ShapeError(
            f"a gradient with respect to z must have shape ({size},), got {gradient.shape}"
        )
    return gradient


def _form(form: str) -> Form:
    if form not in FORMS:
        raise InputError(f"form must be {' or '.join(map(repr, FORMS))}, got {form!r}")
    return form  # type: ignore[return-value]


def _space(system: System, form: Form) -> PhaseSpace:
    m, r = system.m, system.r
    heavy = bool(pivot_weight(system).any())
    sizes = {"x": system.nx, "p" if form == "connection" else "pi": m, "mu": r, "gamma": 3 * heavy}
    space = PhaseSpace(system, form, *(ca.SX.sym(name, size) for name, size in sizes.items()))
    for symbol in ca.vertsplit(space.z):
        _spaces[symbol.element_hash()] = space
    return space


def _space_of(*expressions: ca.SX) -> PhaseSpace:
    """Return the phase space to which the symbols of expressions belong.  Raises InputError."""
    spaces: list[PhaseSpace] = []
    for symbol in ca.symvar(ca.vertcat(*(ca.vec(ca.SX(value)) for value in expressions))):
        space = _spaces.get(symbol.element_hash())
        if space is None:
            raise InputError(
                f"'{symbol}' is not a phase-space variable; use the variables of "
                "pinred.poisson.phase_space(system)"
            )
        spaces.append(space)
    if not spaces or any(space is not spaces[0] for space in spaces):
        raise InputError("f and g must be expressions in the symbols of one phase space")
    return spaces[0]
