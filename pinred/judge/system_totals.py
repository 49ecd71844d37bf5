"""Energies, momenta, gravity loads and size of the whole system, computed with Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..system.scale import moved_masses
from .full_coordinates import RootMotion


class SystemTotals:
    """Sums over all bodies of a model, as functions of Pinocchio's q and v.

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

    def kinetic_energy(self, q: Array, v: Array) -> float:
        """Compute the kinetic energy, armature included [J]."""
        rotors = 0.5 * float(self._model.armature @ v**2)
        return float(pin.computeKineticEnergy(self._bare, self._data, q, v)) + rotors

    def potential_energy(self, q: Array) -> float:
        """Compute the potential energy in the model's gravity [J]."""
        return float(pin.computePotentialEnergy(self._model, self._data, q))

    def com_kinetic_energy(self, q: Array, v: Array) -> float:
        """Compute the kinetic energy of the centre of mass along the group's translations [J]."""
        data = self._data
        pin.ccrba(self._model, data, self.at_origin(q), v)
        momentum = self._root.axes[:3].T @ self._to_root @ data.hg.linear
        return 0.5 * float(momentum @ momentum) / float(data.Ig.mass)

    def body_momentum(self, q: Array, v: Array) -> Array:
        """Compute the body momentum μ of the base, (r,) [N·s; N·m·s]."""
        return np.array(pin.rnea(self._weightless, self._data, q, np.zeros(len(v)), v)[: self._r])

    def momentum(self, q: Array, v: Array, fall: Array, *, about_pivot: bool) -> Array:
        """Compute the momentum along the group's axes in the root's fixed frame.

        Args:
            q: Pinocchio's configuration, (nq,).
            v: Pinocchio's velocity, (nv,).
            fall: Linear momentum gained in free fall, subtracted, (3,) [N·s].
            about_pivot: Whether angular momentum is taken about the frame's origin; otherwise about
                the centre of mass.
        Returns:
            (r,) linear, then angular momentum [N·s; N·m·s].
        """
        data = self._data
        pin.ccrba(self._model, data, self.at_origin(q), v)
        momentum = data.hg.vector.copy()
        if about_pivot:
            arm = data.com[0] - self._pivot + self._slides @ q[: self._linear]
            momentum[3:] += pin.skew(arm) @ momentum[:3]  # np.cross is ten times slower
        momentum[:3] -= fall
        return np.asarray(self._axes @ momentum + self._rotors * v[: self._r])

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
        """Return the magnitudes of the generalised gravity forces, (nv,), without free fall."""
        if not self._pivot_gravity.gravity.linear.any():
            return np.zeros(self._model.nv)
        return np.asarray(np.abs(pin.computeGeneralizedGravity(self._pivot_gravity, self._data, q)))

    def pivot_load_sizes(self, q: Array) -> Array:
        """Return the magnitudes of gravity's moments about the pivot axes."""
        return gravity_load_sizes(self._pivot_gravity, self._data, q)[self._linear : self._r]

    def at_origin(self, q: Array) -> Array:
        """Return q (..., nq) with the base moved to the origin.

        Pinocchio sums momenta in the world frame, with round-off of the distance squared.
        """
        q = q.copy()
        q[..., : self._linear] = 0.0
        return q


def gravity_load_sizes(model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Compute Σ m |g| |c − p| over the bodies that each velocity coordinate moves.

    Args:
        model: Model with its gravity.
        data: Work space of the model.
        q: Pinocchio's configuration, (nq,).
    Returns:
        (nv,) [N·m | N]. c is a body's centre of mass and p the position of the joint.
        Prismatic joints have no lever arm; their entry is Σ m |g|.
    """
    loads = np.zeros(model.nv)
    g = float(np.linalg.norm(model.gravity.linear))
    if not g:
        return loads
    angular, mass = moved_masses(model, data, q)
    pin.forwardKinematics(model, data, q)
    bodies = range(1, model.njoints)
    force = np.array([g * model.inertias[i].mass for i in bodies])
    centres = np.array([data.oMi[i].act(model.inertias[i].lever) for i in bodies])
    for i in bodies:
        joint = model.joints[i]
        columns = slice(joint.idx_v, joint.idx_v + joint.nv)
        subtree = np.array(list(model.subtrees[i])) - 1
        arms = np.linalg.norm(centres[subtree] - data.oMi[i].translation, axis=1)
        loads[columns] = np.where(angular[columns], float(force[subtree] @ arms), g * mass[columns])
    return loads
