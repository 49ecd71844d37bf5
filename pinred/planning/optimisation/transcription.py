"""Transcription of a gait optimisation to a nonlinear program.

This module defines the unknowns, the objective and the constraints.  The coefficients of a path
are affine in the unknowns y: c = L y + c₀.  The period is an additional
unknown if it is minimised.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.phases.path_basis import (
    Drift,
    PathBasis,
    cycloid_basis,
    fourier_basis,
    fourier_rows,
    path_lift,
)
from ...common.arrays import Array
from ...common.errors import NoConvergence, SingularInertiaError
from .ipopt import Problem
from .limits import Limits
from .loop_peaks import Cells, loop_peaks
from .objective import (
    DEGREES,
    AxisAim,
    CostKind,
    TargetAim,
    cost_of,
    torque_order,
    torque_slopes,
    torques,
)

_INSIDE = 1e-6  # relative margin inside the limits, for round-off and small overshoot
# Relative margin outside the limits at sample times, if the peaks are limited: no such limit is
# active, but between cells without a limit of the peak, a loop cannot leave the limits far.
_OUTSIDE = 1e-3
_ROUND_OFF = 1e-8  # relative margin of the peaks inside the limits: the tolerance of IPOPT


@dataclass(frozen=True, eq=False)
class Passage:
    """The motion along a loop from rest to rest: several cycles with a cycloidal time law.

    Attributes:
        cycles: Number of cycles.
        drift: Motion of the base caused by nonzero momentum.
        more: Number of additional quadrature segments that resolve the drift.
    """

    cycles: int
    drift: Drift
    more: int


@dataclass(frozen=True, eq=False)
class Task:
    """The task of a gait optimisation: objective, cost and limits.

    Attributes:
        connection: The connection.
        aim: The objective.
        cost: The cost, or None.
        most: Bound on the cost, or None.
        limits: Limits of the joints.
        period: Period T [s]; if the period is minimised, its initial value.
        passage: Motion from rest to rest, or None for a periodic loop.
    """

    connection: Connection
    aim: AxisAim | TargetAim
    cost: CostKind | None
    most: float | None
    limits: Limits
    period: float
    passage: Passage | None = None

    @property
    def drift(self) -> Drift | None:
        """Motion of the base caused by nonzero momentum, or None at zero momentum."""
        return None if self.passage is None else self.passage.drift

    @property
    def period_is_free(self) -> bool:
        """Whether the period is an unknown."""
        return self.cost == "time"

    @property
    def per_cost(self) -> bool:
        """Whether the objective per cost is maximised."""
        return isinstance(self.aim, AxisAim) and self.cost is not None and self.most is None

    def merit(self, value: float, cost: float) -> float:
        """Compute the merit, the quantity that the optimisation maximises.

        Args:
            value: Objective of one cycle.
            cost: Cost of one cycle.
        Returns:
            The value without a cost, the value divided by a power of the cost, or the negative cost
            for a target.
        """
        if isinstance(self.aim, TargetAim):
            return -cost
        if self.cost is None or not self.per_cost:
            return value
        return float(value / cost ** (1.0 / DEGREES[self.cost]))


@dataclass(frozen=True, eq=False)
class Path:
    """A family of paths whose coefficients are affine in unknowns y: c = L y + c₀.

    Attributes:
        basis: Basis functions at the Gauss nodes.
        checked: Values, first and second derivatives of the basis functions at the times at which
            limits are imposed, (C, K) each.
        matrix: Matrix L of the affine map, (K m, n).
        shift: Constant term c₀ of the affine map, (K, m).
        cells: Cells in which the peaks of the loop are limited; None if limits are imposed at
            sample times.
        action: Weight of the root of the action in the cost "length".
    """

    basis: PathBasis
    checked: tuple[Array, Array, Array]
    matrix: Array
    shift: Array
    cells: Cells | None = None
    action: float = 1.0

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.matrix.shape[1])

    def coefficients(self, y: Array) -> Array:
        """Return the path coefficients c, (K, m), for unknowns y."""
        return np.asarray(self.shift + (self.matrix @ y).reshape(self.shift.shape))

    def unknowns(self, coefficients: Array) -> Array:
        """Return the unknowns, (n,), of the path nearest to given coefficients, (K, m)."""
        deviation = (coefficients - self.shift).ravel()
        return np.asarray(np.linalg.lstsq(self.matrix, deviation, rcond=None)[0])


def fourier_path(
    harmonics: int,
    m: int,
    *,
    pieces: int,
    checks: Array,
    power: int,
    start: Array | None = None,
    passage: Passage | None = None,
) -> Path:
    """Return the family of Fourier series; its unknowns are scaled means, cosines and sines.

    Args:
        harmonics: Number of harmonics.
        m: Number of joints.
        pieces: Number of quadrature segments per cycle.
        checks: Times s = t/T at which limits are imposed, (C,).
        power: Unknowns of harmonic k are k^power times its coefficients, so that all harmonics
            contribute equally to a cost of derivatives of this order.
        start: Common initial shape of all paths, (m,), or None.  If set, it determines the mean,
            which is then not an unknown.
        passage: Motion from rest to rest, or None for constant speed in s.
    Returns:
        The family of paths.
    """
    K, k = 1 + 2 * harmonics, np.arange(1.0, harmonics + 1.0)
    scale: Array = np.concatenate([[1.0], k ** float(-power), k ** float(-power)])
    matrix: Array = np.kron(np.diag(scale), np.eye(m)).astype(float)
    shift = np.zeros((K, m))
    if start is not None:  # mean = start − Σ cosines
        matrix = matrix[:, m:]
        for j in range(m):
            matrix[j, j : harmonics * m : m] = -scale[1 : 1 + harmonics]
        shift[0] = start
    if passage is None:
        basis = fourier_basis(harmonics, pieces)
    else:
        basis = cycloid_basis(harmonics, passage.cycles * pieces + passage.more, passage.cycles)
    return Path(basis, fourier_rows(harmonics, checks), matrix, shift)


def problem_of(task: Task, path: Path) -> Problem:
    """Create the nonlinear program of a task.

    Args:
        task: The task.
        path: The family of paths over which the task is optimised.
    Returns:
        The problem for IPOPT.
    """
    connection, aim, limits = task.connection, task.aim, task.limits
    m, n, free = connection.m, path.size, int(task.period_is_free)
    size = n + free
    values, slopes, bends = path.checked
    limited = np.flatnonzero(np.isfinite(limits.torque))
    order = torque_order(connection) if len(limited) else 0

    def evaluate(z: Array) -> tuple[Array, Array]:
        c, T = path.coefficients(z[:n]), float(z[n]) if free else task.period
        results: list[Array] = []
        jacobian: list[Array] = []

        def add(value: Array, by_c: Array, by_T: Array | float = 0.0) -> None:
            """Append values, (k,), with their derivatives in c, (k, K, m), and T, (k,)."""
            derivative = np.zeros((len(value), size))
            derivative[:, :n] = by_c.reshape(len(value), len(path.matrix)) @ path.matrix
            if free:
                derivative[:, n] = by_T
            results.append(value)
            jacobian.append(derivative)

        lift = path_lift(connection, path.basis, c, task.drift)
        cost = None
        if task.cost is not None:
            cost = cost_of(task.cost, connection, path.basis, c, lift, T, action=path.action)
        size_of_cost = 1.0 if cost is None else max(cost.value, 1e-300)
        power = 1.0 / DEGREES[task.cost or "time"]
        root = size_of_cost**power
        if isinstance(aim, TargetAim) and cost is not None:
            factor = power * root / size_of_cost
            add(np.array([root]), factor * cost.slope[None], factor * cost.by_log_period / T)
            residual, by_twist = aim.error(lift.pose)
        elif isinstance(aim, AxisAim):
            value, by_twist = aim.value(lift.pose)
            slope = np.tensordot(by_twist, lift.twist, 1)
            if cost is None or not task.per_cost:
                add(np.array([-value]), -slope[None])
            else:
                factor = power * value / (root * size_of_cost)
                by_c = factor * cost.slope - slope / root
                add(np.array([-value / root]), by_c[None], factor * cost.by_log_period / T)
            residual, by_twist = aim.constraint(lift.pose)
        if len(residual):
            add(residual, np.tensordot(by_twist, lift.twist, 1))
        if task.most is not None and cost is not None:
            add(
                np.array([cost.value / task.most]), cost.slope[None] / task.most,
                cost.by_log_period / T / task.most,
            )  # fmt: skip
        if path.cells is not None:
            peaks = loop_peaks(connection, limits, c, T, path.cells)
            add(peaks.values, peaks.by_c, peaks.by_log_period / T)
        elif len(limited):
            x, x1, x2 = values @ c, slopes @ c, bends @ c
            tau = torques(connection, x, x1, x2) / T**order
            for k in limited:
                most = limits.torque[k] * (1.0 - _INSIDE)
                covector = np.zeros_like(x)
                covector[:, k] = 1.0 / (most * T**order)
                S = torque_slopes(connection, x, x1, x2, covector)
                by_c = (
                    values[:, :, None] * S[:, None, :m]
                    + slopes[:, :, None] * S[:, None, m : 2 * m]
                    + bends[:, :, None] * S[:, None, 2 * m :]
                )
                add(tau[:, k] / most, by_c, -order * tau[:, k] / (most * T))
        return np.concatenate(results), np.vstack(jacobian)

    def evaluate_or_nan(z: Array) -> tuple[Array, Array]:
        """Return NaN where the lift fails, so that IPOPT shortens its step."""
        try:
            return evaluate(z)
        except (SingularInertiaError, NoConvergence, FloatingPointError):
            count = 1 + len(g_lower)
            return np.full(count, np.nan), np.full((count, size), np.nan)

    g_lower, g_upper = _nonlinear_bounds(task, path)
    rows, lower, upper = _linear_constraints(task, path)
    return Problem(
        size,
        evaluate_or_nan,
        rows,
        np.concatenate([g_lower, lower]),
        np.concatenate([g_upper, upper]),
    )


def _nonlinear_bounds(task: Task, path: Path) -> tuple[Array, Array]:
    """Return the bounds of the nonlinear constraints."""
    identity = task.connection.group.identity()
    residual, _ = (
        task.aim.error(identity)
        if isinstance(task.aim, TargetAim)
        else task.aim.constraint(identity)
    )
    lower, upper = [np.zeros(len(residual))], [np.zeros(len(residual))]
    if task.most is not None:
        lower.append(np.array([-np.inf]))
        upper.append(np.ones(1))
    if path.cells is not None:
        lower.append(np.full(len(path.cells.joint), -np.inf))
        upper.append(np.full(len(path.cells.joint), 1.0 - _ROUND_OFF))
    else:
        limited = len(path.checked[0]) * int(np.isfinite(task.limits.torque).sum())
        lower.append(np.full(limited, -1.0))
        upper.append(np.full(limited, 1.0))
    return np.concatenate(lower), np.concatenate(upper)


def _linear_constraints(task: Task, path: Path) -> tuple[Array, Array, Array]:
    """Return matrix and bounds of the linear constraints on shapes, speeds and period."""
    limits, n, free = task.limits, path.size, int(task.period_is_free)
    values, slopes, _ = path.checked
    L = path.matrix.reshape(*path.shift.shape, n)
    rows, lower, upper = [], [], []
    by_y = np.tensordot(values, L, 1).reshape(-1, n)  # (C m, n)
    shift = (values @ path.shift).ravel()
    inside = _INSIDE if path.cells is None else -_OUTSIDE
    edge = inside * limits.reach
    rows.append(np.hstack([by_y, np.zeros((len(by_y), free))]))
    lower.append(np.tile(limits.shape[:, 0] + edge, len(values)) - shift)
    upper.append(np.tile(limits.shape[:, 1] - edge, len(values)) - shift)
    fast = np.flatnonzero(np.isfinite(limits.speed))
    if len(fast):
        by_y = np.tensordot(slopes, L[:, fast], 1).reshape(-1, n)
        shift = (slopes @ path.shift[:, fast]).ravel()
        most = np.tile(limits.speed[fast] * (1.0 - inside), len(slopes))
        if free:
            for sign in (1.0, -1.0):
                rows.append(np.hstack([sign * by_y, -most[:, None]]))
                lower.append(np.full(len(most), -np.inf))
                upper.append(-sign * shift)
        else:
            rows.append(by_y)
            lower.append(-most * task.period - shift)
            upper.append(most * task.period - shift)
    if free:
        rows.append(np.eye(n + 1)[-1:])
        lower.append(np.array([1e-6]))
        upper.append(np.array([np.inf]))
    return np.vstack(rows), np.concatenate(lower), np.concatenate(upper)
