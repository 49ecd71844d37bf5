"""The keys of scene files: the one description that reader, JSON Schema and docs go by."""

from __future__ import annotations

from math import inf

from ...common.defaults import Default
from ...integrators.methods import METHODS, Method, Option, options_of
from ...lie.groups import GROUPS
from ..random_state import DURATION
from ..scene import ENGINES, EVEN_TIMES, OUTPUTS, Scene
from .force_kinds import FORCE
from .parameter_tables import NamedNumbers
from .schema import (
    ByName,
    Either,
    Flag,
    Key,
    ListOf,
    Node,
    Schema,
    Table,
    Tagged,
    Text,
    Whole,
    document_schema,
)
from .signal_keys import NUMBER, NUMBERS, POSITIVE, SHAPE, SIGNAL

MOST_SAMPLES = 1_000_000
_APART = (
    ("xi0", "momentum"),
    *((name, "q0") for name in ("x0", "pose0")),
    *((name, "v0") for name in ("xdot0", "xi0", "momentum")),
    *(
        (name, whole)
        for name in ("x0", "xdot0", "xi0", "momentum", "q0", "v0")
        for whole in ("seed", "keyframe")
    ),
    ("seed", "keyframe"),
)
LOAD = Table(
    {
        "group": Key(Text(tuple(GROUPS)), "the symmetry", default="the robot's own root"),
        "gravity": Key(ListOf(NUMBER, 3), "in the world frame [m/s²]", default="the robot's own"),
        "lock": Key(
            Either((ListOf(Text((), "the name of a joint")), ByName(NUMBER))),
            "joints to freeze at zero, or at the values given by name [rad | m]",
            default="none",
        ),
        "root": Key(
            Text((), "the name of a body"),
            "of an MJCF file, the body of the world that carries the robot, where several move",
            default="the only one",
        ),
        "strict": Key(Flag(), "refuse what is otherwise a warning", default="false"),
        "meshes": Key(
            Either((Text((), "a folder"), ListOf(Text((), "a folder")))),
            "where playback looks for the meshes of a URDF, relative to this file",
            default="in folders above the robot's file",
        ),
    },
    "the options of pinred.load",
)
_OWN = "the robot's own, or zero beside the other of x0 and xdot0"
START = Table(
    {
        "x0": Key(SHAPE, "shape [rad | m]; by name, the others are zero", default=_OWN),
        "xdot0": Key(SHAPE, "shape rate; by name, the others are zero", default=_OWN),
        "q0": Key(NUMBERS, "Pinocchio's configuration instead of x0 and pose0", default="as of x0"),
        "v0": Key(
            NUMBERS, "Pinocchio's velocity instead of xdot0, xi0, momentum", default="as of xdot0"
        ),
        "xi0": Key(NUMBERS, "body twist of the base [linear; angular]", default="as of x0"),
        "momentum": Key(
            Either((NUMBER, NUMBERS)), "body momentum instead of xi0, or just 0", default="from xi0"
        ),
        "pose0": Key(NUMBERS, "pose of the base, as in Trajectory.pose", default="identity"),
        "seed": Key(Whole(), "a random state instead of all these but pose0", default="none"),
        "keyframe": Key(
            Text((), "the name of a keyframe"),
            "a state that an MJCF file has a name for, instead of all these but pose0",
            default="none",
        ),
    },
    "the initial state",
    apart=_APART,
)


def _method_table(kind: type[Method]) -> Table:
    """Return the table of a method's options."""
    return Table(
        {
            option.name: Key(
                _option_node(option),
                option.about,
                required=option.required,
                default=_default_of(option),
            )
            for option in options_of(kind)
        },
        kind.about,
    )


def _option_node(option: Option) -> Node:
    if option.kind == "float":
        return POSITIVE
    if option.kind == "int":
        return Whole(option.least, option.most)
    return Text(option.among)


def _default_of(option: Option) -> str:
    """Return what holds without an option: of tolerances, the scene's, or their own as a pair."""
    if not isinstance(option.default, Default):
        return "" if option.required else _shown_default(option.default)
    other = {"rtol": "atol", "atol": "rtol"}[option.name]
    return f"a tenth of run.{option.name}, or {_shown_default(option.default)} beside {other}"


def _shown_default(value: float | str) -> str:
    if value == inf:
        return "none"
    return f"{value:g}".replace("e-0", "e-") if isinstance(value, float) else str(value)


_INTEGRATOR = "an integrator {name = …}"
_APART_FROM = "not beside a method's own"
_METHODS = {
    "auto": Table({}, "one that suits the scene and its tolerance"),
    **{name: _method_table(kind) for name, kind in METHODS.items()},
}
RUN = Table(
    {
        "duration": Key(
            POSITIVE, "how long to simulate [s]", default=f"the robot's own, or {DURATION:g}"
        ),
        "times": Key(NUMBERS, "where to report [s], increasing", default="even ones"),
        "samples": Key(
            Whole(2, MOST_SAMPLES), "number of even report times instead", default=str(EVEN_TIMES)
        ),
        "rtol": Key(POSITIVE, "relative tolerance", default=f"{Scene.rtol:g}; {_APART_FROM}"),
        "atol": Key(POSITIVE, "absolute tolerance", default=f"{Scene.atol:g}; {_APART_FROM}"),
        "outputs": Key(Text(OUTPUTS), "shape leaves out the base", default=Scene.outputs),
        "engine": Key(Text(ENGINES), "what integrates", default=ENGINES[0]),
        "method": Key(
            Either((Text((), "an integrator as text"), Tagged("name", _METHODS, _INTEGRATOR))),
            'an integrator of the compiled engine: "Radau", "RKMK4(0.01)", or a table',
            default="auto",
        ),
    },
    "how to simulate",
    apart=(("times", "samples"),),
)

EVENT = Table(
    {
        "function": Key(
            Text((), "a formula"), "what crosses zero there, a formula of the state", required=True
        ),
        "name": Key(Text(), "what results call it", default="event"),
        "terminal": Key(Flag(), "whether the motion ends there", default="false"),
        "direction": Key(Whole(-1, 1), "1 rising, -1 falling, 0 both", default="0"),
    },
    "an event",
)
# Which robot, in files of scenes and of gaits.
ROBOT = {
    "robot": Key(
        Text(),
        "a robot's name, or a URDF or MJCF file relative to this file (with a suffix or /)",
        required=True,
    ),
    "load": Key(LOAD, "how to read the robot: the options of pinred.load"),
}
SCENE = Table(
    {
        **ROBOT,
        "start": Key(START, "the initial state", default="the robot's own"),
        "run": Key(RUN, "for how long and how accurately"),
        "springs": Key(
            ByName(ListOf(NUMBER, 2)), "joint = [stiffness, rest], short for forces of kind spring"
        ),
        "passive": Key(
            Flag(), "whether springs and dampers in the robot's file act", default="false"
        ),
        "friction": Key(
            POSITIVE,
            "dry friction in the file acts, with this width of its smooth law [rad/s | m/s]",
            default="it does not",
        ),
        "parameters": Key(
            NamedNumbers(),
            "numbers by name: of the robot, such as hand.mass (docs/flow.md), and those that the "
            "formulas of forces and events use",
        ),
        "prescribed": Key(ByName(SIGNAL), "joints that follow a plan, each a signal"),
        "forces": Key(ListOf(FORCE), "what acts"),
        "events": Key(ListOf(EVENT), "moments to find, and to end at"),
    },
    "a scene",
)


def scene_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of scene files, as read from TOML."""
    return document_schema(SCENE, "pinred scene")
