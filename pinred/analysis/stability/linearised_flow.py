"""Integrate the flow and its tangent, ẏ = f(y), Ẏ = ∂f/∂y Y, with equal Runge–Kutta steps.

The method is DOP853, of order 8. Its steps are at most half as long as the steps of the motion, and
short compared with the time scales of the linearised flow. They are halved until the result no
longer changes. Cyclic angles are left out, because the flow does not depend on them.

The linearised reduced flow at a state: its matrix, eigenvalues, modes and their errors.

The state of the compiled kernel is y = (x, π) of the active joints, x of the cyclic joints, entries
of the balls, entries of the base, and time. Cyclic angles and time are left out, because the flow
does not depend on them. The momentum of the base stays on its symplectic leaf, where the Casimirs
are constant. The quaternion q of a ball stays on the sphere |q| = 1; with a conjugate momentum p,
q · p is constant, too.  With closed loops, perturbations keep the loops closed and are orthogonal
to the gauge of the impetus (see `loop_gauge`).

With closed loops the reduced state contains all joints and an impetus p = π + Jᵀν.  A perturbation
keeps the loops closed, J δx = 0.  Changes of p by Jᵀα change no velocity (gauge); see
reduction/tree/loop_constraints.py.  The linearised flow maps closed perturbations to closed ones
and gauge to gauge, so it acts on closed perturbations that are orthogonal to the gauge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError, IntegrationError
from ...integrators.methods import DOP853
from ...integrators.stepping.compiling import compiled
from ...integrators.stepping.intrinsics import SEEDS, call, call_tangent
from ...kernels.build import jacobian_of, tangent_of
from ...kernels.kernel import Kernel, Layout, evaluate
from ...reduction.base_parts import BaseParts
from ...reduction.pointwise_reduction import mass_matrix, usual_inertias
from ...reduction.tree.loop_constraints import GAUGE_RATE
from ...scene.scene import Scene
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.plan import plan_of
from ...simulation.reduced_flow import Sample
from ...simulation.trajectory import Trajectory
from ...system.joints import BALL
from ...system.loops.kinematics import loop_jacobian, loop_jacobian_rate
from ...system.state_fields import State
from ...system.system import System

_ROUND_OFF = 10.0  # error of the Jacobian, in units of machine epsilon times its norm


@checks_arguments
@dataclass(frozen=True, eq=False)
class Linearisation(FrozenArrays):
    """The linearised reduced flow δż = matrix δz. Arrays are read-only.

    Attributes:
        state: Reduced state z without cyclic angles and time, (k,).
        names: Names of the entries of z; with closed loops, π is the impetus.
        matrix: Exact Jacobian of the reduced flow, (k, k).
        eigenvalues: Eigenvalues on the leaf where the Casimirs are constant, (d,) [1/s], largest
            growth first.
        modes: Eigenvectors, (k, d), one per column.
        errors: Largest effect of round-off on each eigenvalue, (d,) [1/s].
        leaf: Tangent space of the leaf at the state.
    """

    state: Array
    names: tuple[str, ...]
    matrix: Array
    eigenvalues: NDArray[np.complex128]
    modes: NDArray[np.complex128]
    errors: Array
    leaf: Leaf

    def __str__(self) -> str:
        lines = ["growth [1/s]      frequency [rad/s]      (negative growth: decay)"]
        lines += [f"{value.real:+.6e}     {abs(value.imag):.6e}" for value in self.eigenvalues]
        return "\n".join(lines)


def linearised(flow: CompiledFlow, y: Array) -> Linearisation:
    """Linearise the flow at a reduced state y (size,)."""
    sample = flow.sample(0.0, y)
    leaf = leaf_of(flow.kernel, y, sample.x, _usual_rate(flow, sample))
    indices = leaf.indices
    if leaf.gauge is None:
        matrix = jacobian_of(flow.kernel, y, flow.parameters)[np.ix_(indices, indices)]
    else:
        at, parameters = y.copy(), np.ascontiguousarray(flow.parameters)
        rates = evaluate(flow.kernel.rate.address, parameters, y[None], len(y))[0]
        at[indices], shear = leaf.gauge.at_rest(sample.x, y[indices], rates[indices])
        matrix = jacobian_of(flow.kernel, at, flow.parameters)[np.ix_(indices, indices)]
        matrix = np.linalg.solve(shear, matrix @ shear)
    on_leaf = leaf.restrict(matrix)
    values, left_vectors, right = eigen(on_leaf)
    error = eigenvalue_errors(left_vectors, right, _ROUND_OFF * np.finfo(float).eps * norm(on_leaf))
    return Linearisation(y[indices], leaf.names, matrix, values, leaf.embed(right), error, leaf)


def _usual_rate(flow: CompiledFlow, sample: Sample) -> float:
    """Return the largest rate at a state [rad/s], at least 1 rad/s under gravity or forces."""
    kernel = flow.kernel
    angular_velocity = sample.xi[kernel.system.group.linear :]
    rate = max(float(np.abs(rates).max(initial=0.0)) for rates in (angular_velocity, sample.xdot))
    has_forces = bool(kernel.layout.gravity) or kernel.forces is not None
    return max(rate, 1.0) if has_forces or not rate else rate


def norm(matrix: Array) -> float:
    """Return the largest singular value of a matrix, or 0 for an empty matrix."""
    return float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0


def eigen(matrix: Array) -> tuple[NDArray[np.complex128], ...]:
    """Return the eigenvalues (d,), largest real part first, and left and right eigenvectors.

    The eigenvectors are columns.
    """
    from scipy.linalg import eig

    if not matrix.size:
        empty = np.zeros((0, 0), dtype=complex)
        return np.zeros(0, dtype=complex), empty, empty
    values, left_vectors, right = eig(matrix, left=True, right=True)
    order = np.lexsort((-values.imag, np.abs(values.imag), -np.round(values.real, 12)))
    return values[order], left_vectors[:, order], right[:, order]


def eigenvalue_errors(
    left: NDArray[np.complex128], right: NDArray[np.complex128], change: float
) -> Array:
    """Bound the change of each eigenvalue under a perturbation of the matrix.

    The bound uses the condition numbers |y||x|/|yᴴx|. Eigenvalues of a
    defective pair move by ±√ε, so the bound is limited to this order.

    Args:
        left: Left eigenvectors y, one per column.
        right: Right eigenvectors x, one per column.
        change: Norm ε of the perturbation.
    Returns:
        Bounds of the changes, (d,).
    """
    if not right.size:
        return np.zeros(0)
    overlap = np.abs(np.einsum("ij,ij->j", left.conj(), right))
    size = np.linalg.norm(left, axis=0) * np.linalg.norm(right, axis=0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.minimum(change * size / overlap, np.sqrt(change) * 1e3 + change))


_STEP_RATIO = 0.5  # longest step, relative to the median step of the motion
_RATE_STEP = 0.2  # longest step, relative to the inverse of the fastest rate
_RATE_SAMPLES = 9  # number of times at which the rates are sampled
_CONVERGED = 1e-11  # largest relative change when the steps are halved
_MAX_HALVINGS = 8
_SAME_RATE = 1e-9  # relative difference of rates that count as equal


@dataclass
class LinearisedFlow:
    """A motion and its tangent directions; `advance` changes it in place.

    Attributes:
        flow: Flow of the scene without the base.
        leaf: Tangent space of the leaf at the initial state.
        y: Reduced state, (size,).
        Y: Tangent directions, (size, d).
        longest: Longest step [s].
    """

    flow: CompiledFlow
    leaf: Leaf
    y: Array
    Y: Array
    longest: float

    def align(self, y: Array) -> None:
        """Choose the signs of balls' quaternions, ±q, that are nearest to y (size,).

        The sign stays if a force depends on it.
        """
        kernel, parameters = self.flow.kernel, np.ascontiguousarray(self.flow.parameters)
        for place in self.leaf.quaternions:
            signs, entries = np.ones(len(y)), self.leaf.indices[place]
            if self.y[entries] @ y[entries] >= 0.0:
                continue
            signs[entries] = -1.0
            if kernel.layout.lifted_balls:
                signs[entries + kernel.layout.pairs] = -1.0
            both = np.array([self.y, signs * self.y])
            before, after = evaluate(kernel.rate.address, parameters, both, len(y))
            if np.abs(after - signs * before).max() <= _SAME_RATE * np.abs(before).max():
                self.y *= signs
                self.Y *= signs[:, None]

    def reset_gauge(self) -> None:
        """With closed loops, change to the gauge ν = 0, and project Y on closed perturbations.

        Gaps are constant, so their round-off would exceed directions that decay.
        """
        gauge, indices = self.leaf.gauge, self.leaf.indices
        if gauge is None:
            return
        sample = self.flow.sample(0.0, self.y)
        quaternions = self.leaf.quaternions
        gauge = loop_gauge(gauge.system, self.flow.kernel.layout, quaternions, self.y[indices])
        assert gauge is not None
        z, Z = gauge.reset(sample, self.y[indices], self.Y[indices])
        scales = self.leaf.scales
        Q = np.linalg.qr(gauge.gradients(sample.x, scales).T)[0]
        scaled = Z / scales[:, None]
        self.y[indices] = z
        self.Y[indices] = (scaled - Q @ (Q.T @ scaled)) * scales[:, None]

    def converged_step(self, duration: float) -> float:
        """Return a step [s] so short that halving it does not change Y after a duration [s]."""
        longest, directions = self.longest, self._after(duration, self.longest)
        for _ in range(_MAX_HALVINGS):
            refined = self._after(duration, 0.5 * longest)
            size = float(np.abs(refined).max(initial=1e-300))
            if float(np.abs(refined - directions).max(initial=0.0)) <= _CONVERGED * size:
                break
            longest, directions = 0.5 * longest, refined
        return longest

    def _after(self, duration: float, longest: float) -> Array:
        """Compute Y after a duration, with steps of at most `longest`; self is not modified."""
        copy = replace(self, y=self.y.copy(), Y=self.Y.copy(), longest=longest)
        copy.advance(duration)
        return copy.Y

    def advance(self, duration: float) -> None:
        """Advance by a duration.

        Args:
            duration: Duration [s].
        Raises:
            IntegrationError: The state or its derivative is no longer finite.
        """
        steps = max(1, int(np.ceil(duration / self.longest - 1e-9)))
        n, d = self.Y.shape
        groups = -(-d // SEEDS)
        lanes = np.zeros((groups, n * SEEDS))
        for j in range(d):
            lanes[j // SEEDS, j % SEEDS :: SEEDS] = self.Y[:, j]
        tableau = DOP853.tableau()
        s, A = tableau.stages, np.array(tableau.A)
        kernel = self.flow.kernel
        parameters = np.ascontiguousarray(self.flow.parameters)
        _advance(
            kernel.rate.address, tangent_of(kernel).address, parameters, A, s, duration / steps,
            steps, self.y, lanes, np.zeros((s, n)), np.zeros((s, groups, n * SEEDS)), np.zeros(n),
            np.zeros(n * SEEDS),
        )  # fmt: skip
        for j in range(d):
            self.Y[:, j] = lanes[j // SEEDS, j % SEEDS :: SEEDS]
        excluded = np.setdiff1d(np.arange(n), self.leaf.indices)
        self.Y[excluded] = 0.0
        if not (np.isfinite(self.y).all() and np.isfinite(self.Y).all()):
            raise IntegrationError(f"the linearised flow of '{kernel.system.name}' is not finite")


def linearised_flow(traj: Trajectory) -> LinearisedFlow:
    """Return the linearised flow of a motion at its start, with a basis of its leaf.

    Args:
        traj: Motion that the compiled engine computed.
    Returns:
        The flow.
    Raises:
        InputError: The motion was not computed by the compiled engine, or its forces are not smooth
            in time.
    """
    if traj.run.engine != "compiled":
        raise InputError(
            "traj: the linearised flow needs a motion that was simulated with engine='compiled'"
        )
    if len(traj.plan.stops) > 1:
        raise InputError(
            "traj: the linearised flow needs forces that are smooth in time, and no controllers"
        )
    flow = CompiledFlow.of_plan(plan_of(without_base(traj.scene)))
    leaf = leaf_of(flow.kernel, flow.y0, flow.sample(0.0, flow.y0).x)
    Y = np.zeros((len(flow.y0), leaf.basis.shape[1]))
    Y[leaf.indices] = np.linalg.qr(leaf.embed(np.eye(leaf.basis.shape[1])))[0]
    step_ends = traj.motion.knots
    steps = np.diff(step_ends)
    longest = _STEP_RATIO * float(np.median(steps)) if steps.size else 0.01 * traj.scene.end
    fastest_rate = 0.0
    samples = traj.motion.changes(np.linspace(0.0, traj.scene.end, _RATE_SAMPLES)).y[
        :, : flow.kernel.layout.base_at
    ]
    for sample in samples:
        state = flow.y0.copy()
        state[: len(sample)] = sample
        J = jacobian_of(flow.kernel, state, flow.parameters)
        fastest_rate = max(fastest_rate, float(np.abs(np.linalg.eigvals(J)).max(initial=0.0)))
    if fastest_rate > 0.0:
        longest = min(longest, _RATE_STEP / fastest_rate)
    result = LinearisedFlow(flow, leaf, flow.y0.copy(), Y, longest)
    return replace(result, longest=result.converged_step(min(20.0 * longest, traj.scene.end)))


def without_base(scene: Scene) -> Scene:
    """Return the same scene with outputs="shape", which leaves out the base."""
    scene = scene if scene.outputs == "shape" else replace(scene, outputs="shape")
    return of_smooth_momenta(scene)


def of_smooth_momenta(scene: Scene) -> Scene:
    """Return a scene whose balls have momenta along their axes, if it has loops and balls.

    Symplectic methods use conjugate momenta of quaternions, in which the gauge of loops is not
    linear.  The flow is the same.
    """
    system = scene.system
    return replace(scene, method=DOP853()) if system.loops and system.space.balls else scene


def scene_at(traj: Trajectory, t: float) -> Scene:
    """Return the scene, without its base, whose initial state is the state of a motion at time t.

    Args:
        traj: Motion that includes its base.
        t: Time [s].
    Returns:
        The scene.
    Raises:
        InputError: The motion has no base, or t is outside it.
    """
    state = traj.at(t)
    if not isinstance(state, State):
        raise InputError(
            "traj: linearise needs a motion with its base. Simulate with outputs='all'."
        )
    return replace(
        of_smooth_momenta(traj.scene), x0=state.x, xdot0=state.xdot, xi0=state.xi,
        pose0=state.pose, momentum=None, seed=None, keyframe=None, q0=None, v0=None,
        outputs="shape",
    )  # fmt: skip


@compiled
def _advance(
    address: int,
    tangent: int,
    params: Array,
    A: Array,
    s: int,
    h: float,
    steps: int,
    y: Array,
    Y: Array,
    rates: Array,
    tangent_rates: Array,
    stage: Array,
    stage_tangent: Array,
) -> None:
    """Integrate y and Y in place over equal steps with an explicit Runge–Kutta tableau.

    Args:
        address: Address of the compiled right side f.
        tangent: Address of the compiled tangent (∂f/∂y) δy.
        params: Parameters of the kernel.
        A: Tableau, (s + 1, s); its last row holds the weights.
        s: Number of stages.
        h: Step [s].
        steps: Number of steps.
        y: State, (n,).
        Y: Tangent directions in groups of SIMD lanes, (groups, n SEEDS).
        rates: Work space for the stage derivatives, (s, n).
        tangent_rates: Work space for the tangents of the stage derivatives, (s, groups, n SEEDS).
        stage: Work space for a stage, (n,).
        stage_tangent: Work space for the tangent of a stage, (n SEEDS,).
    """
    n, groups = len(y), len(Y)
    size = n * SEEDS
    for _ in range(steps):
        for k in range(s):
            for i in range(n):
                total = 0.0
                for m in range(k):
                    total += A[k, m] * rates[m, i]
                stage[i] = y[i] + h * total
            call(address, stage, params, rates[k])
            for g in range(groups):
                for i in range(size):
                    total = 0.0
                    for m in range(k):
                        total += A[k, m] * tangent_rates[m, g, i]
                    stage_tangent[i] = Y[g, i] + h * total
                call_tangent(tangent, stage, params, stage_tangent, tangent_rates[k, g])
        for i in range(n):
            for m in range(s):
                y[i] += h * A[s, m] * rates[m, i]
        for g in range(groups):
            for i in range(size):
                for m in range(s):
                    Y[g, i] += h * A[s, m] * tangent_rates[m, g, i]


@dataclass(frozen=True)
class LoopGauge:
    """Where the reduced state z of a kernel has shapes and momenta of joints with loops.

    Attributes:
        system: The system, with loops.
        rates: Indices of the rates whose momenta are in z, (a,).
        momenta: Positions of these momenta in z, (a,).
        displacements: Map from changes of z to displacements of these rates, (a, k).
    """

    system: System
    rates: NDArray[np.intp]
    momenta: NDArray[np.intp]
    displacements: Array

    def gradients(self, x: Array, scales: Array) -> Array:
        """Return the gradients of the equations, and the gauge, at a shape.

        Args:
            x: Shape, (nx,) [rad | m].
            scales: Typical sizes of z, (k,).
        Returns:
            Unit vectors in z/scales, (2c, k).
        """
        J = self._jacobian(x)
        gauge = np.zeros((len(J), len(scales)))
        gauge[:, self.momenta] = J
        rows = np.concatenate([J @ self.displacements * scales, gauge / scales])
        return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))

    def at_rest(self, x: Array, z: Array, rates: Array) -> tuple[Array, Array]:
        """Return the state in the gauge that does not change with time at rest.

        The forces λ of the loops are missing in ṗ, so in the gauge ν = 0 the impetus of a steady
        motion grows by −Jᵀλ.  It is constant for ν = −λ over the rate of the gauge.

        Args:
            x: Shape, (nx,) [rad | m].
            z: Entries of the reduced state with ν = 0, (k,).
            rates: Their derivatives, (k,).
        Returns:
            The state, (k,), and the map of perturbations from the gauge ν = 0, (k, k).
        """
        J, z = self._jacobian(x), z.copy()
        nu = np.asarray(np.linalg.lstsq(J.T, rates[self.momenta] / GAUGE_RATE, rcond=None)[0])
        z[self.momenta] += J.T @ nu
        return z, np.eye(len(z)) + self._shear(x, nu)

    def reset(self, sample: Sample, z: Array, Z: Array) -> tuple[Array, Array]:
        """Return the state and its perturbations after the change of gauge p → π = p − Jᵀν.

        Args:
            sample: Shape and velocities of the state.
            z: Entries of the reduced state, (k,).
            Z: Perturbations, (k, d).
        Returns:
            The same in the gauge ν = 0.
        """
        system, J, z = self.system, self._jacobian(sample.x), z.copy()
        v = np.concatenate([sample.xi, sample.xdot])
        pi = (mass_matrix(system, sample.x) @ v)[system.r + self.rates]
        nu = np.asarray(np.linalg.lstsq(J.T, z[self.momenta] - pi, rcond=None)[0])
        z[self.momenta] -= J.T @ nu
        return z, Z - self._shear(sample.x, nu) @ Z

    def _shear(self, x: Array, nu: Array) -> Array:
        """Return the derivative of Jᵀν with respect to the shape at constant ν, (k, k)."""
        system, count = self.system, len(self.rates)
        assert system.closure is not None
        by_rate = np.zeros((count, count))
        for column, k in zip(by_rate.T, self.rates.tolist(), strict=True):
            rate = loop_jacobian_rate(system, x, np.eye(system.m)[k])[system.closure.rows]
            column[:] = rate[:, self.rates].T @ nu
        shear = np.zeros((self.displacements.shape[1],) * 2)
        shear[self.momenta] = by_rate @ self.displacements
        return shear

    def _jacobian(self, x: Array) -> Array:
        assert self.system.closure is not None
        J = loop_jacobian(self.system, x)[self.system.closure.rows][:, self.rates]
        return np.asarray(J)


def loop_gauge(
    system: System, layout: Layout, quaternions: tuple[slice, ...], z: Array
) -> LoopGauge | None:
    """Return the gauge of a kernel with loops; None without loops.

    Args:
        system: The system.
        layout: Layout of the kernel, without conjugate momenta of quaternions.
        quaternions: Positions of the quaternions in z.
        z: Entries of the reduced state, (k,).
    """
    if not system.loops:
        return None
    assert not layout.lifted_balls, "of_smooth_momenta() avoids conjugate momenta of quaternions"
    active = len(layout.active)
    rates, momenta = [*layout.active], [*range(active, 2 * active)]
    displacements = [np.eye(active, len(z))]
    for (_, v), entries in zip(layout.balls, quaternions, strict=True):
        block = np.zeros((3, len(z)))
        block[:, entries] = 4.0 * BALL.rate_map(z[entries]).T
        pi_rates = [k for k in range(v, v + 3) if k in layout.ball_pi]
        rates += pi_rates
        momenta += [2 * active + layout.ball_pi.index(k) for k in pi_rates]
        displacements.append(block[[k - v for k in pi_rates]])
    return LoopGauge(
        system, np.array(rates, dtype=np.intp), np.array(momenta, dtype=np.intp),
        np.concatenate(displacements),
    )  # fmt: skip


_ZERO_MOMENTUM = 1e-12  # largest scaled momentum that counts as zero


@dataclass(frozen=True)
class Leaf:
    """The tangent space of the symplectic leaf at a reduced state.

    Attributes:
        indices: Indices of the entries z of y that the flow depends on, (k,).
        scales: Typical sizes of the entries of z, (k,): 1, or an inertia for a momentum.
        basis: Orthonormal basis in z/scales, (k, d).
        names: Names of the entries of z.
        places: Position of x of the active joints in z.
        momenta: Position of π of the active joints in z.
        quaternions: Position of the quaternion of each ball in z.
        gauge: Gauge of closed loops; None without loops.
    """

    indices: Array
    scales: Array
    basis: Array
    names: tuple[str, ...]
    places: slice
    momenta: slice
    quaternions: tuple[slice, ...] = ()
    gauge: LoopGauge | None = None

    def restrict(self, matrix: Array) -> Array:
        """Restrict a matrix (k, k) on z to the leaf, (d, d)."""
        return np.asarray(self.basis.T @ (matrix / self.scales[:, None] * self.scales) @ self.basis)

    def embed(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """Embed vectors on the leaf, (d, …), in z, (k, …)."""
        return np.asarray((self.scales * (self.basis @ vectors).T).T)


def leaf_of(kernel: Kernel, y: Array, x: Array, rate: float = 1.0) -> Leaf:
    """Return the leaf through a reduced state.

    Args:
        kernel: Compiled kernel of the flow.
        y: Reduced state, (size,).
        x: Shape of this state, (nx,), with prescribed joints.
        rate: Typical rate [rad/s], which scales momenta.
    Returns:
        The leaf.
    """
    system, layout = kernel.system, kernel.layout
    active, pairs, base = len(layout.active), layout.pairs, layout.base
    size = layout.base_at + base.size
    indices = np.r_[: 2 * pairs, layout.balls_at : size].astype(np.intp)
    scales = _scales(kernel, rate)[indices]
    basis, z = np.eye(len(indices)), y[indices] / scales
    quaternions = _quaternions(layout)
    gradients = _sphere_gradients(layout, y[indices], scales, quaternions)
    gauge = loop_gauge(system, layout, quaternions, y[indices])
    if gauge is not None:
        gradients = np.vstack([gradients, gauge.gradients(x, scales)])
    if not base.attitude:
        gradients = np.vstack([_casimir_gradients(z, len(z) - base.size, base), gradients])
    basis = _null_space(gradients) if len(gradients) else basis
    return Leaf(
        indices,
        scales,
        basis,
        reduced_names(system, kernel, indices),
        slice(0, active),
        slice(pairs, pairs + active),
        quaternions,
        gauge,
    )


def reduced_names(system: System, kernel: Kernel, indices: Array) -> tuple[str, ...]:
    """Return the names of some entries of the reduced state.

    Args:
        system: The system.
        kernel: Kernel whose layout orders the entries.
        indices: Indices of the entries.
    Returns:
        One name per index.
    """
    layout, base = kernel.layout, kernel.layout.base
    joints = system.shape_names
    attitudes = [system.x_names[k] for k in layout.ball_x]
    names = [joints[k] for k in layout.active] + attitudes * layout.lifted_balls
    names += [f"π {joints[k]}" for k in layout.active]
    names += [f"p {name}" for name in attitudes * layout.lifted_balls]
    names += [joints[k] for k in layout.cyclic]
    if not layout.lifted_balls:
        names += [*(f"π {joints[k]}" for k in layout.ball_pi), *attitudes]
    momentum_names = [
        name.replace("ω", "L") for name in system.group.twist_names[system.group.linear :]
    ]
    names += [*system.group.pose_names[system.group.linear :]][: base.attitude]
    names += [f"Γ{k + 1}" for k in range(base.down)] + momentum_names[: base.momentum]
    names += [f"push {k + 1}" for k in range(base.push)] + ["t"] * layout.clock
    return tuple(names[int(k)] for k in indices)


def _scales(kernel: Kernel, rate: float) -> Array:
    """Return the typical sizes of the reduced-state entries, (size,)."""
    system, layout, base = kernel.system, kernel.layout, kernel.layout.base
    momenta, pairs, r = rate * usual_inertias(system), layout.pairs, system.r
    scales = np.ones(layout.base_at + base.size)
    scales[pairs : pairs + len(layout.active)] = momenta[r:][list(layout.active)]
    first = layout.balls_at
    for k, (_, v) in enumerate(layout.balls):
        width = sum(j in layout.ball_pi for j in range(v, v + 3))
        if layout.lifted_balls:
            first, width = pairs + len(layout.active) + 4 * k, 4
        scales[first : first + width] = momenta[r + v : r + v + 3].max()
        first += width
    if base.momentum:
        offset = layout.base_at + base.attitude + base.down
        scales[offset : offset + base.momentum] = momenta[r - base.momentum : r].max()
    return np.where(scales > 0.0, scales, 1.0)


def _quaternions(layout: Layout) -> tuple[slice, ...]:
    """Return the positions in z of the quaternions of balls."""
    first = 2 * layout.pairs + len(layout.ball_pi)
    if layout.lifted_balls:
        first = len(layout.active)
    return tuple(slice(first + 4 * k, first + 4 * k + 4) for k in range(len(layout.balls)))


def _sphere_gradients(
    layout: Layout, z: Array, scales: Array, quaternions: tuple[slice, ...]
) -> Array:
    """Return the gradients in z/scales of |q|² and of q · p of the balls, one per row.

    Args:
        layout: Layout of the kernel.
        z: Entries of the reduced state, (k,).
        scales: Typical sizes of z, (k,).
        quaternions: Positions of the quaternions in z.
    Returns:
        Unit gradients, (c, k).
    """
    rows = []
    for entries in quaternions:
        row = np.zeros(len(z))
        row[entries] = z[entries]
        rows.append(row)
        if layout.lifted_balls:
            momenta = slice(entries.start + layout.pairs, entries.stop + layout.pairs)
            row = np.zeros(len(z))
            row[entries], row[momenta] = z[momenta], z[entries]
            rows.append(row)
    gradients = np.array(rows).reshape(len(rows), len(z)) * scales
    return np.asarray(gradients / np.linalg.norm(gradients, axis=1, keepdims=True))


def _casimir_gradients(z: Array, at: int, base: BaseParts) -> Array:
    """Return the gradients of the Casimirs in scaled entries z (k,), one per row.

    At zero momentum the leaf is a single point, so that all momenta are constrained.

    Args:
        z: Scaled reduced state, (k,).
        at: Index of the first entry of the base.
        base: Entries of the base.
    Returns:
        Gradients, (c, k).
    """
    if base.down:
        gradients = np.zeros((2, len(z)))
        down, momentum = z[at : at + 3], z[at + 3 : at + 6]
        gradients[0, at : at + 3] = down
        gradients[1, at : at + 3], gradients[1, at + 3 : at + 6] = momentum, down
        return np.asarray(gradients / np.linalg.norm(gradients, axis=1, keepdims=True))
    if base.momentum != 3:
        return np.zeros((0, len(z)))
    gradients, momentum = np.zeros((3, len(z))), z[at : at + 3]
    if np.linalg.norm(momentum) <= _ZERO_MOMENTUM:
        gradients[:, at : at + 3] = np.eye(3)
        return gradients
    gradients[0, at : at + 3] = momentum / np.linalg.norm(momentum)
    return gradients[:1]


def _null_space(matrix: Array) -> Array:
    _, singular, vectors = np.linalg.svd(matrix)
    rank = int((singular > 1e-12 * singular[0]).sum())
    return np.asarray(vectors[rank:].T)
