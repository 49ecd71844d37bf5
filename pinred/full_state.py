"""The full simulation: Pinocchio's ABA on (q, v), and what Pinocchio says is conserved.

This is the other side of every comparison, so it shares nothing with the reduction: its
own kinematics of the root, its own spring torques, other integrators (Hairer's, through
scipy.integrate.ode), momentum and energy by Pinocchio's functions.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.integrate import ode

from .arrays import Array
from .errors import IntegrationError
from .system import System

_MOST_STEPS = 10_000_000


@dataclass(frozen=True)
class FullMotion:
    """A motion in Pinocchio's coordinates.  x: (T, m) unwrapped angles.  q: (T, nq)."""

    x: Array
    q: Array


@dataclass(frozen=True)
class Size:
    """What errors of a motion are measured by.

    shape: the largest |x|, at least 1 [rad | m].  position: the largest coordinate of the
    base, at least the radius of gyration [m].
    """

    shape: float
    position: float


@dataclass(frozen=True)
class Distance:
    """How far two motions are apart, each (T,).

    shape: largest |Δx| [rad | m].  rotation [rad] and position [m]: norms of the parts of
    log(g⁻¹ĝ) of the base.
    """

    shape: Array
    rotation: Array
    position: Array

    def worst(self, size: Size) -> float:
        """Return the largest of all, in units of the motion's size; NaN if there is one."""
        return float(
            np.max([self.shape / size.shape, self.rotation, self.position / size.position])
        )


@dataclass(frozen=True)
class Drift:
    """Largest relative change over a motion.

    energy: over the largest kinetic energy T about the centre of mass.  momentum: of each
    conserved component, angular about the centre of mass if the group translates, over
    √(2mT), for angular ones times the radius of gyration.
    """

    energy: float
    momentum: float


class FullState:
    """Pinocchio's forward dynamics of one system with springs, as an initial value problem.

    The state is y = (root, x, v): root coordinates (position; angle or quaternion), joint
    angles unwrapped, Pinocchio's velocity.
    """

    def __init__(self, system: System, springs: Mapping[str, tuple[float, float]]) -> None:
        """Prepare Pinocchio's work space."""
        self._model, self._data = system.model, system.model.createData()
        self._root = system.model.joints[1]
        self._kind = system.group.name
        self._r, self._m = system.r, system.m
        self._size = {"R": 1, "SO2": 1, "SE2": 3, "SO3": 4, "SE3": 7}[self._kind]
        self._linear = {"R": 1, "SO2": 0, "SE2": 2, "SO3": 0, "SE3": 3}[self._kind]
        # Pinocchio 4.1 leaves the armature of slanted revolute joints out of the kinetic energy.
        self._bare = system.model.copy()
        self._bare.armature = np.zeros(system.n)
        # Axes of the root joint's motion in its fixed frame, (6, r).
        pin.computeJointJacobians(self._model, self._data, pin.neutral(self._model))
        self._axes = np.array(self._data.joints[1].S).reshape(6, self._r)
        names = list(self._model.names)
        stiffness, rest = np.zeros(self._m), np.zeros(self._m)
        for name, (k, x) in springs.items():
            stiffness[names.index(name) - 2], rest[names.index(name) - 2] = k, x
        self._stiffness, self._rest = stiffness, rest

    def state(self, pose: Array, x: Array, xi: Array, xdot: Array) -> Array:
        """Return y for a pose, shape, body twist and shape rate."""
        return np.concatenate([pose, x, xi, xdot])

    def kick(self, y0: Array, time: float, part: float) -> Array:
        """Return y0 with each entry changed by a small part of itself, up or down at random.

        The least change is that part of a radian, of the radius of gyration, or of the
        rate that covers these in the time.
        """
        where = self._size + self._m
        least = np.ones(len(y0))
        least[: self._linear] = self.radius(self.q(y0))
        least[where:] = 1.0 / time
        least[where : where + self._linear] *= self.radius(self.q(y0))
        sign = np.random.default_rng(0).choice([-1.0, 1.0], len(y0))
        return np.asarray(y0 + part * sign * np.maximum(np.abs(y0), least))

    def run(
        self, y0: Array, times: Array, rtol: float, atol: float, *, method: str = "dop853"
    ) -> FullMotion:
        """Integrate from t = 0 and return the motion at `times`.

        method: Hairer's "dop853" or "dopri5", of order 8 or 5.
        Raises IntegrationError if it cannot be followed.
        """
        y = np.empty((len(times), len(y0)))
        solver = ode(self.rate).set_integrator(method, rtol=rtol, atol=atol, nsteps=_MOST_STEPS)
        solver.set_initial_value(y0, 0.0)
        for k, t in enumerate(times):
            if t == 0.0:
                y[k] = y0
                continue
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # its failures are raised below
                y[k] = solver.integrate(t)
            if not (solver.successful() and np.isfinite(y[k]).all()):
                raise IntegrationError(
                    f"the full simulation of '{self._model.name}' cannot be followed to "
                    f"t = {t:g} s at rtol = {rtol:g}"
                )
        return FullMotion(
            x=y[:, self._size : self._size + self._m].copy(),
            q=np.array([self.q(row) for row in y]),
        )

    def rate(self, t: float, y: Array) -> Array:  # noqa: ARG002
        """Return dy/dt with Pinocchio's ABA."""
        size, m = self._size, self._m
        x, v = y[size : size + m], y[size + m :]
        tau = np.zeros(len(v))
        tau[self._r :] = -self._stiffness * (x - self._rest)
        a = pin.aba(self._model, self._data, self.q(y), v, tau)
        return np.concatenate([self._root_rate(y[:size], v[: self._r]), v[self._r :], a])

    def _root_rate(self, root: Array, v: Array) -> Array:
        if self._kind in ("R", "SO2"):
            return v
        if self._kind == "SE2":
            c, s = np.cos(root[2]), np.sin(root[2])
            return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]])
        q = pin.Quaternion(root[-4:])
        spin = pin.Quaternion(np.append(0.5 * v[-3:], 0.0))
        turn = (q * spin).coeffs()
        if self._kind == "SO3":
            return np.asarray(turn)
        return np.concatenate([q.normalized().matrix() @ v[:3], turn])

    def q(self, y: Array) -> Array:
        """Return Pinocchio's configuration of y, (nq,)."""
        root, x = y[: self._size], y[self._size : self._size + self._m]
        parts: list[Array]
        if self._root.nq == self._size:
            parts = [root.copy()]
            if self._size >= 4:
                parts[0][-4:] /= np.linalg.norm(root[-4:])
        else:
            parts = [root[:-1], np.array([np.cos(root[-1]), np.sin(root[-1])])]
        for i, angle in enumerate(x, start=2):
            circle = self._model.joints[i].nq == 2
            parts.append(np.array([np.cos(angle), np.sin(angle)] if circle else [angle]))
        return np.concatenate(parts)

    def distance(self, a: FullMotion, b: FullMotion) -> Distance:
        """Return how far b is from a over time."""
        apart = [
            pin.difference(self._model, p, q)[: self._r] for p, q in zip(a.q, b.q, strict=True)
        ]
        log = np.array(apart)
        return Distance(
            shape=np.abs(b.x - a.x).max(axis=1, initial=0.0),
            rotation=np.linalg.norm(log[:, self._linear :], axis=1),
            position=np.linalg.norm(log[:, : self._linear], axis=1),
        )

    def size(self, motion: FullMotion) -> Size:
        """Return the units in which errors of a motion are judged."""
        travelled = float(np.abs(motion.q[:, : self._linear]).max(initial=0.0))
        return Size(
            shape=float(np.abs(motion.x).max(initial=1.0)),
            position=max(travelled, self.radius(motion.q[0])),
        )

    def radius(self, q: Array) -> float:
        """Return the radius of gyration at q about the centre of mass, √(tr I / m) [m]."""
        pin.ccrba(self._model, self._data, q, np.zeros(self._model.nv))
        return float(np.sqrt(np.trace(self._data.Ig.inertia) / self._data.Ig.mass))

    def drift(self, t: Array, motion: FullMotion, v: Array) -> Drift:
        """Return by how much energy and conserved momentum change along a motion."""
        model, data = self._model, self._data
        energy, total, internal, momentum = [], [], [], []
        for k, q in enumerate(motion.q):
            kinetic = pin.computeKineticEnergy(self._bare, data, q, v[k])
            kinetic += 0.5 * float(model.armature @ v[k] ** 2)
            height = pin.computePotentialEnergy(model, data, q)
            spring = 0.5 * float(self._stiffness @ (motion.x[k] - self._rest) ** 2)
            energy.append(kinetic + height + spring)
            momentum.append(self._conserved(float(t[k]), q, v[k]))
            carried = self._axes[:3].T @ model.jointPlacements[1].rotation.T @ data.hg.linear
            total.append(kinetic)
            internal.append(kinetic - 0.5 * float(carried @ carried) / data.Ig.mass)
        # A body that only falls has no internal motion to measure its changes by.
        most = max(internal) if max(internal) > 1e-9 * max(total) else max(total)
        scale = np.full(self._r, np.sqrt(2.0 * data.Ig.mass * most))
        scale[self._linear :] *= self.radius(motion.q[0])
        energy_change = np.abs(np.array(energy) - energy[0]).max()
        momentum_change = np.abs(np.array(momentum) - momentum[0]).max(axis=0)
        return Drift(
            energy=_ratio(float(energy_change), most),
            momentum=max(map(_ratio, momentum_change.tolist(), scale.tolist())),
        )

    def _conserved(self, t: float, q: Array, v: Array) -> Array:
        """Return the momentum that the symmetry conserves, (r,), in the root's fixed frame.

        Angular momentum is about the centre of mass if the group translates, else about the
        pivot.  What gravity adds to linear momentum, m g t, is taken off.
        """
        model, data = self._model, self._data
        pin.ccrba(model, data, q, v)
        placement = model.jointPlacements[1]
        linear, angular = data.hg.linear, data.hg.angular
        if not self._linear:
            angular = angular + np.cross(data.com[0] - placement.translation, linear)
        linear = linear - data.Ig.mass * model.gravity.linear * t
        to_root = placement.rotation.T
        rotor = model.armature[: self._r] * v[: self._r]
        return np.asarray(self._axes.T @ np.append(to_root @ linear, to_root @ angular) + rotor)


def _ratio(change: float, scale: float) -> float:
    return change / scale if scale > 0.0 else change
