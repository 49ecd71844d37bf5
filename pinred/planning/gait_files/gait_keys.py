"""The keys of gait files: the one description that reader, JSON Schema and docs go by."""

from __future__ import annotations

from dataclasses import replace

from ...scene.scene_options import SCENE_OPTIONS
from ...scene.toml.keys import ROBOT
from ...scene.toml.schema import (
    ByName,
    Either,
    Key,
    ListOf,
    Schema,
    Table,
    Tagged,
    Text,
    Whole,
    document_schema,
)
from ...scene.toml.signal_tables import NUMBER, NUMBERS, POSITIVE, SHAPE
from ..optimisation.aims import AIMS
from ..optimisation.costs import COSTS

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
_LIMIT = Either((NUMBER, ListOf(NUMBER, 2)))
_RANGES = Either((NUMBER, ListOf(_LIMIT), ByName(_LIMIT)))
_MOSTS = Either((POSITIVE, ListOf(POSITIVE), ByName(POSITIVE)))
_LIMITS = {
    "limits": Key(
        _RANGES, "of joints [rad | m]: r for [−r, r], or one or a pair for each, or by joint",
        default="those in the robot's file",
    ),
    "speeds": Key(_MOSTS, "greatest of joints [rad/s | m/s], for all, for each, or by joint"),
    "torques": Key(_MOSTS, "greatest of joints [N m | N], in the same forms"),
}  # fmt: skip
_TARGET = Either((NUMBER, NUMBERS))
OPTIMISE = Table(
    {
        "objective": Key(Text(AIMS), "what is wanted of the loop", default=AIMS[0]),
        "axis": Key(Either((Text(("x", "y", "z")), NUMBERS)), "along or about which"),
        "target": Key(_TARGET, "of objective target: an angle, a rotation vector, or a pose"),
        "cost": Key(Text((*COSTS, "none")), "what it is to cost little of", default=COSTS[0]),
        "most": Key(POSITIVE, "bound on the cost, under which the objective is made great"),
        "harmonics": Key(Whole(1), "of the Fourier series", default="5"),
        "vertices": Key(Whole(3), "of a polygon instead"),
        "winding": Key(
            Either((Whole(1, 1), Text(("any",)))), "how often it goes round", default="1"
        ),
        **_LIMITS,
        "period": Key(POSITIVE, "time of one cycle [s]", default="1"),
        "starts": Key(Whole(1), "random first loops", default="5"),
        "seed": Key(Whole(), "of their random numbers", default="0"),
    },
    "the objective of a best gait",
)
REORIENT = Table(
    {
        "target": Key(_TARGET, "rotation vector, angle [rad] or pose", required=True),
        **_LIMITS,
        "x0": Key(SHAPE, "shape at start and end, in order or by joint", default="zero"),
        "cycles": Key(Whole(1), "of equal loops", default="as few as will do"),
        "duration": Key(POSITIVE, "of all of it [s]", default="2 s a cycle"),
    },
    "how the base is to turn",
)
GAIT_FILE = Table(
    {
        **ROBOT,
        "parameters": replace(
            SCENE_OPTIONS["parameters"],
            text="values of robot parameters, such as hand.mass (docs/flow.md)",
        ),
        "connection": Key(
            Tagged("kind", CONNECTIONS, "a connection"), "what moves the body", default="mechanical"
        ),
        "base": Key(Text((), "the name of a link"), "the link to be the base", default="the root"),
        "gait": Key(Tagged("kind", GAITS, "a gait"), "the closed path"),
        "momentum": replace(SCENE_OPTIONS["momentum"], default="0"),
        "optimise": Key(OPTIMISE, "the objective of a best gait"),
        "reorient": Key(REORIENT, "how the base is to turn"),
    },
    "a gait file",
)


def gait_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of gait files, as read from TOML."""
    return document_schema(GAIT_FILE, "pinred gait")
