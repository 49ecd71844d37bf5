"""The mixed connection: wheels constrain some body motions, momentum determines the others.

With fewer wheels than the group has dimensions, W_b ξ + W_s ẋ = 0 leaves some body motions free.
The columns of S(x) span the kernel of W_b.  The momentum along these free motions is p = Sᵀ μ, and

    ξ = −A ẋ + Γ p,   [W_b; SᵀI] (A, Γ) = ([W_s; SᵀI_a], [0; 1]),
    ṗ = Sᵀ ad*_ξ μ + (∂S ẋ)ᵀ μ,   −Aᵀ (μ̇ − ad*_ξ μ) + π̇ − ½ ∂ₓ(vᵀHv) = τ

(with −π × ẋ on the left for a ball, whose derivatives are along its axes), with the momentum
μ = I ξ + I_a ẋ of the robot without wheels.  Source: A. Bloch, P. Krishnaprasad, J. Marsden,
R. Murray, "Nonholonomic mechanical systems with symmetry", Arch. Rational Mech. Anal. 136 (1996).

In its motions, the joints are driven by torques, or follow a gait.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import (
    Array,
    FrozenArrays,
    central_differences,
    positive,
    read_only,
    vector,
    vector_or_zero,
)
from ...common.errors import InputError, IntegrationError, SingularInertiaError
from ...common.machine_code import NativeCode, load_object
from ...kernels.connection.connection_form import (
    along_frame,
    coordinate_rates,
    form_of,
    health,
    solve_locked,
)
from ...kernels.connection.connection_validation import TrialShape, trial_shapes
from ...kernels.kernel import evaluate
from ...kernels.machine.native import compile_object
from ...kernels.reference_state import length_of, steps_of
from ...kernels.validation import TOLERANCE, require_agreement
from ...reduction.pointwise_reduction import mass_matrix
from ...reduction.tree.momenta import bracket, momenta
from ...reduction.tree.scalars import solve_spd
from ...system.system import System, checked_system
from ..phases.gait import Gait
from .connection import Connection, refuse_singular
from .drag_fluid_and_wheels import Rolling, Slip, Wheel, slip_matrix, slip_rows, slips_of
from .rotation_chart import RotationChart

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
        load = np.append(np.zeros(k), at.weights[k:] * p) - G[:, r:] @ rates
        v = np.append(np.linalg.solve(G[:, :r], load), rates)
        still, q = system.sorted_model.copy(), system.sorted_q(system.group.identity(), at.x)
        still.gravity.setZero()
        full = system.joint_rates(units * v)
        bias = units * system.on_shape(pin.nonLinearEffects(still, still.createData(), q, full))
        (drift,) = central_differences(lambda s: rows(s[0])[:k] @ v, np.zeros(1), _STEP).T
        matrix = np.block([[H, -G[:k].T], [G[:k], np.zeros((k, k))]])
        forces = np.append(tau - bias, -drift)
        solution = np.linalg.solve(matrix, forces)
        a = solution[:n]
        (pdot,) = central_differences(
            lambda s: rows(s[0])[k:] @ (v + s[0] * a), np.zeros(1), _STEP
        ).T
        energy = 0.5 * v @ H @ v
        state = np.concatenate([at.x, xdot, p])
        values = evaluate(native.address, tau[r:] / at.steps, state[None], size)[0]
        inverse = np.abs(np.linalg.inv(matrix))
        terms = inverse @ (np.abs(matrix) @ np.abs(solution) + np.abs(forces))
        speeds = np.abs(np.linalg.inv(G[:, :r])) @ (np.abs(load) + np.abs(G[:, r:]) @ abs(rates))
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
                computed = relative[first:last]
                require_agreement(
                    f"the machine code of {form.what}", what, computed, expected, terms, tolerance
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


_RTOL, _ATOL = 5e-14, 1e-15
_LEAST_HEALTH = 1e-3  # least admissible health of P_b; ±1 is best
_SHAPES = 4096  # number of shapes of a path at which P_b is checked


@checks_arguments
@dataclass(frozen=True)
class MixedMotion(FrozenArrays):
    """A motion on wheels; the first axis of every array is time.

    Attributes:
        t: Times, (T,) [s].
        pose: Pose coordinates of the base, (T, size).
        x: Shapes, (T, nx) [rad | m | 1].
        xdot: Shape rates, (T, m) [rad/s | m/s].
        p: Generalised momenta, (T, r − k).
        energy: Kinetic energy, (T,) [J].
    """

    t: Array
    pose: Array
    x: Array
    xdot: Array
    p: Array
    energy: Array


@checks_arguments
def simulate_mixed(
    mixed: MixedConnection,
    x0: ArrayLike,
    xdot0: ArrayLike,
    p0: ArrayLike,
    *,
    times: ArrayLike,
    torques: Callable[[float], ArrayLike] | None = None,
) -> MixedMotion:
    """Simulate the motion under joint torques, without gravity.

    Args:
        mixed: The mixed connection.
        x0: Initial shape, (nx,) [rad | m | 1].
        xdot0: Initial shape rate, (m,) [rad/s | m/s].
        p0: Initial generalised momentum, (r − k,).
        times: Increasing times, (T,) [s]; the first is the time of the initial state.
        torques: Function of time that returns the joint torques, (m,) [N m | N]; zero if None.
    Returns:
        The motion.  Raises SingularInertiaError if the motion crosses a singular shape,
        IntegrationError if it stops at a singular shape.
    """
    system, names = mixed.system, mixed.system.shape_names
    space, m, r, k = system.space, system.m, system.r, mixed.size
    start = shape_of(system, x0, "x0")
    initial = [start, vector(xdot0, m, "xdot0", names), vector(p0, k, "p0")]
    ends = [system.nx, system.nx + m, system.nx + m + k]
    t = _times(times)
    code, zero = mixed.equations.address, np.zeros(m)

    def torque(time: float) -> Array:
        return zero if torques is None else vector(torques(time), m, "torques", names)

    side = _sign_of_health(mixed, initial[0])

    def rate(time: float, y: Array) -> Array:
        x, xdot, p, pose = np.split(y, ends)
        x = space.normalized(x, "x", near=False)
        state = np.concatenate([x, xdot, p])
        values = evaluate(code, torque(time), state[None], r + k + m + 2)[0]
        _require_regular(mixed, time, values[0] * side)
        xi, pdot, xddot = np.split(values[1:-1], [r, r + k])
        by_time = xdot if not space.balls else space.rate_map(x) @ xdot
        pose_rate = system.group.rate(system.group.normalize(pose), xi)
        return np.concatenate([by_time, xddot, pdot, pose_rate])

    y, dense = _integrate(rate, np.concatenate([*initial, system.group.identity()]), t)
    fine = np.linspace(t[0], t[-1], _SHAPES)
    # A step may skip a singular shape, so check the path inside steps, too.
    path = np.asarray(dense(fine)).T[:, : system.nx]
    _require_regular_path(mixed, space.normalized(path, "x", near=False))
    x, xdot, p, pose = np.split(y, ends, axis=1)
    return _motion(mixed, t, space.normalized(x, "x", near=False), xdot, p, pose)


@checks_arguments
def follow_mixed(
    mixed: MixedConnection, gait: Gait, p0: ArrayLike = 0, *, times: ArrayLike
) -> MixedMotion:
    """Compute the motion of the body while the joints follow a gait.

    Args:
        mixed: The mixed connection.
        gait: The gait; balls follow rotation vectors about rest.
        p0: Initial generalised momentum, (r − k,); 0 for zero momentum.
        times: Increasing times, (T,) [s]; the first is the time of the initial state.
    Returns:
        The motion; errors as in `simulate_mixed`.
    """
    system, k = mixed.system, mixed.size
    chart = RotationChart(system.space, system.space.neutral)
    p = vector_or_zero(p0, k, "p0")
    t = _times(times)

    def joints(time: float | Array) -> tuple[Array, Array]:
        w, wdot = gait.at(time)
        return (w, wdot) if not system.space.balls else (chart.shapes(w), chart.rates(w, wdot))

    side = _sign_of_health(mixed, joints(t[0])[0])
    _require_regular_path(mixed, chart.shapes(gait.samples(_SHAPES)[0]))
    code, none = mixed.driven.address, np.zeros(1)

    def rate(time: float, y: Array) -> Array:
        state = np.concatenate([*joints(time), y[:k]])
        values = evaluate(code, none, state[None], system.r + k + 1)[0]
        _require_regular(mixed, time, values[0] * side)
        xi, pdot = np.split(values[1:], [system.r])
        return np.concatenate([pdot, system.group.rate(system.group.normalize(y[k:]), xi)])

    y, _ = _integrate(rate, np.concatenate([p, system.group.identity()]), t)
    x, xdot = joints(t)
    return _motion(mixed, t, x, xdot, y[:, :k], y[:, k:])


def _sign_of_health(mixed: MixedConnection, x: Array) -> float:
    """Return the sign of P_b's health at a shape.  Raises SingularInertiaError if it is zero."""
    health = mixed.connection.code.locals(x[None]).health
    refuse_singular(mixed.connection.form, x[None], health)
    return float(np.sign(health[0]))


def _require_regular_path(mixed: MixedConnection, x: Array) -> None:
    """Raise SingularInertiaError if a path (N, m) has a nearly singular shape."""
    health = np.abs(mixed.connection.code.locals(x).health)
    if not health.min() > _LEAST_HEALTH:
        raise SingularInertiaError(
            f"the joints pass the shape {x[int(np.argmin(health))]}, where "
            f"{mixed.connection.form.what} do not determine the motion of the body. Keep the "
            "joints away from this shape."
        )


def _require_regular(mixed: MixedConnection, time: float, health: float) -> None:
    """Raise IntegrationError if P_b is nearly singular; `health` has its initial sign."""
    if not health > _LEAST_HEALTH:
        raise IntegrationError(
            f"at t = {time:g} s the joints reach a shape at which {mixed.connection.form.what} "
            "do not determine the motion of the body; the motion is not defined beyond this shape"
        )


def _times(times: ArrayLike) -> Array:
    """Validate report times.  Raises InputError if they do not increase."""
    t = np.asarray(times, dtype=float)
    t = vector(t, t.size, "times")
    positive(float(np.diff(t).min(initial=np.inf)) if len(t) > 1 else 0.0, "the step of times")
    return t


def _integrate(
    rate: Callable[[float, Array], Array], initial: Array, t: Array
) -> tuple[Array, Callable[[Array], Array]]:
    """Return the states at times t (T,), and the dense output.  Raises IntegrationError."""
    from scipy.integrate import solve_ivp

    result = solve_ivp(
        rate,
        (t[0], t[-1]),
        initial,
        method="DOP853",
        rtol=_RTOL,
        atol=_ATOL,
        t_eval=t,
        dense_output=True,
    )
    if result.status != 0 or not np.isfinite(result.y).all():
        raise IntegrationError(f"the motion cannot be integrated to {t[-1]:g} s: {result.message}")
    return np.asarray(result.y.T), result.sol


def _motion(
    mixed: MixedConnection, t: Array, x: Array, xdot: Array, p: Array, pose: Array
) -> MixedMotion:
    """Compute the energies and return the motion."""
    m, r, k = mixed.system.m, mixed.system.r, mixed.size
    states = np.hstack([x, xdot, p])
    energy = evaluate(mixed.equations.address, np.zeros(m), states, r + k + m + 2)[:, -1]
    pose = mixed.system.group.normalize(pose)
    return MixedMotion(t, pose, x.copy(), xdot.copy(), p.copy(), energy.copy())
