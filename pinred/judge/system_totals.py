"""Energies, momenta, gravity loads and size of the whole system, computed with Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..system.system import moved_masses
from .full_coordinates import RootMotion

# Levi-Civita symbol: a × b = Σ ε_ijk a_j b_k.
_CROSS = np.array([np.cross(axis, np.eye(3)) for axis in np.eye(3)])


class SystemTotals:
    """Sums over all bodies of a model, as functions of Pinocchio's q and v.

    Energies and momenta accept one state, or T states with a leading axis.

    Attributes:
        mass: Total mass [kg].
    """

    def __init__(self, model: pin.Model, root: RootMotion) -> None:
        """Prepare copies of the model without gravity, without armature, and with pivot gravity."""
        self._model, self._data, self._root = model, pin.Data(model), root
        self._r, self._linear = root.axes.shape[1], root.linear
        self._weightless = model.copy()
        self._weightless.gravity.setZero()
        # Pinocchio 4.1 omits the armature of revolute joints with a general axis from the
        # kinetic energy, so it is added here.
        self._bare = model.copy()
        self._bare.armature = np.zeros(model.nv)
        self._rotors = model.armature[: self._r].copy()
        placement = model.jointPlacements[1]
        self._to_root, self._pivot = placement.rotation.T.copy(), placement.translation.copy()
        self._axes = np.hstack([axes.T @ self._to_root for axes in (root.axes[:3], root.axes[3:])])
        self._slides = placement.rotation @ root.axes[:3, : root.linear]
        # Gravity along the root's translations only accelerates the centre of mass.
        self._pivot_gravity = model.copy()
        along = self._slides @ (self._slides.T @ model.gravity.linear)
        self._pivot_gravity.gravity.linear -= along
        pin.ccrba(model, self._data, pin.neutral(model), np.zeros(model.nv))
        self.mass = float(self._data.Ig.mass)

    def radius_of_gyration(self, q: Array) -> float:
        """Compute the radius of gyration about the centre of mass, √(tr I / m) [m]."""
        pin.ccrba(self._model, self._data, q, np.zeros(self._model.nv))
        return float(np.sqrt(np.trace(self._data.Ig.inertia) / self._data.Ig.mass))

    def kinetic_energy(self, q: Array, v: Array) -> Array:
        """Compute the kinetic energy, armature included, (...) [J]."""
        rotors = 0.5 * v**2 @ self._model.armature
        energy = partial(pin.computeKineticEnergy, self._bare, self._data)
        return np.asarray(_at_states(energy, q, v) + rotors)

    def potential_energy(self, q: Array) -> Array:
        """Compute the potential energy in the model's gravity, (...) [J]."""
        return _at_states(partial(pin.computePotentialEnergy, self._model, self._data), q)

    def com_kinetic_energy(self, q: Array, v: Array) -> Array:
        """Compute the kinetic energy of the centre of mass along translations, (...) [J]."""
        momentum = self._centroidal(q, v)[..., :3] @ self._axes[: self._linear, :3].T
        return np.asarray(0.5 * (momentum * momentum).sum(axis=-1) / self.mass)

    def body_momentum(self, q: Array, v: Array) -> Array:
        """Compute the body momentum μ of the base, (..., r) [N·s; N·m·s]."""
        model, data, zero = self._weightless, self._data, np.zeros(v.shape[-1])
        return _at_states(lambda q, v: pin.rnea(model, data, q, zero, v)[: self._r], q, v)

    def momentum(self, q: Array, v: Array, fall: Array, *, about_pivot: bool) -> Array:
        """Compute the momentum along the group's axes in the root's fixed frame.

        Args:
            q: Pinocchio's configuration, (..., nq).
            v: Pinocchio's velocity, (..., nv).
            fall: Linear momentum gained in free fall, subtracted, (..., 3) [N·s].
            about_pivot: Whether angular momentum is taken about the frame's origin; otherwise about
                the centre of mass.
        Returns:
            (..., r) linear, then angular momentum [N·s; N·m·s].
        """
        momentum, com = np.split(self._centroidal(q, v), [6], axis=-1)
        if about_pivot:
            arm = com - self._pivot + q[..., : self._linear] @ self._slides.T
            # np.cross is ten times slower.
            momentum[..., 3:] += np.einsum("ijk,...j,...k", _CROSS, arm, momentum[..., :3])
        momentum[..., :3] -= fall
        return np.asarray(momentum @ self._axes.T + self._rotors * v[..., : self._r])

    def _centroidal(self, q: Array, v: Array) -> Array:
        """Return the momentum about the centre of mass and its position, (..., 9), at the origin.

        Both have the world's axes.
        """
        model, data = self._model, self._data

        def at_state(q: Array, v: Array) -> Array:
            pin.ccrba(model, data, q, v)
            return np.concatenate((data.hg.vector, data.com[0]))

        return _at_states(at_state, self.at_origin(q), v)

    def about_com(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute body twist and body momentum relative to the centre of mass.

        About a pivot, angular momentum refers to the pivot.

        Args:
            q: Configuration, (nq,).
            v: Velocity, (nv,).
        Returns:
            Body twist and body momentum, (r,) each.
        """
        data, r, k = self._data, self._r, self._linear
        momentum = self.momentum(q, v, np.zeros(3), about_pivot=self._root.is_pivoted)
        to_body = data.oMi[1].rotation.T
        xi, mu = v[:r].copy(), np.zeros(r)
        if k:
            velocity = to_body @ data.hg.linear / data.Ig.mass
            xi[:k] -= (self._root.axes[:3].T @ velocity)[:k]
        angular = momentum[k:]
        mu[k:] = to_body @ (angular @ self._to_root) if len(angular) == 3 else angular
        return xi, mu

    def gravity_slopes(self, q: Array) -> Array:
        """Return the magnitudes of the gravity forces, (..., nv), without free fall."""
        if not self._pivot_gravity.gravity.linear.any():
            return np.zeros((*q.shape[:-1], self._model.nv))
        gravity = partial(pin.computeGeneralizedGravity, self._pivot_gravity, self._data)
        return np.abs(_at_states(gravity, q))

    def pivot_load_sizes(self, q: Array) -> Array:
        """Return the magnitudes of gravity's moments about the pivot axes, (T, turns)."""
        return gravity_load_sizes(self._pivot_gravity, self._data, q)[:, self._linear : self._r]

    def at_origin(self, q: Array) -> Array:
        """Return q (..., nq) with the base moved to the origin.

        Pinocchio sums momenta in the world frame, with round-off of the distance squared.
        """
        q = q.copy()
        q[..., : self._linear] = 0.0
        return q


def _at_states(function: Callable[..., Any], *arrays: Array) -> Array:
    """Return a function's results at one state, or at T states with a leading axis."""
    if arrays[0].ndim == 1:
        return np.asarray(function(*arrays))
    return np.array([function(*rows) for rows in zip(*arrays, strict=True)])


def gravity_load_sizes(model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Compute Σ m |g| |c − p| over the bodies that each velocity coordinate moves.

    Args:
        model: Model with its gravity.
        data: Work space of the model.
        q: Pinocchio's configurations, (T, nq).
    Returns:
        (T, nv) [N·m | N]. c is a body's centre of mass and p the position of the joint.
        Prismatic joints have no lever arm; their entry is Σ m |g|.
    """
    loads = np.zeros((len(q), model.nv))
    g = float(np.linalg.norm(model.gravity.linear))
    if not g:
        return loads
    angular, mass = moved_masses(model, data, q[0])
    bodies = range(1, model.njoints)
    levers = [model.inertias[i].lever for i in bodies]
    force = np.array([g * model.inertias[i].mass for i in bodies])
    origins, centres = np.empty((2, len(q), len(bodies), 3))
    for k, q_k in enumerate(q):
        pin.forwardKinematics(model, data, q_k)
        places = [data.oMi[i] for i in bodies]
        origins[k] = [place.translation for place in places]
        centres[k] = [place.act(lever) for place, lever in zip(places, levers, strict=True)]
    for i in bodies:
        joint = model.joints[i]
        columns = slice(joint.idx_v, joint.idx_v + joint.nv)
        subtree = np.array(list(model.subtrees[i])) - 1
        moments = np.linalg.norm(centres[:, subtree] - origins[:, [i - 1]], axis=2) @ force[subtree]
        loads[:, columns] = np.where(angular[columns], moments[:, None], g * mass[columns])
    return loads
