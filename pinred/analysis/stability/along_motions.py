"""linearise(), lyapunov(), floquet(): the linearised reduced flow along a motion.

The flow is integrated with its derivative, ẏ = f(y), Ẏ = ∂f/∂y Y, by a Runge–Kutta method of equal
steps. The method is DOP853's, of order 8. Its steps are at most halves of those that the motion
took, which may be long where it rests, and short against the rates of the linearised flow; they are
halved until that changes nothing. Angles of cyclic joints, on which nothing depends, are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array, freeze, positive
from ...common.errors import InputError, IntegrationError
from ...common.progress import Progress, shown
from ...forces.acting import ForceInputs
from ...integrators.methods import DOP853
from ...integrators.stepping.compiling import compiled
from ...integrators.stepping.kernel_call import SEEDS, call, call_tangent
from ...kernels.tangent import jacobian_of, tangent_of
from ...scene.scene import Scene
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.plan import plan_of
from ...simulation.trajectory import Trajectory
from ...system.state_fields import State
from .linearised import Linearisation, linearised
from .reduced_state import Leaf, leaf_of

_BETWEEN = 10  # steps, from one orthonormal basis to the next
_CLOSED = 1e-6  # relative; by how much a period may miss its start

_FINER = 0.5  # of the motion's own steps
_SHORT = 0.2  # of the time in which the linearised flow does something
_LOOKS = 9  # times at which its rates are looked at
_SAME = 1e-11  # relative; what halving the steps may change
_HALVINGS = 8


@dataclass
class Variational:
    """A motion with directions that are carried along; it changes as it advances.

    flow: of the scene without the base.  leaf: at the start.  y: (size,) state, Y: (size, d)
    directions.  longest: of its steps [s].
    """

    flow: CompiledFlow
    leaf: Leaf
    y: Array
    Y: Array
    longest: float

    def sure_step(self, duration: float) -> float:
        """Return a step that may be halved without any change over a time, relative to Y."""
        longest, found = self.longest, self._after(duration, self.longest)
        for _ in range(_HALVINGS):
            finer = self._after(duration, 0.5 * longest)
            size = float(np.abs(finer).max(initial=1e-300))
            if float(np.abs(finer - found).max(initial=0.0)) <= _SAME * size:
                break
            longest, found = 0.5 * longest, finer
        return longest

    def advance_surely(self, duration: float) -> None:
        """Go on by a time, in steps that may be halved without any change."""
        self.longest = 0.5 * self.sure_step(duration)
        self.advance(duration)

    def _after(self, duration: float, longest: float) -> Array:
        there = replace(self, y=self.y.copy(), Y=self.Y.copy(), longest=longest)
        there.advance(duration)
        return there.Y

    def advance(self, duration: float) -> None:
        """Go on by a time.  Raises IntegrationError if numbers are not finite."""
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
        dropped = np.setdiff1d(np.arange(n), self.leaf.kept)
        self.Y[dropped] = 0.0
        if not (np.isfinite(self.y).all() and np.isfinite(self.Y).all()):
            raise IntegrationError(f"the linearised flow of '{kernel.system.name}' is not finite")


def variational(traj: Trajectory) -> Variational:
    """Return the flow of a motion from its start, with a basis of all its directions.

    Raises InputError for motions by the readable route, and for scenes that stop on their way.
    """
    if traj.run.engine != "compiled":
        raise InputError("the linearised flow takes a motion of engine='compiled'")
    if len(traj.plan.stops) > 1:
        raise InputError(
            "the linearised flow takes forces that are smooth in time, without controllers"
        )
    flow = CompiledFlow.of_plan(plan_of(without_base(traj.scene)))
    leaf = leaf_of(flow.kernel, flow.y0)
    Y = np.zeros((len(flow.y0), leaf.basis.shape[1]))
    Y[leaf.kept] = np.linalg.qr(leaf.outward(np.eye(leaf.basis.shape[1])))[0]
    knots = traj.motion.knots
    steps = np.diff(knots)
    longest = _FINER * float(np.median(steps)) if steps.size else 0.01 * traj.scene.end
    fastest = 0.0
    y = traj.motion.changes(np.linspace(0.0, traj.scene.end, _LOOKS)).y[:, : 2 * leaf.places.stop]
    for row in y:
        state = flow.y0.copy()
        state[: len(row)] = row
        J = jacobian_of(flow.kernel, state, flow.parameters)
        fastest = max(fastest, float(np.abs(np.linalg.eigvals(J)).max(initial=0.0)))
    if fastest > 0.0:
        longest = min(longest, _SHORT / fastest)
    made = Variational(flow, leaf, flow.y0.copy(), Y, longest)
    return replace(made, longest=made.sure_step(min(20.0 * longest, traj.scene.end)))


def without_base(scene: Scene) -> Scene:
    """Return a scene that leaves out the base."""
    return scene if scene.outputs == "shape" else replace(scene, outputs="shape")


def scene_at(traj: Trajectory, t: float) -> Scene:
    """Return the scene that begins where a motion is at time t, without its base.

    Raises InputError if the motion leaves out the base itself.
    """
    state = traj.at(t)
    if not isinstance(state, State):
        raise InputError("linearise takes a motion with its base: outputs='all'")
    return replace(
        traj.scene, x0=state.x, xdot0=state.xdot, xi0=state.xi, pose0=state.pose, momentum=None,
        seed=None, keyframe=None, q0=None, v0=None, outputs="shape",
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
    slopes: Array,
    stage: Array,
    moved: Array,
) -> None:
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
                        total += A[k, m] * slopes[m, g, i]
                    moved[i] = Y[g, i] + h * total
                call_tangent(tangent, stage, params, moved, slopes[k, g])
        for i in range(n):
            for m in range(s):
                y[i] += h * A[s, m] * rates[m, i]
        for g in range(groups):
            for i in range(size):
                for m in range(s):
                    Y[g, i] += h * A[s, m] * slopes[m, g, i]


@dataclass(frozen=True)
class LyapunovSpectrum:
    """Lyapunov exponents of a motion on its leaf; arrays are read-only.

    exponents: (d,) [1/s], largest first.  times: (K,) [s], history: (K, d) the exponents up to
    then.  spread: (d,) by how much each still changed over the last half.
    """

    exponents: Array
    times: Array
    history: Array
    spread: Array

    def __post_init__(self) -> None:
        freeze(self)

    def __str__(self) -> str:
        rows = [
            f"{value:+.6f} ± {spread:.1g} 1/s"
            for value, spread in zip(self.exponents, self.spread, strict=True)
        ]
        return "\n".join(rows)


@dataclass(frozen=True)
class FloquetMultipliers:
    """Floquet multipliers of a periodic motion on its leaf; arrays are read-only.

    multipliers: (d,), largest first.  exponents: (d,) log μ/T [1/s].  monodromy: (d, d).
    period: T [s].  closure: by how much the reduced state missed its start, relative.
    """

    multipliers: NDArray[np.complex128]
    exponents: NDArray[np.complex128]
    monodromy: Array
    period: float
    closure: float

    def __post_init__(self) -> None:
        freeze(self)

    def __str__(self) -> str:
        rows = [f"|{abs(mu):.9g}|  {mu.real:+.9g} {mu.imag:+.9g}i" for mu in self.multipliers]
        return "\n".join([f"period {self.period:g} s, closes to {self.closure:.1g}", *rows])


def linearise(traj: Trajectory, t: float = 0.0) -> Linearisation:
    """Return the linearised reduced flow at time t of a motion, by the exact Jacobian.

    Its state is (x, π, μ) without cyclic angles; its eigenvalues and modes are those on the leaf
    where the Casimirs are constant.  Raises InputError for a time outside the motion, or a motion
    without its base.
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


def lyapunov(
    traj: Trajectory, *, every: float | None = None, progress: Progress | bool | None = None
) -> LyapunovSpectrum:
    """Return the Lyapunov spectrum along a motion, from its start to its end.

    every: time from one orthonormal basis to the next (ten steps) [s].  The exponents add up to
    zero and come in pairs ±λ on the leaf, the latter as the time grows.
    Raises InputError for forces that are not smooth in time, or motions by the readable route.
    Source: G. Benettin et al., "Lyapunov characteristic exponents", Meccanica 15, 1980.
    """
    whole = variational(traj)
    end, d = traj.scene.end, whole.Y.shape[1]
    if not d:
        raise InputError(f"nothing of '{traj.system.name}' can be disturbed on its leaf")
    step = _BETWEEN * whole.longest if every is None else positive(every, "every")
    count = max(2, int(np.ceil(end / step)))
    step, sums, history = end / count, np.zeros(d), np.zeros((count, d))
    with shown(progress, "Lyapunov") as done:
        for k in range(count):
            whole.advance(step)
            Q, R = np.linalg.qr(whole.Y)
            sums += np.log(np.abs(np.diag(R)))
            whole.Y[:] = Q
            history[k] = sums / ((k + 1) * step)
            if done is not None:
                done((k + 1) / count)
    history = history[:, np.argsort(-history[-1])]
    half, times = history[count // 2 :], step * np.arange(1.0, count + 1.0)
    spread = np.asarray(half.max(axis=0) - half.min(axis=0), dtype=float)
    return LyapunovSpectrum(history[-1].copy(), np.asarray(times), history, spread)


def floquet(traj: Trajectory, *, period: float | None = None) -> FloquetMultipliers:
    """Return the Floquet multipliers of a motion that is periodic in its reduced state.

    period: T, the motion's duration if None [s].  Forces and prescribed joints must have it, too.
    The base need not return: its shift over a period is the motion's phase.
    Raises InputError if the reduced state is not back after T.
    """
    T = traj.scene.end if period is None else positive(period, "period")
    if traj.scene.end * (1.0 + 1e-12) < T:
        raise InputError(f"the motion ends at {traj.scene.end:g} s, before its period {T:g} s")
    whole = variational(traj)
    start, first = whole.y.copy(), whole.Y.copy()
    whole.advance_surely(T)
    closure = _closure(traj, whole, start, T)
    if not closure <= _CLOSED:
        raise InputError(
            f"the motion of '{traj.system.name}' is not back after {T:g} s: its reduced state "
            f"misses its start by {closure:.2g}; give its period"
        )
    monodromy = first.T @ whole.Y
    values = (
        np.linalg.eigvals(monodromy).astype(complex) if monodromy.size else np.zeros(0, complex)
    )
    values = values[np.argsort(-np.abs(values), kind="stable")]
    return FloquetMultipliers(values, np.log(values) / T, monodromy, T, closure)


def _closure(traj: Trajectory, whole: Variational, start: Array, T: float) -> float:
    """Return how far the reduced state is from its start, whole turns of angles left out."""
    kept, layout, system = whole.leaf.kept, whole.flow.kernel.layout, traj.system
    apart = (whole.y - start)[kept]
    touched = traj.scene.force_model.touched if traj.scene.force_model is not None else ()
    for i, k in enumerate(layout.active):
        if system.units[k] == "rad" and k not in touched:
            apart[i] -= 2.0 * np.pi * np.round(apart[i] / (2.0 * np.pi))
    model = traj.scene.force_model
    if model is not None and model.needs_time:
        first, last = (
            model.acting(
                ForceInputs(
                    t, np.zeros(system.m), np.zeros(system.m), np.zeros(system.r),
                    np.zeros(system.r), model.numbers_from(t, traj.scene.end),
                )
            ).torque
            for t in (0.0, T)
        )  # fmt: skip
        plans = [model.prescribed(t, model.numbers_from(t, traj.scene.end)) for t in (0.0, T)]
        moved = np.concatenate([plans[1].x - plans[0].x, plans[1].xdot - plans[0].xdot])
        apart = np.concatenate([apart, last - first, moved])
    size = 1.0 + float(np.abs(start[kept]).max(initial=0.0))
    return float(np.abs(apart).max(initial=0.0)) / size
