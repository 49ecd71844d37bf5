"""Tables of connections in gait files: their keys, and the connections that they describe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..analysis.connections.connection import Connection
from ..analysis.connections.fluid import Ellipse, Ellipsoid, Rod
from ..analysis.connections.wheels import Rolling, Wheel
from ..scene.toml.schema import ByName, Key, ListOf, Table, Tagged, Text
from ..scene.toml.value_tables import NUMBER, POSITIVE
from ..system.system import System

_POINT = ListOf(NUMBER, 3)
_CENTRE = Key(_POINT, "its centre in the link's frame [m]", default="[0, 0, 0]")
_AXIS = Key(_POINT, "direction of its long axis", default="[1, 0, 0]")
_ROD = Table(
    {
        "length": Key(POSITIVE, "length [m]", required=True),
        "across": Key(POSITIVE, "drag across it per length [N s/m²]", required=True),
        "along": Key(POSITIVE, "drag along it per length [N s/m²]", required=True),
        "centre": _CENTRE,
        "axis": _AXIS,
    },
    "a rod in a viscous fluid",
)
_BODIES = {
    "ellipsoid": Table(
        {"semi_axes": Key(_POINT, "a, b, c [m]", required=True), "centre": _CENTRE, "axis": _AXIS},
        "an ellipsoid",
    ),
    "ellipse": Table(
        {
            "a": Key(POSITIVE, "semi-axis along its axis [m]", required=True),
            "b": Key(POSITIVE, "semi-axis across [m]", required=True),
            "centre": _CENTRE,
            "axis": _AXIS,
            "convention": Key(
                Text(("textbook", "sysplotter")),
                "convention of the added moment",
                default="textbook",
            ),
        },
        "an elliptic cylinder across the plane",
    ),
}
_AT = Key(_POINT, "position in the link's frame [m]", default="[0, 0, 0]")
_LINK = Key(Text((), "the name of a link"), "the link that carries it", required=True)
_WHEELS = {
    "wheel": Table(
        {
            "link": _LINK,
            "at": _AT,
            "axle": Key(_POINT, "direction of its axle", default="[0, 1, 0]"),
        },
        "a wheel that does not slip along its axle",
    ),
    "rolling": Table(
        {
            "joint": Key(
                Text((), "the name of a joint"), "the joint that rotates the wheel", required=True
            ),
            "radius": Key(POSITIVE, "radius [m]", required=True),
            "link": _LINK,
            "at": _AT,
            "heading": Key(_POINT, "direction of motion for positive rates", default="[1, 0, 0]"),
        },
        "a wheel that rolls without slipping",
    ),
}
CONNECTIONS = {
    "mechanical": Table({}, "momenta"),
    "viscous": Table({"drag": Key(ByName(_ROD), "a rod for each link", required=True)}, "drag"),
    "fluid": Table(
        {
            "density": Key(
                POSITIVE, "density of the fluid [kg/m³]; for ellipses [kg/m²]", required=True
            ),
            "bodies": Key(
                ByName(Tagged("kind", _BODIES, "a body")), "a body for each link", required=True
            ),
        },
        "a perfect fluid",
    ),
    "kinematic": Table(
        {
            "wheels": Key(
                ListOf(Tagged("kind", _WHEELS, "a wheel")),
                "one wheel for each dimension of the group",
                required=True,
            )
        },
        "wheels",
    ),
}


def connection_in(
    table: Mapping[str, Any], system: System, independent: Sequence[str] | None
) -> Connection:
    """Return the connection that a validated table describes.

    Args:
        table: Value of a key with a description in CONNECTIONS.
        system: The robot.
        independent: Independent joints of a robot with loops; None: chosen.
    """
    kind = table["kind"]
    if kind == "viscous":
        drag = {name: Rod(**rod) for name, rod in table["drag"].items()}
        return Connection.viscous(system, drag, independent=independent)
    if kind == "fluid":
        bodies = {name: _made(body) for name, body in table["bodies"].items()}
        return Connection.fluid(system, table["density"], bodies, independent=independent)
    if kind == "kinematic":
        wheels = [_made(wheel) for wheel in table["wheels"]]
        return Connection.kinematic(system, wheels, independent=independent)
    return Connection.mechanical(system, independent=independent)


_CLASSES = {"ellipsoid": Ellipsoid, "ellipse": Ellipse, "wheel": Wheel, "rolling": Rolling}


def _made(table: Mapping[str, Any]) -> Any:
    """Create the body or wheel that a table describes."""
    options = dict(table)
    return _CLASSES[options.pop("kind")](**options)
