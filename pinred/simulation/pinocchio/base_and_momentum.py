"""The base of a scene, evaluated with NumPy: the rate of its momentum, its attitude and its path.

`Base.rate` is the momentum equation μ̇ = μ × ω + N; reduction/base_parts.py explains the variables.
The compiled route has the same equations in kernels/base_graph.py.
"""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ...lie.rotations import apply, rotation, unit
from ...reduction.base_parts import base_parts, into_body, quaternion_rate, root_of
from ...scene.initial_state import Start
from ..plan import Plan


class Base:
    """The base of one scene: its integrated variables b, and its motion.

    Attributes:
        parts: The integrated variables.
        b0: Initial values of the integrated variables, (parts.size,).
        axes: Directions of the translations, (3, k).
        spin: Constant angular momentum in the fixed frame, (parts.spin,) [N·m·s].
        relative_twist0: Initial body twist relative to the centre of mass, (r,).
        has_momentum: Whether the equations have terms with angular momentum.
        turns: Number of angular momentum components.
    """

    def __init__(self, plan: Plan, start: Start) -> None:
        """Set up the base for a plan and its initial state."""
        system, weight, wrench = plan.system, plan.acting.weight, plan.acting.wrench
        group, root = system.group, root_of(system)
        k = self._k = group.linear
        self._group, self._mass, self.turns = group, system.mass, group.turns
        self.axes, self._g, self._weight = root.axes, root.g, weight
        self._lift = float(root.origin @ root.axes @ root.g)
        self._pivot = float(weight @ root.origin)
        heavy = plan.acting.turned
        attitude, c, P = start.pose[k:], start.com @ root.axes, start.mu[:k]
        about = group.about(start.com, start.mu)
        self.parts = base_parts(
            group, wanted=plan.wanted, heavy=heavy, wrench=wrench, zero_momentum=not about.any()
        )
        self.has_momentum = plan.acting.momentum_changes or bool(about.any())
        self._c0 = start.pose[:k] + group.turned(attitude, c)
        self._v0 = group.turned(attitude, P / system.mass)
        self.spin = self._fixed(attitude, about)[: self.parts.spin]
        down = self._body(attitude, weight / np.linalg.norm(weight)) if self.parts.down else weight
        initial_values = [attitude[: self.parts.attitude], down[: self.parts.down]]
        initial_values += [about[: self.parts.momentum], np.zeros(self.parts.push)]
        self.b0 = np.concatenate(initial_values)
        self.relative_twist0 = start.xi - np.append(P / system.mass, np.zeros(self.turns))
        self._none = np.zeros(system.r)

    def momentum(self, b: Array) -> Array:
        """Return the body momentum (r,) in the frame of the centre of mass."""
        if not (self.parts.momentum or self.parts.spin):
            return self._none
        attitude, _, momentum, _ = self.parts.split(b)
        if self.parts.spin:
            momentum = _into_body(attitude, self.spin) if self.parts.spin == 3 else self.spin
        out = self._none.copy()
        out[self._k :] = momentum
        return out

    def body_weight(self, b: Array) -> Array:
        """Return gravity's force (3,) [N] in the body frame if gravity rotates the base, else 0."""
        if not self._weight.any():
            return self._weight
        attitude, down, _, _ = self.parts.split(b)
        if self.parts.down:
            return np.asarray(np.linalg.norm(self._weight) * down)
        return _into_body(attitude, self._weight)

    def rate(self, b: Array, xi: Array, moment: Array, force: Array) -> Array:
        """Return db/dt.

        Args:
            b: Integrated variables of the base, (parts.size,).
            xi: Body twist relative to the centre of mass, (r,).
            moment: Moment about the centre of mass (for gravity, about the pivot), in the body
                frame [N·m].
            force: Force on the centre of mass in the body frame, (k,) [N].
        Returns:
            Time derivative of b, (parts.size,).
        """
        attitude, down, momentum, push = self.parts.split(b)
        omega = xi[self._k :]
        rates = []
        if self.parts.attitude == 1:
            rates.append(omega)
        elif self.parts.attitude:
            rates.append(quaternion_rate(attitude, omega))
        if self.parts.down:
            rates.append(np.cross(down, omega))
        if self.parts.momentum == 3:
            rates.append(np.cross(momentum, omega) + moment)
        elif self.parts.momentum:
            rates.append(moment)
        if self.parts.push:
            turned = self._group.turned(self._normal(attitude), force)
            rates += [push[self._k :] / self._mass, turned]
        return np.concatenate(rates) if rates else np.empty(0)

    def pose(self, b: Array, com: Array, t: Array) -> Array:
        """Return poses (T, size) from b (T, …), body-frame centres of mass (T, 3), times (T,)."""
        attitude = self._attitude(b)
        p = self._centre(b, t) - self._group.turned(attitude, com @ self.axes)
        return np.concatenate([p, attitude], axis=1)

    def twist(self, b: Array, xi: Array, t: Array) -> Array:
        """Return body twists (T, r) from twists xi relative to the centre of mass."""
        if not self._k:
            return xi
        twists = xi.copy()
        carried = self._linear(b, t) / self._mass
        twists[:, : self._k] += self._group.turned_back(self._attitude(b), carried)
        return twists

    def base_energy(self, b: Array, com: Array, t: Array) -> Array:
        """Return the energy ½ m |ċ|² − m g · c, or −m g · R c_b of a pivoted base, (T,) [J]."""
        energy = np.zeros(len(t))
        if self._k:
            P, c = self._linear(b, t), self._centre(b, t)
            energy += 0.5 * np.sum(P * P, axis=1) / self._mass
            energy -= self._mass * (c @ self._g + self._lift)
        return energy + self.weight_energy(b, com)

    def weight_energy(self, b: Array, com: Array) -> Array:
        """Return the potential energy −m g · R c_b of a pivoted base, (T,) [J]."""
        if not self._weight.any():
            return np.zeros(len(b))
        attitude, down, _, _ = self.parts.split(b)
        if self.parts.down:
            weight = np.linalg.norm(self._weight) * down
        else:
            weight = self._body(self._normal(attitude), self._weight)
        return np.asarray(-np.sum(weight * com, axis=-1) - self._pivot)

    def _attitude(self, b: Array) -> Array:
        return self._normal(self.parts.split(b)[0])

    def _normal(self, attitude: Array) -> Array:
        return unit(attitude) if self.parts.attitude == 4 else attitude

    def _centre(self, b: Array, t: Array) -> Array:
        """Return the centre of mass in the root joint's fixed frame, (T, k) [m]."""
        s = t[:, None]
        path = self._c0 + self._v0 * s + 0.5 * self._g * s**2
        return path + self.parts.split(b)[3][:, : self._k] if self.parts.push else path

    def _linear(self, b: Array, t: Array) -> Array:
        """Return the linear momentum, (T, k) [N s]."""
        P = self._mass * (self._v0 + self._g * t[:, None])
        return P + self.parts.split(b)[3][:, self._k :] if self.parts.push else P

    def _fixed(self, attitude: Array, v: Array) -> Array:
        """Rotate angular components (a,) from the body frame to the fixed frame."""
        return np.asarray(apply(rotation(attitude), v)) if v.shape[-1] == 3 else v

    def _body(self, attitude: Array, v: Array) -> Array:
        """Rotate vectors (..., 3) to the body frame; planar angular components stay."""
        if v.shape[-1] != 3 or attitude.shape[-1] != 4:
            return v
        return into_body(attitude, v)


def _into_body(q: Array, J: Array) -> Array:
    """Return Rᵀ J, (3,), for a quaternion of any length.  Scalar code is faster than NumPy here."""
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
