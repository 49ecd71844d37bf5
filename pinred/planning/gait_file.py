"""Gait files: the tables of keys, from which schema and docs are generated, and the reader."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..analysis.connections.connection import Connection
from ..analysis.connections.drag_fluid_and_wheels import Ellipse, Ellipsoid, Rod, Rolling, Wheel
from ..analysis.phases.gait import Gait
from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, vector_or_zero
from ..common.errors import InputError
from ..scene.scene_options import BY_JOINT, SCENE_OPTIONS
from ..scene.toml.reader import ROBOT, read_document, robot_in
from ..scene.toml.schema import (
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
    naming,
    with_places,
)
from ..scene.toml.value_tables import (
    NUMBER,
    NUMBERS,
    POSITIVE,
    file_parameters,
    refuse_others,
    with_robot_parameters,
)
from ..system.system import System
from .optimisation.objective import AIMS, COSTS

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

_ROWS = ListOf(NUMBERS)
_PERIOD = Key(POSITIVE, "time of one cycle [s]", default="1")
_TURNS = Key(NUMBERS, "complete turns of each joint per cycle", default="none")
_POINTS = Key(_ROWS, "shapes, each with a number for every joint [rad | m]", required=True)
GAITS = {
    "fourier": Table(
        {
            "mean": Key(NUMBERS, "mean shape", required=True),
            "cos": Key(_ROWS, "amplitudes of cos(2πkt/period), a row for each k", required=True),
            "sin": Key(_ROWS, "amplitudes of sin(2πkt/period), a row for each k", required=True),
            "period": _PERIOD,
            "turns": _TURNS,
        },
        "a Fourier series",
    ),
    "waypoints": Table(
        {"points": _POINTS, "period": _PERIOD, "turns": _TURNS}, "a polygon at one speed"
    ),
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
_MAXIMA = Either((POSITIVE, ListOf(POSITIVE), ByName(POSITIVE)))
_FORMAT = "R, R1,R2,… or J1=R1,…"  # command-line format of limits
_LIMITS = {
    "limits": Key(
        _RANGES,
        "joint ranges [rad | m]: R for [-R, R], or a limit or a pair for each joint, or by joint",
        default="limits of the robot's file", command=f"--limits {_FORMAT}",
    ),
    "speeds": Key(
        _MAXIMA, "largest joint rates [rad/s | m/s], for all, for each, or by joint",
        default="none", command=f"--speeds {_FORMAT}",
    ),
    "torques": Key(
        _MAXIMA, "largest joint torques [N·m | N], for all, for each, or by joint",
        default="none", command=f"--torques {_FORMAT}",
    ),
}  # fmt: skip
_TARGET = Either((NUMBER, NUMBERS))
_TARGETS = (
    "one angle [rad], a rotation vector of three numbers [rad], or all numbers of a pose with its "
    "quaternion (x, y, z, w) last"
)
OPTIMISE = Table(
    {
        "objective": Key(
            Text(AIMS), f"objective: {', '.join(AIMS)}", default=AIMS[0], command="--objective O"
        ),
        "axis": Key(
            Either((Text((), "the name of an axis"), NUMBERS)),
            "axis of the rotation or displacement: x, y, z (or v1, w1, turn, …), or a vector",
            command="--axis AXIS",
        ),
        "target": Key(
            _TARGET, "target of objective target: " + _TARGETS,
            command="--target V1,V2,…",
        ),
        "cost": Key(
            Text((*COSTS, "none")), f"cost: {', '.join(COSTS)}, none",
            default=COSTS[0], command="--cost C",
        ),
        "most": Key(
            POSITIVE, "upper bound on the cost, under which the objective is maximised",
            command="--most C",
        ),
        "harmonics": Key(
            Whole(1), "number of Fourier harmonics", default="5", command="--harmonics H"
        ),
        "vertices": Key(
            Whole(3), "number of vertices of a polygon, instead of a Fourier series",
            command="--vertices N",
        ),
        "winding": Key(
            Either((Whole(1, 1), Text(("any",)))), "winding number of the loop", default="1"
        ),
        **_LIMITS,
        "period": Key(POSITIVE, "time of one cycle [s]", default="1", command="--period T"),
        "starts": Key(
            Whole(1), "number of random initial loops", default="10", command="--starts N"
        ),
        "seed": Key(Whole(), "seed of the random loops", default="0", command="--seed S"),
    },
    "the objective of a best gait",
)  # fmt: skip
REORIENT = Table(
    {
        "target": Key(
            _TARGET, _TARGETS + ", of which only the attitude counts",
            required=True, command="--target V1,V2,…",
        ),
        **_LIMITS,
        "x0": replace(
            SCENE_OPTIONS["x0"], text="shape at start and end [rad | m]", default="zero"
        ),
        "cycles": Key(
            Whole(1), "number of equal loops", default="smallest possible", command="--cycles N"
        ),
        "duration": Key(
            POSITIVE, "duration of the motion [s]; effort needs it", default="2 per cycle",
            command="--duration T",
        ),
        "x_end": replace(
            SCENE_OPTIONS["x0"], text="final shape, with effort [rad | m]", default="x0",
            command=f"--x-end {BY_JOINT}",
        ),
        "effort": Key(
            Text(("torque", "rate")),
            "no loop, but the least mean square of torque or rate within the limits",
            default="none: a loop", command="--effort E",
        ),
    },
    "the rotation of the base",
)  # fmt: skip
GAIT_FILE = with_places(Table(
    {
        **ROBOT,
        "parameters": replace(
            SCENE_OPTIONS["parameters"], text="robot parameters by name (docs/flow.md)"
        ),
        "connection": Key(
            Tagged("kind", CONNECTIONS, "a connection"),
            "connection that moves the body",
            default="mechanical",
        ),
        "independent": Key(
            ListOf(Text((), "the name of a joint")),
            "independent joints of a robot with loops, whose coordinates are the shapes of gaits",
            default="chosen where the loops were assembled",
            command="--independent J1,J2,…",
        ),
        "base": Key(
            Text((), "the name of a link"), "link that serves as the base", default="the root"
        ),
        "centre": replace(
            SCENE_OPTIONS["x0"],
            text="shape about which gaits are given; a ball has a rotation vector or a quaternion",
            default="at rest",
            command=f"--centre {BY_JOINT}",
        ),
        "gait": Key(Tagged("kind", GAITS, "a gait"), "the closed path"),
        "momentum": replace(SCENE_OPTIONS["momentum"], default="0"),
        "optimise": Key(OPTIMISE, OPTIMISE.words),
        "reorient": Key(REORIENT, REORIENT.words),
    },
    "a gait file",
))  # fmt: skip


@checks_arguments
def gait_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of gait files."""
    return document_schema(GAIT_FILE, "pinred gait")


@checks_arguments
@dataclass(frozen=True)
class GaitFile:
    """The contents of a gait file.

    Attributes:
        system: The system.
        connection: The connection, in rotation vectors about `centre` if there are ball joints.
        gait: The gait, or None.
        momentum: Initial body momentum, (r,).
        optimise: Options in the file for `optimise_gait`, by name.
        reorient: Options in the file for `reorient`, by name.
    """

    system: System
    connection: Connection
    gait: Gait | None
    momentum: Array
    optimise: Mapping[str, Any] = field(default_factory=dict)
    reorient: Mapping[str, Any] = field(default_factory=dict)

    @property
    def path(self) -> Gait:
        """The gait.  Raises InputError if the file has none."""
        if self.gait is None:
            raise InputError(
                f"no gait of '{self.system.name}' is given; add a [gait] table to the file"
            )
        return self.gait


@checks_arguments
def load_gait(path: str | Path) -> GaitFile:
    """Read a gait file: robot, connection, gait and objectives in TOML (see docs/phases.md).

    Args:
        path: Name of the file.
    Returns:
        The contents.
    Raises:
        LoadError: The file, or a file that it names, cannot be read.
        InputError: A value is invalid; the message names file and key.
    """
    document, place = read_document(path, GAIT_FILE, "gait")
    folder = Path(path).parent
    parameters = file_parameters(document, place)
    system, other_values = with_robot_parameters(
        robot_in(document, folder, place), parameters, place
    )
    refuse_others(system, other_values)
    with naming(place / "connection"):
        table = document.get("connection", {"kind": "mechanical"})
        connection = connection_in(table, system, document.get("independent"))
    if "base" in document:
        with naming(place / "base"):
            connection = connection.seen_from(document["base"])
    with naming(place / "centre", "centre: "):
        connection = connection.in_chart(document.get("centre"))
    gait = None
    if "gait" in document:
        with naming(place / "gait"):
            gait = _gait(document["gait"], connection, system, folder)
    stated = document.get("momentum", 0.0)
    with naming(place / "momentum", "momentum: "):
        values = stated if stated == 0.0 else np.atleast_1d(stated)
        momentum = vector_or_zero(values, connection.r, "momentum", connection.group.momentum_names)
    optimise = dict(document.get("optimise", {}))
    for name, word in (("cost", "none"), ("winding", "any")):
        if optimise.get(name) == word:
            optimise[name] = None
    turn = dict(document.get("reorient", {}))
    if turn and momentum.any():
        turn["momentum"] = momentum
    return GaitFile(system, connection, gait, momentum, optimise, turn)


def _gait(table: Mapping[str, Any], connection: Connection, system: System, folder: Path) -> Gait:
    options = dict(table)
    kind = options.pop("kind")
    if kind == "recorded":
        gait = Gait.read(folder / options.pop("file"), **options)
    elif kind == "strokes":
        gait = Gait.strokes(joints=connection.joints, **options)
    else:
        gait = getattr(Gait, kind)(**options)
    if gait.m not in ({connection.m, system.m} if system.loops else {connection.m}):
        raise InputError(
            f"the gait moves {gait.m} joints, but the connection has {connection.m}: "
            f"{', '.join(connection.joints)}"
        )
    return gait


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
