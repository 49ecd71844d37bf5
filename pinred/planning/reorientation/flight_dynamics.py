"""Torques and attitude rates of a robot in flight at many instants, with two derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array
from ...lie.rotations import hat
from ...reduction.tree.dynamics_derivatives import InverseDynamics, Motion
from ...system.system import System


@dataclass(frozen=True, eq=False)
class Instants:
    """States of a flight at N instants.

    Attributes:
        x: Shapes, (N, m).
        u: Shape rates, (N, m).
        q: Attitudes: quaternions (N, 4), or angles (N, 1).
        momentum: Angular momentum about the centre of mass in the axes of the attitudes, (turns,).
        inertia: Locked inertia, (N, r, r).
        coupling: Rows of the base and columns of the shape in the mass matrix, (N, r, m).
        twist: Base twists, (N, r).
        motion: The motion of all bodies.
        momenta: The momenta of all bodies, as wrenches at rest.
        rate: Rates of the attitudes, (N, 4) or (N, 1).
        torque: Torques, (N, m).
    """

    x: Array
    u: Array
    q: Array
    momentum: Array
    inertia: Array
    coupling: Array
    twist: Array
    motion: Motion
    momenta: Motion
    rate: Array
    torque: Array


@dataclass(frozen=True, eq=False)
class Slopes:
    """First derivatives by (x, ẋ, ẍ, q) at N instants.

    Attributes:
        base: Derivatives of the base twists and of their rates, (N, 2r, 3m + size).
        rate: Derivatives of the attitude rates, (N, size, 3m + size).
        torque: Derivatives of the torques, (N, m, 3m + size).
    """

    base: Array
    rate: Array
    torque: Array


class FlightDynamics:
    """Equations of a flight: the momentum about the centre of mass is known and conserved.

    The base twist ξ and its rate follow from H_bb ξ + H_bs ẋ = (0, RᵀL) and from zero wrench on
    the base.
    """

    def __init__(self, system: System) -> None:
        """Prepare the inverse dynamics."""
        self.system, self._inverse = system, InverseDynamics(system)
        self.r, self.m, self.turns = system.r, system.m, system.group.turns
        self.linear = system.group.linear
        self.size = 4 if self.turns == 3 else 1  # of an attitude

    def at(self, x: Array, u: Array, w: Array, q: Array, momentum: Array) -> Instants:
        """Compute twists, accelerations, attitude rates and torques; see `Instants`."""
        bodies = self._inverse.bodies(x)
        H, C = self._inverse.base_rows(bodies)
        mu = np.zeros((len(x), self.r))
        mu[:, self.linear :] = self._body_momentum(q, momentum)
        xi = _solved(H, mu - _times(C, u))
        zero, none = np.zeros_like(xi), np.zeros_like(u)
        bias = self._inverse.motion(bodies, xi, zero, u, w)
        motion = self._inverse.motion(bodies, xi, -_solved(H, bias.wrench), u, w)
        # The momentum H v is the inverse dynamics of the acceleration v at rest.
        momenta = self._inverse.motion(bodies, zero, xi, none, u)
        rate = _times(self._rate_map(q), xi[:, self.linear :])
        return Instants(x, u, q, momentum, H, C, xi, motion, momenta, rate, motion.torque)

    def rates(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return (P, a), (N, turns, turns) and (N, turns), of the angular velocities P RᵀL − a."""
        H, C = self._inverse.base_rows(self._inverse.bodies(x))
        inverse, at = np.asarray(np.linalg.inv(H), dtype=float), slice(self.linear, None)
        return inverse[:, at, at], _times(inverse, _times(C, u))[:, at]

    def attitude_rate(self, q: Array, locked: Array, drift: Array, momentum: Array) -> Array:
        """Return the rate of one attitude q from the entries of `rates`."""
        if self.turns == 1:
            return np.asarray(locked @ momentum - drift)
        x, y, z, w = q.tolist()
        R = np.array(
            [
                [w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)],
                [2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)],
                [2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z],
            ]
        )  # the transpose of the rotation matrix
        a, b, c = (locked @ (R @ momentum) - drift).tolist()
        return 0.5 * np.array(
            [
                w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a,
                -x * a - y * b - z * c,
            ]
        )  # fmt: skip

    def first(self, s: Instants) -> Slopes:
        """Compute the first derivatives by (x, ẋ, ẍ, q)."""
        r, m = self.r, self.m
        wide = 3 * m + self.size
        slopes = np.zeros((len(s.q), r + m, wide))
        slopes[:, :r, :m] = self._inverse.first(s.momenta)[:, :r, 2 * r : 2 * r + m]
        slopes[:, :r, m : 2 * m] = s.coupling
        slopes[:, self.linear : r, 3 * m :] = -self._momentum_slope(s.q, s.momentum)
        twist = -np.linalg.solve(s.inertia, slopes[:, :r])
        first = self._inverse.first(s.motion)
        slopes = first[:, :, :r] @ twist
        slopes[..., : 3 * m] += first[:, :, 2 * r :]
        acceleration = -np.linalg.solve(s.inertia, slopes[:, :r])
        torque = slopes[:, r:] + np.swapaxes(s.coupling, 1, 2) @ acceleration
        rate = self._rate_map(s.q) @ twist[:, self.linear :]
        rate[..., 3 * m :] += self._rate_slope(s.twist[:, self.linear :])
        return Slopes(np.concatenate([twist, acceleration], axis=1), rate, torque)

    def second(self, s: Instants, slopes: Slopes, on_rate: Array, on_torque: Array) -> Array:
        """Compute second derivatives of weighted sums of attitude rates and torques.

        Twists and accelerations of the base are implicit functions, so their equations are added
        with the multipliers that make the sum stationary in them.

        Args:
            s: The instants.
            slopes: First derivatives.
            on_rate: Weights of the attitude rates, (N, size).
            on_torque: Weights of the torques, (N, m).
        Returns:
            Second derivatives by (x, ẋ, ẍ, q), (N, 3m + size, 3m + size).
        """
        r, m, linear = self.r, self.m, self.linear
        eta = -_solved(s.inertia, _times(s.coupling, on_torque))
        by_twist, power = self._inverse.second(s.motion, eta, on_torque)
        by_twist[:, linear:] += _times(np.swapaxes(self._rate_map(s.q), 1, 2), on_rate)
        zeta = -_solved(s.inertia, by_twist)
        _, momenta = self._inverse.second(s.momenta, zeta, np.zeros_like(on_torque))
        wide = 2 * r + 3 * m
        H = np.zeros((len(s.q), wide + self.size, wide + self.size))
        H[:, :wide, :wide] = power
        # The momenta have the twist in place of the acceleration, and ẋ in place of ẍ.
        xi, x = slice(0, r), slice(2 * r, 2 * r + m)
        u, w = slice(2 * r + m, 2 * r + 2 * m), slice(2 * r + 2 * m, wide)
        H[:, x, x] += momenta[:, x, x]
        for to, of in ((xi, slice(r, 2 * r)), (u, w)):
            H[:, x, to] += momenta[:, x, of]
            H[:, to, x] += momenta[:, of, x]
        if self.turns == 3:
            mixed = _rate_mixed(on_rate)
            H[:, wide:, linear:r] += mixed
            H[:, linear:r, wide:] += np.swapaxes(mixed, 1, 2)
            H[:, wide:, wide:] -= _momentum_second(zeta[:, linear:], s.momentum)
        cross = H[:, 2 * r :, : 2 * r] @ slopes.base
        result = H[:, 2 * r :, 2 * r :] + cross + np.swapaxes(cross, 1, 2)
        return np.asarray(
            result + np.swapaxes(slopes.base, 1, 2) @ H[:, : 2 * r, : 2 * r] @ slopes.base
        )

    def _body_momentum(self, q: Array, J: Array) -> Array:
        """Return RᵀJ, or J on a plane."""
        if self.turns == 1:
            return np.broadcast_to(J, q.shape)
        v, w = q[:, :3], q[:, 3:]
        alignment = np.sum(v * J, axis=1, keepdims=True)
        square = w**2 - np.sum(v**2, axis=1, keepdims=True)
        return np.asarray(square * J + 2.0 * v * alignment - 2.0 * w * np.cross(v, J))

    def _momentum_slope(self, q: Array, J: Array) -> Array:
        if self.turns == 1:
            return np.zeros((len(q), 1, 1))
        v, w = q[:, :3], q[:, 3:]
        alignment = np.sum(v * J, axis=1)[:, None, None]
        slope = np.empty((len(q), 3, 4))
        slope[..., :3] = 2.0 * (
            alignment * np.eye(3) + v[:, :, None] * J - J[:, None] * v[:, None]
            + w[..., None] * hat(J)
        )  # fmt: skip
        slope[..., 3] = 2.0 * (w * J - np.cross(v, J))
        return slope

    def _rate_map(self, q: Array) -> Array:
        """Return Q with q̇ = Q ω."""
        if self.turns == 1:
            return np.ones((len(q), 1, 1))
        v, w = q[:, :3], q[:, 3:, None]
        return 0.5 * np.concatenate([w * np.eye(3) + hat(v), -v[:, None]], axis=1)

    def _rate_slope(self, omega: Array) -> Array:
        if self.turns == 1:
            return np.zeros((len(omega), 1, 1))
        slope = np.zeros((len(omega), 4, 4))
        slope[:, :3, :3] = -0.5 * hat(omega)
        slope[:, :3, 3], slope[:, 3, :3] = 0.5 * omega, -0.5 * omega
        return slope


def _momentum_second(z: Array, J: Array) -> Array:
    second = np.zeros((len(z), 4, 4))
    alignment = (z @ J)[:, None, None]
    outer = z[:, :, None] * J
    second[:, :3, :3] = 2.0 * (outer + np.swapaxes(outer, 1, 2) - alignment * np.eye(3))
    second[:, 3:, 3:] = 2.0 * alignment
    second[:, :3, 3] = second[:, 3, :3] = -2.0 * np.cross(J, z)
    return second


def _rate_mixed(p: Array) -> Array:
    v, s = p[:, :3], p[:, 3:, None]
    return 0.5 * np.concatenate([-hat(v) - s * np.eye(3), v[:, None]], axis=1)


def _solved(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.linalg.solve(matrices, vectors[..., None]))[..., 0]


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray(matrices @ vectors[..., None])[..., 0]
