"""Rotation vectors as coordinates of ball joints, and connections in these coordinates.

The chart is x = c exp(w) about a centre c.  The rates along the frame of the shape space are
σ = J(w) ẇ, where J is the right Jacobian of SO(3) for a ball and 1 for a hinge or slide.  A form
F(x)(ξ, σ) pulls back to F(c exp w)(ξ, J ẇ), a metric to JᵀMJ, and a connection to A J.  The new
shape space is ℝᵐ, so all functions of loops and gaits apply.  J is singular where the angle of a
ball is 2π: a connection is smooth there, but its metric loses rank.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import factorial

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, FrozenArrays, vector
from ...common.errors import InputError
from ...forces.signals import Attitude, Fourier
from ...kernels.connection.connection_code import ConnectionCode
from ...kernels.connection.connection_form import ConnectionForm, form_of
from ...lie.rotations import TAU, conjugate, left_jacobian, quaternion_exp, quaternion_product
from ...scene.initial_state import order_by_joint
from ...system.coordinates import ShapeSpace
from ...system.system import System

_SMALL = 4.0  # square of the angle below which Taylor series replace the closed forms [rad²]
_TERMS = 16  # terms of the series; three derivatives are then exact to round-off
_CLOSED = 1e-9  # largest angle between the attitudes at both ends of a loop [rad]


@dataclass(frozen=True, eq=False)
class RotationChart(FrozenArrays):
    """The coordinates w, (m,), of shapes x = c exp(w).

    Attributes:
        space: Shape space with coordinates x, (nx,).
        centre: Centre c, (nx,).
    """

    space: ShapeSpace
    centre: Array

    @property
    def words(self) -> str:
        """What the coordinates are, for messages."""
        return "in rotation vectors" if self.space.balls else "about a centre"

    def shapes(self, w: Array) -> Array:
        """Return the shapes x, (..., nx), of coordinates w, (..., m)."""
        return self.space.integrate(self.centre, w)

    def shape_graph(self, w: ca.SX) -> ca.SX:
        """Return the expressions of the shape x, (nx,), at coordinates w, (m,)."""
        return self._shape(self._terms(w), w)

    def coordinates(self, x: Array) -> Array:
        """Return the coordinates over time, (T, m), of shapes, (T, nx)."""
        about = x.copy()
        for ball in self.space.balls:
            about[:, ball.x] = quaternion_product(conjugate(self.centre[ball.x]), x[:, ball.x])
        return self.space.chart(about)

    def rate_maps(self, w: Array) -> Array:
        """Return J(w), (..., m, m), which maps ẇ to rates σ along the frame."""
        J = np.zeros((*w.shape, self.space.m))
        J[...] = np.eye(self.space.m)
        for ball in self.space.balls:
            J[..., ball.v, ball.v] = left_jacobian(-w[..., ball.v])
        return J

    def rates(self, w: Array, wdot: Array) -> Array:
        """Return the rates σ = J(w) ẇ along the frame, (..., m)."""
        return np.asarray((self.rate_maps(w) @ wdot[..., None])[..., 0])

    def motions(self, signals: Mapping[str, Fourier]) -> dict[str, Fourier | Attitude]:
        """Return a gait as prescribed motions, with an attitude over time for each ball.

        Args:
            signals: `gait.signals(connection.joints)`, the coordinates over time by label.
        Returns:
            Motions by joint, for `prescribed` of a Scene.
        """
        motions: dict[str, Fourier | Attitude] = {}
        for joint in self.space.joints:
            entries = [signals[joint.name + suffix] for suffix in joint.kind.rates]
            centre = self.centre[joint.x]
            if joint.kind.is_ball:
                motions[joint.name] = Attitude(entries, centre)
            else:
                motions[joint.name] = replace(entries[0], mean=entries[0].mean + float(centre[0]))
        return motions

    def frame_forces(self, w: Array, forces: Array) -> Array:
        """Return the components along the frame, J⁻ᵀ f, of forces f along w, (..., m)."""
        transposed = np.swapaxes(self.rate_maps(w), -1, -2)
        return np.asarray(np.linalg.solve(transposed, forces[..., None])[..., 0])

    def coordinate_rates(self, w: Array, rates: Array) -> Array:
        """Return ẇ = J⁻¹ σ for rates σ along the frame, (..., m)."""
        return np.asarray(np.linalg.solve(self.rate_maps(w), rates[..., None])[..., 0])

    def power_gradients(self, w: Array, forces: Array, wdot: Array) -> Array:
        """Return the derivatives of the power uᵀ J(w) ẇ by w, for frame forces u, (..., m)."""
        gradients = np.zeros_like(w)
        for ball in self.space.balls:
            vectors = (array[..., ball.v] for array in (w, forces, wdot))
            gradients[..., ball.v] = _power_gradients(*vectors)
        return gradients

    def open_ball(self, start: Array, end: Array) -> str:
        """Return a ball whose attitudes at two coordinates (m,) differ, or ""."""
        for ball in self.space.balls:
            first, last = quaternion_exp(start[ball.v]), quaternion_exp(end[ball.v])
            gap = min(np.linalg.norm(first - last), np.linalg.norm(first + last))
            if not 2.0 * gap <= _CLOSED:
                return ball.name
        return ""

    def ball_beyond(self, w: Array) -> str:
        """Return a ball whose rotation vector reaches 2π at coordinates (N, m), or ""."""
        for ball in self.space.balls:
            if not np.linalg.norm(w[:, ball.v], axis=1).max() < TAU:
                return ball.name
        return ""

    def code_of(self, form: ConnectionForm) -> ConnectionCode:
        """Return the compiled code of the pulled-back form."""
        return ConnectionCode(self.pulled_back(form))

    def pulled_back(self, form: ConnectionForm) -> ConnectionForm:
        """Return a form of velocities (ξ, σ) as a form of (ξ, ẇ)."""
        r = form.r

        def values(w: ca.SX, v: ca.SX) -> ca.SX:
            terms = self._terms(w)
            F = form.values(self._shape(terms, w), _velocity(v, r, terms, +1.0))
            return _velocity(F, r, terms, -1.0) if form.symmetric else F

        def reference(w: Array) -> Array:
            T = np.eye(r + form.m)
            T[r:, r:] = self.rate_maps(w)
            G = form.reference(self.shapes(w)) @ T
            return np.asarray(T.T @ G if form.symmetric else G)

        def locked(w: ca.SX) -> ca.SX:
            return ca.reshape(form.locked(self._shape(self._terms(w), w)), r, r)

        return form_of(
            form.group, form.joints, form.units, f"{form.what}, {self.words}", values, reference,
            symmetric=form.symmetric, momentum=form.momentum, locked=locked,
        )  # fmt: skip

    def _terms(self, w: ca.SX) -> list[_BallTerms]:
        return [_BallTerms(ball.v, w[ball.v]) for ball in self.space.balls]

    def _shape(self, terms: list[_BallTerms], w: ca.SX) -> ca.SX:
        """Return the expressions of x, (nx,)."""
        attitudes, x = {term.place.start: term for term in terms}, []
        for joint in self.space.joints:
            c = self.centre[joint.x]
            term = attitudes.get(joint.v.start)
            x.append(c + w[joint.v] if term is None else term.turned(c))
        return ca.vertcat(ca.SX(0, 1), *x)


def _velocity(v: ca.SX, r: int, terms: list[_BallTerms], sign: float) -> ca.SX:
    """Apply J (sign 1) or Jᵀ (sign −1) to the last m of r + m entries."""
    mapped = ca.SX(v)
    for term in terms:
        place = slice(r + term.place.start, r + term.place.stop)
        mapped[place] = term.mapped(v[place], sign)
    return mapped


class _BallTerms:
    """Expressions of the rotation vector w of a ball, smooth at w = 0.

    Attributes:
        place: Slice of the ball in w.
        w: Rotation vector, (3,).
        f: sin(θ/2) / (θ/2), where θ = |w|.
        g: cos(θ/2).
        c: (θ − sin θ) / θ³.
    """

    def __init__(self, place: slice, w: ca.SX) -> None:
        self.place, self.w = place, w
        s = ca.dot(w, w)
        large = s > _SMALL
        # The branch that is not selected gets an argument at which it is regular, because
        # 0 · NaN would make the derivatives NaN.
        inner, outer = ca.if_else(large, 0.0, s), ca.if_else(large, s, _SMALL)
        half = 0.5 * ca.sqrt(outer)
        f, g = ca.sin(half) / half, ca.cos(half)
        self.f = ca.if_else(large, f, _series(0.25 * inner, 1))
        self.g = ca.if_else(large, g, _series(0.25 * inner, 0))
        self.c = ca.if_else(large, (1.0 - f * g) / outer, _series(inner, 3))

    def turned(self, centre: Array) -> ca.SX:
        """Return the quaternion of centre · exp(w), (4,)."""
        u, scalar = 0.5 * self.f * self.w, self.g
        if (centre == np.array([0.0, 0.0, 0.0, 1.0])).all():
            return ca.vertcat(u, scalar)
        c, real = ca.DM(centre[:3]), float(centre[3])
        vector_part = real * u + scalar * c + ca.cross(c, u)
        return ca.vertcat(vector_part, real * scalar - ca.dot(c, u))

    def mapped(self, v: ca.SX, sign: float) -> ca.SX:
        """Return J v for sign 1, or Jᵀ v for sign −1, (3,)."""
        across = ca.cross(self.w, v)
        return v - sign * 0.5 * self.f**2 * across + self.c * ca.cross(self.w, across)


def _series(s: ca.SX, first: int) -> ca.SX:
    """Return Σ_k (−s)^k / (2k + first)!."""
    total = ca.SX(0)
    for k in reversed(range(_TERMS)):
        total = 1.0 / factorial(2 * k + first) - s * total
    return total


def _power_gradients(w: Array, u: Array, v: Array) -> Array:
    """Return ∂/∂w of uᵀ J(w) v = u·v − b w·(v × u) + c ((u·w)(w·v) − s u·v), s = |w|², (..., 3)."""

    def dot(x: Array, y: Array) -> Array:
        return np.asarray(np.sum(x * y, axis=-1, keepdims=True))

    s, across = dot(w, w), np.cross(v, u)
    small, k = s < _SMALL, np.arange(_TERMS)
    outer = np.where(small, _SMALL, s)
    theta = np.sqrt(outer)
    sine, inner = np.sin(theta) / theta, np.where(small, -s, 0.0)
    closed_b = (1.0 - np.cos(theta)) / outer
    closed_c = (1.0 - sine) / outer
    slope_of_sine = (np.cos(theta) - sine) / (2.0 * outer)

    def term(first: int, closed: Array, closed_slope: Array) -> tuple[Array, Array]:
        """Return Σ (−s)^k / (2k + first)! and its derivative by s."""
        terms = np.array([1.0 / factorial(2 * int(j) + first) for j in k])
        series = inner**k @ terms
        slope = -(inner ** k[:-1]) @ (k[1:] * terms[1:])
        choose = small[..., 0]
        return (
            np.where(choose, series, closed[..., 0])[..., None],
            np.where(choose, slope, closed_slope[..., 0])[..., None],
        )

    b, slope_b = term(2, closed_b, (0.5 * sine - closed_b) / outer)
    c, slope_c = term(3, closed_c, (-slope_of_sine - closed_c) / outer)
    uw, wv, uv = dot(u, w), dot(w, v), dot(u, v)
    along_w = -slope_b * dot(w, across) + slope_c * (uw * wv - s * uv) - c * uv
    return np.asarray(2.0 * along_w * w - b * across + c * (u * wv + v * uw))


Centre = ArrayLike | Mapping[str, ArrayLike]


def chart_about(
    space: ShapeSpace,
    system: System | None,
    centre: Centre | None,
    current: RotationChart | None = None,
) -> RotationChart:
    """Return the chart about a centre.

    Args:
        space: Shape space.
        system: System whose joint names a table of values uses, or None.
        centre: Centre, (nx,), or {joint: value}, as for x0; None for the shape at rest.
        current: Chart of the connection, if it has one already.
    Returns:
        The chart.
    Raises:
        InputError: A joint does not exist, a quaternion is zero, or there is a chart already.
        ShapeError: The number of values is wrong.
    """
    if current is not None:
        raise InputError("centre: expected none, because the connection already has a centre")
    if centre is None:
        return RotationChart(space, space.neutral)
    ordered: ArrayLike
    if not isinstance(centre, Mapping):
        ordered = centre
    elif system is not None:
        ordered = order_by_joint(centre, system, "centre")
    else:
        raise InputError("centre: expected (nx,) numbers, because the connection has no system")
    values = vector(ordered, space.nx, "centre", space.x_names)
    return RotationChart(space, space.normalized(values, "centre").copy())
