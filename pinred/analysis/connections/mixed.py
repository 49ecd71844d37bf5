"""The mixed connection: wheels constrain some body motions, momentum determines the others.

With fewer wheels than the group has dimensions, W_b ξ + W_s ẋ = 0 leaves some body motions free.
The columns of S(x) span the kernel of W_b.  The momentum along these free motions is p = Sᵀ μ, and

    ξ = −A ẋ + Γ p,   [W_b; SᵀI] (A, Γ) = ([W_s; SᵀI_a], [0; 1]),
    ṗ = Sᵀ ad*_ξ μ + (∂S ẋ)ᵀ μ,   −Aᵀ (μ̇ − ad*_ξ μ) + π̇ − ½ ∂ₓ(vᵀHv) = τ

(with −π × ẋ on the left for a ball, whose derivatives are along its axes), with the momentum
μ = I ξ + I_a ẋ of the robot without wheels.  Source: A. Bloch, P. Krishnaprasad, J. Marsden,
R. Murray, "Nonholonomic mechanical systems with symmetry", Arch. Rational Mech. Anal. 136 (1996).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, read_only, vector
from ...common.differences import central_differences
from ...common.errors import InputError
from ...common.machine_code import NativeCode, load_object
from ...kernels.connection.connection_form import (
    along_frame,
    coordinate_rates,
    form_of,
    health,
    solve_locked,
)
from ...kernels.connection.connection_validation import TrialShape, trial_shapes
from ...kernels.evaluate import evaluate
from ...kernels.machine.native import compile_object
from ...kernels.reference_state import length_of, steps_of
from ...kernels.validation import TOLERANCE, require_agreement
from ...reduction.inertia_split import mass_matrix
from ...reduction.tree.momenta import bracket, momenta
from ...reduction.tree.scalars import solve_spd
from ...system.system import System, checked_system
from .connection import Connection
from .wheels import Rolling, Slip, Wheel, slip_matrix, slip_rows, slips_of

_NAME = "mixed"
_STEP = 1e-3  # step of differences in validation, relative to the time of one displacement
_TOLERANCE = 1e-7  # tolerance of comparisons with differences, relative to the largest entry


@checks_arguments
@dataclass(frozen=True, eq=False)
class MixedConnection:
    """The connection and the momentum equation of a robot with k < r wheels.

    Attributes:
        system: The system.
        connection: The connection A of motions with p = 0, without metric.
        slips: The constraints of the wheels.
        free: The constant C in S = U (1 − W⁺ W) C with W = W_b U, (r, r − k), where U contains
            `units`.  It has no rows if S is the cross product of the two rows of W_b in SE(2).
        units: Size of each entry of the body twist, (r,): a power of 2 near the robot's length [m]
            for translations, or one.
    """

    system: System
    connection: Connection
    slips: tuple[Slip, ...] = field(repr=False)
    free: Array = field(repr=False)
    units: Array = field(repr=False)

    @property
    def size(self) -> int:
        """Number of generalised momenta, r − k."""
        return self.system.r - len(self.slips)

    def local(self, x: ArrayLike) -> Array:
        """Compute the local connection A(x).

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            (r, m).  Raises SingularInertiaError if two wheels constrain the same motion at x.
        """
        return self.connection.local(x)

    def gain(self, x: ArrayLike) -> Array:
        """Compute Γ(x), the body twist per unit of momentum p.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            (r, r − k); errors as in `local`.
        """
        P = self.connection.locked(x)
        return read_only(np.asarray(np.linalg.inv(P)[:, len(self.slips) :]))

    def free_motions(self, x: ArrayLike) -> Array:
        """Compute S(x), the body twists that the wheels allow with locked joints.

        Args:
            x: Shape, (nx,) [rad | m | 1].
        Returns:
            S(x), (r, r − k).
        """
        W = slip_matrix(self.system, self.slips, shape_of(self.system, x))
        return read_only(_kernel(W[:, : self.system.r], self.free, self.units))

    def momentum(self, x: ArrayLike, xdot: ArrayLike, xi: ArrayLike) -> Array:
        """Compute the generalised momentum p = Sᵀ μ.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            xdot: Shape rate, (m,) [rad/s | m/s].
            xi: Body twist, (r,) [m/s; rad/s].
        Returns:
            Momentum p, (r − k,).
        Raises:
            InputError: The wheels slip at these velocities.
        """
        system = self.system
        shape = shape_of(system, x)
        v = np.concatenate([vector(xi, system.r, "xi"), vector(xdot, system.m, "xdot")])
        W = slip_matrix(system, self.slips, shape)
        slip, size = np.abs(W @ v), np.abs(W) @ np.abs(v)
        if (slip > 1e-9 * np.maximum(size, 1e-300)).any():
            raise InputError(f"the wheels slip at {W @ v} m/s with this twist; see `velocity`")
        mu = mass_matrix(system, shape)[: system.r] @ v
        return np.asarray(self.free_motions(shape).T @ mu)

    def velocity(self, x: ArrayLike, xdot: ArrayLike, p: ArrayLike) -> Array:
        """Compute the body twist ξ = −A ẋ + Γ p.

        Args:
            x: Shape, (nx,) [rad | m | 1].
            xdot: Shape rate, (m,) [rad/s | m/s].
            p: Generalised momentum, (r − k,).
        Returns:
            (r,) [m/s; rad/s].
        """
        rate = vector(xdot, self.system.m, "xdot", self.system.shape_names)
        return np.asarray(-self.local(x) @ rate + self.gain(x) @ vector(p, self.size, "p"))

    @cached_property
    def equations(self) -> NativeCode:
        """Compiled map from (x, ẋ, p) and torques τ (m,) to health of P_b, ξ, ṗ, ẍ and energy."""
        return self._code(self._graph())

    @cached_property
    def driven(self) -> NativeCode:
        """Compiled map from (x, ẋ, p) to health of P_b, ξ and ṗ, for prescribed joint motions."""
        return self._code(self._driven_graph())

    def _code(self, graph: ca.Function) -> NativeCode:
        """Compile a function whose outputs are the first ones of `equations`, and validate it."""
        native = load_object(compile_object(graph, graph.name()), graph.name())
        for at, rng in trial_shapes(self.connection.form):
            self._validate(native, graph.numel_out(0), at, rng)
        return native

    def _validate(
        self, native: NativeCode, size: int, at: TrialShape, rng: np.random.Generator
    ) -> None:
        """Compare with Pinocchio's mass matrix and RNEA, with a multiplier for each wheel.

        H v̇ + C v = (0, τ) + Wᵀ λ and W v̇ = −Ẇ v determine v̇, and differences along (ẋ, v̇)
        determine ṗ.

        Args:
            native: The machine code.
            size: Number of its outputs.
            at: A shape.
            rng: Random number generator.
        Raises:
            KernelMismatch: Values differ.
        """
        system, form, r, k = self.system, self.connection.form, self.system.r, len(self.slips)
        units, weights, n = at.units, at.weights[:, None], system.n
        xdot, p = at.steps * rng.normal(size=system.m), rng.normal(size=self.size) / at.weights[k:]
        H = mass_matrix(system, at.x) * np.outer(units, units)
        tau = np.append(np.zeros(r), np.diag(H)[r:] * rng.normal(size=system.m))

        def rows(s: float) -> Array:
            """Return the form, without units, at the shape after a time s."""
            return weights * form.reference(system.space.integrate(at.x, s * xdot)) * units

        G, rates = rows(0.0), xdot / at.steps
        given = np.append(np.zeros(k), at.weights[k:] * p) - G[:, r:] @ rates
        v = np.append(np.linalg.solve(G[:, :r], given), rates)
        still, q = system.sorted_model.copy(), system.sorted_q(system.group.identity(), at.x)
        still.gravity.setZero()
        full = system.joint_rates(units * v)
        bias = units * system.on_shape(pin.nonLinearEffects(still, still.createData(), q, full))
        (drift,) = central_differences(lambda s: rows(s[0])[:k] @ v, np.zeros(1), _STEP).T
        whole = np.block([[H, -G[:k].T], [G[:k], np.zeros((k, k))]])
        forces = np.append(tau - bias, -drift)
        solution = np.linalg.solve(whole, forces)
        a = solution[:n]
        (pdot,) = central_differences(
            lambda s: rows(s[0])[k:] @ (v + s[0] * a), np.zeros(1), _STEP
        ).T
        energy = 0.5 * v @ H @ v
        state = np.concatenate([at.x, xdot, p])
        values = evaluate(native.address, tau[r:] / at.steps, state[None], size)[0]
        inverse = np.abs(np.linalg.inv(whole))
        terms = inverse @ (np.abs(whole) @ np.abs(solution) + np.abs(forces))
        speeds = np.abs(np.linalg.inv(G[:, :r])) @ (np.abs(given) + np.abs(G[:, r:]) @ abs(rates))
        momenta_rates = np.abs(G[k:]) @ (terms[:n] + np.abs(v).sum() * np.abs(v))
        ends = np.cumsum([1, r, self.size, system.m, 1])
        scales = np.concatenate([[1.0], at.twists, 1.0 / at.weights[k:], at.steps, [1.0]])
        relative = values / scales[:size]
        checks = [
            ("the twist", v[:r], speeds, TOLERANCE),
            ("the rate of p", pdot, momenta_rates / _STEP, _TOLERANCE),
            ("the acceleration", a[r:], terms[r:n] / _STEP, _TOLERANCE),
            ("the energy", np.array([energy]), np.abs(v) @ np.abs(H) @ np.abs(v), TOLERANCE),
        ]
        for (what, expected, terms, tolerance), first, last in zip(
            checks, ends[:-1], ends[1:], strict=True
        ):
            if last <= size:  # `driven` has only the first outputs
                found = relative[first:last]
                require_agreement(
                    f"the machine code of {form.what}", what, found, expected, terms, tolerance
                )

    def _motion_terms(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
        """Return the symbols x, ẋ, p and the CasADi expressions of ξ, ṗ and A."""
        system, r, k = self.system, self.system.r, len(self.slips)
        x, xdot = ca.SX.sym("x", system.nx), ca.SX.sym("xdot", system.m)
        p = ca.SX.sym("p", self.size)
        form = self.connection.form
        P = ca.reshape(form.locked(x), r, r)
        of_shape = form.values(x, ca.vertcat(ca.SX.zeros(r, 1), xdot))
        xi = solve_locked(form, P, ca.vertcat(ca.SX.zeros(k, 1), p) - of_shape)
        A = -ca.jacobian(xi, xdot)
        mu = momenta(system, x, ca.vertcat(xi, xdot))[:r]
        S = kernel_graph(self.system, self.slips, self.free, self.units, x)
        by_time = coordinate_rates(system.space, x, xdot)
        Sdot = ca.reshape(ca.jtimes(ca.vec(S), x, by_time), r, self.size)
        return x, xdot, p, xi, S.T @ self._coadjoint(xi, mu) + Sdot.T @ mu, A

    def _coadjoint(self, xi: ca.SX, mu: ca.SX) -> ca.SX:
        """Return the coadjoint action ad*_ξ μ as a CasADi expression."""
        eta = ca.SX.sym("eta", self.system.r)
        return ca.gradient(ca.dot(mu, bracket(self.system.group, xi, eta)), eta)

    def _driven_graph(self) -> ca.Function:
        x, xdot, p, xi, pdot, _ = self._motion_terms()
        y = ca.vertcat(x, xdot, p)
        return ca.Function(
            "driven", [y, ca.SX.sym("none")], [ca.densify(ca.vertcat(self._health(x), xi, pdot))]
        )

    def _graph(self) -> ca.Function:
        system, r, form = self.system, self.system.r, self.connection.form
        x, xdot, p, xi, pdot, A = self._motion_terms()
        tau = ca.SX.sym("tau", system.m)
        momentum = momenta(system, x, ca.vertcat(xi, xdot))
        mu, pi = momentum[:r], momentum[r:]
        # The rate of the momentum is affine in ẍ: `without_xddot` + `by_xddot` ẍ.
        by_time = coordinate_rates(system.space, x, xdot)
        without_xddot = ca.jtimes(momentum, x, by_time) + ca.jtimes(momentum, p, pdot)
        by_xddot = ca.jacobian(momentum, xdot)
        v = ca.SX.sym("v", system.n)
        kinetic = 0.5 * ca.dot(v, momenta(system, x, v))
        gradient = along_frame(form, ca.gradient(kinetic, x).T, x).T
        force = ca.substitute(gradient, v, ca.vertcat(xi, xdot))
        for ball in system.space.balls:
            force[ball.v] += ca.cross(pi[ball.v], xdot[ball.v])
        constraint = without_xddot[:r] - self._coadjoint(xi, mu)
        force = tau + force - without_xddot[r:] + A.T @ constraint
        xddot = solve_spd(by_xddot[r:, :] - A.T @ by_xddot[:r, :], force)
        energy = 0.5 * (ca.dot(xi, mu) + ca.dot(xdot, pi))
        outputs = ca.densify(ca.vertcat(self._health(x), xi, pdot, xddot, energy))
        y = ca.vertcat(x, xdot, p)
        return ca.Function(_NAME, [y, tau], [outputs], {"cse": True})

    def _health(self, x: ca.SX) -> ca.SX:
        r = self.system.r
        return health(self.connection.form, ca.reshape(self.connection.form.locked(x), r, r))


@checks_arguments
def mixed_connection(system: System, wheels: Sequence[Wheel | Rolling]) -> MixedConnection:
    """Return the mixed connection of a robot with fewer wheels than the group has dimensions.

    Args:
        system: The system.
        wheels: The wheels.
    Returns:
        The connection and the momentum equation.
    Raises:
        InputError: There are no wheels, or at least as many as the group has dimensions (see
            Connection.kinematic).
    """
    remedy = "Use as many wheels as the group has dimensions (Connection.kinematic)."
    system = checked_system(system, "mixed_connection", remedy=remedy)
    slips = tuple(slips_of(system, list(wheels)))
    r, k = system.r, len(slips)
    if not 0 < k < r:
        raise InputError(
            f"{system.group.name} has {r} dimensions: a mixed connection takes 1 to {r - 1} "
            f"wheels, got {k}; with {r}, see Connection.kinematic"
        )
    length = float(2.0 ** np.round(np.log2(length_of(system))))
    steps, rng = steps_of(system, length), np.random.default_rng(0)
    units, free = steps[:r], np.zeros((0, r - k))
    if not (r == 3 and k == 2):
        x0 = system.space.integrate(
            system.space.neutral, steps[r:] * rng.uniform(-1.0, 1.0, system.m)
        )
        free = np.linalg.svd(slip_matrix(system, slips, x0)[:, :r] * units)[2][k:].T

    def values(x: ca.SX, v: ca.SX) -> ca.SX:
        S = kernel_graph(system, slips, free, units, x)
        momentum = S.T @ momenta(system, x, v)[:r]
        rows: ca.SX = ca.vertcat(slip_rows(system, slips, x, v), momentum)
        return rows

    def reference(x: Array) -> Array:
        W = slip_matrix(system, slips, x)
        S = _kernel(W[:, :r], free, units)
        return np.vstack([W, S.T @ mass_matrix(system, x)[:r]])

    form = form_of(
        system.group, system.shape_names, system.units, f"wheels and momenta of '{system.name}'",
        values, reference, symmetric=False, space=system.space,
    )  # fmt: skip
    return MixedConnection(system, Connection.of(form), slips, free, units)


def shape_of(system: System, x: ArrayLike, what: str = "x") -> Array:
    """Return a shape, (nx,), with quaternions of length one."""
    return system.space.normalized(vector(x, system.nx, what, system.x_names), what)


def kernel_graph(
    system: System, slips: Sequence[Slip], free: Array, units: Array, x: ca.SX
) -> ca.SX:
    """Return S(x) as a CasADi expression, (r, r − k).

    Args:
        system: The system.
        slips: The constraints.
        free: See `MixedConnection`.
        units: See `MixedConnection`.
        x: Shape symbols, (nx,).
    Returns:
        The expression.
    """
    v = ca.SX.sym("v", system.n)
    W = ca.densify(ca.jacobian(slip_rows(system, slips, x, v), v)[:, : system.r])
    if not len(free):
        return ca.cross(W[0, :].T, W[1, :].T)
    Q, _ = ca.qr(ca.diag(ca.DM(units)) @ W.T)
    S = ca.DM(free) - Q @ (Q.T @ ca.DM(free))
    return ca.densify(ca.diag(ca.DM(units)) @ S)


def _kernel(W: Array, free: Array, units: Array) -> Array:
    """Return S, (r, r − k), a basis of the kernel of W_b (k, r); see `MixedConnection`."""
    if not len(free):
        return np.asarray(np.cross(W[0], W[1])[:, None])
    Q = np.linalg.qr(units[:, None] * W.T)[0]
    return np.asarray(units[:, None] * (free - Q @ (Q.T @ free)))
