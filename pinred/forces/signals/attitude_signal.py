"""Attitudes of ball joints as functions of time: rotation vectors about a constant attitude.

R(t) = R_c exp(w(t)) with three signals w.  The rate of the ball is σ = J(w) ẇ with the right
Jacobian J, and its acceleration is dσ/dt.  Both are finite for rotation vectors of any length.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import factorial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, as_floats
from ...common.errors import InputError, ShapeError
from ...common.names import brief
from ...common.parameter import Parameter
from ...lie.rotations import (
    conjugate,
    left_jacobian,
    quaternion_exp,
    quaternion_product,
    unwrapped_rotation_vectors,
)
from .signal import Constant, Expression, Hold, Linear, Signal, Spline

if TYPE_CHECKING:
    import casadi as ca

_AXES = "xyz"
_NO_ROTATION = (0.0, 0.0, 0.0)
_TERMS = 9  # terms of the Taylor series about zero; with 9 the error at |w| = 1 is below 1e-17
_TINY = 1e-20  # added to |w|², so that its root has derivatives at zero


@checks_arguments
@dataclass(frozen=True, eq=False)
class Attitude:
    """The attitude of a ball joint over time, R(t) = R_c exp(w(t)).

    Attributes:
        vector: The rotation vector w in the axes of the child, of any length: three signals,
            numbers, Parameters or formulas in t [rad].
        centre: The constant attitude R_c: a rotation vector, (3,) [rad], or a quaternion
            (x, y, z, w).
    """

    vector: Any
    centre: Any = _NO_ROTATION

    def __post_init__(self) -> None:
        try:
            values = [] if isinstance(self.vector, str) else list(self.vector)
        except TypeError:
            values = []
        if len(values) != 3:
            raise InputError(
                "vector of an Attitude: expected three signals, numbers or formulas in t, got "
                f"{brief(self.vector)}"
            )
        from ...system.joints import attitude_of

        signals = tuple(_signal(v, axis) for v, axis in zip(values, _AXES, strict=True))
        object.__setattr__(self, "vector", signals)
        object.__setattr__(self, "centre", attitude_of(self.centre, "centre of an Attitude"))

    @classmethod
    def through(
        cls,
        times: ArrayLike,
        attitudes: ArrayLike,
        centre: Any = _NO_ROTATION,
        *,
        end: Literal["natural", "clamped", "not-a-knot", "periodic"] = "natural",
    ) -> Attitude:
        """Return splines through the unwrapped rotation vectors of attitudes.

        Args:
            times: Increasing times, (n,) [s].
            attitudes: Rotation vectors, (n, 3) [rad], or quaternions (x, y, z, w), (n, 4).
            centre: The constant attitude R_c, such as the mean attitude.
            end: Condition at both ends (see Spline).
        Returns:
            The attitude over time.
        Raises:
            ShapeError: The attitudes have a wrong shape.
            InputError: A quaternion is zero, or the times do not increase.
        """
        table = as_floats(attitudes, "attitudes")
        if table.ndim != 2 or table.shape[1] not in (3, 4) or not len(table):
            raise ShapeError(
                "attitudes: expected rotation vectors (n, 3) or quaternions (n, 4), got shape "
                f"{table.shape}"
            )
        from ...system.joints import attitude_of

        q = np.array([attitude_of(row, f"attitudes[{k}]") for k, row in enumerate(table)])
        about = attitude_of(centre, "centre of an Attitude")
        vectors = unwrapped_rotation_vectors(quaternion_product(conjugate(about), q))
        return cls([Spline(times, column, end=end) for column in vectors.T], about)

    def value(self, t: ArrayLike) -> Array:
        """Evaluate the attitude.

        Args:
            t: Times of any shape [s].
        Returns:
            Quaternions (x, y, z, w), (..., 4).
        """
        return quaternion_product(self.centre, quaternion_exp(self._vector(t, "value")))

    def rate(self, t: ArrayLike) -> Array:
        """Evaluate the angular velocity of the child relative to the parent.

        Args:
            t: Times of any shape [s].
        Returns:
            Angular velocities in the axes of the child, (..., 3) [rad/s].
        """
        w, wdot = self._vector(t, "value"), self._vector(t, "rate")
        return np.asarray(np.einsum("...ij,...j", left_jacobian(-w), wdot))

    def _vector(self, t: ArrayLike, order: str) -> Array:
        return np.stack([getattr(signal, order)(t) for signal in self.vector], axis=-1)

    def refuse_jumps(self, what: str) -> None:
        """Reject tables that jump by more than π between neighbouring entries.

        Args:
            what: Name of the attitude in messages.
        Raises:
            InputError: A table jumps; the message says how to unwrap it.
        """
        tables = [s for s in self.vector if isinstance(s, (Spline, Linear))]
        times = [np.asarray(s.times) for s in tables]
        changes = [np.diff(np.asarray(s.values)) for s in tables]
        if len(tables) == 3 and all(np.array_equal(times[0], other) for other in times):
            times, changes = times[:1], [np.linalg.norm(changes, axis=0)]
        for at, change in zip(times, changes, strict=True):
            k = int(np.argmax(np.abs(change)))
            if abs(change[k]) > np.pi:
                raise InputError(
                    f"{what}: the rotation vector jumps by {abs(change[k]):.3g} rad from "
                    f"t = {at[k]:g} s to {at[k + 1]:g} s, as the logarithm of a rotation does at "
                    "half a turn. Unwrap it, as Attitude.through(times, attitudes) does, or add "
                    "entries between these times"
                )

    def written(
        self, t: ca.SX, within: ca.SX | None, number: Callable[[Any], Any]
    ) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return attitude, rate and acceleration as expressions of time.

        Args:
            t: Time [s].
            within: Time that selects the segments of tables.
            number: Function that replaces a coefficient by a symbol.
        Returns:
            Quaternion, (4,), angular velocity σ, (3,), and dσ/dt, (3,), in the axes of the child.
        """
        import casadi as ca

        w = ca.vertcat(*(signal.written(t, within, number) for signal in self.vector))
        e = _exponential(w)
        edot = ca.jacobian(e, t)
        sigma = 2.0 * (e[3] * edot[:3] - edot[3] * e[:3] - ca.cross(e[:3], edot[:3]))
        a, b = ca.DM(self.centre[:3]), float(self.centre[3])
        vector = b * e[:3] + e[3] * a + ca.cross(a, e[:3])
        q = ca.vertcat(vector, b * e[3] - ca.dot(a, e[:3]))
        return q, sigma, ca.jacobian(sigma, t)


def _signal(value: Any, axis: str) -> Signal:
    """Return a component of a rotation vector as a Signal."""
    if isinstance(value, Signal):
        if isinstance(value, Hold):
            raise InputError(
                f"vector.{axis} of an Attitude: a Hold jumps, so the ball has no rate; use a Spline"
            )
        return value
    if isinstance(value, str):
        return Expression(value)
    if isinstance(value, Parameter):
        return Constant(value)
    number = as_floats(value, f"vector.{axis} of an Attitude")
    if number.ndim:
        raise ShapeError(
            f"vector.{axis} of an Attitude: expected a signal, a number or a formula in t, got "
            f"{brief(value)}"
        )
    return Constant(float(number))


def _exponential(w: ca.SX) -> ca.SX:
    """Return the quaternion of a rotation vector, (4,), with accurate derivatives of all orders.

    The closed form loses the digits of its derivatives near |w| = 0, where the Taylor series
    replaces it.  The weight of the series is a rational function of z = |w|².  A condition would
    be a switch in time, at which integration would have to stop.
    """
    import casadi as ca

    z = ca.dot(w, w)
    half = 0.5 * ca.sqrt(z + _TINY)
    quarter = -0.25 * z
    real, scale = ca.SX(0), ca.SX(0)
    for k in reversed(range(_TERMS)):
        real = real * quarter + 1.0 / factorial(2 * k)
        scale = scale * quarter + 0.5 / factorial(2 * k + 1)
    square = z * z
    fifth = square * square * z
    series = 1.0 / (1.0 + fifth * fifth)
    closed = fifth * fifth * series
    real = series * real + closed * ca.cos(half)
    scale = series * scale + closed * 0.5 * ca.sin(half) / half
    return ca.vertcat(scale * w, real)


def parse_attitude(value: Sequence[Any] | Array) -> Attitude:
    """Return three signals of a rotation vector, or a quaternion of numbers, as an Attitude."""
    if len(value) == 4:
        return Attitude(_NO_ROTATION, value)
    return Attitude(value)
