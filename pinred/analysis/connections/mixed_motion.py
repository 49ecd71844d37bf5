"""Motions of the mixed connection: the joints are driven by torques, or follow a gait."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, positive, vector, vector_or_zero
from ...common.errors import IntegrationError, SingularInertiaError
from ...kernels.evaluate import evaluate
from ..gaits.gait import Gait
from .connection_values import refuse_singular
from .mixed import MixedConnection, shape_of
from .rotation_chart import RotationChart

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
