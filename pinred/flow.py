"""The reduced flow of a scene: its vector field, and the full state behind a reduced one.

The reduced state is (x, π, attitude): shape, canonical shape momentum in the frame of
the centre of mass, and as much of the base as has to be integrated.
"""

from __future__ import annotations

import numpy as np

from .arrays import Array
from .base import BASES
from .canonical import CanonicalForm
from .errors import IntegrationError
from .potential import Potential
from .scene import Scene
from .trajectory import State


class ReducedFlow:
    """What an integrator needs of a scene, by Pinocchio's numbers.  Not thread-safe."""

    def __init__(self, scene: Scene) -> None:
        """Set up the flow.  Raises SymmetryError if gravity breaks the symmetry."""
        system, start = scene.system, scene.start
        self._system = system
        self._potential = Potential(system, scene.springs)
        self._form = CanonicalForm(system, self._potential)
        H = symmetric(self._form.mass_matrix(start.x))
        self._base = BASES[system.group.name](system, start, self._form.com())
        v = np.concatenate([self._base.relative_twist0, start.xdot])
        pi = H[system.r :] @ v
        self.y0 = np.concatenate([start.x, pi, self._base.attitude0])

    @property
    def has_spin(self) -> bool:
        """Whether there is angular momentum, so that terms with it are needed."""
        return bool(self._base.spin.any())

    def rate(self, t: float, y: Array) -> Array:  # noqa: ARG002
        """Return dy/dt, (k,)."""
        m, r = self._system.m, self._system.r
        x, attitude = y[:m], y[2 * m :]
        momentum = np.concatenate([self._base.momentum(attitude), y[m : 2 * m]])
        v = self._form.velocity(x, momentum)
        return np.concatenate([v[r:], self._form.force(x, v), self._base.rate(attitude, v[:r])])

    def states(self, t: Array, y: Array) -> State:
        """Return the full states at times t (T,) of reduced states y (T, k)."""
        system, form, base = self._system, self._form, self._base
        m, r, T = system.m, system.r, len(t)
        x, attitude = y[:, :m].copy(), y[:, 2 * m :].copy()
        v, com, potential = np.empty((T, system.n)), np.empty((T, 3)), np.empty(T)
        H = np.empty((T, system.n, system.n))
        for k in range(T):
            momentum = np.concatenate([base.momentum(attitude[k]), y[k, m : 2 * m]])
            v[k] = form.velocity(x[k], momentum)
            com[k] = form.com()
            H[k] = symmetric(form.mass_matrix(x[k]))
            potential[k] = self._potential.value(x[k])
        pose = base.pose(attitude, com, t)
        v[:, :r] = base.twist(attitude, v[:, :r], t)
        if not (np.isfinite(v).all() and np.isfinite(pose).all()):
            bad = t[~(np.isfinite(v).all(axis=1) & np.isfinite(pose).all(axis=1))][0]
            raise IntegrationError(f"the motion of '{system.name}' is not finite at t = {bad:g} s")
        p = (H @ v[:, :, None])[:, :, 0]
        mu = p[:, :r].copy()
        kinetic = 0.5 * np.sum(v * p, axis=1)
        return State(
            t=t.copy(),
            x=x,
            xdot=v[:, r:].copy(),
            xi=v[:, :r].copy(),
            pose=pose,
            q=system.q(pose, x),
            v=v,
            body_momentum=mu,
            spatial_momentum=system.group.spatial_momentum(pose, mu),
            energy=kinetic + potential + base.falling_energy(system.mass, t),
        )

    def entry_name(self, entry: int) -> str:
        """Return what an entry of the reduced state is, for messages."""
        m = self._system.m
        if entry >= 2 * m:
            return f"the attitude of the root joint '{self._system.root_name}'"
        what = "the position" if entry < m else "the momentum"
        return f"{what} of joint '{self._system.shape_names[entry % m]}'"


def symmetric(upper: Array) -> Array:
    """Return the matrix whose upper triangle CRBA filled."""
    return np.asarray(np.triu(upper) + np.triu(upper, 1).T)
