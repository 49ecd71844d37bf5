"""Descriptions of all options: of a Scene, of methods, of runs, of `pinred.load` and of sweeps.

A field of SceneFields holds the Python type, the default, the meaning with its unit, the value
type in scene files, and the name on the command line.  Scene, the keys of scene files, their
JSON Schema, the command line and docs/scenes.md are derived from it.  SceneOptions repeats the
types, because type checkers cannot derive a TypedDict from a dataclass.

The parameters of `pinred.load` and `pinred.sweep` have the names of their options.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from math import inf
from textwrap import fill
from typing import Any, Literal, TypeAlias, TypedDict, get_args

from numpy.typing import ArrayLike

from ..common.argument_kinds import Default, checks_arguments
from ..common.parameter import Parameter
from ..forces.controller import Control, Controller
from ..forces.force import Force
from ..forces.signals import Attitude, Signal
from ..integrators.methods import METHODS, Method, options_of
from ..integrators.methods import Option as MethodOption
from ..integrators.methods.method import ATOL, RTOL
from ..lie.groups import GROUPS
from ..system.loops.loop import KINDS
from ..system.system import System
from .event import EVENT_TABLE, Event
from .initial_state import DURATION
from .parse_options import EVEN_TIMES
from .stop import STOPS, BallStop, Stop
from .toml.schema import (
    ByName,
    Either,
    Flag,
    Key,
    ListOf,
    Node,
    Place,
    Schema,
    Table,
    Tagged,
    Text,
    Whole,
)
from .toml.value_tables import ACTION, FORCE, NUMBER, NUMBERS, PLAN, POSITIVE, SHAPE, NamedNumbers


def _method_table(method: type[Method]) -> Table:
    """Return the table (keys of a scene file) for a method's options."""
    keys = {
        option.name: Key(
            _option_node(option),
            option.about,
            required=option.required,
            default=_default_of(option),
        )
        for option in options_of(method)
    }
    return Table(keys, method.about)


def _option_node(option: MethodOption) -> Node:
    if option.kind == "float":
        return POSITIVE
    if option.kind == "int":
        return Whole(option.least, option.most)
    return Text(option.among)


def _default_of(option: MethodOption) -> str:
    """Describe the default of an option; a tolerance defaults to a tenth of the scene's."""
    if not isinstance(option.default, Default):
        return "" if option.required else _in_words(option.default)
    other = {"rtol": "atol", "atol": "rtol"}[option.name]
    return f"a tenth of run.{option.name}, or {_in_words(option.default)} beside {other}"


def _in_words(value: float | str) -> str:
    if value == inf:
        return "none"
    return f"{value:g}".replace("e-0", "e-") if isinstance(value, float) else str(value)


METHOD_TABLES = {
    "auto": Table({}, "choose a method that suits the scene and its tolerance"),
    **{name: _method_table(method) for name, method in METHODS.items()},
}
METHOD_NAMES = tuple(METHOD_TABLES)
METHOD = Either(
    (
        Text((), "an integrator as text"),
        Tagged("name", METHOD_TABLES, "an integrator {name = …}"),
    )
)


Engine: TypeAlias = Literal["compiled", "pinocchio"]
Level: TypeAlias = float | Parameter
JointPlan: TypeAlias = Signal | Level | str | Attitude | Sequence[Signal | Level | str]
WantedOutputs: TypeAlias = Literal["all", "shape"]
Held: TypeAlias = Literal["others", "free"]
HELD: tuple[Held, ...] = get_args(Held)
ENGINES: tuple[Engine, ...] = get_args(Engine)
OUTPUTS: tuple[WantedOutputs, ...] = get_args(WantedOutputs)
BY_JOINT = "V1,V2,… or J1=V1,…"  # command-line format of values in joint order or by joint
_VECTOR = "V1,V2,…"  # command-line format of a vector
_STATE = ("x0", "xdot0", "xi0", "momentum", "q0", "v0")
_MOST_SAMPLES = 1_000_000  # largest number of report times in a scene file


@dataclass(frozen=True)
class Option(Key):
    """The description of a scene option.

    Attributes:
        node: Type of the value in scene files.
        text: Meaning, with unit.
        required: Not used; every option has a default.
        default: Value that applies without the option, in words.
        formats: Accepted values in Python, beyond the annotated type.
        command: Name and value format on the command line, such as "--duration T"; "" for none.
        table: Table of the option in scene files; "" for the top level.
        replaces: Options that cannot be combined with this option, because it sets the same
            quantities.
        scope: The quantities that this option sets instead of the replaced options.
    """

    formats: str = ""
    table: str = ""
    replaces: tuple[str, ...] = ()
    scope: str = ""


def _option(node: Node, text: str, default: str = "none", **more: Any) -> dict[str, Option]:
    """Return the metadata of a field in SceneFields; the arguments are those of Option."""
    return {"option": Option(node, text, default=default, **more)}


class SceneOptions(TypedDict, total=False):
    """The fields of Scene except its system, for functions that take them as `**options`."""

    x0: ArrayLike | Mapping[str, ArrayLike] | None
    xdot0: ArrayLike | Mapping[str, ArrayLike] | None
    xi0: ArrayLike | None
    momentum: ArrayLike | None
    seed: int | None
    keyframe: str | None
    pose0: Any
    q0: ArrayLike | None
    v0: ArrayLike | None
    duration: float | None
    times: ArrayLike | None
    rtol: float
    atol: float
    springs: Mapping[str, tuple[Level, Level]]
    forces: Sequence[Force] | Force
    prescribed: Mapping[str, JointPlan]
    hold: Held | None
    controls: Mapping[str, Control] | Controller
    passive: bool
    friction: float | None
    stops: Mapping[str, Stop | BallStop | Sequence[float]] | str | None
    parameters: Any
    events: Sequence[Event] | Event
    outputs: WantedOutputs
    method: Method | str


@checks_arguments
@dataclass(frozen=True, kw_only=True, eq=False)
class SceneFields:
    """The fields of Scene, with the description of each option in the metadata."""

    system: System
    x0: ArrayLike | Mapping[str, ArrayLike] | None = field(default=None, metadata=_option(
        SHAPE, "initial shape [rad | m]; a ball has a rotation vector or a quaternion "
        "(x, y, z, w); if joints are named, the others are at rest",
        default="the robot's own, or at rest if xdot0 is stated",
        formats="(nx,), or {joint: value}",
        table="start", command=f"--x0 {BY_JOINT}",
    ))  # fmt: skip
    xdot0: ArrayLike | Mapping[str, ArrayLike] | None = field(default=None, metadata=_option(
        SHAPE, "initial shape rate [rad/s | m/s]; a ball has the angular velocity of its child; "
        "if joints are named, the others have rate zero",
        default="the robot's own, or zero if x0 is stated", formats="(m,), or {joint: value}",
        table="start", command=f"--xdot0 {BY_JOINT}",
    ))  # fmt: skip
    xi0: ArrayLike | None = field(default=None, metadata=_option(
        NUMBERS, "initial body twist of the base, [linear; angular] [m/s; rad/s]",
        default="the robot's own if its shape and rate are, else zero", formats="(r,)",
        table="start", command=f"--xi0 {_VECTOR}",
    ))  # fmt: skip
    momentum: ArrayLike | None = field(default=None, metadata=_option(
        Either((NUMBER, NUMBERS)),
        "initial body momentum, [linear; angular] [N·s; N·m·s], or 0 for zero momentum",
        default="computed from xi0", formats="(r,), a number if r = 1, or 0", table="start",
        command=f"--momentum {_VECTOR}", replaces=("xi0",),
    ))  # fmt: skip
    seed: int | None = field(default=None, metadata=_option(
        Whole(), "seed of a random initial state, which replaces all of the state except pose0",
        table="start", command="--seed S", replaces=_STATE,
        scope="a whole random state",
    ))  # fmt: skip
    keyframe: str | None = field(default=None, metadata=_option(
        Text((), "the name of a keyframe"),
        "name of a state in an MJCF file; pose0, xdot0, xi0, momentum or v0 replace parts of it",
        formats="a name in System.keyframes", table="start",
        command="--keyframe K", replaces=("x0", "q0", "seed"), scope="shape and pose",
    ))  # fmt: skip
    pose0: Any = field(default=None, metadata=_option(
        NUMBERS,
        "initial pose of the base, in the order of Trajectory.pose [m; rad or quaternion]",
        default="identity", formats="(size,)", table="start", command=f"--pose0 {_VECTOR}",
    ))  # fmt: skip
    q0: ArrayLike | None = field(default=None, metadata=_option(
        NUMBERS, "initial configuration of system.model, which replaces x0 and pose0",
        formats="(nq,), with angles in (−π, π]", table="start",
        command=f"--q0 {_VECTOR}", replaces=("x0", "pose0"), scope="shape and pose",
    ))  # fmt: skip
    v0: ArrayLike | None = field(default=None, metadata=_option(
        NUMBERS, "initial velocity of system.model, which replaces xdot0, xi0 and momentum",
        formats="(n,)", table="start", command=f"--v0 {_VECTOR}",
        replaces=("xdot0", "xi0", "momentum"), scope="shape rate and body twist",
    ))  # fmt: skip
    duration: float | None = field(default=None, metadata=_option(
        POSITIVE, "time to simulate [s]",
        default=f"the last of times, else the robot's own, else {DURATION:g}", table="run",
        command="--duration T",
    ))  # fmt: skip
    times: ArrayLike | None = field(default=None, metadata=_option(
        NUMBERS, "report times [s], increasing", default=f"{EVEN_TIMES} evenly spaced ones",
        formats="(T,)", table="run",
    ))  # fmt: skip
    rtol: float = field(default=RTOL, metadata=_option(
        POSITIVE, "relative tolerance of a step; omit it if the method has its own tolerances",
        default=f"{RTOL:g}", table="run", command="--rtol TOL",
    ))  # fmt: skip
    atol: float = field(default=ATOL, metadata=_option(
        POSITIVE, "absolute tolerance of a step; omit it if the method has its own tolerances",
        default=f"{ATOL:g}", table="run", command="--atol TOL",
    ))  # fmt: skip
    springs: Mapping[str, tuple[Level, Level]] = field(default_factory=dict, metadata=_option(
        ByName(ListOf(NUMBER, 2)),
        "springs at joints, each a pair of stiffness [N·m/rad | N/m] and rest position [rad | m]",
        formats="{joint: (stiffness, rest)}, short for pinred.forces.Spring",
        command="--springs J=K,REST",
    ))  # fmt: skip
    forces: Sequence[Force] | Force = field(default=(), metadata=_option(
        ListOf(FORCE), "forces on joints, base and links",
        formats="forces of pinred.forces",
    ))  # fmt: skip
    prescribed: Mapping[str, JointPlan] = field(default_factory=dict, metadata=_option(
        ByName(PLAN),
        "joints with a prescribed motion [rad | m]: a number, or a function of time such as "
        "0.4*sin(t); a ball has three of these as a rotation vector, or a quaternion",
        formats="{joint: Signal, number, or formula in t; Attitude or three of these for a ball}",
        command="--prescribed J=PLAN",
    ))  # fmt: skip
    hold: Held | None = field(default=None, metadata=_option(
        Text(HELD), "others: keep joints without prescribed motion at their initial positions; "
        "free: let them move, without the warning that names them",
        default="the others move freely, and a warning names them", command="--hold W",
    ))  # fmt: skip
    controls: Mapping[str, Control] | Controller = field(default_factory=dict, metadata=_option(
        ByName(ACTION, "controls", "actuator"),
        "controls of actuators in an MJCF file: numbers, or functions of time and state such as "
        "0.3*sin(2*t), clamped to the limits of the file; other actuators do not act",
        formats="{actuator: number, Signal, formula, or function as of a Torque}, or a Controller "
        "whose function returns the controls of all actuators",
        command="--controls A=CONTROL",
    ))  # fmt: skip
    passive: bool = field(default=False, metadata=_option(
        Flag(), "let the springs and dampers of the robot's file act", default="false",
        command="--passive",
    ))  # fmt: skip
    friction: float | None = field(default=None, metadata=_option(
        POSITIVE,
        "let the dry friction of the robot's file act as −most·tanh(rate/WIDTH), with this "
        "width [rad/s | m/s]", default="no friction", command="--friction WIDTH",
    ))  # fmt: skip
    stops: Mapping[str, Stop | BallStop | Sequence[float]] | str | None = field(
        default=None, metadata=_option(
            STOPS,
            "stops of joints [rad | m]: file for the limits of hinges and slides in the robot's "
            "file; or lower and upper stop by joint, perhaps with a restitution from 0 to 1",
            formats="'file', or {joint: (lower, upper), (lower, upper, restitution), Stop or "
            "BallStop}",
            command="--stops file or J=LOWER,UPPER,E",
        ),
    )  # fmt: skip
    parameters: Any = field(default_factory=dict, metadata=_option(
        NamedNumbers(),
        "values of robot parameters, such as hand.mass (docs/flow.md), and of the parameters "
        "in formulas", formats="{name: value}, a list of names, or 'all'",
    ))  # fmt: skip
    events: Sequence[Event] | Event = field(default=(), metadata=_option(
        ListOf(EVENT_TABLE), "events to detect; a terminal event ends the motion",
    ))  # fmt: skip
    outputs: WantedOutputs = field(default="all", metadata=_option(
        Text(OUTPUTS), "outputs to compute: all, or shape to omit the motion of the base",
        default="all", table="run", command="--outputs O",
    ))  # fmt: skip
    method: Method | str = field(default="auto", metadata=_option(
        METHOD,
        f"integrator of the compiled engine: {', '.join(METHOD_NAMES)}; with options, such "
        "as Gauss(0.01, 8)", default="auto", formats="a method of pinred, or text", table="run",
        command="--method M",
    ))  # fmt: skip


SCENE_OPTIONS: dict[str, Option] = {
    entry.name: entry.metadata["option"]
    for entry in fields(SceneFields)
    if "option" in entry.metadata
}
# Options that state the initial state as arrays.
ARRAYS_OF_STATE = ("x0", "xdot0", "pose0", "xi0", "momentum", "q0", "v0")
# Options of scene files and commands that are not fields of a Scene.
RUN_OPTIONS = {
    "samples": Option(
        Whole(2, _MOST_SAMPLES), "number of evenly spaced report times", default=str(EVEN_TIMES),
        table="run", command="--samples N", replaces=("times",),
    ),
    "engine": Option(
        Text(ENGINES),
        "engine: compiled for machine code, pinocchio for Pinocchio with SciPy's DOP853",
        default=ENGINES[0], table="run", command="--engine E",
    ),
    "check": Option(
        Flag(),
        "find forces that steps skip, such as in a narrow range of the shape, and run again with "
        "stops there", default="false", table="run", command="--check-steps",
    ),
    "checkpoint": Option(
        Text((), "the name of a .ckpt file"),
        "file to which the state of the run is written every minute, at Ctrl-C and at the end; "
        "if it exists, the run continues from it", default="none",
        table="run", command="--checkpoint FILE",
    ),
}  # fmt: skip


def list_conflicts(options: Mapping[str, Option]) -> list[tuple[str, str]]:
    """Return the pairs of options that cannot be combined."""
    return [(other, name) for name, option in options.items() for other in option.replaces]


def describe_fields(options: Mapping[str, Option]) -> str:
    """Return the section `Attributes` of the docstring of Scene."""
    lines = ["    Attributes:", "        system: The system to simulate."]
    for name, option in options.items():
        formats = f"{option.formats}.  " if option.formats else ""
        text = option.text[0].upper() + option.text[1:]
        line = f"{name}: {formats}{text}.  Default: {option.default}."
        lines.append(fill(line, 100, initial_indent=8 * " ", subsequent_indent=12 * " "))
    return "\n".join(lines)


LOOP = Table(
    {
        "frame_a": Key(Text((), "a link or frame"), "link or frame", required=True),
        "frame_b": Key(Text((), "a link or frame"), "other link or frame", required=True),
        "kind": Key(
            Text(KINDS),
            "3d: the origins coincide; 6d: the frames coincide; x, y or z: the origins and this "
            "axis coincide",
            default="3d",
        ),
        "name": Key(Text((), "a name"), "name in messages", default="frame_a = frame_b"),
        "coupled": Key(
            Flag(),
            "whether couplings replace the loop if its closed shapes are linear in independent "
            "joints",
            default="true",
        ),
    },
    "a closed loop",
)

LOAD = Table(
    {
        "group": Key(
            Text(tuple(GROUPS)),
            f"symmetry group: {', '.join(GROUPS)}",
            default="motion of the root joint",
            command="--group G",
        ),
        "gravity": Key(
            ListOf(NUMBER, 3),
            "gravity in the world frame [m/s²]",
            default="the robot's own",
            command="--gravity V1,V2,…",
        ),
        "lock": Key(
            Either(
                (
                    ListOf(Text((), "the name of a joint")),
                    ByName(Either((NUMBER, NUMBERS))),
                )
            ),
            "joints to lock at zero, or at the values stated by name [rad | m]; a ball has a "
            "rotation vector or a quaternion (x, y, z, w)",
            default="none",
            command="--lock J1,J2=VALUE,…",
        ),
        "balls": Key(
            Either((Flag(), ListOf(Text((), "the name of a ball or of a hinge")))),
            "three hinges at one point to merge into a ball, by name; true: all such hinges",
            default="false",
            command="--balls all or B1,B2,…",
        ),
        "loops": Key(
            Either((Text((), "a YAML file, or loops A=B:KIND,…"), ListOf(LOOP))),
            "closed kinematic loops, besides those of the robot's file: tables, or a YAML file "
            "relative to this file",
            default="none",
            command="--loops A=B:KIND,… or FILE.yaml",
        ),
        "root": Key(
            Text((), "the name of a body"),
            "root body of the robot, for MJCF files in which several bodies of the world move; "
            "base link, or model, of the robot, for SDF files with several",
            default="the only one that moves",
            command="--root BODY",
        ),
        "strict": Key(
            Flag(), "reject a robot that causes a warning", default="false", command="--strict"
        ),
        "meshes": Key(
            Either((Text((), "a folder"), ListOf(Text((), "a folder")))),
            "folders with the meshes of a URDF, or with the models that an SDF file includes; in "
            "scene files relative to them",
            default="folders above the robot's file",
            command="--meshes FOLDER",
        ),
    },
    "the options of pinred.load",
)


Sampler: TypeAlias = Literal["sobol", "latin", "random", "grid"]
SAMPLERS: tuple[Sampler, ...] = get_args(Sampler)
BLOCK = 16_384  # default number of points of a block


@dataclass(frozen=True)
class Laws(Node):
    """A table from names of numbers to distributions; nested tables extend the names."""

    types = (dict,)
    words = 'a table {name = "Uniform(0.5, 2)" or list of numbers}'
    name = "distributions"

    def _read(self, value: Any, place: Place) -> dict[str, Any]:
        """Return {name with dots: text or list of numbers}."""
        laws: dict[str, Any] = {}
        for name, entry in value.items():
            if isinstance(entry, dict):
                nested = self.read(entry, place / name)
                read = {f"{name}.{end}": law for end, law in nested.items()}
            else:
                read = {name: _LAW.read(entry, place / name)}
            for key, law in read.items():
                if key in laws:
                    (place / name).fail(f"'{key}' is stated twice")
                laws[key] = law
        return laws

    def _schema(self, defs: dict[str, Schema]) -> Schema:
        return {
            "type": "object",
            "additionalProperties": {"anyOf": [_LAW.schema(defs), self.schema(defs)]},
        }


_LAW = Either((Text((), 'a distribution, such as "Uniform(0.5, 2)"'), NUMBERS))


def _of_sweep(node: Node, text: str, default: str, command: str, **more: Any) -> Option:
    return Option(node, text, default=default, table="sweep", command=command, **more)


SWEEP_OPTIONS: Mapping[str, Option] = {
    "vary": Option(
        Laws(),
        "numbers of the scene or robot that vary, each with its distribution: Uniform(low, high), "
        "LogUniform(low, high), Normal(mean, deviation), Grid(low, high, count), or a list",
        required=True, table="sweep", command="--vary NAME=LAW",
    ),
    "points": _of_sweep(
        Whole(1), "number of points", "the product of all lists, for the sampler grid", "--points N"
    ),
    "sampler": _of_sweep(
        Text(SAMPLERS), f"sampler: {', '.join(SAMPLERS)}", "sobol, or grid without points",
        "--sampler S",
    ),
    "seed": _of_sweep(Whole(), "seed of the sampler", "0", "--seed S"),
    "outputs": _of_sweep(
        Either((ListOf(Text()), ByName(Text()))),
        "what to store, by name: a field at the end of the motion, such as pose or pose.θ, or at "
        "all report times, such as pose(t); or turn, position(FRAME), peak_torque, excursion",
        "x, xdot, pose and energy", "--outputs [NAME=]FIELD",
    ),
    "store": _of_sweep(
        Text((), "the name of a .zarr folder"),
        "zarr folder of the results; if it exists, the sweep continues",
        "a temporary folder", "--store FOLDER",
    ),
    "scheduler": _of_sweep(
        Text((), "an address such as tcp://host:8786"),
        "address of a Dask scheduler, whose workers compute the blocks", "local threads",
        "--scheduler ADDRESS",
    ),
    "block": _of_sweep(
        Whole(1), "number of points of a block, which is stored at once", str(BLOCK), "--block N"
    ),
}  # fmt: skip
# The table of a scene file.
SWEEP = Key(Table(SWEEP_OPTIONS, "a sweep"), "numbers that `pinred sweep` varies")
