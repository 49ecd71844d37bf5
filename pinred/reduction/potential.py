"""The potential V(x) on shape space: springs, and gravity if it keeps the symmetry.

Gravity along a translation of the group makes the whole system fall: it bends the path of the
centre of mass and is not part of V(x).  The remaining component g⊥ must leave the potential
unchanged under the group's rotations: V(x) = −m g⊥ᵀ c(x).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, as_floats, read_only
from ..common.errors import InputError, SymmetryError
from ..common.memo import once
from ..system.coordinates import Indices
from ..system.joints import axes_of
from ..system.system import System

Springs: TypeAlias = Mapping[str, tuple[float, float]]

_SAMPLES = 8  # number of random configurations at which the symmetry is checked
_ROUND_OFF = 4e-16  # relative round-off of a rotated vector
_LEVEL = 1e-12  # height of a pivot that counts as zero, relative to its distance from the origin
_TOLERANCE = 1e-10  # torques below this multiple of weight times size count as zero


def translations(system: System) -> Array:
    """Return the translation directions of the group, (3, k), in the root joint's fixed frame."""

    def make() -> Array:
        linear = system.group.linear
        if system.r > 1 or not linear:
            return read_only(np.eye(3)[:, list(system.group.axes[:linear])])
        return read_only(axes_of(system.model.joints[1])[:3])  # a single axis has any direction

    return once(system, translations, make)


def falling(system: System) -> Array:
    """Return the acceleration by gravity along the base's translations, (k,) [m/s²]."""
    root = system.model.jointPlacements[1].rotation
    return np.asarray(translations(system).T @ root.T @ system.gravity)


class Potential:
    """The potential V(x) of one system and its gradient; zero terms are skipped."""

    def __init__(
        self, system: System, springs: Springs | None = None, *, weight: bool = True
    ) -> None:
        """Prepare the terms of the potential.

        Args:
            system: The system.
            springs: {joint: (stiffness [N·m/rad | N/m], rest [rad | m])}.
            weight: Whether the potential includes gravity.

        InputError is raised for an unknown joint or a number that is not finite, SymmetryError if
        gravity breaks the symmetry.
        """
        self._system = system
        self._index, self._stiffness, self._rest = _spring_arrays(system, springs or {})
        self._index_x = np.array(system.space.coordinates_of(self._index.tolist()), dtype=np.intp)
        root = system.model.jointPlacements[1].rotation
        sideways = system.gravity - root @ translations(system) @ falling(system)
        if not weight or np.linalg.norm(sideways) <= 1e-14 * np.linalg.norm(system.gravity):
            sideways = np.zeros(3)
        self._sideways = sideways
        # Pinocchio computes the potential energy and torques with g⊥ as the only gravity.
        self._model = system.sorted_model.copy()
        self._model.gravity.linear = sideways
        self._data = system.sorted_data
        self._identity = system.group.neutral
        if sideways.any() and system.group.turns and not system.group.plane:
            _check_invariance(system, self._model, self._data)
        # A pivot keeps the symmetry only if the centre of mass is at the pivot in all shapes.
        self._acts = sideways.any() and not system.group.is_pivot
        self._weighs = self._acts and system.m > 0

    @property
    def is_zero(self) -> bool:
        """Whether V is constant: no springs, and no gravity perpendicular to the translations."""
        return not (self._weighs or self._index.size)

    @property
    def direction(self) -> tuple[float, float, float] | None:
        """Gravity normal to the translations, (3,) [m/s²], or None if it is zero.

        The vector is in the root joint's fixed frame.
        """
        if not self._acts:
            return None
        x, y, z = self._system.model.jointPlacements[1].rotation.T @ self._sideways
        return float(x), float(y), float(z)

    def values(self, x: Array, com: Array) -> Array:
        """Return V, (T,) [J], for shapes (T, m) and centres of mass (T, 3) in the root body."""
        placement = self._system.model.jointPlacements[1]
        height = com @ placement.rotation.T + placement.translation
        spring = 0.5 * (x[:, self._index_x] - self._rest) ** 2 @ self._stiffness
        return np.asarray(-self._system.mass * height @ self._sideways + spring)

    def value(self, x: Array) -> float:
        """Return V(x) [J], with heights measured from the world origin."""
        energy = 0.0
        if self._sideways.any():
            q = self._system.sorted_q(self._identity, x)
            energy += float(pin.computePotentialEnergy(self._model, self._data, q))
        return energy + self._spring_energy(x)

    def value_at(self, x: Array, com: Array) -> float:
        """Return V(x) [J] from the centre of mass c(x) in the root body's frame, (3,) [m]."""
        height = self._system.model.jointPlacements[1].act(com)
        return float(-self._system.mass * self._sideways @ height) + self._spring_energy(x)

    def gradient(self, x: Array) -> Array:
        """Return ∂V/∂x, (m,) [N·m | N]."""
        gradient = np.zeros(self._system.m)
        if self._weighs:
            q = self._system.sorted_q(self._identity, x)
            torque = pin.computeGeneralizedGravity(self._model, self._data, q)
            gradient += self._system.on_shape(torque)[self._system.r :]
        gradient[self._index] += self._stiffness * (x[self._index_x] - self._rest)
        return gradient

    def _spring_energy(self, x: Array) -> float:
        return float(0.5 * self._stiffness @ (x[self._index_x] - self._rest) ** 2)


def pivot_weight(system: System) -> Array:
    """Return m g in the root joint's fixed frame, (3,) [N], if gravity rotates a pivoted base.

    Returns zero otherwise.  A robot that is balanced on a pivot above or below the world's origin
    also counts, although its moment is zero: its potential energy depends on gravity and mass,
    which may be varied.
    """

    def make() -> Array:
        place, gravity = system.model.jointPlacements[1], system.gravity
        size = float(np.linalg.norm(place.translation) * np.linalg.norm(gravity))
        lifted = abs(float(place.translation @ gravity)) > _LEVEL * size
        if system.group.is_pivot and (broken_by_gravity(system) or lifted):
            return read_only(np.asarray(system.mass * place.rotation.T @ gravity))
        return read_only(np.zeros(3))

    return system.workspace(pivot_weight, make)


def broken_by_gravity(system: System) -> str:
    """Return why gravity rotates the base, so that its momentum changes; empty if it does not."""

    def make() -> str:
        try:
            Potential(system)
        except SymmetryError as error:
            return str(error)
        return ""

    return once(system, broken_by_gravity, make)


def shape_gravity(system: System) -> Potential:
    """Return the potential of gravity on the shape, cached per thread.

    Raises SymmetryError if gravity breaks the symmetry.
    """
    return system.workspace(
        shape_gravity, lambda: Potential(system, weight=not pivot_weight(system).any())
    )


def acting_gravity(system: System) -> Array:
    """Return the part of gravity that acts on the shape or rotates a pivoted base, (3,) [m/s²].

    The vector is in the root joint's fixed frame; entries due to the round-off of its rotation
    are set to zero.  Raises SymmetryError if gravity breaks the symmetry.
    """

    def make() -> Array:
        gravity = pivot_weight(system) / system.mass
        direction = shape_gravity(system).direction
        if direction is not None and not gravity.any():
            gravity = np.array(direction)
        small = np.abs(gravity) <= _ROUND_OFF * np.linalg.norm(gravity)
        return read_only(np.where(small, 0.0, gravity))

    return system.workspace(acting_gravity, make)


def spring_pair(name: str, pair: Any) -> Array:
    """Return (stiffness, rest) of a spring.  Raises InputError unless both are finite."""
    values = as_floats(pair, f"springs['{name}']")
    if values.shape != (2,) or not np.isfinite(values).all():
        raise InputError(f"springs['{name}'] must be (stiffness, rest), both finite, got {pair}")
    return values


def _spring_arrays(system: System, springs: Springs) -> tuple[Indices, Array, Array]:
    unknown = [name for name in springs if name not in system.shape_names]
    if unknown:
        system.refuse_follower(unknown[0], "springs")
        raise InputError(
            f"springs: no shape joint '{unknown[0]}'; "
            f"the joints are {', '.join(system.shape_names)}"
        )
    index = np.array([system.shape_names.index(name) for name in springs], dtype=np.intp)
    pairs = np.zeros((len(springs), 2))
    for row, (name, pair) in zip(pairs, springs.items(), strict=True):
        row[:] = spring_pair(name, pair)
    return index, pairs[:, 0], pairs[:, 1]


def _check_invariance(system: System, model: pin.Model, data: pin.Data) -> None:
    """Check that gravity exerts no moment about the group's rotations.

    Args:
        system: The system.
        model: Model with the component of gravity that acts on the shape.
        data: Data of this model.
    Raises:
        SymmetryError: Gravity exerts a moment.
    """
    rng = np.random.default_rng(0)
    directions = []
    for _ in range(_SAMPLES):
        pose = system.group.exp(rng.uniform(-3.0, 3.0, system.r))
        q = system.sorted_q(pose, system.space.random(rng, 3.0))
        moment = pin.computeGeneralizedGravity(model, data, q)[: system.r]
        pin.centerOfMass(model, data, q)
        size = np.linalg.norm(data.com[0] - data.oMi[1].translation)
        inertia = pin.crba(model, data, q)[: system.r, : system.r]
        size = max(size, np.sqrt(np.trace(inertia) / system.mass))
        weight = system.mass * np.linalg.norm(model.gravity.linear)
        if np.linalg.norm(moment) > _TOLERANCE * weight * size:
            S = np.array(data.joints[1].S)[3:].reshape(3, system.r)
            directions.append(data.oMi[1].rotation @ S @ moment)
    if not directions:
        return
    gravity = ", ".join(f"{g:g}" for g in system.gravity)
    if system.group.turns == 1:
        unit = directions[0] / np.linalg.norm(directions[0])
        axis = ", ".join(f"{a:.3g}" for a in np.round(unit, 9) + 0.0)  # hides round-off
        broken = f"rotation about its axis ({axis}), which is not along gravity,"
    else:
        broken = f"rotation about the world's {_axes(np.array(directions))} axes"
    raise SymmetryError(
        f"gravity ({gravity}) breaks the {system.group.name} symmetry of '{system.name}': {broken} "
        "changes the potential energy; use gravity=(0, 0, 0), a group that gravity preserves "
        "(SO2 about the vertical, SE3), or put the pivot at the centre of mass"
    )


def _axes(moments: Array) -> str:
    """Return the names of the world axes in the span of the moments (k, 3)."""
    _, singular, span = np.linalg.svd(moments)
    rank = int((singular > 1e-6 * singular[0]).sum())
    share = np.linalg.norm(span[:rank], axis=0)
    return ", ".join(name for name, s in zip("xyz", share, strict=True) if s > 1e-3)
