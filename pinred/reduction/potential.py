"""The potential V(x) on shape space: springs, and gravity where it keeps the symmetry.

Gravity along a translation of the group only makes the whole system fall; it is no part of
V(x) and shows in the path of the centre of mass.  What remains, g⊥, must leave the
potential unchanged under the group's rotations: V(x) = −m g⊥ᵀ c(x).
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

_SAMPLES = 8  # random configurations at which an invariance is tried
_ROUND_OFF = 4e-16  # of the largest entry of a rotation
_LEVEL = 1e-12  # of a place times gravity: less is round-off
_TOLERANCE = 1e-10  # of weight times size, the torque that counts as none


def translations(system: System) -> Array:
    """Return the directions in which the group translates the base, (3, k), root joint frame."""
    return once(system, translations, lambda: read_only(_translations(system)))


def _translations(system: System) -> Array:
    linear = system.group.linear
    if system.r > 1 or not linear:
        return np.eye(3)[:, list(system.group.axes[:linear])]
    return axes_of(system.model.joints[1])[:3]  # one axis alone may be any


def falling(system: System) -> Array:
    """Return the acceleration with which the base's translations fall, (k,) [m/s²]."""
    root = system.model.jointPlacements[1].rotation
    return np.asarray(translations(system).T @ root.T @ system.gravity)


class Potential:
    """The potential V(x) of one system and its gradient.  Only terms that act are computed."""

    def __init__(
        self, system: System, springs: Springs | None = None, *, weight: bool = True
    ) -> None:
        """Collect what acts on the shape.

        springs: {joint: (stiffness [N·m/rad | N/m], rest [rad | m])}.  weight: whether
        gravity counts.
        Raises InputError for an unknown joint or a number that is not finite, and
        SymmetryError if gravity breaks the symmetry.
        """
        self._system = system
        self._index, self._stiffness, self._rest = _spring_arrays(system, springs or {})
        root = system.model.jointPlacements[1].rotation
        sideways = system.gravity - root @ translations(system) @ falling(system)
        if not weight or np.linalg.norm(sideways) <= 1e-14 * np.linalg.norm(system.gravity):
            sideways = np.zeros(3)
        self._sideways = sideways
        # Pinocchio's potential energy and torques with only g⊥ acting.
        self._model = system.model.copy()
        self._model.gravity.linear = sideways
        self._data = system.data
        self._identity = system.group.identity()
        if sideways.any() and system.group.turns and not system.group.plane:
            _check_invariance(system, self._model, self._data)
        # What every rotation about a pivot leaves alone has its centre of mass there at all shapes.
        self._acts = sideways.any() and not system.group.is_pivot
        self._weighs = self._acts and system.m > 0

    @property
    def is_zero(self) -> bool:
        """Whether nothing acts on the shape: no springs, no gravity across the group."""
        return not (self._weighs or self._index.size)

    @property
    def direction(self) -> tuple[float, float, float] | None:
        """Gravity across the translations, (3,) in the root joint's fixed frame; None if zero."""
        if not self._acts:
            return None
        x, y, z = self._system.model.jointPlacements[1].rotation.T @ self._sideways
        return float(x), float(y), float(z)

    def values(self, x: Array, com: Array) -> Array:
        """Return V, (T,) [J], for shapes (T, m) and centres of mass (T, 3) in the root body."""
        placement = self._system.model.jointPlacements[1]
        height = com @ placement.rotation.T + placement.translation
        spring = 0.5 * (x[:, self._index] - self._rest) ** 2 @ self._stiffness
        return np.asarray(-self._system.mass * height @ self._sideways + spring)

    def value(self, x: Array) -> float:
        """Return V(x) [J]; heights are counted from the world origin."""
        energy = 0.0
        if self._sideways.any():
            q = self._system.model_q(self._identity, x)
            energy += float(pin.computePotentialEnergy(self._model, self._data, q))
        return energy + self._spring_energy(x)

    def value_at(self, x: Array, com: Array) -> float:
        """Return V(x) where the centre of mass c(x) in the root body frame is known, (3,)."""
        height = self._system.model.jointPlacements[1].act(com)
        return float(-self._system.mass * self._sideways @ height) + self._spring_energy(x)

    def gradient(self, x: Array) -> Array:
        """Return ∂V/∂x, (m,) [N·m | N]."""
        out = np.zeros(self._system.m)
        if self._weighs:
            q = self._system.model_q(self._identity, x)
            torque = pin.computeGeneralizedGravity(self._model, self._data, q)
            out += self._system.on_shape(torque)[self._system.r :]
        out[self._index] += self._stiffness * (x[self._index] - self._rest)
        return out

    def _spring_energy(self, x: Array) -> float:
        return float(0.5 * self._stiffness @ (x[self._index] - self._rest) ** 2)


def pivot_weight(system: System) -> Array:
    """Return m g in the root joint's fixed frame, (3,), if it turns a pivoted base, else zero.

    A robot that is balanced on a pivot above or below the world's origin counts as turned, by no
    moment: only so its height, which has an energy, follows gravity and mass where these vary.
    """
    return system.workspace(pivot_weight, lambda: read_only(_pivot_weight(system)))


def _pivot_weight(system: System) -> Array:
    if system.group.is_pivot and (broken_by_gravity(system) or _is_lifted(system)):
        return np.asarray(system.mass * system.model.jointPlacements[1].rotation.T @ system.gravity)
    return np.zeros(3)


def _is_lifted(system: System) -> bool:
    place, gravity = system.model.jointPlacements[1].translation, system.gravity
    size = float(np.linalg.norm(place) * np.linalg.norm(gravity))
    return abs(float(place @ gravity)) > _LEVEL * size


def broken_by_gravity(system: System) -> str:
    """Return why gravity turns the base, so that its momentum changes; empty if it does not."""

    def why() -> str:
        try:
            Potential(system)
        except SymmetryError as error:
            return str(error)
        return ""

    return once(system, broken_by_gravity, why)


def shape_gravity(system: System) -> Potential:
    """Return the potential of gravity on the shape alone, set up once for each thread.

    Raises SymmetryError if gravity breaks the symmetry.
    """
    return system.workspace(
        shape_gravity, lambda: Potential(system, weight=not pivot_weight(system).any())
    )


def acting_gravity(system: System) -> Array:
    """Return the part of gravity that acts on the shape or turns a pivoted base, (3,) [m/s²].

    In the root joint's fixed frame; entries that are round-off of a rotation are zero.  Raises
    SymmetryError if gravity breaks the symmetry.
    """
    return system.workspace(acting_gravity, lambda: read_only(_acting_gravity(system)))


def _acting_gravity(system: System) -> Array:
    found = pivot_weight(system) / system.mass
    direction = shape_gravity(system).direction
    if direction is not None and not found.any():
        found = np.array(direction)
    return np.where(np.abs(found) <= _ROUND_OFF * np.linalg.norm(found), 0.0, found)


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
    """Raise SymmetryError if gravity exerts a moment about the group's rotations anywhere."""
    rng = np.random.default_rng(0)
    directions = []
    for _ in range(_SAMPLES):
        pose = system.group.exp(rng.uniform(-3.0, 3.0, system.r))
        q = system.model_q(pose, rng.uniform(-3.0, 3.0, system.m))
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
        axis = ", ".join(f"{a:.3g}" for a in np.round(unit, 9) + 0.0)  # without its round-off
        broken = f"turning about its axis ({axis}), which is not along gravity,"
    else:
        broken = f"turning about the world's {_axes(np.array(directions))} axes"
    raise SymmetryError(
        f"gravity ({gravity}) breaks the {system.group.name} symmetry of '{system.name}': {broken} "
        "changes the potential energy; use gravity=(0, 0, 0), a group that gravity keeps "
        "(SO2 about the vertical, SE3), or put the pivot at the centre of mass"
    )


def _axes(moments: Array) -> str:
    """Name the world axes that lie in the span of the moments."""
    _, singular, span = np.linalg.svd(moments)
    rank = int((singular > 1e-6 * singular[0]).sum())
    share = np.linalg.norm(span[:rank], axis=0)
    return ", ".join(name for name, s in zip("xyz", share, strict=True) if s > 1e-3)
