"""Values in files: signals, attitudes, the kinds of forces, and parameters by name.

A signal is a number, a formula, a table of points, or a column of a csv file.  Required keys and
defaults of forces follow from the fields of the classes in pinred.forces.  A parameter whose name
has dots, such as hand.mass, may be written in TOML as nested tables or as a quoted key.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError, PinredError
from ...common.names import quoted_path
from ...forces import kinds
from ...forces.force import Force
from ...forces.kinds import AXES
from ...forces.signals import Attitude, Constant, Expression, Fourier, Hold, Linear, Signal, Spline
from ...forces.signals.attitude_signal import parse_attitude
from ...forces.signals.signal import ENDS
from ...system.body_parameters import refuse_vague
from ...system.model_parameters import kinds_near, size_of, with_parameters
from ...system.system import System
from .schema import (
    ByName,
    Either,
    Flag,
    Key,
    ListOf,
    Node,
    Number,
    Place,
    Schema,
    Table,
    Tagged,
    Text,
    Whole,
    naming,
    read_text,
    shown,
    unknown,
)


def read_columns(path: Path, columns: Sequence[str | int]) -> Array:
    """Return columns of a csv file.

    The first line is a header if one of its cells is not a number.

    Args:
        path: The file.
        columns: Column names in the header, or column indices from 0.
    Returns:
        Values of the columns, (rows, len(columns)).
    Raises:
        LoadError: The file cannot be read.
        InputError: A column is missing or a cell is not a number.
    """
    text = read_text(path, "csv file")
    try:
        lines = [
            (reader.line_num, [cell.strip() for cell in cells])
            for reader in [csv.reader(io.StringIO(text, newline=""), strict=True)]
            for cells in reader
            if any(cell.strip() for cell in cells)
        ]
    except csv.Error as error:
        raise InputError(f"{quoted_path(path)} is not a csv file: {error}") from None
    if not lines:
        raise InputError(f"{quoted_path(path)} is empty")
    first = lines[0][1]
    header = first if any(_float(cell) is None for cell in first) else []
    chosen = [_index(column, header, len(first), path) for column in columns]
    table_lines = lines[1:] if header else lines
    if not table_lines:
        raise InputError(f"{quoted_path(path)} has no numbers below its header")
    return np.array([[_cell(cells, k, line, path) for k in chosen] for line, cells in table_lines])


def _index(column: str | int, header: list[str], count: int, path: Path) -> int:
    if isinstance(column, str):
        if column not in header:
            said = unknown(column, "column", header, "the columns are")
            raise InputError(
                f"{quoted_path(path)}: {said if header else 'there is no header with names'}"
            )
        if header.count(column) > 1:
            raise InputError(f"{quoted_path(path)} has two columns {shown(column)}")
        return header.index(column)
    if column >= count:
        raise InputError(
            f"{quoted_path(path)} has {count} columns, so column {column} (counted from 0) is "
            "missing"
        )
    return column


def _cell(row: list[str], k: int, line: int, path: Path) -> float:
    value = _float(row[k]) if k < len(row) else None
    if value is not None and math.isfinite(value):
        return value
    where = f"{quoted_path(path)}, line {line}, column {k}"  # slow for each of 100,000 rows
    if k >= len(row):
        raise InputError(f"{where}: there are only {len(row)} columns")
    raise InputError(f"{where}: must be a finite number, got {shown(row[k])}")


def _float(cell: str) -> float | None:
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


NUMBER, POSITIVE = Number(), Number(positive=True)
NUMBERS = ListOf(NUMBER)
PER_JOINT = Either((NUMBER, ByName(NUMBER)), "per_joint")
SHAPE = Either((NUMBERS, ByName(Either((NUMBER, NUMBERS)))), "shape")
_TABULATED: dict[str, Callable[..., Signal]] = {"spline": Spline, "linear": Linear, "hold": Hold}


def _tabulated(words: str, **more: Key) -> Table:
    """Return the table (keys) of a signal through points from the scene file or a csv file."""
    columns = ListOf(Either((Text((), "a name"), Whole())), 2)
    keys = {
        "times": Key(NUMBERS, "strictly increasing times [s], at most 100,000"),
        "values": Key(NUMBERS, "signal values, one for each time"),
        "file": Key(Text(), "csv file with the times and values, relative to this file"),
        "columns": Key(
            columns,
            "csv columns of time and value, as two names in the header or two indices from 0",
            default="[0, 1]",
        ),
        **more,
    }
    return Table(
        keys,
        words,
        needs={"times": "values", "values": "times", "columns": "file"},
        one_of=("times", "file"),
    )


_END = Key(Text(ENDS), "condition at both ends of the spline", default=ENDS[0])
_FOURIER = Table(
    {
        "mean": Key(NUMBER, "mean value", default="0"),
        "cosines": Key(NUMBERS, "amplitudes of cos(2πk t/period), k from 1", default="none"),
        "sines": Key(NUMBERS, "amplitudes of sin(2πk t/period), k from 1", default="none"),
        "period": Key(POSITIVE, "period [s]", required=True),
    },
    "a Fourier series",
)
_KINDS = {
    "spline": Key(_tabulated("a cubic spline", end=_END), "cubic spline through points"),
    "linear": Key(_tabulated("straight lines"), "linear interpolation between points"),
    "hold": Key(_tabulated("steps"), "zero-order hold: each value is kept until the next time"),
    "fourier": Key(_FOURIER, "mean + Σ aₖ cos(2πk t/period) + bₖ sin(2πk t/period)"),
}
SIGNAL_TABLE = Table(_KINDS, "a signal table", one_of=tuple(_KINDS), name="signal_table")
_TIME = Text((), "a formula in t")
SIGNAL = Either((NUMBER, _TIME, SIGNAL_TABLE), "signal")
_ATTITUDE = Table(
    {
        "vector": Key(ListOf(SIGNAL, 3), "rotation vector w(t) in the axes of the child [rad]"),
        "centre": Key(
            NUMBERS,
            "constant attitude R_c of R_c exp(w(t)): rotation vector [rad] or quaternion "
            "(x, y, z, w)",
            default="no rotation",
        ),
        "times": Key(NUMBERS, "strictly increasing times [s], at most 100,000"),
        "attitudes": Key(
            ListOf(NUMBERS),
            "rotation vectors [rad] or quaternions, one for each time, of which the unwrapped "
            "rotation vectors about the centre are interpolated",
        ),
        "end": Key(Text(ENDS), "condition at both ends of the splines", default=ENDS[0]),
    },
    "an attitude",
    needs={"times": "attitudes", "attitudes": "times", "end": "times"},
    one_of=("vector", "times"),
)
_OF_BALL = Key(_ATTITUDE, "attitude of a ball joint, R(t) = R_c exp(w(t))")
ATTITUDE = Either(
    (
        ListOf(SIGNAL),
        Table({"attitude": _OF_BALL}, "a table with the key attitude", one_of=("attitude",)),
    ),
    "attitude",
)
_PLANS = {**_KINDS, "attitude": _OF_BALL}
PLAN_TABLE = Table(_PLANS, "a signal table", one_of=tuple(_PLANS), name="plan_table")
PLAN = Either((NUMBER, _TIME, ListOf(SIGNAL), PLAN_TABLE), "plan")
_FORMULA = Text((), "a formula in t, x, xdot and mu")
ACTION = Either((NUMBER, _FORMULA, SIGNAL_TABLE), "action")


class SignalReader:
    """A reader of the signals in one file, which stores the place of each signal for messages.

    Args:
        folder: Folder to which the names of csv files are relative.
    """

    def __init__(self, folder: Path) -> None:
        """Create a reader that has not read any signals yet."""
        self._folder = folder
        self._places: list[tuple[Signal, Place]] = []

    def motion(self, value: Any, place: Place) -> Signal | Attitude:
        """Convert a validated value to a Signal; a number becomes a constant signal.

        Args:
            value: Number, formula in t, or signal table; for a ball a list of signals, or a table
                with the key attitude.
            place: Its place in the file.
        Returns:
            The signal, or the attitude of a ball.
        Raises:
            InputError: the value does not define a valid signal; the message names the place.
            LoadError: a csv file cannot be read.
        """
        plan = self.plan(value, place)
        return self._remember(Constant(plan), place) if isinstance(plan, float) else plan

    def plan(self, value: Any, place: Place) -> Signal | Attitude | float:
        """Convert a validated value to a Signal or an Attitude; return a number unchanged."""
        if isinstance(value, list) or (isinstance(value, dict) and "attitude" in value):
            return self.attitude(value, place)
        return self.value(value, place)

    def attitude(self, value: Any, place: Place) -> Attitude:
        """Convert a validated list of signals, or a table with the key attitude (see motion)."""
        if isinstance(value, list):
            with naming(place):
                return parse_attitude([self.value(v, place / k) for k, v in enumerate(value)])
        place, table = place / "attitude", value["attitude"]
        centre = table.get("centre", (0.0, 0.0, 0.0))
        with naming(place):
            if "vector" in table:
                at = place / "vector"
                vector = [self.value(v, at / k) for k, v in enumerate(table["vector"])]
                return Attitude(vector, centre)
            end = table.get("end", ENDS[0])
            return Attitude.through(table["times"], table["attitudes"], centre, end=end)

    def value(self, value: Any, place: Place) -> Signal | float:
        """Convert a validated value to a Signal, but return a number unchanged (see motion)."""
        if isinstance(value, float):
            return value
        if isinstance(value, str):
            with naming(place):
                return self._remember(Expression(value), place)
        ((kind, table),) = value.items()
        place = place / kind
        options = dict(table)
        if "file" in options:
            columns = options.pop("columns", [0, 1])
            with naming(place / "file"):
                points = read_columns(self._folder / options.pop("file"), columns)
            options |= {"times": points[:, 0], "values": points[:, 1]}
        with naming(place):
            if kind == "fourier":
                options = {"mean": 0.0, "cosines": [], "sines": [], **options}
                return self._remember(Fourier(**options), place)
            return self._remember(_TABULATED[kind](**options), place)

    def of_error(self, error: PinredError) -> tuple[Place, str] | None:
        """Return the place of the signal that an error names, and the message without it."""
        text = str(error)
        for signal, place in self._places:
            if repr(signal) in text:
                return place, text.replace(repr(signal), f"this {type(signal).__name__}")
        return None

    def _remember(self, signal: Signal, place: Place) -> Signal:
        self._places.append((signal, place))
        return signal


FunctionFormat: TypeAlias = Literal["of the shape", "by joint", "on the base"]
KeyTexts: TypeAlias = Mapping[str, tuple[Node, str]]  # {key: (type of the value, meaning)}


@dataclass(frozen=True)
class ForceKind:
    """A kind of force in scene files.

    Attributes:
        make: Builds the force from the entries of its table.
        table: The keys of the table.
        function: Format of the key `function`: a formula "of the shape", actions "by joint", or
            a list of actions "on the base".  None for a kind without this key.
    """

    make: Callable[..., Force]
    table: Table
    function: FunctionFormat | None = None


def _force_kind(
    force: type[Force],
    words: str,
    texts: KeyTexts,
    *,
    function: FunctionFormat | None = None,
    defaults: Mapping[str, str] | None = None,
) -> ForceKind:
    """Return a kind of force with a key for each field of its class.

    Args:
        force: Class of the force.
        words: Description of the force.
        texts: {field: (type, meaning)}; the fields `limit` and `name` need no entry.
        function: See ForceKind.
        defaults: {field: default in words} for fields whose default value needs an explanation;
            "" makes the key required.
    Returns:
        The kind of force.
    """
    keys: dict[str, Key] = {}
    for field in fields(force):  # type: ignore[arg-type]
        node, text = {**_COMMON, **texts}[field.name]
        default = "" if field.default is MISSING else _in_words(field.default)
        if field.name == "name":
            default = "its kind"
        default = (defaults or {}).get(field.name, default)
        keys[field.name] = Key(node, text, required=not default, default=default)
        if field.name == "limit":
            keys["smooth"] = Key(Flag(), "limit by a tanh, without a kink", default="false")
    needs = {"smooth": "limit"} if "limit" in keys else {"at": "link"} if "at" in keys else {}
    return ForceKind(force, Table(keys, words, needs=needs), function)


def _in_words(default: Any) -> str:
    if isinstance(default, float):
        return f"{default:g}"
    return str(default) if default else "none"


_COMMON: KeyTexts = {
    "name": (Text(), "name in tables and messages"),
    "limit": (PER_JOINT, "largest torque [N·m | N]"),
}
_JOINT = (Text((), "the name of a joint"), "name of the joint")
_TO = (Text((), "the name of a joint"), "name of a second joint, at the other end")
_BALL = (Text((), "the name of a ball joint"), "name of the ball joint")
_ATTITUDE_TEXT = "rotation vector [rad] or quaternion (x, y, z, w)"
_STIFFNESS = Either((NUMBER, ListOf(ListOf(NUMBER, 3), 3)))
_CONTROL: KeyTexts = {
    "reference": (
        ByName(PLAN),
        "desired motion of each joint [rad | m]; of a ball an attitude over time",
    ),
    "kp": (PER_JOINT, "gain of the position error"),
    "kd": (PER_JOINT, "gain of the rate error"),
}
FORCES: dict[str, ForceKind] = {
    "spring": _force_kind(
        kinds.Spring,
        "a spring at a joint, or between two",
        {
            "joint": _JOINT,
            "stiffness": (NUMBER, "stiffness k [N·m/rad | N/m]"),
            "rest": (NUMBER, "joint position without torque [rad | m]"),
            "to": _TO,
            "polynomial": (NUMBERS, "k₂, k₃, … of −τ = k y + k₂ y² + k₃ y³ + …"),
        },
    ),
    "damper": _force_kind(
        kinds.Damper,
        "a damper at a joint, or between two",
        {
            "joint": _JOINT,
            "coefficient": (NUMBER, "damping coefficient c [N·m·s/rad | N·s/m]"),
            "to": _TO,
            "polynomial": (NUMBERS, "c₂, c₃, … of −τ = v (c + c₂ |v| + c₃ |v|² + …)"),
        },
    ),
    "friction": _force_kind(
        kinds.Friction,
        "dry friction at a joint, smooth: −most·tanh(v/width)",
        {
            "joint": _JOINT,
            "most": (NUMBER, "torque of dry friction [N·m | N]"),
            "width": (POSITIVE, "joint rate over which the torque changes sign [rad/s | m/s]"),
        },
        defaults={"width": ""},
    ),
    "ball_spring": _force_kind(
        kinds.BallSpring,
        "a spring at a ball joint, with the angle θ and the rotation vector r from rest",
        {
            "joint": _BALL,
            "stiffness": (
                _STIFFNESS,
                "stiffness k [N·m/rad]; for the laws vector and trace also a symmetric matrix, "
                "in the axes of the child",
            ),
            "rest": (NUMBERS, f"attitude without torque: {_ATTITUDE_TEXT}"),
            "law": (
                Text(kinds.BallSpring.LAWS),
                "potential: angle ½ k θ², cosine k (1 − cos θ), vector ½ rᵀ K r, or trace "
                "tr (G (1 − R))",
            ),
            "polynomial": (NUMBERS, "k₂, k₃, … of the law angle: torque −(k + k₂ θ + k₃ θ² + …) r"),
        },
        defaults={"rest": "no rotation"},
    ),
    "ball_pd": _force_kind(
        kinds.BallPD,
        "a PD controller of the attitude of a ball joint: torque −kp log(E) − kd (σ − Eᵀ σ_d), "
        "E = R_dᵀ R",
        {
            "joint": _BALL,
            "attitude": (
                ATTITUDE,
                f"desired attitude: {_ATTITUDE_TEXT}, or an attitude over time",
            ),
            "kp": (NUMBER, "gain of the attitude error [N·m/rad]"),
            "kd": (NUMBER, "gain of the rate [N·m·s/rad]"),
            "limit": (PER_JOINT, "largest torque about each axis [N·m], such as neck.x"),
        },
    ),
    "ball_limit": _force_kind(
        kinds.BallLimit,
        "a smooth potential that limits the swing and the twist of a ball joint",
        {
            "joint": _BALL,
            "swing": (POSITIVE, "largest swing angle, less than π [rad]"),
            "twist": (POSITIVE, "largest twist angle, less than π [rad]"),
            "axis": (Text(("x", "y", "z")), "axis of the child about which it twists"),
            "stiffness": (NUMBER, "stiffness k [N·m]"),
            "width": (POSITIVE, "width of the transition, in cosines"),
        },
    ),
    "potential": _force_kind(
        kinds.PotentialEnergy,
        "a potential energy of the shape",
        {"function": (Text((), "a formula in x"), "potential V(x) [J], a formula in x")},
        function="of the shape",
    ),
    "torque": _force_kind(
        kinds.Torque,
        "torques at the joints",
        {
            "function": (
                ByName(ACTION),
                "torque at each joint [N·m | N], as a number, formula or signal table",
            )
        },
        function="by joint",
    ),
    "pd": _force_kind(
        kinds.PD, "a PD controller of the joints: torque kp (x_d − x) + kd (ẋ_d − ẋ)", _CONTROL
    ),
    "computed_torque": _force_kind(
        kinds.ComputedTorque,
        "torques that make every joint follow its reference exactly",
        _CONTROL,
    ),
    "wrench": _force_kind(
        kinds.Wrench,
        "a wrench on the base, such as thrusters, or on a link",
        {
            "function": (
                ListOf(ACTION),
                "wrench [linear; angular]: on the base one entry for each dimension of the group, "
                "on a link a force (3 entries) or a force and a moment (6); each entry is a "
                "number, formula or signal table",
            ),
            "link": (Text((), "the name of a link"), "link on which the wrench acts"),
            "at": (ListOf(NUMBER, 3), "point of application in the frame of the link [m]"),
            "frame": (
                Text(AXES),
                "axes of the entries: body for the axes of the base or link, world for the axes "
                "in which the pose of the base is stated",
            ),
        },
        function="on the base",
        defaults={"link": "the base", "at": "origin of the link"},
    ),
}
_NO_FUNCTIONS = (
    "a Controller is a Python function, and scene files are never executed; "
    "write it in Python, or use pd, computed_torque or torque"
)
FORCE = Tagged(
    "kind",
    {name: kind.table for name, kind in FORCES.items()},
    "a force {kind = …}",
    {"controller": _NO_FUNCTIONS},
)


@dataclass(frozen=True)
class NamedNumbers(Node):
    """A table from names to numbers or lists of numbers; nested tables extend the names."""

    types = (dict,)
    words = "a table {name = number or list of numbers}"
    name = "parameters"

    def _read(self, value: Any, place: Place) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for name, entry in value.items():
            node: Node = self if isinstance(entry, dict) else NUMBER
            if isinstance(entry, list):
                node = NUMBERS
            values[name] = node.read(entry, place / name)
        return values

    def _schema(self, defs: dict[str, Schema]) -> Schema:
        nodes = (NUMBER, NUMBERS, self)
        return {
            "type": "object",
            "additionalProperties": {"anyOf": [node.schema(defs) for node in nodes]},
        }


@dataclass(frozen=True)
class FileParameter:
    """A parameter in a file.

    Attributes:
        name: Full name, with dots.
        value: A number or a list of numbers.
        place: Its place in the file.
    """

    name: str
    value: Any
    place: Place


def file_parameters(document: Mapping[str, Any], place: Place) -> list[FileParameter]:
    """Return the parameters of a document; raise InputError if a name occurs twice."""
    parameters: dict[str, FileParameter] = {}
    for parameter in _flatten(document.get("parameters", {}), "", place / "parameters"):
        if parameter.name in parameters:
            parameter.place.fail(
                f"'{parameter.name}' is given twice, here and as a name in another form"
            )
        parameters[parameter.name] = parameter
    return list(parameters.values())


def _flatten(table: Mapping[str, Any], prefix: str, place: Place) -> Iterator[FileParameter]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flatten(value, f"{prefix}{key}.", place / key)
        else:
            yield FileParameter(prefix + key, value, place / key)


def with_robot_parameters(
    system: System, parameters: Sequence[FileParameter], place: Place
) -> tuple[System, list[FileParameter]]:
    """Apply the parameters of a file that belong to the robot.

    Args:
        system: The robot as loaded.
        parameters: The parameters of the file.
        place: Place of the top level of the document.
    Returns:
        The robot with its parameters, and the remaining parameters, which belong to formulas.
    Raises:
        InputError: a value is not physical; the message names the key.
    """
    values: dict[str, Any] = {}
    other_parameters: list[FileParameter] = []
    for parameter in parameters:
        with naming(parameter.place, "parameters: "):
            if size_of(system, parameter.name) is None:
                other_parameters.append(parameter)
                continue
            refuse_vague(system, parameter.name)
            values[parameter.name] = parameter.value
            with_parameters(system, {parameter.name: parameter.value})
    with naming(place / "parameters", "parameters: "):
        return with_parameters(system, values) if values else system, other_parameters


def refuse_others(system: System, others: Sequence[FileParameter]) -> None:
    """Raise InputError for parameters that the robot does not have."""
    for parameter in others:
        parameter.place.fail(
            f"there is no '{parameter.name}'; {kinds_near(system, parameter.name)}"
        )
