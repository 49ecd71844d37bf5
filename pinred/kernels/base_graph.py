"""CasADi expressions for the base: its symbols, momentum and rates (see base_parts.py)."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import casadi as ca

from ..reduction.base_parts import BaseParts, root_of
from ..reduction.tree.scalars import (
    Scalar,
    Vec,
    add,
    cross,
    dot,
    mul,
    plus,
    quaternion_rate,
    sub,
    total,
)
from ..system.system import System


@dataclass(frozen=True)
class FullBase:
    """CasADi expressions for the base fields of State.

    Attributes:
        pose: Pose coordinates, (size,).
        xi: Body twist, (r,).
        body_momentum: Body momentum, (r,).
        spatial_momentum: Spatial momentum, (r,).
        energy: Kinetic and potential energy of the centre-of-mass motion.
    """

    pose: list[Scalar]
    xi: list[Scalar]
    body_momentum: list[Scalar]
    spatial_momentum: list[Scalar]
    energy: Scalar


class BaseGraph:
    """CasADi expressions for the state and the rates of the base of one system.

    Attributes:
        parts: Numbers of integrated and constant entries (see BaseParts).
        attitude: Angle or quaternion of the base.
        down: Unit vector of gravity in the body frame.
        momentum: Angular momentum in the body frame, about the centre of mass.
        push: Displacement and momentum of the centre of mass caused by a wrench.
        b: All integrated entries of the base, in the order of the attributes above.
        spin: Constant angular momentum in the fixed frame.
    """

    def __init__(
        self,
        system: System,
        parts: BaseParts,
        weight: Vec | None,
        *,
        lifted: bool = False,
        mass: Scalar = None,
    ) -> None:
        """Create the symbols.

        Args:
            system: The system.
            parts: How many base variables of each kind are integrated or constant.
            weight: Gravity force m g in the root joint's fixed frame, (3,), if it rotates the base.
            lifted: See Structure.
            mass: Mass of the system, if it is a variable parameter.
        """
        self._lifted = lifted
        self._k, self._r = system.group.linear, system.r
        self._mass = system.mass if mass is None else mass
        self._group, self.parts = system.group, parts
        self._weight = weight
        self._root = root_of(system)
        names = ("attitude", "down", "momentum", "push")
        self.attitude, self.down, self.momentum, self.push = (
            [ca.SX.sym(f"{name}{i}") for i in range(count)]
            for name, count in zip(names, astuple(parts)[:4], strict=True)
        )
        self.b = [*self.attitude, *self.down, *self.momentum, *self.push]
        self.spin = [ca.SX.sym(f"spin{i}") for i in range(parts.spin)]

    def body_momentum(self) -> list[Scalar]:
        """Return μ relative to the centre of mass, in body axes; its linear part is zero."""
        if self.parts.momentum:
            angular: list[Scalar] = list(self.momentum)
        elif self.parts.spin:
            lifted = self._lifted and self.parts.attitude == 4
            angular = _lift(self.attitude, self.spin) if lifted else self._to_body(self.spin)
        else:
            return [0.0] * self._r
        return [0.0] * self._k + angular

    def body_weight(self) -> Vec | None:
        """Return the gravity force that rotates the base, (3,) in the body frame, or None."""
        if self._weight is None:
            return None
        if self.parts.down:
            norm = ca.sqrt(total([mul(w, w) for w in self._weight]))
            return [mul(norm, d) for d in self.down]
        return self._to_body(self._weight)

    def rates(
        self, xi: list[Scalar], com: Vec, wrench: list[Scalar], weight: Vec | None
    ) -> list[Scalar]:
        """Compute the rates of the base entries b.

        Args:
            xi: Body twist relative to the centre of mass, (r,).
            com: Centre of mass in the body frame, (3,).
            wrench: Wrench at the base's origin, (r,), or empty.
            weight: Gravity force in the body frame, (3,), or None.
        Returns:
            The rates, as many as b has entries.
        """
        rates: list[Scalar] = []
        omega = xi[self._k :]
        if self.parts.attitude == 1:
            rates += omega
        elif self.parts.attitude:
            rates += quaternion_rate(self.attitude, omega)
        if self.parts.down:
            rates += cross(self.down, omega)
        if self.parts.momentum:
            moment: list[Scalar] = [0.0] * self.parts.momentum
            if self.parts.momentum == 3:
                moment = cross(self.momentum, omega)
            if wrench:
                moment = plus(moment, self.about(com, wrench))
            if weight is not None:
                moment = plus(moment, cross(com, weight))
            rates += moment
        if self.parts.push:
            rates += [mul(1.0 / self._mass, P) for P in self.push[self._k :]]
            rates += self.turned(wrench[: self._k])
        return rates

    def along(self, com: Vec) -> list[Scalar]:
        """Return the components (k,) of the centre of mass along the group's translations."""
        axes = self._root.axes.T.tolist()
        return [dot(axis, com) for axis in axes]

    def about(self, com: Vec, wrench: list[Scalar]) -> list[Scalar]:
        """Return the angular part N − c × F of a wrench or momentum about the centre of mass c."""
        moment = self._moment(com, wrench[: self._k])
        return [sub(a, b) for a, b in zip(wrench[self._k :], moment, strict=True)]

    def turned_angular(self, v: list[Scalar]) -> list[Scalar]:
        """Rotate the angular part of a twist or momentum from the body to the fixed frame."""
        return rotated(self.attitude, v, 1.0) if len(v) == 3 else list(v)

    def full(
        self, xi: list[Scalar], mu: list[Scalar], com: Vec, t: Scalar, com_path: list[Scalar]
    ) -> FullBase:
        """Compute the full state of the base from quantities relative to the centre of mass.

        Args:
            xi: Body twist relative to the centre of mass, (r,).
            mu: Body momentum relative to the centre of mass, (r,).
            com: Centre of mass in the body frame, (3,).
            t: Time.
            com_path: Centre-of-mass path (c0, v0, g), (3k,).
        Returns:
            The full state.
        """
        k, m = self._k, self._mass
        c0, v0, g = com_path[:k], com_path[k : 2 * k], com_path[2 * k :]
        c = [c0[i] + v0[i] * t + 0.5 * g[i] * t * t for i in range(k)]
        P = [m * (v0[i] + g[i] * t) for i in range(k)]
        if self.push:
            c = plus(c, self.push[:k])
            P = plus(P, self.push[k:])
        shift, about = self.along(com), mu[k:]
        norm = ca.sqrt(sum(a * a for a in self.attitude)) if len(self.attitude) == 4 else 1.0
        position = [sub(a, b) for a, b in zip(c, self.turned(shift), strict=True)]
        body_P = self._linear_to_body(P)
        origin = (self._root.origin @ self._root.axes).tolist()
        spatial = self.turned_angular(about)
        return FullBase(
            pose=position + [a / norm for a in self.attitude],
            xi=[add(a, mul(1.0 / m, b)) for a, b in zip(xi, body_P, strict=False)] + xi[k:],
            body_momentum=body_P + plus(self._moment(self._in_space(shift), body_P), about),
            spatial_momentum=P + plus(self._moment(self._in_space(c), P), spatial),
            energy=0.5 / m * dot(P, P) - m * dot(g, plus(c, origin)),
        )

    def _in_space(self, v: list[Scalar]) -> Vec:
        """Return the linear part (k,) of a twist or momentum as a vector in space, (3,)."""
        vector: Vec = [0.0, 0.0, 0.0]
        for axis, entry in zip(self._group.axes, v, strict=False):
            vector[axis] = entry
        return vector

    def _moment(self, c: Vec, P: list[Scalar]) -> list[Scalar]:
        """Return the components of c × P about the group's rotation axes; c is (3,), P is (k,)."""
        moment = cross(c, self._in_space(P))
        return [moment[axis - 3] for axis in self._group.axes[self._k :]]

    def _to_body(self, v: list[Scalar]) -> list[Scalar]:
        """Rotate an angular part, or any vector (3,), from the fixed to the body frame."""
        return rotated(self.attitude, v, -1.0) if len(v) == 3 else list(v)

    def turned(self, v: list[Scalar]) -> list[Scalar]:
        """Rotate the linear part of a twist or momentum from the body to the fixed frame."""
        if self._group.plane:
            *normal, x, y = v
            c, s = ca.cos(self.attitude[0]), ca.sin(self.attitude[0])
            return [*normal, sub(mul(c, x), mul(s, y)), add(mul(s, x), mul(c, y))]
        return self.turned_angular(v) if self._group.turns == 3 else list(v)

    def _linear_to_body(self, v: list[Scalar]) -> list[Scalar]:
        """Rotate the linear part of a twist or momentum from the fixed to the body frame."""
        if self._group.plane:
            *normal, x, y = v
            c, s = ca.cos(self.attitude[0]), ca.sin(self.attitude[0])
            return [*normal, add(mul(c, x), mul(s, y)), sub(mul(c, y), mul(s, x))]
        return self._to_body(v) if self._group.turns == 3 else list(v)


def rotated(q: list[Scalar], v: list[Scalar], sign: float) -> list[Scalar]:
    """Rotate a vector by a quaternion of any norm.

    Args:
        q: Quaternion (x, y, z, w).
        v: Vector, (3,).
        sign: 1 for R v, −1 for Rᵀ v.
    Returns:
        The rotated vector, (3,).
    """
    u, w = [mul(sign, c) for c in q[:3]], q[3]
    scale = 2.0 / (sum(c * c for c in u) + w * w)
    t = cross(u, v)
    u_t = cross(u, t)
    return [add(v[i], mul(scale, add(mul(w, t[i]), u_t[i]))) for i in range(3)]


def _lift(q: list[Scalar], v: list[Scalar]) -> list[Scalar]:
    """Return q̄ v q = |q|² Rᵀ v for a quaternion (x, y, z, w)."""
    u, w = [mul(-1.0, c) for c in q[:3]], q[3]
    square = add(dot(u, u), mul(w, w))
    t = cross(u, v)
    u_t = cross(u, t)
    return [add(mul(square, v[i]), mul(2.0, add(mul(w, t[i]), u_t[i]))) for i in range(3)]
