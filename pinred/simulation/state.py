"""States of a motion: at one time, or at many with time as the first axis."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

from ..common.arrays import Array, freeze
from ..common.errors import InputError
from ..forces.acting import BaseInSpace
from ..system.system import System


@dataclass(frozen=True)
class Sample:
    """The state that forces see at one time, in the frame of the centre of mass.

    x, xdot: (m,).  xi, mu: (r,) body twist and body momentum; the linear part of μ is zero.
    weight: (3,) m g in the body's frame, where it turns a pivoted base, else zero [N].
    base: the base as seen from space; None where it is left out.
    """

    x: Array
    xdot: Array
    xi: Array
    mu: Array
    weight: Array
    base: BaseInSpace | None = None


@dataclass(frozen=True)
class ShapeState:
    """The shape, where the base was left out; arrays are read-only.

    t: [s].  x, xdot: (…, m).  energy: (…,) of the motion about the centre of mass, kinetic
    and potential [J].
    """

    t: Array
    x: Array
    xdot: Array
    energy: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True)
class State:
    """The system at one time, or at many with time as the first axis; arrays are read-only.

    t: [s].  x, xdot: (…, m) shape and rate.  xi: (…, r) body twist [linear; angular].
    pose: (…, size) of the base.  q, v: (…, nq), (…, n), Pinocchio's.
    body_momentum: (…, r) μ in the body's frame.  spatial_momentum: (…, r) J = Ad*_{g⁻¹} μ
    in the root joint's fixed frame, about its origin.
    energy: (…,) kinetic and potential, of falling too, zero height at the world's origin [J].
    """

    t: Array
    x: Array
    xdot: Array
    xi: Array
    pose: Array
    q: Array
    v: Array
    body_momentum: Array
    spatial_momentum: Array
    energy: Array

    def __post_init__(self) -> None:
        freeze(self)


def with_base(state: State | ShapeState, name: str) -> State:
    """Return `state` if the base is in it.  Raises InputError that says how to get it."""
    if isinstance(state, State):
        return state
    raise InputError(
        f"the scene of '{name}' has outputs='shape', which leaves out the base; "
        "simulate with outputs='all'"
    )


class OverTime(ABC):
    """Fields of State over the times of a motion, of what has `outputs`.

    Those that need the base raise InputError if it was left out.
    """

    @property
    @abstractmethod
    def outputs(self) -> State | ShapeState:
        """All that is known, time first."""

    @property
    @abstractmethod
    def system(self) -> System:
        """The system that moves."""

    @property
    @abstractmethod
    def _name(self) -> str:
        """Name in messages."""

    @property
    def states(self) -> State:
        """The states.  Raises InputError if the base was left out."""
        return with_base(self.outputs, self._name)

    @property
    def x(self) -> Array:
        """Shape, (T, m) [rad | m]."""
        return self.outputs.x

    @property
    def xdot(self) -> Array:
        """Shape rate, (T, m)."""
        return self.outputs.xdot

    @property
    def xi(self) -> Array:
        """Body twist of the base, (T, r) [linear; angular]."""
        return self.states.xi

    @property
    def pose(self) -> Array:
        """Pose of the base, (T, size)."""
        return self.states.pose

    @property
    def q(self) -> Array:
        """Pinocchio's configuration, (T, nq)."""
        return self.states.q

    @property
    def v(self) -> Array:
        """Pinocchio's velocity, (T, n)."""
        return self.states.v

    @property
    def body_momentum(self) -> Array:
        """Body momentum μ, (T, r)."""
        return self.states.body_momentum

    @property
    def spatial_momentum(self) -> Array:
        """Spatial momentum J = Ad*_{g⁻¹} μ, (T, r)."""
        return self.states.spatial_momentum

    @property
    def energy(self) -> Array:
        """Total energy, (T,) [J]; without the base, that about the centre of mass."""
        return self.outputs.energy

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset over t, with joints and coordinates by name (needs xarray).

        Of many members, over member and t.
        """
        from .labelled import dataset

        return dataset(self.outputs, self.system)

    def to_pandas(self) -> Any:
        """Return a pandas.DataFrame over t, columns such as "x.elbow" (needs pandas).

        Of many members, a row for each member and t.
        """
        from .labelled import frame

        return frame(self.outputs, self.system)
