"""Costs of a path with exact derivatives: length, torque, power, acceleration and time.

During the optimisation the square root of the action ∫x′ᵀMx′ ds replaces the length.  It is never
smaller, and equal at constant speed, so that the optimal parametrisation is unique.  For a path
x(s), s = t/T, joint torques against inertia are f/T² with the covariant force f of the path.
Against drag they are M x′/T.
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
# Exponent of each cost in the size of small loops; objectives grow with the square of the size.
DEGREES = {"length": 1, "torque": 2, "power": 4, "acceleration": 2, "time": 1}


@dataclass(frozen=True)
class Cost:
    """A cost and its derivatives.

    Attributes:
        value: The cost.
        slope: Derivative by the coefficients, (K, m).
        by_log_period: Derivative by log T.
    """

    value: float
    slope: Array
    by_log_period: float


def check_cost(connection: Connection, kind: str) -> None:
    """Raise InputError unless a connection defines this cost."""
    if kind not in COSTS:
        raise InputError(f"unknown cost {kind!r}; the costs are {', '.join(COSTS)}")
    if kind != "time" and not connection.has_metric:
        raise InputError(
            f"{connection.form.what} give no metric on shape space, so that no cost but time "
            f"is defined; got {kind!r}"
        )


def torques(connection: Connection, x: Array, slope: Array, bend: Array) -> Array:
    """Compute the joint torques for T = 1; for another T they scale with T^(−order).

    Args:
        connection: The connection.
        x: Shapes, (N, m).
        slope: First derivatives by s, (N, m).
        bend: Second derivatives by s, (N, m).
    Returns:
        (N, m): the torques.
    """
    if not connection.form.momentum:
        return np.asarray(0.5 * _squares(connection, x, slope)[:, connection.m :])
    return connection.code.covariant_forces(x, slope, bend, np.zeros_like(x))[0]


def torque_slopes(
    connection: Connection, x: Array, slope: Array, bend: Array, along: Array
) -> Array:
    """Compute the derivatives of λᵀτ for T = 1.

    Args:
        connection: The connection.
        x: Shapes, (N, m).
        slope: First derivatives by s, (N, m).
        bend: Second derivatives by s, (N, m).
        along: Covectors λ, (N, m).
    Returns:
        (N, 3m): the derivatives by (x, x′, x″).
    """
    m = connection.m
    if connection.form.momentum:
        return connection.code.covariant_forces(x, slope, bend, along)[1]
    # λᵀ∂M x′ follows from squares of sum and difference.
    plus = _squares(connection, x, along + slope)[:, :m]
    minus = _squares(connection, x, along - slope)[:, :m]
    by_slope = 0.5 * _squares(connection, x, along)[:, m:]
    return np.hstack([0.25 * (plus - minus), by_slope, np.zeros_like(by_slope)])


def torque_order(connection: Connection) -> int:
    """Return the power of 1/T in joint torques: 2 against inertia, 1 against drag."""
    return 1 if not connection.form.momentum else 2


def cost_of(
    kind: CostKind,
    connection: Connection,
    basis: PathBasis,
    coefficients: Array,
    lift: PathLift,
    period: float,
) -> Cost:
    """Compute the cost of a path and its derivatives.

    Args:
        kind: The cost.
        connection: The connection.
        basis: Basis functions at the Gauss nodes.
        coefficients: Coefficients of the path, (K, m).
        lift: Lift of this path.
        period: Period T [s].
    Returns:
        The cost.
    Raises:
        InputError: The connection has no metric.
    """
    if kind == "time":
        return Cost(period, np.zeros_like(coefficients), period)
    x, slope, w, m = lift.x, lift.slope, basis.weights, connection.m
    if kind == "length":
        length = float(np.sqrt(w @ lift.square))
        derivatives = (0.5 * w / max(length, 1e-300))[:, None] * lift.square_slopes
        return Cost(length, _sum_over_nodes(basis, m, derivatives), 0.0)
    bend, order = basis.bends @ coefficients, torque_order(connection)
    if kind == "acceleration":
        order = 2
        force = connection.code.covariant_forces(x, slope, bend, np.zeros_like(x))[0]
        M = connection.locals_at(x)[1]
        if M is None:
            raise InputError(f"{connection.form.what} give no metric on shape space")
        u: Array = np.linalg.solve(M, force[..., None])[..., 0].astype(float)
        derivatives = 2.0 * connection.code.covariant_forces(x, slope, bend, u)[1]
        derivatives[:, :m] -= _squares(connection, x, u)[:, :m]
        value, power = float(w @ np.sum(force * u, axis=1)), 1 - 2 * order
    else:
        tau = torques(connection, x, slope, bend)
        rates = np.ones_like(tau) if kind == "torque" else slope
        derivatives = 2.0 * torque_slopes(connection, x, slope, bend, tau * rates**2)
        if kind == "power":
            derivatives[:, m : 2 * m] += 2.0 * tau**2 * slope
        value = float(w @ np.sum((tau * rates) ** 2, axis=1))
        power = 1 - 2 * (order + (kind == "power"))
    scale = period**power
    return Cost(
        scale * value,
        scale * _sum_over_nodes(basis, m, w[:, None] * derivatives),
        power * scale * value,
    )


def _squares(connection: Connection, x: Array, u: Array) -> Array:
    """Return the derivatives of uᵀMu by (x, u), (N, 2m)."""
    return np.asarray(connection.horizontal_slopes(x, u)[:, connection.r])


def _sum_over_nodes(basis: PathBasis, m: int, derivatives: Array) -> Array:
    blocks = [derivatives[:, None, k : k + m] for k in range(0, derivatives.shape[1], m)]
    return np.asarray(by_coefficients(basis, *blocks)[0])
