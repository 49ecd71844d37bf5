"""The base in the reduced graph: its symbols, its momentum, its rates (see base_parts.py)."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import casadi as ca

from ..reduction.base_parts import BaseParts, root_of
from ..reduction.tree.scalars import Scalar, Vec, add, cross, dot, mul, plus, sub, total
from ..system.system import System


@dataclass(frozen=True)
class Full:
    """The base's full state, as in State.  energy: of the motion and fall of the centre of mass."""

    pose: list[Scalar]
    xi: list[Scalar]
    body_momentum: list[Scalar]
    spatial_momentum: list[Scalar]
    energy: Scalar


class BaseGraph:
    """The base of one system as expressions.

    b: its integrated numbers.  spin: the constant angular momentum.  weight: (3,) m g in the
    root joint's fixed frame where it turns the base, else None.
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
        """Make the symbols.  lifted: see Structure.  mass: of the system, if it is not its own."""
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
        """Return μ in the frame of the centre of mass: without linear part, in the body's axes."""
        if self.parts.momentum:
            angular: list[Scalar] = list(self.momentum)
        elif self.parts.spin:
            lifted = self._lifted and self.parts.attitude == 4
            angular = _lift(self.attitude, self.spin) if lifted else self._turned_back(self.spin)
        else:
            return [0.0] * self._r
        return [0.0] * self._k + angular

    def body_weight(self) -> Vec | None:
        """Return the weight that turns the base, (3,) in its frame."""
        if self._weight is None:
            return None
        if self.parts.down:
            size = ca.sqrt(total([mul(w, w) for w in self._weight]))
            return [mul(size, d) for d in self.down]
        return self._turned_back(self._weight)

    def rates(
        self, xi: list[Scalar], com: Vec, wrench: list[Scalar], weight: Vec | None
    ) -> list[Scalar]:
        """Return the rates of b for the relative body twist ξ (r,).

        com: (3,) in the body's frame.  wrench: (r,) at its origin, or none at all.
        """
        out: list[Scalar] = []
        omega = xi[self._k :]
        if self.parts.attitude == 1:
            out += omega
        elif self.parts.attitude:
            out += _quaternion_rate(self.attitude, omega)
        if self.parts.down:
            out += cross(self.down, omega)
        if self.parts.momentum:
            moment: list[Scalar] = [0.0] * self.parts.momentum
            if self.parts.momentum == 3:
                moment = cross(self.momentum, omega)
            if wrench:
                moment = plus(moment, self.about(com, wrench))
            if weight is not None:
                moment = plus(moment, cross(com, weight))
            out += moment
        if self.parts.push:
            out += [mul(1.0 / self._mass, P) for P in self.push[self._k :]]
            out += self.turned(wrench[: self._k])
        return out

    def along(self, com: Vec) -> list[Scalar]:
        """Return the part of the centre of mass along the group's translations, (k,)."""
        axes = self._root.axes.T.tolist()
        return [dot(axis, com) for axis in axes]

    def about(self, com: Vec, wrench: list[Scalar]) -> list[Scalar]:
        """Return the angular part about the centre of mass, N − c × F, of a wrench or momentum."""
        moment = self._moment(com, wrench[: self._k])
        return [sub(a, b) for a, b in zip(wrench[self._k :], moment, strict=True)]

    def turned_angular(self, v: list[Scalar]) -> list[Scalar]:
        """Return an angular part in the fixed frame."""
        return rotated(self.attitude, v, 1.0) if len(v) == 3 else list(v)

    def full(
        self, xi: list[Scalar], mu: list[Scalar], com: Vec, t: Scalar, line: list[Scalar]
    ) -> Full:
        """Return the base's full state at a time from what is relative to the centre of mass.

        xi, mu: (r,).  line: (3k,) where the centre of mass begins, how fast, and how it falls.
        """
        k, m = self._k, self._mass
        c0, v0, g = line[:k], line[k : 2 * k], line[2 * k :]
        c = [c0[i] + v0[i] * t + 0.5 * g[i] * t * t for i in range(k)]
        P = [m * (v0[i] + g[i] * t) for i in range(k)]
        if self.push:
            c = plus(c, self.push[:k])
            P = plus(P, self.push[k:])
        shift, about = self.along(com), mu[k:]
        size = ca.sqrt(sum(a * a for a in self.attitude)) if len(self.attitude) == 4 else 1.0
        moved = self.turned(shift)
        place = [sub(a, b) for a, b in zip(c, moved, strict=True)]
        carried = self._linear_back(P)
        origin = (self._root.origin @ self._root.axes).tolist()
        spatial = self.turned_angular(about)
        return Full(
            pose=place + [a / size for a in self.attitude],
            xi=[add(a, mul(1.0 / m, b)) for a, b in zip(xi, carried, strict=False)] + xi[k:],
            body_momentum=carried + plus(self._moment(self._in_space(shift), carried), about),
            spatial_momentum=P + plus(self._moment(self._in_space(c), P), spatial),
            energy=0.5 / m * dot(P, P) - m * dot(g, plus(c, origin)),
        )

    def _in_space(self, v: list[Scalar]) -> Vec:
        """Return a linear part, (k,), as a vector of space."""
        out: Vec = [0.0, 0.0, 0.0]
        for axis, entry in zip(self._group.axes, v, strict=False):
            out[axis] = entry
        return out

    def _moment(self, c: Vec, P: list[Scalar]) -> list[Scalar]:
        """Return c × P about the group's axes.  c: (3,).  P: (k,)."""
        moment = cross(c, self._in_space(P))
        return [moment[axis - 3] for axis in self._group.axes[self._k :]]

    def _turned_back(self, v: list[Scalar]) -> list[Scalar]:
        """Return an angular part, or any (3,), in the body's frame."""
        return rotated(self.attitude, v, -1.0) if len(v) == 3 else list(v)

    def turned(self, v: list[Scalar]) -> list[Scalar]:
        """Return a linear part in the fixed frame."""
        if self._group.plane:
            *rest, x, y = v
            c, s = ca.cos(self.attitude[0]), ca.sin(self.attitude[0])
            return [*rest, sub(mul(c, x), mul(s, y)), add(mul(s, x), mul(c, y))]
        return self.turned_angular(v) if self._group.turns == 3 else list(v)

    def _linear_back(self, v: list[Scalar]) -> list[Scalar]:
        """Return a linear part in the body's frame."""
        if self._group.plane:
            *rest, x, y = v
            c, s = ca.cos(self.attitude[0]), ca.sin(self.attitude[0])
            return [*rest, add(mul(c, x), mul(s, y)), sub(mul(c, y), mul(s, x))]
        return self._turned_back(v) if self._group.turns == 3 else list(v)


def rotated(q: list[Scalar], v: list[Scalar], sign: float) -> list[Scalar]:
    """Return R v, or Rᵀ v for sign −1, by a quaternion (x, y, z, w) of any length."""
    u, w = [mul(sign, c) for c in q[:3]], q[3]
    scale = 2.0 / (sum(c * c for c in u) + w * w)
    t = cross(u, v)
    turned = cross(u, t)
    return [add(v[i], mul(scale, add(mul(w, t[i]), turned[i]))) for i in range(3)]


def _lift(q: list[Scalar], v: list[Scalar]) -> list[Scalar]:
    """Return q̄ v q, which is |q|² Rᵀ v, by a quaternion (x, y, z, w)."""
    u, w = [mul(-1.0, c) for c in q[:3]], q[3]
    square = add(dot(u, u), mul(w, w))
    t = cross(u, v)
    turned = cross(u, t)
    return [add(mul(square, v[i]), mul(2.0, add(mul(w, t[i]), turned[i]))) for i in range(3)]


def _quaternion_rate(q: list[Scalar], omega: list[Scalar]) -> list[Scalar]:
    """Return ½ q ω."""
    x, y, z, w = q
    a, b, c = omega
    return [
        0.5 * (w * a + y * c - z * b),
        0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y * a),
        -0.5 * (x * a + y * b + z * c),
    ]
