"""The keys of gait files: one description for the reader, the JSON Schema and the docs."""

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
            "times": Key(NUMBERS, "increasing times from 0 [s]", default="equally spaced"),
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
            "period": Key(POSITIVE, "time of one cycle [s]", default="the time span of the data"),
        },
        "recorded joint data",
    ),
}
_LIMIT = Either((NUMBER, ListOf(NUMBER, 2)))
_RANGES = Either((NUMBER, ListOf(_LIMIT), ByName(_LIMIT)))
_MOSTS = Either((POSITIVE, ListOf(POSITIVE), ByName(POSITIVE)))
_LIMITS = {
    "limits": Key(
        _RANGES, "limits of joints [rad | m]: r for [−r, r], one value or pair each, or by joint",
        default="those in the robot's file",
    ),
    "speeds": Key(_MOSTS, "largest speeds [rad/s | m/s], for all joints, for each, or by joint"),
    "torques": Key(_MOSTS, "largest torques [N m | N], in the same formats"),
}  # fmt: skip
_TARGET = Either((NUMBER, NUMBERS))
OPTIMISE = Table(
    {
        "objective": Key(Text(AIMS), "objective of the loop", default=AIMS[0]),
        "axis": Key(Either((Text(("x", "y", "z")), NUMBERS)), "axis of the objective"),
        "target": Key(
            _TARGET, "target of objective 'target': an angle, a rotation vector, or a pose"
        ),
        "cost": Key(Text((*COSTS, "none")), "cost of the loop", default=COSTS[0]),
        "most": Key(POSITIVE, "bound on the cost, under which the objective is maximised"),
        "harmonics": Key(Whole(1), "number of harmonics of the Fourier series", default="5"),
        "vertices": Key(Whole(3), "number of corners of a polygon instead"),
        "winding": Key(Either((Whole(1, 1), Text(("any",)))), "winding number", default="1"),
        **_LIMITS,
        "period": Key(POSITIVE, "time of one cycle [s]", default="1"),
        "starts": Key(Whole(1), "number of random initial loops", default="5"),
        "seed": Key(Whole(), "seed of their random numbers", default="0"),
    },
    "the objective of a best gait",
)
REORIENT = Table(
    {
        "target": Key(_TARGET, "rotation vector, angle [rad] or pose", required=True),
        **_LIMITS,
        "x0": Key(SHAPE, "initial and final shape, in order or by joint", default="zero"),
        "cycles": Key(Whole(1), "number of equal loops", default="as few as possible"),
        "duration": Key(POSITIVE, "total duration [s]", default="2 s per cycle"),
    },
    "reorientation of the base",
)
GAIT_FILE = Table(
    {
        **ROBOT,
        "parameters": replace(
            SCENE_OPTIONS["parameters"],
            text="values of robot parameters, such as hand.mass (docs/flow.md)",
        ),
        "connection": Key(
            Tagged("kind", CONNECTIONS, "a connection"),
            "connection that moves the body",
            default="mechanical",
        ),
        "base": Key(
            Text((), "the name of a link"), "link that serves as the base", default="the root"
        ),
        "gait": Key(Tagged("kind", GAITS, "a gait"), "the closed path"),
        "momentum": replace(SCENE_OPTIONS["momentum"], default="0"),
        "optimise": Key(OPTIMISE, "the objective of a best gait"),
        "reorient": Key(REORIENT, "reorientation of the base"),
    },
    "a gait file",
)


def gait_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of gait files."""
    return document_schema(GAIT_FILE, "pinred gait")
