"""Costs of a path: length, torque, power, covariant acceleration, time; values and exact slopes.

Of a path's length the root of its action ∫x′ᵀMx′ ds stands in while one is looked for.  It is
never less, and the same at constant speed; so that of all ways to pass through a loop one is best.
Along x(s), s = t/T, the torques of the joints are f/T² where inertia resists, with f the covariant
force of the path in s, and M x′/T where drag does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.phases.path_basis import PathBasis, PathLift, by_coefficients
from ...common.arrays import Array
from ...common.errors import InputError

CostKind: TypeAlias = Literal["length", "torque", "power", "acceleration", "time"]
COSTS: tuple[CostKind, ...] = get_args(CostKind)
ABOUT = {
    "length": "∫√(ẋᵀMẋ) dt, path length in the reduced metric",
    "torque": "∫ Σ τᵢ² dt",
    "power": "∫ Σ (τᵢ ẋᵢ)² dt",
    "acceleration": "∫ |∇ẋ|²_M dt, the covariant acceleration in the reduced metric",
    "time": "T, the period",
}
# A loop made smaller by a factor costs less by that to this power; what it does, by its square.
DEGREES = {"length": 1, "torque": 2, "power": 4, "acceleration": 2, "time": 1}


@dataclass(frozen=True)
class Cost:
    """A cost and its slopes: by coefficients (K, m), and by log T."""

    value: float
    slope: Array
    by_log_period: float


def check_cost(connection: Connection, kind: str) -> None:
    """Raise InputError if there is no such cost of a connection."""
    if kind not in COSTS:
        raise InputError(f"unknown cost {kind!r}; the costs are {', '.join(COSTS)}")
    if kind != "time" and not connection.has_metric:
        raise InputError(
            f"{connection.form.what} give no metric on shape space, so that no cost but time "
            f"is defined; got {kind!r}"
        )


def torques(connection: Connection, x: Array, slope: Array, bend: Array) -> Array:
    """Return the torques of the joints for T = 1, (N, m); T^(−order) times that for any T."""
    if not connection.form.momentum:
        return np.asarray(0.5 * _squares(connection, x, slope)[:, connection.m :])
    none = np.zeros_like(x)
    return connection.code.covariant_forces(x, slope, bend, none)[0]


def torque_slopes(
    connection: Connection, x: Array, slope: Array, bend: Array, along: Array
) -> Array:
    """Return the derivative of λᵀτ, T = 1, by (x, x′, x″), (N, 3m).  along: λ (N, m)."""
    m = connection.m
    if connection.form.momentum:
        return connection.code.covariant_forces(x, slope, bend, along)[1]
    # λᵀ∂M x′ by polarisation of the square.
    plus = _squares(connection, x, along + slope)[:, :m]
    minus = _squares(connection, x, along - slope)[:, :m]
    by_slope = 0.5 * _squares(connection, x, along)[:, m:]
    return np.hstack([0.25 * (plus - minus), by_slope, np.zeros_like(by_slope)])


def torque_order(connection: Connection) -> int:
    """By which power of 1/T torques grow: 2 against inertia, 1 against drag."""
    return 1 if not connection.form.momentum else 2


def cost_of(
    kind: CostKind,
    connection: Connection,
    basis: PathBasis,
    coefficients: Array,
    lift: PathLift,
    period: float,
) -> Cost:
    """Return the cost of the path with coefficients (K, m), passed through in a period [s].

    lift: of that path.
    """
    if kind == "time":
        return Cost(period, np.zeros_like(coefficients), period)
    x, slope, w, m = lift.x, lift.slope, basis.weights, connection.m
    if kind == "length":
        size = float(np.sqrt(w @ lift.square))
        rows = (0.5 * w / max(size, 1e-300))[:, None] * lift.square_slopes
        return Cost(size, _summed(basis, m, rows), 0.0)
    bend, order = basis.bends @ coefficients, torque_order(connection)
    if kind == "acceleration":
        none, order = np.zeros_like(x), 2
        force = connection.code.covariant_forces(x, slope, bend, none)[0]
        M = connection.locals_at(x)[1]
        if M is None:
            raise InputError(f"{connection.form.what} give no metric on shape space")
        u: Array = np.linalg.solve(M, force[..., None])[..., 0].astype(float)
        rows = 2.0 * connection.code.covariant_forces(x, slope, bend, u)[1]
        rows[:, :m] -= _squares(connection, x, u)[:, :m]
        value, power = float(w @ np.sum(force * u, axis=1)), 1 - 2 * order
    else:
        tau = torques(connection, x, slope, bend)
        rates = np.ones_like(tau) if kind == "torque" else slope
        rows = 2.0 * torque_slopes(connection, x, slope, bend, tau * rates**2)
        if kind == "power":
            rows[:, m : 2 * m] += 2.0 * tau**2 * slope
        value = float(w @ np.sum((tau * rates) ** 2, axis=1))
        power = 1 - 2 * (order + (kind == "power"))
    scale = period**power
    return Cost(scale * value, scale * _summed(basis, m, w[:, None] * rows), power * scale * value)


def _squares(connection: Connection, x: Array, u: Array) -> Array:
    """Return the slopes of uᵀMu by (x, u), (N, 2m)."""
    return np.asarray(connection.horizontal_slopes(x, u)[:, connection.r])


def _summed(basis: PathBasis, m: int, rows: Array) -> Array:
    parts = [rows[:, None, k : k + m] for k in range(0, rows.shape[1], m)]
    return np.asarray(by_coefficients(basis, *parts)[0])
