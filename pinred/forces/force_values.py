"""Numeric arguments of compiled forces at one state, and the resulting torques and wrenches."""

from __future__ import annotations

from dataclasses import dataclass

from ..common.arrays import Array, FrozenArrays


@dataclass(frozen=True)
class BaseInSpace:
    """Pose, twist and momenta of the base in space, i.e. relative to the root joint's fixed frame.

    See SeenState for their definitions.

    Attributes:
        pose: Pose, (size,).
        xi: Body twist, (r,).
        mu: Body momentum, (r,).
        J: Spatial momentum, (r,).
    """

    pose: Array
    xi: Array
    mu: Array
    J: Array


@dataclass(frozen=True)
class ForceInputs:
    """The state that forces depend on, and the numbers in the forces: see Symbols.

    At T times, t has the shape (T,), and all others have a leading axis of length T.

    Attributes:
        t: Time [s].
        x: Shape, (m,).
        xdot: Shape rate, (m,).
        xi: Body twist relative to the centre of mass, (r,).
        mu: Body momentum about the centre of mass, (r,).
        numbers: Values of the numbers in the forces (see ForceModel.numbers), (p,).
        base: The base in space; required if forces depend on its pose or motion.
    """

    t: float | Array
    x: Array
    xdot: Array
    xi: Array
    mu: Array
    numbers: Array
    base: BaseInSpace | None = None


@dataclass(frozen=True)
class Acting:
    """The sum of all forces at one state, or at T states with a leading axis.

    Attributes:
        torque: Torques on the joints, −∂V/∂x included, (m,).
        wrench: Wrench on the base, (r,).
    """

    torque: Array
    wrench: Array


@dataclass(frozen=True)
class Prescribed(FrozenArrays):
    """Motion of k prescribed joints at one time, or at T times with a leading axis.

    Attributes:
        x: Positions, (k,).
        xdot: Rates, (k,).
        xddot: Accelerations, (k,).
    """

    x: Array
    xdot: Array
    xddot: Array
