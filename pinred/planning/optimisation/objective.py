"""Objectives (functions of the pose after a loop) and costs of a loop, with exact derivatives.

The optimisation starts with the square root of the action ∫x′ᵀMx′ ds in place of the length.  The
root is never smaller than the length, and equals it at constant speed, so that it determines the
speed along the loop, which the length does not.  For a path
x(s), s = t/T, joint torques against inertia are f/T² with the covariant force f of the path.
Joint torques against drag are M x′/T.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from ...analysis.connections.connection import Connection, require_metric
from ...analysis.phases.lift import PathBasis, PathLift, sum_over_nodes
from ...common.arrays import Array, FrozenArrays, as_floats, vector
from ...common.errors import InputError
from ...common.names import brief
from ...lie.group import Group
from ...lie.rotations import (
    conjugate,
    left_jacobian_inverse,
    quaternion_exp,
    quaternion_log,
    quaternion_product,
    unit,
)

AimKind: TypeAlias = Literal["rotation", "displacement", "target"]
AIMS: tuple[AimKind, ...] = get_args(AimKind)
_LETTERS = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True, eq=False)
class AxisAim(FrozenArrays):
    """Objective: maximise the rotation about an axis, or the displacement along an axis.

    The rotation of a planar group is the unwrapped angle [rad].  In space it is the component of
    the rotation vector along the axis, at most π.  A displacement is the component of the final
    position along the axis [m].  It requires a zero rotation, because otherwise repeated cycles
    would move the base in a circle.

    Attributes:
        group: The symmetry group.
        kind: "rotation" or "displacement".
        axis: Unit vector in the initial frame of the base, (turns,) or (linear,).
    """

    group: Group
    kind: AimKind
    axis: Array

    @property
    def unit(self) -> str:
        """Unit of the value."""
        return "rad" if self.kind == "rotation" else "m"

    def constraint(self, pose: Array) -> tuple[Array, Array]:
        """Evaluate the equality constraints: a displacement requires zero rotation.

        Args:
            pose: Pose after one cycle, (size,).
        Returns:
            The constraint values, (k,), and their derivatives with respect to g⁻¹δg,
            (k, r).
        """
        if self.kind == "rotation" or not self.group.turns:
            return np.zeros(0), np.zeros((0, self.group.dim))
        return TargetAim(self.group, self.group.identity()[self.group.linear :], None).error(pose)

    def value(self, pose: Array) -> tuple[float, Array]:
        """Evaluate the rotation or displacement.

        Args:
            pose: Pose after one cycle, (size,).
        Returns:
            The value [rad | m], and its derivative with respect to g⁻¹δg, (r,).
        """
        group, k = self.group, self.group.linear
        derivative = np.zeros(group.dim)
        if self.kind == "displacement":
            derivative[:k] = group.turned_back(pose[k:], self.axis)
            return float(self.axis @ pose[:k]), derivative
        if group.turns == 1:
            derivative[k] = self.axis[0]
            return float(self.axis[0] * pose[k]), derivative
        w = quaternion_log(pose[k:])
        derivative[k:] = self.axis @ left_jacobian_inverse(-w)
        return float(self.axis @ w), derivative


@dataclass(frozen=True, eq=False)
class TargetAim:
    """Objective: reach a pose, or an attitude with any position.

    Attributes:
        group: The symmetry group.
        attitude: Angle [rad] or unit quaternion, (size − linear,).
        position: Position, (linear,) [m], or None for any position.
    """

    group: Group
    attitude: Array
    position: Array | None

    def error(self, pose: Array) -> tuple[Array, Array]:
        """Compute the deviation from the target.

        Args:
            pose: Pose after one cycle, (size,).
        Returns:
            The deviation, (k,), rotation [rad] before position [m], and its derivatives with
            respect to g⁻¹δg, (k, r).
        """
        group, k = self.group, self.group.linear
        errors, derivatives = [], []
        if group.turns:
            by_twist = np.zeros((group.turns, group.dim))
            if group.turns == 1:
                errors.append(pose[k:] - self.attitude)
                by_twist[0, k] = 1.0
            else:
                w = rotation_between(self.attitude, pose[k:])
                errors.append(w)
                by_twist[:, k:] = left_jacobian_inverse(-w)
            derivatives.append(by_twist)
        if self.position is not None:
            errors.append(pose[:k] - self.position)
            by_twist = np.zeros((k, group.dim))
            for j, axis in enumerate(np.eye(k)):
                by_twist[j, :k] = group.turned_back(pose[k:], axis)
            derivatives.append(by_twist)
        return np.concatenate(errors), np.vstack(derivatives)


def rotation_between(a: Array, b: Array) -> Array:
    """Return the rotation vector of a⁻¹ b, (3,), for unit quaternions."""
    return quaternion_log(quaternion_product(conjugate(a), b))


def axis_aim(group: Group, kind: AimKind, axis: str | ArrayLike | None) -> AxisAim:
    """Create the objective of a rotation about an axis or a displacement along an axis.

    Args:
        group: The symmetry group.
        kind: "rotation" or "displacement".
        axis: 'x', 'y', 'z', another name of this component of a twist, or a vector, in the
            initial frame of the base; None for the first or only axis of the group.
    Returns:
        The objective.
    Raises:
        InputError: The group has no such rotation or translation, or the axis is missing or
            invalid.
    """
    size = group.turns if kind == "rotation" else group.linear
    if not size:
        raise InputError(f"the group {group.name} has no {kind}; its twists are {_names(group)}")
    if axis is None:
        if size > 1 and kind == "rotation":
            raise InputError(
                "axis: expected 'x', 'y', 'z' or a vector (3,) for a rotation in space, got None"
            )
        return AxisAim(group, kind, np.eye(size)[0])
    axes = group.axes[group.linear :] if kind == "rotation" else group.axes[: group.linear]
    if isinstance(axis, str):
        indices = {
            letter: axes.index(k + 3 * (kind == "rotation"))
            for letter, k in _LETTERS.items()
            if k + 3 * (kind == "rotation") in axes
        }
        first = group.linear if kind == "rotation" else 0
        named = {name: k - first for name, k in group.components("twist").items()}
        index = indices.get(axis, named.get(axis, -1))
        if not 0 <= index < size:
            raise InputError(f"axis must be {', '.join(indices)} or a vector, got {brief(axis)}")
        return AxisAim(group, kind, np.eye(size)[index])
    direction = vector(np.atleast_1d(as_floats(axis, "axis")), size, "axis")
    norm = float(np.linalg.norm(direction))
    if not norm > 0.0:
        raise InputError(f"axis: expected a nonzero vector, got {brief(axis)}")
    return AxisAim(group, kind, direction / norm)


def target_aim(group: Group, target: ArrayLike) -> TargetAim:
    """Create the objective of reaching a target.

    Args:
        group: The symmetry group.
        target: A pose, (size,), or a rotation, (turns,): an angle [rad], which may exceed a full
            turn, or a rotation vector [rad].
    Returns:
        The objective.
    Raises:
        InputError: The target is not an element of the group.
        ShapeError: The target has the wrong shape, or an entry is not finite.
    """
    values = np.atleast_1d(as_floats(getattr(target, "homogeneous", target), "target"))
    if group.turns and values.shape == (group.turns,):
        values = vector(values, group.turns, "target")
        attitude = values.copy() if group.turns == 1 else quaternion_exp(values)
        return TargetAim(group, attitude, None)
    pose = group.pose(values)
    if group.turns == 3:
        pose = np.concatenate([pose[:-4], unit(pose[-4:])])
    k = group.linear
    return TargetAim(group, pose[k:].copy(), pose[:k].copy() if k else None)


def _names(group: Group) -> str:
    return ", ".join(group.twist_names)


CostKind: TypeAlias = Literal["length", "torque", "power", "acceleration", "time"]
COSTS: tuple[CostKind, ...] = get_args(CostKind)
ABOUT = {
    "length": "∫√(ẋᵀMẋ) dt, path length in the reduced metric",
    "torque": "∫ Σ τᵢ² dt",
    "power": "∫ Σ (τᵢ ẋᵢ)² dt",
    "acceleration": "∫ |∇ẋ|²_M dt, the covariant acceleration in the reduced metric",
    "time": "T, the period",
}
# Exponent with which each cost grows with the size of small loops.  It normalises the merit,
# because objectives grow with the square of the size.
DEGREES = {"length": 1, "torque": 2, "power": 4, "acceleration": 2, "time": 1}


@dataclass(frozen=True)
class Cost:
    """The cost of one cycle and its derivatives.

    Attributes:
        value: The cost.
        slope: Derivative with respect to the path coefficients, (K, m).
        by_log_period: Derivative with respect to the logarithm of the period T.
    """

    value: float
    slope: Array
    by_log_period: float


def check_cost(connection: Connection, kind: str) -> None:
    """Raise InputError if the cost is unknown or undefined for the connection."""
    if kind not in COSTS:
        raise InputError(f"unknown cost {kind!r}; the costs are {', '.join(COSTS)}")
    if kind != "time" and not connection.has_metric:
        raise InputError(
            f"cost: expected 'time', got {kind!r}, because {connection.form.what} define no metric "
            "on shape space"
        )


def torques(connection: Connection, x: Array, slope: Array, bend: Array) -> Array:
    """Compute the joint torques τ along a path for period T = 1, in the child's axes for balls.

    For another period, torques scale with T^(−order); see `torque_order`.

    Args:
        connection: The connection.
        x: Shapes, (N, m).
        slope: First derivatives by s, (N, m).
        bend: Second derivatives by s, (N, m).
    Returns:
        (N, m): the torques.
    """
    if not len(x):
        return np.zeros_like(x)
    if connection.form.momentum:
        forces = connection.code.covariant_forces(x, slope, bend, np.zeros_like(x))[0]
    else:
        forces = np.asarray(0.5 * _squares(connection, x, slope)[:, connection.m :])
    return forces if connection.chart is None else connection.chart.frame_forces(x, forces)


def torque_slopes(
    connection: Connection, x: Array, slope: Array, bend: Array, along: Array
) -> Array:
    """Compute the derivatives of λᵀτ along a path, with the joint torques τ at period T = 1.

    Args:
        connection: The connection.
        x: Shapes, (N, m).
        slope: First derivatives by s, (N, m).
        bend: Second derivatives by s, (N, m).
        along: Constant weights λ of the torques, (N, m).
    Returns:
        (N, 3m): the derivatives with respect to (x, x′, x″).
    """
    if connection.chart is None:
        return _force_slopes(connection, x, slope, bend, along)
    # λᵀτ = yᵀf with forces f along w and y = J⁻¹λ, which depends on w.
    rates = connection.chart.coordinate_rates(x, along)
    slopes = _force_slopes(connection, x, slope, bend, rates).copy()
    tau = torques(connection, x, slope, bend)
    slopes[:, : connection.m] -= connection.chart.power_gradients(x, tau, rates)
    return slopes


def _force_slopes(
    connection: Connection, x: Array, slope: Array, bend: Array, along: Array
) -> Array:
    """Return the derivatives, (N, 3m), of λᵀf by (x, x′, x″) for forces f along x."""
    m = connection.m
    if connection.form.momentum:
        return connection.code.covariant_forces(x, slope, bend, along)[1]
    # By polarisation, 4 λᵀ∂M x′ = (λ + x′)ᵀ∂M (λ + x′) − (λ − x′)ᵀ∂M (λ − x′).
    plus = _squares(connection, x, along + slope)[:, :m]
    minus = _squares(connection, x, along - slope)[:, :m]
    by_slope = 0.5 * _squares(connection, x, along)[:, m:]
    return np.hstack([0.25 * (plus - minus), by_slope, np.zeros_like(by_slope)])


def torque_order(connection: Connection) -> int:
    """Return the power of 1/T with which torques scale: 2 against inertia, 1 against drag."""
    return 1 if not connection.form.momentum else 2


def cost_of(
    kind: CostKind,
    connection: Connection,
    basis: PathBasis,
    coefficients: Array,
    lift: PathLift,
    period: float,
    *,
    action: bool = False,
) -> Cost:
    """Compute the cost of a path and its derivatives.

    Args:
        kind: The cost.
        connection: The connection.
        basis: Basis functions at the Gauss nodes.
        coefficients: Coefficients of the path, (K, m).
        lift: Horizontal lift of the path: the motion of the base along it.
        period: Period T [s].
        action: Whether the root of the action replaces the cost "length".
    Returns:
        The cost.
    Raises:
        InputError: The connection has no metric.
    """
    if kind == "time":
        return Cost(period, np.zeros_like(coefficients), period)
    x, slope, w, m = lift.x, lift.slope, basis.weights, connection.m
    if kind == "length":
        speed = np.sqrt(lift.square)
        if action:  # the root mean square of the speed in place of its mean
            length = float(np.sqrt(w @ lift.square))
            factors = np.full_like(speed, 1.0 / max(length, 1e-300))
        else:
            length, factors = float(w @ speed), 1.0 / np.maximum(speed, 1e-300)
        derivatives = (0.5 * w * factors)[:, None] * lift.square_slopes
        return Cost(length, sum_over_nodes(basis, m, derivatives), 0.0)
    bend, order = basis.bends @ coefficients, torque_order(connection)
    if kind == "acceleration":
        order = 2
        force = connection.code.covariant_forces(x, slope, bend, np.zeros_like(x))[0]
        M = require_metric(connection.form, connection.locals_at(x)[1])
        u: Array = np.linalg.solve(M, force[..., None])[..., 0].astype(float)
        derivatives = 2.0 * connection.code.covariant_forces(x, slope, bend, u)[1]
        derivatives[:, :m] -= _squares(connection, x, u)[:, :m]
        value, power = float(w @ np.sum(force * u, axis=1)), 1 - 2 * order
    else:
        tau = torques(connection, x, slope, bend)
        rates = np.ones_like(tau)
        if kind == "power":
            rates = slope if connection.chart is None else connection.chart.rates(x, slope)
        derivatives = 2.0 * torque_slopes(connection, x, slope, bend, tau * rates**2)
        if kind == "power":
            _add_rate_gradients(derivatives, connection, x, slope, 2.0 * tau**2 * rates)
        value = float(w @ np.sum((tau * rates) ** 2, axis=1))
        power = 1 - 2 * (order + (kind == "power"))
    scale = period**power
    return Cost(
        scale * value,
        scale * sum_over_nodes(basis, m, w[:, None] * derivatives),
        power * scale * value,
    )


def _add_rate_gradients(
    derivatives: Array, connection: Connection, x: Array, slope: Array, weights: Array
) -> None:
    """Add the derivatives of weights · rates to the first 2m columns, those by (x, x′)."""
    chart, m = connection.chart, connection.m
    if chart is None:
        derivatives[:, m : 2 * m] += weights
        return
    derivatives[:, :m] += chart.power_gradients(x, weights, slope)
    by_slope = np.swapaxes(chart.rate_maps(x), 1, 2) @ weights[..., None]
    derivatives[:, m : 2 * m] += by_slope[..., 0]


def _squares(connection: Connection, x: Array, u: Array) -> Array:
    """Return the derivatives, (N, 2m), of uᵀM(x)u with respect to (x, u)."""
    return np.asarray(connection.horizontal_slopes(x, u)[:, connection.r])
