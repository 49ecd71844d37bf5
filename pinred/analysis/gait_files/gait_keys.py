"""The keys of gait files: the one description that reader, JSON Schema and docs go by."""

from __future__ import annotations

from ...scene.toml.keys import LOAD
from ...scene.toml.schema import (
    ByName,
    Either,
    Key,
    ListOf,
    Schema,
    Table,
    Tagged,
    Text,
    document_schema,
)
from ...scene.toml.signal_keys import NUMBER, NUMBERS, POSITIVE

_POINT = ListOf(NUMBER, 3)
_ROWS = ListOf(NUMBERS)
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
                Text(("textbook", "sysplotter")), "of the added moment", default="textbook"
            ),
        },
        "an elliptic cylinder across the plane",
    ),
}
_AT = Key(_POINT, "where, in the link's frame [m]", default="[0, 0, 0]")
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
            "joint": Key(Text((), "the name of a joint"), "that turns the wheel", required=True),
            "radius": Key(POSITIVE, "radius [m]", required=True),
            "link": _LINK,
            "at": _AT,
            "heading": Key(_POINT, "where positive rates take it", default="[1, 0, 0]"),
        },
        "a wheel that rolls without slipping",
    ),
}
CONNECTIONS = {
    "mechanical": Table({}, "momenta"),
    "viscous": Table({"drag": Key(ByName(_ROD), "a rod for each link", required=True)}, "drag"),
    "fluid": Table(
        {
            "density": Key(POSITIVE, "of the fluid [kg/m³]; of ellipses [kg/m²]", required=True),
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
                "as many as the group has dimensions",
                required=True,
            )
        },
        "wheels",
    ),
}
_PERIOD = Key(POSITIVE, "time of one cycle [s]", default="1")
_POINTS = Key(_ROWS, "shapes, each with a number for every joint [rad | m]", required=True)
GAITS = {
    "fourier": Table(
        {
            "mean": Key(NUMBERS, "mean shape", required=True),
            "cos": Key(_ROWS, "amplitudes of cos(2πkt/period), a row for each k", required=True),
            "sin": Key(_ROWS, "amplitudes of sin(2πkt/period), a row for each k", required=True),
            "period": _PERIOD,
        },
        "a Fourier series",
    ),
    "waypoints": Table({"points": _POINTS, "period": _PERIOD}, "a polygon at one speed"),
    "spline": Table(
        {
            "points": _POINTS,
            "times": Key(NUMBERS, "from 0, increasing [s]", default="even ones"),
            "period": _PERIOD,
        },
        "a periodic cubic spline",
    ),
    "strokes": Table(
        {
            "start": Key(NUMBERS, "shape to start from", required=True),
            "moves": Key(
                ListOf(ByName(NUMBER)), "{joint = change} of each stroke [rad | m]", required=True
            ),
            "period": _PERIOD,
        },
        "straight strokes, one after another",
    ),
    "recorded": Table(
        {
            "file": Key(Text(), "a csv or npz file, relative to this one", required=True),
            "period": Key(POSITIVE, "time of one cycle [s]", default="that of the data"),
        },
        "recorded joint data",
    ),
}
GAIT_FILE = Table(
    {
        "robot": Key(
            Text(),
            "a robot's name, or a URDF or MJCF file relative to this file (with a suffix or /)",
            required=True,
        ),
        "load": Key(LOAD, "how to read the robot: the options of pinred.load"),
        "connection": Key(
            Tagged("kind", CONNECTIONS, "a connection"), "what moves the body", default="mechanical"
        ),
        "base": Key(Text((), "the name of a link"), "the link to be the base", default="the root"),
        "gait": Key(Tagged("kind", GAITS, "a gait"), "the closed path", required=True),
        "momentum": Key(
            Either((NUMBER, NUMBERS)), "body momentum at the start, or just 0", default="0"
        ),
    },
    "a gait file",
)


def gait_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of gait files, as read from TOML."""
    return document_schema(GAIT_FILE, "pinred gait")
