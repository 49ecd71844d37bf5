"""linearise(), lyapunov(), floquet(): the linearised reduced flow along a motion.

With joint stops, multipliers are computed through the impacts. The kernels leave out the positions
of cyclic joints, and their momenta are constant. A stop breaks this symmetry of its joint, and an
impact changes the momentum. So both are added to the leaf.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, positive
from ...common.errors import InputError
from ...common.names import listed
from ...common.waiting import Progress, Wait, shown
from ...forces.force_numbers import ForceInputs
from ...simulation.compiled.compiled_flow import CompiledFlow, has_no_momentum
from ...simulation.flow_map.flow_through_stops import StoppedPropagator
from ...simulation.flow_map.inputs import Inputs
from ...simulation.plan import plan_of
from ...simulation.run_with_stops import StoppedMotion
from ...simulation.trajectory import Trajectory
from .linearised_flow import (
    Linearisation,
    LinearisedFlow,
    leaf_of,
    linearised,
    linearised_flow,
    scene_at,
    without_base,
)

_STEPS_PER_BASIS = 10  # number of steps between two orthonormalisations
_MAX_CLOSURE = 1e-6  # largest relative difference between the two ends of a period


@checks_arguments
@dataclass(frozen=True)
class LyapunovSpectrum(FrozenArrays):
    """Lyapunov exponents of a motion on its symplectic leaf. Arrays are read-only.

    Attributes:
        exponents: Exponents, (d,) [1/s], largest first.
        times: Times at which the basis was orthonormalised, (K,) [s].
        history: Exponents over the motion up to each of `times`, (K, d) [1/s].
        spread: Range of each exponent over the last half of the motion, (d,) [1/s].
    """

    exponents: Array
    times: Array
    history: Array
    spread: Array

    def __str__(self) -> str:
        lines = [
            f"{value:+.6f} ± {spread:.1g} 1/s"
            for value, spread in zip(self.exponents, self.spread, strict=True)
        ]
        return "\n".join(lines)


@checks_arguments
@dataclass(frozen=True)
class FloquetMultipliers(FrozenArrays):
    """Floquet multipliers of a periodic motion on its symplectic leaf. Arrays are read-only.

    Attributes:
        multipliers: Multipliers, (d,), largest first.
        exponents: Floquet exponents log(multipliers)/period, (d,) [1/s].
        monodromy: Monodromy matrix, (d, d).
        period: Period T [s].
        closure: Relative difference of the reduced states at the two ends of the period.
    """

    multipliers: NDArray[np.complex128]
    exponents: NDArray[np.complex128]
    monodromy: Array
    period: float
    closure: float

    def __str__(self) -> str:
        lines = [f"|{abs(mu):.9g}|  {mu.real:+.9g} {mu.imag:+.9g}i" for mu in self.multipliers]
        return "\n".join([f"period {self.period:g} s, closes to {self.closure:.1g}", *lines])


@checks_arguments
@Wait("linearises a motion")
def linearise(traj: Trajectory, t: float = 0.0) -> Linearisation:
    """Linearise the reduced flow at time t of a motion with the exact Jacobian.

    The reduced state is (x, π, μ) without cyclic angles. Eigenvalues and modes are computed on
    the symplectic leaf, where the Casimirs are constant.

    Args:
        traj: Motion that includes its base (outputs="all").
        t: Time [s].
    Returns:
        The linearisation.
    Raises:
        InputError: t is outside the motion, or the motion has no base.
    """
    scene = scene_at(traj, t)
    flow = CompiledFlow.of_plan(plan_of(scene))
    model, layout = scene.force_model, flow.kernel.layout
    y = flow.y0.copy()
    if layout.clock:
        y[-1] = t
    if model is not None and layout.numbers:
        flow.numbers[:] = traj.motion.numbers(np.array([t]))[0]
    return linearised(flow, y)


@checks_arguments
def lyapunov(
    traj: Trajectory, *, every: float | None = None, progress: Progress | bool | None = None
) -> LyapunovSpectrum:
    """Compute the Lyapunov spectrum along a motion, from its start to its end.

    The exponents sum to zero. On the leaf they approach pairs ±λ as the duration grows.
    Source: G. Benettin et al., "Lyapunov characteristic exponents", Meccanica 15, 1980.

    Args:
        traj: Motion that the compiled engine computed.
        every: Time between two orthonormalisations [s]; None: ten steps.
        progress: Progress display, or whether to show one.
    Returns:
        The exponents, and their convergence over time.
    Raises:
        InputError: The forces are not smooth in time, the motion was not computed by the compiled
            engine, or the leaf is a single point.
    """
    flow = linearised_flow(traj)
    duration, d = traj.scene.end, flow.Y.shape[1]
    if not d:
        raise InputError(
            f"traj: the reduced state of '{traj.system.name}' cannot be perturbed on its leaf, so "
            "it has no Lyapunov exponents"
        )
    step = _STEPS_PER_BASIS * flow.longest if every is None else positive(every, "every")
    count = max(2, int(np.ceil(duration / step)))
    step, sums, history = duration / count, np.zeros(d), np.zeros((count, d))
    with shown(progress, "Lyapunov", what="computes Lyapunov exponents", reports=True) as report:
        for k in range(count):
            flow.advance(step)
            flow.reset_gauge()
            Q, R = np.linalg.qr(flow.Y)
            sums += np.log(np.abs(np.diag(R)))
            flow.Y[:] = Q
            history[k] = sums / ((k + 1) * step)
            if report is not None:
                report((k + 1) / count)
    history = history[:, np.argsort(-history[-1])]
    half, times = history[count // 2 :], step * np.arange(1.0, count + 1.0)
    spread = np.asarray(half.max(axis=0) - half.min(axis=0), dtype=float)
    return LyapunovSpectrum(history[-1].copy(), np.asarray(times), history, spread)


@checks_arguments
@Wait("computes Floquet multipliers")
def floquet(traj: Trajectory, *, period: float | None = None) -> FloquetMultipliers:
    """Compute the Floquet multipliers of a motion whose reduced state is periodic.

    The base need not return to its initial pose: its displacement over a period is the phase of the
        motion. With joint stops, the derivatives contain the jumps at impacts. The start must be a
        time at which no joint is at its stop. Joints with stops are not cyclic: their positions and
        momenta belong to the leaf.

    Args:
        traj: Motion that the compiled engine computed.
        period: Period T [s] of the reduced state, the forces and the prescribed joints; None: the
            duration of the motion.
    Returns:
        The multipliers, and the closure of the period.
    Raises:
        InputError: The motion is shorter than T, or its reduced state at T differs from the initial
            one.
    """
    T = traj.scene.end if period is None else positive(period, "period")
    if traj.scene.end * (1.0 + 1e-12) < T:
        raise InputError(
            f"period: expected at most the duration {traj.scene.end:g} s of the motion, got "
            f"{T:g} s. Simulate at least one period."
        )
    if traj.scene.bounds:
        initial, flow = tangents_through_stops(traj, T)
        initial_y, initial_basis = initial.y, initial.Y
    else:
        flow = linearised_flow(traj)
        initial_y, initial_basis = flow.y.copy(), flow.Y.copy()
        flow.longest = 0.5 * flow.converged_step(T)
        flow.advance(T)
    flow.align(initial_y)
    flow.reset_gauge()
    closure = _closure(traj, flow, initial_y, T)
    if not closure <= _MAX_CLOSURE:
        raise InputError(
            f"period: the motion of '{traj.system.name}' is not periodic after {T:g} s; its "
            f"reduced state differs from the initial one by {closure:.2g}. "
            "Pass the period of the motion."
        )
    monodromy = initial_basis.T @ flow.Y
    values = (
        np.linalg.eigvals(monodromy).astype(complex) if monodromy.size else np.zeros(0, complex)
    )
    values = values[np.argsort(-np.abs(values), kind="stable")]
    return FloquetMultipliers(values, np.log(values) / T, monodromy, T, closure)


def _closure(traj: Trajectory, flow: LinearisedFlow, initial_y: Array, T: float) -> float:
    """Return the relative difference of the reduced state from its initial value.

    Full turns of angles are ignored where no force depends on them. Torques and prescribed joints
    at 0 and T are compared, too.

    Args:
        traj: The motion.
        flow: Linearised flow of the motion, advanced to time T.
        initial_y: Initial reduced state, (size,).
        T: Period [s].
    Returns:
        The largest difference, relative to the size of the reduced state.
    """
    indices, layout, system = flow.leaf.indices, flow.flow.kernel.layout, traj.system
    difference = (flow.y - initial_y)[indices]
    driven_joints = traj.scene.force_model.touched if traj.scene.force_model is not None else ()
    for i, k in enumerate(layout.active):
        if system.units[k] == "rad" and k not in driven_joints:
            difference[i] -= 2.0 * np.pi * np.round(difference[i] / (2.0 * np.pi))
    model = traj.scene.force_model
    if model is not None and model.needs_time:
        torque_0, torque_T = (
            model.acting(
                ForceInputs(
                    t, system.space.neutral, np.zeros(system.m), np.zeros(system.r),
                    np.zeros(system.r), model.numbers_from(t, traj.scene.end),
                )
            ).torque
            for t in (0.0, T)
        )  # fmt: skip
        prescribed = [model.prescribed(t, model.numbers_from(t, traj.scene.end)) for t in (0.0, T)]
        prescribed_change = np.concatenate(
            [prescribed[1].x - prescribed[0].x, prescribed[1].xdot - prescribed[0].xdot]
        )
        difference = np.concatenate([difference, torque_T - torque_0, prescribed_change])
    size = 1.0 + float(np.abs(initial_y[indices]).max(initial=0.0))
    return float(np.abs(difference).max(initial=0.0)) / size


_TOLERANCE = 1e-11  # Largest rtol and atol of the motion whose derivatives are computed.


def tangents_through_stops(
    traj: Trajectory, period: float
) -> tuple[LinearisedFlow, LinearisedFlow]:
    """Return a motion and its tangent directions at the start and at the end of a period.

    Constant momenta of cyclic joints with stops follow the reduced state in `y` and in `Y`.

    Args:
        traj: A motion with stops.
        period: Period [s].
    Returns:
        The start and the end.
    Raises:
        InputError: A joint is at its stop at the start or at the end, or the motion has no
            derivative.
    """
    scene = without_base(traj.scene)
    rtol, atol = min(scene.rtol, _TOLERANCE), min(scene.atol, _TOLERANCE)
    scene = replace(scene, duration=period, times=np.array([period]), rtol=rtol, atol=atol)
    plan = plan_of(replace(scene, stops=None))
    propagator = StoppedPropagator(scene, ("x0", "xdot0"), zero_momentum=has_no_momentum(plan))
    run = propagator.run(Inputs(scene, propagator.kernel, plan.gravity, ()).own)
    last = propagator.parts_of(run)[-1]
    motion = run.trajectory.motion
    assert isinstance(motion, StoppedMotion)
    if resting := motion.phases[-1].mode.rest:
        names = [bound.joint for bound in resting]
        raise InputError(
            f"period: {listed(names, 8)} of '{scene.system.name}' rests at its stop after "
            f"{period:g} s. Simulate from a state in which no joint is at its stop"
        )
    flow, layout = run.flow, propagator.kernel.layout
    leaf = leaf_of(flow.kernel, flow.y0, flow.sample(0.0, flow.y0).x)
    joints, n, d = {bound.v for bound in scene.bounds}, len(flow.y0), leaf.basis.shape[1]
    stopped = np.array([k for k, v in enumerate(layout.cyclic) if v in joints], dtype=np.intp)
    added = np.concatenate([2 * layout.pairs + stopped, n + np.arange(len(stopped))])
    momenta = layout.base.spin + stopped
    Y = np.zeros((n + len(stopped), d + len(added)))
    Y[leaf.indices, :d] = np.linalg.qr(leaf.embed(np.eye(d)))[0]
    Y[added, d + np.arange(len(added))] = 1.0
    head = np.zeros((layout.gravity_at, Y.shape[1]))
    head[momenta] = Y[n:]
    count = layout.parameters - layout.gravity_at + len(run.stops)
    heads = head, np.zeros((count, Y.shape[1]))
    path = np.zeros((len(flow.path), Y.shape[1]))
    y_end, head_end, _ = propagator.tangents(run, (), Y[:n], *heads, path)
    leaf = replace(leaf, indices=np.concatenate([leaf.indices, added]))

    def at(y: Array, parameters: Array, tangents: Array) -> LinearisedFlow:
        rows = np.zeros_like(tangents)
        rows[leaf.indices] = tangents[leaf.indices]
        return LinearisedFlow(flow, leaf, np.append(y, parameters[momenta]), rows, np.inf)

    end = np.vstack([y_end, head_end[momenta]])
    return at(flow.y0, flow.parameters, Y), at(last.solution.states[-1], last.solution.params, end)
