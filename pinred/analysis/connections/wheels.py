"""The kinematic connection: wheels that do not slip determine the motion of the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, positive, vector
from ...common.errors import InputError
from ...common.names import joint_index
from ...kernels.connection.connection_form import ConnectionForm, form_of
from ...lie.rotations import hat
from ...reduction.tree.body_frames import bodies_of
from ...reduction.tree.momenta import speed_along, twists_at
from ...system.system import System, checked_system
from .links import Link, link_jacobian, link_named


@checks_arguments
@dataclass(frozen=True)
class Wheel:
    """A wheel, or a pair of wheels on one axle, that does not slip along the axle.

    Attributes:
        link: Name of the link that carries the wheel.
        at: Contact point in the link's frame, (3,) [m].
        axle: Direction of the axle in the link's frame, (3,).
    """

    link: str
    at: ArrayLike = (0.0, 0.0, 0.0)
    axle: ArrayLike = (0.0, 1.0, 0.0)


@checks_arguments
@dataclass(frozen=True)
class Rolling:
    """A wheel that rolls without slipping: its centre moves at radius times its joint's rate.

    Attributes:
        joint: Name of the hinge that rotates the wheel.
        radius: Radius [m].
        link: Name of the link that carries the wheel.
        at: Centre of the wheel in the link's frame, (3,) [m].
        heading: Direction of motion at positive rates in the link's frame, (3,).
    """

    joint: str
    radius: float
    link: str
    at: ArrayLike = (0.0, 0.0, 0.0)
    heading: ArrayLike = (1.0, 0.0, 0.0)


@dataclass(frozen=True)
class Slip:
    """A constraint: the speed of a point minus `radius` times the rate of a coordinate vanishes.

    Attributes:
        link: The link.
        direction: Direction of the measured speed, (3,), in the joint frame of the link's body.
        point: The point, (3,) [m], in the same frame.
        coordinate: Index of the shape rate, −1 for none.
        radius: Radius [m].
    """

    link: Link
    direction: Array
    point: Array
    coordinate: int
    radius: float


def slips_of(system: System, wheels: Sequence[Wheel | Rolling]) -> list[Slip]:
    """Return the constraints of wheels.  Raises InputError for unknown links or joints."""
    slips = []
    for wheel in wheels:
        if not isinstance(wheel, (Wheel, Rolling)):
            raise InputError(f"wheels must be Wheel or Rolling, got {wheel!r}")
        link = link_named(system, wheel.link, "wheels")
        coordinate, radius = -1, 0.0
        if isinstance(wheel, Rolling):
            d = vector(wheel.heading, 3, "heading")
            coordinate = joint_index(wheel.joint, system.shape_names, "wheels")
            system.space.coordinates_of([coordinate])  # rejects the axes of balls
            radius = positive(wheel.radius, "radius")
        else:
            d = vector(wheel.axle, 3, "axle")
        if not np.linalg.norm(d) > 0.0:
            raise InputError(f"the direction of a wheel on '{wheel.link}' must not be zero")
        direction = link.placement.rotation @ (d / np.linalg.norm(d))
        point = link.placement.act(vector(wheel.at, 3, "at"))
        slips.append(Slip(link, direction, point, coordinate, radius))
    return slips


def slip_rows(system: System, slips: Sequence[Slip], x: ca.SX, v: ca.SX) -> ca.SX:
    """Return the slip speeds of all wheels, (k,), as CasADi expressions; zero without slip.

    Args:
        system: The system.
        slips: The constraints.
        x: Shape symbols, (nx,).
        v: Velocity symbols (ξ, ẋ), (n,).
    Returns:
        Slip speeds, (k,) [m/s].
    """
    bodies, twists = bodies_of(system), twists_at(system, x, v)
    rows = []
    for slip in slips:
        i = slip.link.joint - 1
        row = speed_along(bodies[i], twists[i], slip.direction, slip.point)
        if slip.coordinate >= 0:
            row = row - slip.radius * v[system.r + slip.coordinate]
        rows.append(row)
    column: ca.SX = ca.vertcat(ca.SX(0, 1), *rows)
    return column


def slip_matrix(system: System, slips: Sequence[Slip], x: Array) -> Array:
    """Compute the constraint matrix (W_b, W_s), (k, n), at x (nx,) with Pinocchio's Jacobians."""
    rows = []
    for slip in slips:
        body = Link(slip.link.joint, slip.link.placement.Identity())
        J = link_jacobian(system, body, x)
        row = slip.direction @ (J[:3] - hat(slip.point) @ J[3:])
        if slip.coordinate >= 0:
            row[system.r + slip.coordinate] -= slip.radius
        rows.append(row)
    return np.array(rows).reshape(-1, system.n)


def kinematic_form(system: System, wheels: Sequence[Wheel | Rolling]) -> ConnectionForm:
    """Return the form of slip speeds, for as many wheels as the group has dimensions."""
    system = checked_system(system, "Connection.kinematic")
    slips = slips_of(system, list(wheels))
    if len(slips) != system.r:
        raise InputError(
            f"{system.group.name} has {system.r} dimensions, so a kinematic connection needs "
            f"{system.r} wheels, got {len(slips)}; with fewer, see mixed_connection"
        )
    return form_of(
        system.group, system.shape_names, system.units, f"the wheels of '{system.name}'",
        partial(slip_rows, system, slips), partial(slip_matrix, system, slips), symmetric=False,
        space=system.space,
    )  # fmt: skip
