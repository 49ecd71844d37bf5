"""linearise(), lyapunov(), floquet(): the linearised reduced flow along a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array, freeze, positive
from ...common.errors import InputError
from ...common.progress import Progress, shown
from ...forces.acting import ForceInputs
from ...simulation.compiled.compiled_flow import CompiledFlow
from ...simulation.plan import plan_of
from ...simulation.trajectory import Trajectory
from .linearised import Linearisation, linearised
from .variational import Variational, scene_at, variational

_BETWEEN = 10  # steps, from one orthonormal basis to the next
_CLOSED = 1e-6  # relative; by how much a period may miss its start


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
