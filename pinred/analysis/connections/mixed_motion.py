"""Motions on wheels with momentum: of joints driven by torques, or along a given path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, freeze, positive, vector
from ...common.errors import IntegrationError, SingularInertiaError
from ...kernels.evaluate import evaluate
from ..gaits.gait import Gait
from .mixed import MixedConnection

_RTOL, _ATOL = 5e-14, 1e-15
_HEALTHY = 1e-3  # least health of P_b, where ±1 is best
_LOOKED_AT = 4096  # shapes of a gait


@dataclass(frozen=True)
class MixedMotion:
    """A motion on wheels, time first.

    t: (T,) [s].  pose: (T, size).  x, xdot: (T, m).  p: (T, r − k) generalised momenta.
    energy: (T,) kinetic [J].
    """

    t: Array
    pose: Array
    x: Array
    xdot: Array
    p: Array
    energy: Array

    def __post_init__(self) -> None:
        freeze(self)


def simulate_mixed(
    mixed: MixedConnection,
    x0: ArrayLike,
    xdot0: ArrayLike,
    p0: ArrayLike,
    *,
    times: ArrayLike,
    torques: Callable[[float], ArrayLike] | None = None,
) -> MixedMotion:
    """Return the motion from a state with momentum p0, under joint torques τ(t), (m,) [N m | N].

    times: (T,) increasing, the first that of the start [s].  Without gravity.
    Raises SingularInertiaError where it passes a singular shape, IntegrationError where it ends at
    one.
    """
    system, names = mixed.system, mixed.system.shape_names
    m, r, k = system.m, system.r, mixed.size
    start = [vector(x0, m, "x0", names), vector(xdot0, m, "xdot0", names), vector(p0, k, "p0")]
    t = _times(times)
    code, none = mixed.equations.address, np.zeros(m)

    def torque(at: float) -> Array:
        return none if torques is None else vector(torques(at), m, "torques", names)

    side = _side(mixed, start[0])

    def rate(at: float, y: Array) -> Array:
        out = evaluate(code, torque(at), y[None, : 2 * m + k], r + k + m + 2)[0]
        out = _held(mixed, at, out, side)
        g = system.group.normalize(y[2 * m + k :])
        turned = system.group.rate(g, out[:r])
        return np.concatenate([y[m : 2 * m], out[r + k : r + k + m], out[r : r + k], turned])

    y, dense = _solved(rate, np.concatenate([*start, system.group.identity()]), t)
    fine = np.linspace(t[0], t[-1], _LOOKED_AT)
    _refuse_near(mixed, np.asarray(dense(fine)).T[:, :m])  # steps may have jumped over it
    return _motion(mixed, t, y[:, :m], y[:, m : 2 * m], y[:, 2 * m : 2 * m + k], y[:, 2 * m + k :])


def follow_mixed(
    mixed: MixedConnection, gait: Gait, p0: ArrayLike = 0, *, times: ArrayLike
) -> MixedMotion:
    """Return the motion of the body while the joints follow a gait, from momentum p0.

    times: as of `simulate_mixed`.  Errors as there.
    """
    system, k = mixed.system, mixed.size
    p = np.zeros(k) if np.ndim(p0) == 0 and p0 == 0 else vector(p0, k, "p0")
    t = _times(times)
    side = _side(mixed, gait.at(t[0])[0])
    _refuse_near(mixed, gait.samples(_LOOKED_AT)[0])
    code, none = mixed.driven.address, np.zeros(1)

    def rate(at: float, y: Array) -> Array:
        x, xdot = gait.at(at)
        out = evaluate(code, none, np.concatenate([x, xdot, y[:k]])[None], system.r + k + 1)[0]
        out = _held(mixed, at, out, side)
        g = system.group.normalize(y[k:])
        return np.concatenate([out[system.r :], system.group.rate(g, out[: system.r])])

    y, _ = _solved(rate, np.concatenate([p, system.group.identity()]), t)
    x, xdot = gait.at(t)
    return _motion(mixed, t, x, xdot, y[:, :k], y[:, k:])


def _side(mixed: MixedConnection, x: Array) -> float:
    """Return the sign of P_b at the start.  Raises SingularInertiaError where it is singular."""
    found = mixed.connection.code.locals(x[None])
    mixed.connection.refuse_singular(x[None], found.health)
    return float(np.sign(found.health[0]))


def _refuse_near(mixed: MixedConnection, x: Array) -> None:
    """Raise SingularInertiaError if a path (N, m) comes near a singular shape."""
    found = np.abs(mixed.connection.code.locals(x).health)
    if not found.min() > _HEALTHY:
        raise SingularInertiaError(
            f"the joints pass the shape {x[int(np.argmin(found))]}, where "
            f"{mixed.connection.form.what} leave a motion of the body open; keep away from it"
        )


def _held(mixed: MixedConnection, at: float, out: Array, side: float) -> Array:
    """Return what follows the health of P_b.  Raises IntegrationError where that is nearly lost."""
    if not out[0] * side > _HEALTHY:
        raise IntegrationError(
            f"at {at:g} s {mixed.connection.form.what} come to a shape at which they leave a "
            "motion of the body open; the motion is not defined beyond it"
        )
    return out[1:]


def _times(times: ArrayLike) -> Array:
    t = np.asarray(times, dtype=float)
    t = vector(t, t.size, "times")
    positive(float(np.diff(t).min(initial=np.inf)) if len(t) > 1 else 0.0, "the step of times")
    return t


def _solved(
    rate: Callable[[float, Array], Array], start: Array, t: Array
) -> tuple[Array, Callable[[Array], Array]]:
    from scipy.integrate import solve_ivp

    out = solve_ivp(
        rate,
        (t[0], t[-1]),
        start,
        method="DOP853",
        rtol=_RTOL,
        atol=_ATOL,
        t_eval=t,
        dense_output=True,
    )
    if out.status != 0 or not np.isfinite(out.y).all():
        raise IntegrationError(f"the motion cannot be followed to {t[-1]:g} s: {out.message}")
    return np.asarray(out.y.T), out.sol


def _motion(
    mixed: MixedConnection, t: Array, x: Array, xdot: Array, p: Array, pose: Array
) -> MixedMotion:
    m, r, k = mixed.system.m, mixed.system.r, mixed.size
    rows = np.hstack([x, xdot, p])
    energy = evaluate(mixed.equations.address, np.zeros(m), rows, r + k + m + 2)[:, -1]
    pose = mixed.system.group.normalize(pose)
    return MixedMotion(t, pose, x.copy(), xdot.copy(), p.copy(), energy.copy())
