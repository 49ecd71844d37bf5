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
    path_lift,
)
from ...common.arrays import Array
from ...common.errors import NoConvergence, SingularInertiaError
from .limit_checks import LimitChecks, LimitedLoop
from .limits import Limits
from .nonlinear_program import Problem
from .objective import (
    DEGREES,
    AxisAim,
    CostKind,
    TargetAim,
    cost_of,
)

INSIDE = 1.5e-8  # relative margin to limits and bounds, above the accepted violation
# Power of the size of a loop that is minimised for a target.  Small loops reach targets in
# proportion to the square of their size, so that smaller powers are not convex in the target.
CONVEX = 4
_SHORTEST = 1e-6  # lower bound of a variable period [s]
_ROOTS = {1: "", 2: "√", 4: "⁴√"}  # of costs, by their degree


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
        matrix: Matrix L of the affine map, (K m, n).
        shift: Constant term c₀ of the affine map, (K, m).
        checks: Checks of the limits of Fourier series; None for other paths.
        action: Whether the root of the action replaces the cost "length".
    """

    basis: PathBasis
    matrix: Array
    shift: Array
    checks: LimitChecks | None = None
    action: bool = False

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
    power: int,
    start: Array | None = None,
    passage: Passage | None = None,
) -> Path:
    """Return the family of Fourier series; its unknowns are scaled means, cosines and sines.

    Args:
        harmonics: Number of harmonics.
        m: Number of joints.
        pieces: Number of quadrature segments per cycle.
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
    return Path(basis, matrix, shift)


def problem_of(task: Task, path: Path) -> Problem:
    """Create the nonlinear program of a task.

    Args:
        task: The task.
        path: The family of paths over which the task is optimised.
    Returns:
        The problem; it has no limits of polygons.
    """
    connection, aim, limits = task.connection, task.aim, task.limits
    n, free = path.size, int(task.period_is_free)
    size = n + free

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
            powered = root**CONVEX
            factor = CONVEX * power * powered / size_of_cost
            add(np.array([powered]), factor * cost.slope[None], factor * cost.by_log_period / T)
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
        if path.checks is not None:
            checked = LimitedLoop(connection, limits, c, T).values(path.checks)
            add(checked.values, checked.by_c, checked.by_log_period / T)
        return np.concatenate(results), np.vstack(jacobian)

    def evaluate_or_nan(z: Array) -> tuple[Array, Array]:
        """Return NaN where the lift fails or T ≤ 0, so that a line search shortens its step."""
        try:
            if free and not z[n] > 0.0:  # SLSQP also evaluates points beyond linear constraints
                raise FloatingPointError("period")
            return evaluate(z)
        except (SingularInertiaError, NoConvergence, FloatingPointError):
            count = 1 + len(g_lower)
            return np.full(count, np.nan), np.full((count, size), np.nan)

    g_lower, g_upper = _bounds(task, path)
    rows = np.eye(size)[n:]
    return Problem(
        size, evaluate_or_nan, rows, np.append(g_lower, np.full(free, _SHORTEST)),
        np.append(g_upper, np.full(free, np.inf)),
    )  # fmt: skip


def _bounds(task: Task, path: Path) -> tuple[Array, Array]:
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
        upper.append(np.array([1.0 - INSIDE]))
    if path.checks is not None:
        lower.append(np.full(len(path.checks.times.s), -np.inf))
        upper.append(np.full(len(path.checks.times.s), 1.0 - INSIDE))
    return np.concatenate(lower), np.concatenate(upper)


def cost_unit(connection: Connection, kind: CostKind) -> str:
    """Return the unit of a cost, which depends on what the connection's metric measures.

    The metric of momenta gives twice the kinetic energy of a shape rate [J], that of drag the
    dissipated power [W].
    """
    joints = set(connection.form.units)
    torque = "N m" if joints == {"rad"} else "N" if joints == {"m"} else "N m | N"
    is_kinetic = connection.form.momentum
    units = {
        "length": "m √kg" if is_kinetic else "√(J s)",
        "torque": f"({torque})² s",
        "power": "W² s",
        "acceleration": "W" if is_kinetic else "W/s",
        "time": "s",
    }
    return units[kind]


def merit_name(task: Task) -> tuple[str, str]:
    """Return the name and the unit of the merit of a task (see Task.merit)."""
    aim = task.aim
    if not isinstance(aim, AxisAim):
        return f"−{task.cost}", cost_unit(task.connection, task.cost) if task.cost else "1"
    if task.cost is None or not task.per_cost:
        return aim.kind, aim.unit
    root, unit = _ROOTS[DEGREES[task.cost]], cost_unit(task.connection, task.cost)
    per = f"{root}({unit})" if root or (" " in unit and not unit.startswith("√")) else unit
    return f"{aim.kind} / {root}{task.cost}", f"{aim.unit}/{per}"
