"""The keys of scene files: the one description that reader, JSON Schema and docs go by."""

from __future__ import annotations

from math import inf

from ...integrators.methods import METHODS, Method, Option, options_of
from ..scene import DURATION, ENGINES, EVEN_TIMES, OUTPUTS, Scene
from .schema import (
    ByName,
    Either,
    Flag,
    Key,
    ListOf,
    Named,
    Node,
    Number,
    Schema,
    Table,
    Tagged,
    Text,
    Whole,
)

GROUPS = ("R", "SO2", "SE2", "SO3", "SE3")
ENDS = ("natural", "clamped", "not-a-knot", "periodic")
MOST_SAMPLES = 1_000_000
_STATE = ("x0", "xdot0", "xi0", "momentum")
_BOTH = "time and value: two names in the header of the csv, or two columns counted from 0"

NUMBER, POSITIVE = Number(), Number(positive=True)
NUMBERS = ListOf(NUMBER)
PER_JOINT = Named("per_joint", Either((NUMBER, ByName(NUMBER))))
SHAPE = Named("shape", Either((NUMBERS, ByName(NUMBER))))


def _tabulated(words: str, **more: Key) -> Table:
    """Return the table of a signal through points, given in the table or in a csv file."""
    keys = {
        "times": Key(NUMBERS, "strictly increasing times [s], at most 1000"),
        "values": Key(NUMBERS, "as many values"),
        "file": Key(Text(), "a csv file with the times and values, relative to this file"),
        "columns": Key(ListOf(Either((Text((), "a name"), Whole())), 2), _BOTH, default="[0, 1]"),
        **more,
    }
    return Table(
        keys,
        words,
        needs={"times": "values", "values": "times", "columns": "file"},
        one_of=("times", "file"),
    )


_END = Key(Text(ENDS), "what holds at both ends", default="natural")
_FOURIER = Table(
    {
        "mean": Key(NUMBER, "the mean", default="0"),
        "cosines": Key(NUMBERS, "amplitudes of cos(2πk t/period), k from 1", default="none"),
        "sines": Key(NUMBERS, "amplitudes of sin(2πk t/period), k from 1", default="none"),
        "period": Key(POSITIVE, "period [s]", required=True),
    },
    "a Fourier series",
)
_KINDS = {
    "spline": Key(_tabulated("a cubic spline", end=_END), "the cubic spline through a table"),
    "linear": Key(_tabulated("straight lines"), "straight lines from entry to entry"),
    "hold": Key(_tabulated("steps"), "each value until the next"),
    "fourier": Key(_FOURIER, "mean + Σ aₖ cos(2πk t/period) + bₖ sin(2πk t/period)"),
}
SIGNAL_TABLE = Named("signal_table", Table(_KINDS, "a signal table", one_of=tuple(_KINDS)))
SIGNAL = Named("signal", Either((NUMBER, Text((), "a formula in t"), SIGNAL_TABLE)))
_FORMULA = Text((), "a formula in t, x, xdot and mu")
ACTION = Named("action", Either((NUMBER, _FORMULA, SIGNAL_TABLE)))

LOAD = Table(
    {
        "group": Key(Text(GROUPS), "the symmetry", default="the robot's own root"),
        "gravity": Key(ListOf(NUMBER, 3), "in the world frame [m/s²]", default="the robot's own"),
        "lock": Key(
            Either((ListOf(Text((), "the name of a joint")), ByName(NUMBER))),
            "joints to freeze at zero, or at the values given by name [rad | m]",
            default="none",
        ),
        "strict": Key(Flag(), "refuse what is otherwise a warning", default="false"),
    },
    "the options of pinred.load",
)
_OWN = "the robot's own, or zero beside the other of x0 and xdot0"
START = Table(
    {
        "x0": Key(SHAPE, "shape [rad | m]; by name, the others are zero", default=_OWN),
        "xdot0": Key(SHAPE, "shape rate; by name, the others are zero", default=_OWN),
        "xi0": Key(NUMBERS, "body twist of the base [linear; angular]", default="as of x0"),
        "momentum": Key(
            Either((NUMBER, NUMBERS)), "body momentum instead of xi0, or just 0", default="from xi0"
        ),
        "pose0": Key(NUMBERS, "pose of the base, as in Trajectory.pose", default="identity"),
        "seed": Key(Whole(), "a random state instead of all these but pose0", default="none"),
    },
    "the initial state",
    apart=(("xi0", "momentum"), *((name, "seed") for name in _STATE)),
)


def _method_table(kind: type[Method]) -> Table:
    """Return the table of a method's options."""
    return Table(
        {
            option.name: Key(
                _option_node(option),
                option.about,
                required=option.required,
                default="" if option.required else _shown_default(option.default),
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


def _shown_default(value: float | str) -> str:
    if value == inf:
        return "none"
    return f"{value:g}".replace("e-0", "e-") if isinstance(value, float) else str(value)


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
        "rtol": Key(POSITIVE, "relative tolerance", default=f"{Scene.rtol:g}"),
        "atol": Key(POSITIVE, "absolute tolerance", default=f"{Scene.atol:g}"),
        "outputs": Key(Text(OUTPUTS), "shape leaves out the base", default=Scene.outputs),
        "engine": Key(Text(ENGINES), "what integrates", default=ENGINES[0]),
        "method": Key(
            Tagged("name", _METHODS, "an integrator {name = …}"),
            "an integrator of the compiled engine",
            default="auto",
        ),
    },
    "how to simulate",
    apart=(("times", "samples"),),
)

_NAME = {"name": Key(Text(), "what tables and messages call it", default="its kind")}
_LIMITED = {
    "limit": Key(PER_JOINT, "largest torque [N·m | N]", default="none"),
    "smooth": Key(Flag(), "whether the limit is a tanh, not a kink", default="false"),
}
_SMOOTH = {"smooth": "limit"}
_JOINT = Key(Text((), "the name of a joint"), "the joint", required=True)
_TO = Key(Text((), "the name of a joint"), "the joint at the other end", default="none")
_REFERENCE = Key(ByName(SIGNAL), "where each joint should be [rad | m]", required=True)
_FOLLOWING = {
    "kp": Key(PER_JOINT, "gain of the position's error", required=True),
    "kd": Key(PER_JOINT, "gain of the rate's error", required=True),
}
FORCES = {
    "spring": Table(
        {
            "joint": _JOINT,
            "stiffness": Key(NUMBER, "[N·m/rad | N/m]", required=True),
            "rest": Key(NUMBER, "where it is relaxed [rad | m]", default="0"),
            "to": _TO,
        },
        "a spring at a joint, or between two",
    ),
    "damper": Table(
        {
            "joint": _JOINT,
            "coefficient": Key(NUMBER, "[N·m·s/rad | N·s/m]", required=True),
            "to": _TO,
        },
        "a damper at a joint, or between two",
    ),
    "potential": Table(
        {"function": Key(Text((), "a formula in x"), "V(x) [J], a formula in x", required=True)}
        | _NAME,
        "a potential energy of the shape",
    ),
    "torque": Table(
        {
            "function": Key(
                ByName(ACTION),
                "torque at each joint [N·m | N]: number, formula or signal table",
                required=True,
            )
        }
        | _LIMITED
        | _NAME,
        "torques at the joints",
        needs=_SMOOTH,
    ),
    "pd": Table(
        {"reference": _REFERENCE} | _FOLLOWING | _LIMITED | _NAME,
        "a PD controller of the joints",
        needs=_SMOOTH,
    ),
    "computed_torque": Table(
        {"reference": _REFERENCE} | _FOLLOWING | _LIMITED | _NAME,
        "torques that make every joint follow its reference exactly",
        needs=_SMOOTH,
    ),
    "wrench": Table(
        {
            "function": Key(
                ListOf(ACTION),
                "wrench on the base in its own frame [linear; angular]: as many entries as the "
                "group has dimensions, each a number, formula or signal table",
                required=True,
            )
        }
        | _NAME,
        "a wrench on the base: thrusters",
    ),
}
_NO_FUNCTIONS = (
    "a Controller is a Python function, and what stands in a file is never executed; "
    "write it in Python, or use pd, computed_torque or torque"
)
FORCE = Tagged("kind", FORCES, "a force {kind = …}", {"controller": _NO_FUNCTIONS})
SCENE = Table(
    {
        "robot": Key(
            Text(),
            "a robot's name, or a URDF or MJCF file relative to this file (with a suffix or /)",
            required=True,
        ),
        "load": Key(LOAD, "how to read the robot: the options of pinred.load"),
        "start": Key(START, "the initial state", default="the robot's own"),
        "run": Key(RUN, "for how long and how accurately"),
        "springs": Key(
            ByName(ListOf(NUMBER, 2)), "joint = [stiffness, rest], short for forces of kind spring"
        ),
        "prescribed": Key(ByName(SIGNAL), "joints that follow a plan, each a signal"),
        "forces": Key(ListOf(FORCE), "what acts"),
    },
    "a scene",
)


def scene_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of scene files, as read from TOML."""
    defs: dict[str, Schema] = {}
    body = SCENE.schema(defs)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "pinred scene",
        **body,
        "$defs": defs,
    }
