"""The mixed connection: wheels hold some motions of the body, momentum moves it along the rest.

With fewer wheels than the group has dimensions, W_b ξ + W_s ẋ = 0 leaves the body motions S(x)
free, the columns of S spanning the kernel of W_b.  Along them there is a momentum p = Sᵀ μ, and

    ξ = −A ẋ + Γ p,   [W_b; SᵀI] (A, Γ) = ([W_s; SᵀI_a], [0; 1]),
    ṗ = Sᵀ ad*_ξ μ + (∂S ẋ)ᵀ μ,   −Aᵀ (μ̇ − ad*_ξ μ) + π̇ − ½ ∂ₓ(vᵀHv) = τ,

μ = I ξ + I_a ẋ.  Source: A. Bloch, P. Krishnaprasad, J. Marsden, R. Murray, "Nonholonomic
mechanical systems with symmetry", Arch. Rational Mech. Anal. 136 (1996).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, read_only, vector
from ...common.errors import InputError
from ...kernels.connection.form import form_of
from ...kernels.connection.graphs import health
from ...kernels.machine.native import NativeCode, compile_object, load_object
from ...reduction.inertia_split import mass_matrix
from ...reduction.tree.momenta import bracket, momenta
from ...system.system import System, checked_system
from .connection import Connection
from .wheels import Rolling, Slip, Wheel, slip_matrix, slip_rows, slips_of

_NAME = "mixed"


@dataclass(frozen=True, eq=False)
class MixedConnection:
    """The connection and the momentum equation of a robot on fewer wheels than dimensions.

    connection: A, without a metric, for motions with p = 0.  free: (r, r − k), the constant C of
    S = (1 − W_bᵀ (W_b W_bᵀ)⁻¹ W_b) C, or no rows where S is the cross product of two rows in SE(2).
    """

    system: System
    connection: Connection
    slips: tuple[Slip, ...] = field(repr=False)
    free: Array = field(repr=False)

    @property
    def size(self) -> int:
        """Number of generalised momenta, r − k."""
        return self.system.r - len(self.slips)

    def local(self, x: ArrayLike) -> Array:
        """A(x), (r, m).  Raises SingularInertiaError where two wheels hold the same."""
        return self.connection.local(x)

    def gain(self, x: ArrayLike) -> Array:
        """Γ(x), (r, r − k): body twist per unit of momentum p; errors as of `local`."""
        P = self.connection.locked(x)
        return read_only(np.asarray(np.linalg.inv(P)[:, len(self.slips) :]))

    def free_motions(self, x: ArrayLike) -> Array:
        """S(x), (r, r − k): body twists that the wheels leave free with frozen joints."""
        at = vector(x, self.system.m, "x", self.system.shape_names)
        return read_only(
            _kernel(slip_matrix(self.system, self.slips, at)[:, : self.system.r], self.free)
        )

    def momentum(self, x: ArrayLike, xdot: ArrayLike, xi: ArrayLike) -> Array:
        """P = Sᵀ μ, (r − k,), of a body twist ξ (r,) that the wheels allow.

        Raises InputError if they slip.
        """
        system = self.system
        at = vector(x, system.m, "x", system.shape_names)
        v = np.concatenate([vector(xi, system.r, "xi"), vector(xdot, system.m, "xdot")])
        W = slip_matrix(system, self.slips, at)
        slip, size = np.abs(W @ v), np.abs(W) @ np.abs(v)
        if (slip > 1e-9 * np.maximum(size, 1e-300)).any():
            raise InputError(f"the wheels slip with this twist, at {W @ v} m/s; see `velocity`")
        mu = mass_matrix(system, at)[: system.r] @ v
        return np.asarray(self.free_motions(at).T @ mu)

    def velocity(self, x: ArrayLike, xdot: ArrayLike, p: ArrayLike) -> Array:
        """ξ = −A ẋ + Γ p, (r,)."""
        rate = vector(xdot, self.system.m, "xdot", self.system.shape_names)
        return np.asarray(-self.local(x) @ rate + self.gain(x) @ vector(p, self.size, "p"))

    @cached_property
    def equations(self) -> NativeCode:
        """Machine code (x, ẋ, p), τ → health of P_b, ξ, ṗ, ẍ, energy; τ (m,) torques [N m | N]."""
        return load_object(compile_object(self._graph(), _NAME), _NAME)

    @cached_property
    def driven(self) -> NativeCode:
        """Machine code (x, ẋ, p), nothing → health, ξ, ṗ, of joints whose motion is given."""
        return load_object(compile_object(self._driven_graph(), "driven"), "driven")

    def _parts(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
        """Return x, ẋ, p, and ξ, ṗ, A as expressions."""
        system, r, k = self.system, self.system.r, len(self.slips)
        x, xdot = ca.SX.sym("x", system.m), ca.SX.sym("xdot", system.m)
        p = ca.SX.sym("p", self.size)
        form = self.connection.form
        P = ca.reshape(form.locked(x), r, r)
        moved = form.values(x, ca.vertcat(ca.SX.zeros(r, 1), xdot))
        xi = ca.solve(P, ca.vertcat(ca.SX.zeros(k, 1), p) - moved)
        A = -ca.jacobian(xi, xdot)
        mu = momenta(system, x, ca.vertcat(xi, xdot))[:r]
        eta = ca.SX.sym("eta", r)
        turned = ca.gradient(ca.dot(mu, bracket(system.group, xi, eta)), eta)  # ad*_ξ μ
        S = self._kernel_graph(x)
        Sdot = ca.reshape(ca.jtimes(ca.vec(S), x, xdot), r, self.size)
        return x, xdot, p, xi, S.T @ turned + Sdot.T @ mu, A

    def _driven_graph(self) -> ca.Function:
        x, xdot, p, xi, pdot, _ = self._parts()
        y = ca.vertcat(x, xdot, p)
        return ca.Function(
            "driven", [y, ca.SX.sym("none")], [ca.densify(ca.vertcat(self._health(x), xi, pdot))]
        )

    def _graph(self) -> ca.Function:
        system, r = self.system, self.system.r
        x, xdot, p, xi, pdot, A = self._parts()
        tau = ca.SX.sym("tau", system.m)
        both = momenta(system, x, ca.vertcat(xi, xdot))
        mu, pi = both[:r], both[r:]
        # Rates of the momenta without ẍ, and what ẍ adds.
        known = ca.jtimes(both, x, xdot) + ca.jtimes(both, p, pdot)
        gained = ca.jacobian(both, xdot)
        eta = ca.SX.sym("eta", r)
        turned = ca.gradient(ca.dot(mu, bracket(system.group, xi, eta)), eta)
        v = ca.SX.sym("v", system.n)
        kinetic = 0.5 * ca.dot(v, momenta(system, x, v))
        slope = ca.substitute(ca.gradient(kinetic, x), v, ca.vertcat(xi, xdot))
        right = tau + slope - known[r:] + A.T @ (known[:r] - turned)
        xddot = ca.solve(gained[r:, :] - A.T @ gained[:r, :], right)
        energy = 0.5 * (ca.dot(xi, mu) + ca.dot(xdot, pi))
        out = ca.densify(ca.vertcat(self._health(x), xi, pdot, xddot, energy))
        y = ca.vertcat(x, xdot, p)
        return ca.Function(_NAME, [y, tau], [out], {"cse": True})

    def _health(self, x: ca.SX) -> ca.SX:
        r = self.system.r
        return health(self.connection.form, ca.reshape(self.connection.form.locked(x), r, r))

    def _kernel_graph(self, x: ca.SX) -> ca.SX:
        return kernel_graph(self.system, self.slips, self.free, x)


def mixed_connection(system: System, wheels: Sequence[Wheel | Rolling]) -> MixedConnection:
    """Return the mixed connection of a robot on wheels, fewer than the group has dimensions.

    Raises InputError for as many wheels or more (see Connection.kinematic), or for a potential
    in which the joints would move.
    """
    system = checked_system(system, "Connection.mixed")
    slips = tuple(slips_of(system, list(wheels)))
    r, k = system.r, len(slips)
    if not 0 < k < r:
        raise InputError(
            f"{system.group.name} has {r} dimensions: a mixed connection takes 1 to {r - 1} "
            f"wheels, got {k}; with {r}, see Connection.kinematic"
        )
    rng = np.random.default_rng(0)
    free = np.zeros((0, r - k))
    if not (r == 3 and k == 2):
        W = slip_matrix(system, slips, rng.uniform(-1.0, 1.0, system.m))[:, :r]
        free = np.linalg.svd(W)[2][k:].T

    def values(x: ca.SX, v: ca.SX) -> ca.SX:
        S = kernel_graph(system, slips, free, x)
        held: ca.SX = ca.vertcat(slip_rows(system, slips, x, v), S.T @ momenta(system, x, v)[:r])
        return held

    def reference(x: Array) -> Array:
        W = slip_matrix(system, slips, x)
        S = _kernel(W[:, :r], free)
        return np.vstack([W, S.T @ mass_matrix(system, x)[:r]])

    form = form_of(
        system.group, system.shape_names, system.units, f"wheels and momenta of '{system.name}'",
        values, reference, symmetric=False,
    )  # fmt: skip
    return MixedConnection(system, Connection.of(form), slips, free)


def kernel_graph(system: System, slips: Sequence[Slip], free: Array, x: ca.SX) -> ca.SX:
    """Return S(x) as an expression, (r, r − k)."""
    v = ca.SX.sym("v", system.n)
    W = ca.densify(ca.jacobian(slip_rows(system, slips, x, v), v)[:, : system.r])
    if not len(free):
        return ca.cross(W[0, :].T, W[1, :].T)
    held = W.T @ ca.solve(W @ W.T, W @ ca.DM(free))
    return ca.DM(free) - held


def _kernel(W: Array, free: Array) -> Array:
    if not len(free):
        return np.asarray(np.cross(W[0], W[1])[:, None])
    return np.asarray(free - W.T @ np.linalg.solve(W @ W.T, W @ free))
