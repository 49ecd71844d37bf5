"""How the base follows the shape: what of it is integrated, what is known in closed form.

Translations are never integrated.  In the frame of the centre of mass the linear
momentum is zero; the centre of mass itself moves on c0 + v0 t + ½ g t², and the base is
where that puts it, p = c − R c_b(x).  Of the rotation, the attitude is integrated and
the angular momentum is not: it is a constant of SO(2) and SE(2), and turns with the
body, Rᵀ J, in SO(3) and SE(3).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .arrays import Array
from .lie import SE2, SE3, SO2, SO3, R
from .potential import falling, translations
from .rotations import apply, plane_rotation, rotation
from .scene import Start
from .system import System


@dataclass(frozen=True)
class CentreLine:
    """The path of the centre of mass in the root joint's fixed frame, c0 + v0 t + ½ g t²."""

    c0: Array
    v0: Array
    g: Array
    lift: float  # g · origin of the root joint's fixed frame, for potential energy

    def position(self, t: Array) -> Array:
        """Return c(t), (..., k) [m], for t (..., 1) [s]."""
        return self.c0 + self.v0 * t + 0.5 * self.g * t**2

    def velocity(self, t: Array) -> Array:
        """Return ċ(t), (..., k) [m/s], for t (..., 1) [s]."""
        return self.v0 + self.g * t


def _line(system: System, c0: Array, P0: Array) -> CentreLine:
    """Return the path from the initial place (k,) and linear momentum (k,)."""
    g, origin = falling(system), system.model.jointPlacements[1]
    lift = float(origin.translation @ origin.rotation @ translations(system) @ g)
    return CentreLine(c0=c0, v0=P0 / system.mass, g=g, lift=lift)


class Base(ABC):
    """The base of one group, from one initial state.

    attitude0: the integrated coordinates of the base at the start.
    relative_twist0: (r,) initial body twist as seen from the centre of mass's frame.
    momentum: from attitude to body momentum (r,) in that frame; a constant where it is one.
    spin: the constant behind it, angular momentum in the fixed frame, (0,), (1,) or (3,).
    """

    attitude0: Array
    relative_twist0: Array
    momentum: Callable[[Array], Array]
    spin: Array

    @abstractmethod
    def __init__(self, system: System, start: Start, com: Array) -> None:
        """Take over the initial state; com: (3,) centre of mass in the body's frame."""

    @abstractmethod
    def rate(self, attitude: Array, xi: Array) -> Array:
        """Return the rate of the attitude for body twist ξ."""

    @abstractmethod
    def pose(self, attitude: Array, com: Array, t: Array) -> Array:
        """Return the pose (T, size) from attitude (T, …), body-frame com (T, 3), times (T,)."""

    @abstractmethod
    def twist(self, attitude: Array, xi: Array, t: Array) -> Array:
        """Return the body twist (T, r) from the one relative to the centre of mass."""

    def falling_energy(self, mass: float, t: Array) -> Array:  # noqa: ARG002
        """Return −m g · c(t), (T,) [J]: the potential energy of what falls."""
        return np.zeros(len(t))

    def carried_energy(self, mass: float, t: Array) -> Array:  # noqa: ARG002
        """Return ½ m |ċ|², (T,) [J]: the kinetic energy of the centre of mass's motion."""
        return np.zeros(len(t))

    def turning_energy(self, attitude: Array, xi: Array) -> Array:
        """Return half the spin times the turning rate, (T,) [J]; xi: (T, r) body twist."""
        if self.spin.size == 0:
            return np.zeros(len(xi))
        rate = xi[:, -self.spin.size :]
        if self.spin.size == 3:
            rate = apply(rotation(SO3.normalize(attitude)), rate)
        return np.asarray(0.5 * rate @ self.spin)

    def spatial_momentum(self, mass: float, t: Array) -> Array:  # noqa: ARG002
        """Return J(t), (T, r), about the origin of the root joint's fixed frame."""
        return np.broadcast_to(self.spin, (len(t), len(self.spin))).copy()


class _Carried(Base):
    """A base that goes where the centre of mass does.  line: the path of that."""

    line: CentreLine

    def falling_energy(self, mass: float, t: Array) -> Array:
        height = self.line.position(t[:, None]) @ self.line.g + self.line.lift
        return np.asarray(-mass * height)

    def carried_energy(self, mass: float, t: Array) -> Array:
        return np.asarray(0.5 * mass * np.sum(self.line.velocity(t[:, None]) ** 2, axis=1))

    def spatial_momentum(self, mass: float, t: Array) -> Array:
        c, P = self.line.position(t[:, None]), mass * self.line.velocity(t[:, None])
        if not self.spin.size:
            return P
        if self.spin.size == 1:
            about = (c[:, :1] * P[:, 1:] - c[:, 1:] * P[:, :1]) + self.spin
        else:
            about = np.cross(c, P) + self.spin
        return np.concatenate([P, about], axis=1)


def constant(value: Array) -> Callable[[Array], Array]:
    """Return the function that always returns `value`."""
    return lambda _: value


class _Line(_Carried):
    """ℝ: nothing to integrate; the base is where the centre of mass puts it."""

    def __init__(self, system: System, start: Start, com: Array) -> None:
        self._axis = translations(system)
        self.line = _line(system, start.pose + com @ self._axis, start.mu)
        self.attitude0 = np.empty(0)
        self.relative_twist0 = start.xi - self.line.v0
        self.spin = np.empty(0)
        self.momentum = constant(np.zeros(1))

    def rate(self, attitude: Array, xi: Array) -> Array:  # noqa: ARG002
        return attitude

    def pose(self, attitude: Array, com: Array, t: Array) -> Array:  # noqa: ARG002
        return self.line.position(t[:, None]) - com @ self._axis

    def twist(self, attitude: Array, xi: Array, t: Array) -> Array:  # noqa: ARG002
        return xi + self.line.velocity(t[:, None])


class _Turn(Base):
    """SO(2): the momentum is one constant, the angle a quadrature."""

    def __init__(self, system: System, start: Start, com: Array) -> None:  # noqa: ARG002
        self.attitude0, self.relative_twist0 = start.pose, start.xi
        self.spin = start.mu
        self.momentum = constant(start.mu)

    def rate(self, attitude: Array, xi: Array) -> Array:  # noqa: ARG002
        return xi

    def pose(self, attitude: Array, com: Array, t: Array) -> Array:  # noqa: ARG002
        return attitude

    def twist(self, attitude: Array, xi: Array, t: Array) -> Array:  # noqa: ARG002
        return xi


class _Plane(_Carried):
    """SE(2): centre of mass on its line, angular momentum about it one constant."""

    def __init__(self, system: System, start: Start, com: Array) -> None:
        R, c = plane_rotation(start.pose[2]), com[:2]
        self.line = _line(system, start.pose[:2] + R @ c, R @ start.mu[:2])
        self.attitude0 = start.pose[2:]
        self.relative_twist0 = start.xi - np.append(R.T @ self.line.v0, 0.0)
        self.spin = start.mu[2:] - (c[0] * start.mu[1] - c[1] * start.mu[0])
        self.momentum = constant(np.array([0.0, 0.0, self.spin[0]]))

    def rate(self, attitude: Array, xi: Array) -> Array:  # noqa: ARG002
        return xi[2:]

    def pose(self, attitude: Array, com: Array, t: Array) -> Array:
        p = self.line.position(t[:, None]) - apply(plane_rotation(attitude[:, 0]), com[:, :2])
        return np.concatenate([p, attitude], axis=1)

    def twist(self, attitude: Array, xi: Array, t: Array) -> Array:
        out = xi.copy()
        out[:, :2] += apply(plane_rotation(-attitude[:, 0]), self.line.velocity(t[:, None]))
        return out


class _Attitude(Base):
    """SO(3): the quaternion is integrated; the momentum is J in the body's frame."""

    def __init__(self, system: System, start: Start, com: Array) -> None:  # noqa: ARG002
        self.attitude0, self.relative_twist0 = start.pose, start.xi
        J = self.spin = rotation(start.pose) @ start.mu
        self.momentum = (lambda q: into_body(q, J)) if J.any() else constant(J)

    def rate(self, attitude: Array, xi: Array) -> Array:
        return quaternion_rate(attitude, xi)

    def pose(self, attitude: Array, com: Array, t: Array) -> Array:  # noqa: ARG002
        return SO3.normalize(attitude)

    def twist(self, attitude: Array, xi: Array, t: Array) -> Array:  # noqa: ARG002
        return xi


class _Free(_Carried):
    """SE(3): centre of mass on its line, the rest as SO(3) about it."""

    def __init__(self, system: System, start: Start, com: Array) -> None:
        q = start.pose[3:]
        R = rotation(q)
        self.line = _line(system, start.pose[:3] + R @ com, R @ start.mu[:3])
        self.attitude0 = q
        self.relative_twist0 = start.xi - np.append(R.T @ self.line.v0, np.zeros(3))
        J = self.spin = R @ (start.mu[3:] - np.cross(com, start.mu[:3]))
        none = np.zeros(3)
        self.momentum = constant(np.zeros(6))
        if J.any():
            self.momentum = lambda q: np.concatenate([none, into_body(q, J)])

    def rate(self, attitude: Array, xi: Array) -> Array:
        return quaternion_rate(attitude, xi[3:])

    def pose(self, attitude: Array, com: Array, t: Array) -> Array:
        q = SO3.normalize(attitude)
        p = self.line.position(t[:, None]) - apply(rotation(q), com)
        return np.concatenate([p, q], axis=1)

    def twist(self, attitude: Array, xi: Array, t: Array) -> Array:
        back = np.swapaxes(rotation(SO3.normalize(attitude)), 1, 2)
        out = xi.copy()
        out[:, :3] += apply(back, self.line.velocity(t[:, None]))
        return out


def into_body(q: Array, J: Array) -> Array:
    """Return Rᵀ J, (3,), for a quaternion of any length; scalar code, as it runs at every step."""
    x, y, z, w = q.tolist()
    a, b, c = J.tolist()
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    # t = J × u, then J + scale (w t + t × u): the rotation by the conjugate quaternion.
    t1, t2, t3 = b * z - c * y, c * x - a * z, a * y - b * x
    return np.array(
        [
            a + scale * (w * t1 + t2 * z - t3 * y),
            b + scale * (w * t2 + t3 * x - t1 * z),
            c + scale * (w * t3 + t1 * y - t2 * x),
        ]
    )


def quaternion_rate(q: Array, omega: Array) -> Array:
    """Return ½ q ω, (4,); scalar code, as it runs at every step."""
    x, y, z, w = q.tolist()
    a, b, c = omega.tolist()
    return 0.5 * np.array(
        [
            w * a + y * c - z * b,
            w * b + z * a - x * c,
            w * c + x * b - y * a,
            -x * a - y * b - z * c,
        ]
    )


BASES: dict[str, type[Base]] = {
    R.name: _Line, SO2.name: _Turn, SE2.name: _Plane, SO3.name: _Attitude, SE3.name: _Free,
}  # fmt: skip
