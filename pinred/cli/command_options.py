"""Options that several commands share: a robot, and the options of a scene.

Modules that import numpy or Pinocchio are imported inside the functions.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ..common.errors import InputError
from ..common.names import quoted

if TYPE_CHECKING:
    from ..planning.gait_file import GaitFile
    from ..scene.event import Event
    from ..scene.scene import Scene
    from ..scene.toml.schema import Key
    from ..system.system import System

T = TypeVar("T")
ROBOT = "robot: a name (see `pinred robots`), or a URDF or MJCF file"


def option_adder(sub: argparse.ArgumentParser) -> Callable[..., None]:
    """Return a function that adds one option to a parser.

    Its arguments are the name and value format ("--time T", or "--list" for a flag), the help
    text, and optionally the type (text) and the default, which is appended to the help text.
    """

    def add(usage: str, text: str, kind: type = str, default: Any = None, **more: Any) -> None:
        flag, _, metavar = usage.partition(" ")
        if not metavar:
            sub.add_argument(flag, action="store_true", help=text, **more)
            return
        shown = f"{default:g}" if isinstance(default, float) else default
        text += "" if default is None else f" (default: {shown})"
        sub.add_argument(flag, metavar=metavar, type=kind, default=default, help=text, **more)

    return add


def add_options(sub: argparse.ArgumentParser, keys: Mapping[str, Key]) -> None:
    """Add the keys of scene or gait files that have a name on the command line.

    Args:
        sub: Parser of the command.
        keys: {name: description}.  The parsed text is stored under the name.
    """
    from ..scene.toml.schema import ByName, Flag, Number, Whole

    add = option_adder(sub)
    for name, key in keys.items():
        if isinstance(key.node, Flag):
            text = key.description
            sub.add_argument(key.command, dest=name, action="store_const", const=True, help=text)
        elif key.command:
            kind = {Number: float, Whole: int}.get(type(key.node), str)
            action = "append" if isinstance(key.node, ByName) else "store"
            add(key.command, key.description, kind, dest=name, action=action)


def options_in(arguments: argparse.Namespace, keys: Mapping[str, Key]) -> dict[str, Any]:
    """Return the values of the options that the user passed.

    Args:
        arguments: Parsed arguments of a command.
        keys: {name: description}, as for add_options.
    Returns:
        {name: value} of the options passed, in the form that the Python functions accept.
    Raises:
        InputError: a text does not have the format of its option.
    """
    values: dict[str, Any] = {}
    for name, key in keys.items():
        value = getattr(arguments, name, None)
        if key.command and value is not None:
            parse = _PARSERS.get(key.command.partition(" ")[2])
            values[name] = value if parse is None else parse(value, name)
    if values.get("momentum") == [0.0]:
        values["momentum"] = 0
    return values


def add_robot(sub: argparse.ArgumentParser, text: str = ROBOT) -> None:
    """Add the robot argument and the options for loading; `text` describes the accepted values."""
    from ..scene.load_options import LOAD

    sub.add_argument("robot", metavar="ROBOT", help=text)
    add_options(sub, {name: key for name, key in LOAD.keys.items() if key.command})
    add_parameters(sub)


def add_parameters(sub: argparse.ArgumentParser, text: str = "value of a robot parameter") -> None:
    """Add the option --parameter; `text` says which parameters it accepts."""
    text += ", such as hand.mass=1.3 or elbow.placement=X,Y,Z,ROLL,PITCH,YAW; repeatable"
    add_repeated(sub, "--parameter NAME=VALUE", text)


def add_repeated(sub: argparse.ArgumentParser, usage: str, text: str) -> None:
    """Add an option, such as "--parameter NAME=VALUE", that may occur several times."""
    flag, _, metavar = usage.partition(" ")
    sub.add_argument(flag, metavar=metavar, action="append", default=[], help=text)


def parameters_in(entries: Sequence[str]) -> dict[str, Any]:
    """Parse texts NAME=VALUE into {name: number or list of numbers}.  Raises InputError."""
    usage = "NAME=NUMBER, or NAME=V1,V2,…"
    values = assigned_in(entries, "parameter", _floats, usage, noun="")
    return {name: value[0] if len(value) == 1 else value for name, value in values.items()}


def refuse_of_robots(arguments: argparse.Namespace, source: str, *names: str) -> None:
    """Reject options that apply to robots only, if the source is a file.  Raises InputError."""
    for name in names:
        if getattr(arguments, name) not in (None, []):
            raise InputError(
                f"--{name} applies to robots only; {quoted(source)} contains this setting"
            )


def system_of(arguments: argparse.Namespace) -> System:
    """Load the robot that the options of add_robot name."""
    from ..scene.load_options import LOAD
    from ..system.load import load

    parameters = parameters_in(arguments.parameter)
    return load(arguments.robot, parameters=parameters, **options_in(arguments, LOAD.keys))


def add_scene(sub: argparse.ArgumentParser) -> None:
    """Add the options of a scene: initial state, duration, forces, events, and accuracy."""
    from ..integrators.methods import Gauss
    from ..scene.scene_options import ENGINES, RUN_OPTIONS, SCENE_OPTIONS

    add_options(sub, {**SCENE_OPTIONS, **{name: RUN_OPTIONS[name] for name in ("engine", "check")}})
    sub.set_defaults(engine=ENGINES[0], check=False)
    add = option_adder(sub)
    add("--step H", "step of a fixed-step method [s]", float)
    add("--order P", f"order of Gauss (default: {Gauss.order})", int)
    for name, text in (("event", "report when"), ("until", "end the motion when")):
        text += " a formula of the state crosses zero, such as 'x[0] - 0.5'; repeatable"
        add_repeated(sub, f"--{name} [NAME=]FORMULA", text)


def scene_of(arguments: argparse.Namespace) -> Scene:
    """Return the scene that the options of add_robot and add_scene describe."""
    from ..scene.scene_options import SCENE_OPTIONS

    system = system_of(arguments)
    options = options_in(arguments, SCENE_OPTIONS)
    options["method"] = _method(arguments)
    options["events"] = [
        *_events(arguments.event, terminal=False),
        *_events(arguments.until, terminal=True),
    ]
    return scene_with(system, options.pop("seed", None), **options)


def scene_with(system: System, seed: int | None, **options: Any) -> Scene:
    """Build a scene, with a random initial state if neither options nor robot state one.

    The seed is printed, so that the run can be repeated.

    Args:
        system: The robot.
        seed: Seed of a random state, or None.
        **options: Other options of Scene.
    Returns:
        The scene.
    """
    from ..scene.initial_state import large_angles
    from ..scene.scene import Scene
    from ..scene.scene_options import SCENE_OPTIONS

    states = [name for name, option in SCENE_OPTIONS.items() if option.table == "start"]
    has_state = system.initial is not None or any(options.get(n) is not None for n in states)
    seed = 0 if seed is None and not has_state else seed
    scene = Scene(system=system, seed=seed, **options)
    if options.get("x0") is not None and (note := large_angles(scene.given.x[0], system)):
        print(f"note: {note}")
    if seed is not None:
        print(f"initial state: random, seed {seed}")
    return scene


def numbers_in(text: str | None, option: str) -> list[float] | None:
    """Parse the numbers in a text V1,V2,…; None stays None.  Raises InputError."""
    if text is None:
        return None
    try:
        return _floats(text) if text else []
    except ValueError:
        raise InputError(
            f"--{option} takes numbers separated by commas, got {quoted(text)}"
        ) from None


def assigned_in(
    entries: Sequence[str], option: str, read: Callable[[str], T], usage: str, noun: str = "joint "
) -> dict[str, T]:
    """Parse texts NAME=VALUE.

    Args:
        entries: The texts.
        option: Name of the option, for messages.
        read: Converts the text of a value; raises ValueError if it is invalid.
        usage: Accepted formats, for messages.
        noun: Kind of object that a name denotes, for messages.
    Returns:
        The values by name.
    Raises:
        InputError: A text has another format, or a name occurs twice.
    """
    values: dict[str, T] = {}
    for entry in entries:
        name, _, text = entry.partition("=")
        if name in values:
            raise InputError(f"--{option} has {noun}{quoted(name)} twice")
        try:
            values[name] = read(text if name else "")
        except ValueError:
            raise InputError(f"--{option} takes {usage}, got {quoted(entry)}") from None
    return values


def by_joint_in(text: str, option: str) -> list[float] | dict[str, float]:
    """Parse V1,V2,… into numbers, or J1=V1,… into {joint: number}.  Raises InputError."""
    if "=" not in text:
        return numbers_in(text, option) or []
    return assigned_in(text.split(","), option, float, "numbers, or JOINT=NUMBER for each")


def shape_in(text: str, option: str) -> list[float] | dict[str, float | list[float]]:
    """Parse like `by_joint_in`, where J=V1,V2,V3 has the numbers of a ball."""
    if "=" not in text:
        return numbers_in(text, option) or []
    entries: list[str] = []
    for word in text.split(","):
        if "=" in word or not entries:
            entries.append(word)
        else:
            entries[-1] += f",{word}"
    usage = "numbers, or JOINT=NUMBER for each, or JOINT=V1,V2,V3 for a ball"
    return assigned_in(entries, option, _number_or_list, usage)


def _number_or_list(text: str) -> float | list[float]:
    return _floats(text) if "," in text else float(text)


def _floats(text: str) -> list[float]:
    return [float(word) for word in text.split(",")]


def _spring(text: str) -> tuple[float, float]:
    stiffness, rest = _floats(text if "," in text else f"{text},0")
    return stiffness, rest


def _plan(text: str) -> Any:
    """Parse the motion of a joint: a number, a formula, or three of these for a ball."""
    from ..signals import Attitude

    text, has_centre, centre = text.partition("@")
    parts = _split_outside_brackets(text)
    values = [_number_or_formula(part) for part in parts]
    if has_centre:
        return Attitude(values, [float(number) for number in centre.split(",")])
    return values if len(values) > 1 else values[0]


def _split_outside_brackets(text: str) -> list[str]:
    """Split a text at the commas that are not inside of brackets."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter in "([") - (letter in ")]")
        if letter == "," and not depth:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def _number_or_formula(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        if not text:
            raise
        return text


def _lock_in(text: str, _: str) -> dict[str, float]:
    """Parse a text J1,J2=VALUE,… into {joint: value}, with zero for joints without a value."""
    lock: dict[str, float] = {}
    for entry in text.split(",") if text else ():
        name, _, value = entry.partition("=")
        lock[name] = (numbers_in(value, "lock") or [0.0])[0]
    return lock


def _limits_in(text: str, option: str) -> float | list[float] | dict[str, float]:
    values = by_joint_in(text, option)
    if not values:
        raise InputError(f"--{option} takes {_LIMITS}, got nothing")
    return values[0] if isinstance(values, list) and len(values) == 1 else values


_LIMITS = "R, R1,R2,… or J1=R1,…"
# Parsers of option values. Each key is the value format with which `command` declares an option.
_PARSERS: dict[str, Callable[[Any, str], Any]] = {
    "V1,V2,…": numbers_in,
    "V1,V2,… or J1=V1,…": shape_in,
    "J1,J2=VALUE,…": _lock_in,
    "all or B1,B2,…": lambda text, _: True if text == "all" else text.split(",") if text else [],
    "J=K,REST": lambda entries, _: assigned_in(
        entries, "spring", _spring, "JOINT=STIFFNESS or JOINT=STIFFNESS,REST"
    ),
    "J=PLAN": lambda entries, name: assigned_in(
        entries, name, _plan, "JOINT=NUMBER, JOINT=FORMULA, or BALL=W1,W2,W3[@C1,C2,C3]"
    ),
    "AXIS": lambda text, name: text if text in ("x", "y", "z") else numbers_in(text, name),
    _LIMITS: _limits_in,
}


def _events(entries: Sequence[str], *, terminal: bool) -> list[Event]:
    """Return the events of --event or --until; the default names are "event" and "until"."""
    from ..scene.event import Event

    events = []
    for entry in entries:
        match = re.fullmatch(r"\s*([A-Za-z]\w*)\s*=(?!=)(.*)", entry, re.DOTALL)
        name, text = match.groups() if match else ("until" if terminal else "event", entry)
        events.append(Event(text, name, terminal=terminal))
    return events


def _method(arguments: argparse.Namespace) -> str:
    """Return the integrator of --method, --step and --order as the text that Scene accepts."""
    from ..integrators.methods import METHODS, options_of

    name: str = arguments.method or "auto"
    stated = {key: getattr(arguments, key) for key in ("step", "order")}
    stated = {key: value for key, value in stated.items() if value is not None}
    if not stated:
        return name
    if name in ("auto", *METHODS):
        methods_with = {
            key: [m for m, kind in METHODS.items() if key in [o.name for o in options_of(kind)]]
            for key in stated
        }
        if name not in methods_with.get("step", [name]):
            methods = " or ".join(methods_with["step"])
            raise InputError(f"--step H requires --method {methods}")
        if name not in methods_with.get("order", [name]):
            raise InputError(f"--order P requires --method {' or '.join(methods_with['order'])}")
    return f"{name}({', '.join(f'{key}={value!r}' for key, value in stated.items())})"


def add_source(sub: argparse.ArgumentParser) -> None:
    """Add the options that name a connection and a gait."""
    from ..planning.gait_file import GAIT_FILE
    from ..scene.load_options import LOAD

    text = "gait file (.toml), or robot: a name (see `pinred robots`) or a file"
    sub.add_argument("source", metavar="SOURCE", help=text)
    add_options(sub, {"group": LOAD.keys["group"], "centre": GAIT_FILE.keys["centre"]})
    add_parameters(sub)
    add = option_adder(sub)
    add("--gait FILE", "recorded joint data (.csv, .npz) of a robot")
    add("--circle J1,J2,RADIUS", "gait of a robot: a circle of two joints about zero [rad | m]")


def source_of(arguments: argparse.Namespace, *, gait: bool) -> GaitFile:
    """Return the connection and gait named by the options of add_source.

    Args:
        arguments: Parsed arguments of the command.
        gait: Whether a robot needs a gait.
    Returns:
        The source.
    Raises:
        InputError: The options contradict each other, or a gait is missing.
    """
    import numpy as np

    from ..analysis.connections.connection import Connection
    from ..analysis.gaits.gait import Gait
    from ..common.names import joint_index
    from ..planning.gait_file import GAIT_FILE, GaitFile, load_gait
    from ..system.load import load

    if Path(arguments.source).suffix == ".toml":
        names = ("group", "gait", "circle", "parameter", "centre")
        refuse_of_robots(arguments, arguments.source, *names)
        return load_gait(arguments.source)
    parameters = parameters_in(arguments.parameter)
    system = load(arguments.source, group=arguments.group, parameters=parameters)
    stated = options_in(arguments, {"centre": GAIT_FILE.keys["centre"]})
    connection = Connection.mechanical(system).in_chart(stated.get("centre"))
    file, circle = arguments.gait, arguments.circle
    if (file is None) == (circle is None) and (gait or file is not None):
        raise InputError("a robot needs a gait: pass --gait FILE or --circle J1,J2,RADIUS")
    zero, path = np.zeros((1, system.m)), None
    if file is not None:
        path = Gait.read(file)
    elif circle is not None:
        words = circle.split(",")
        if len(words) != 3:
            raise InputError(f"--circle takes J1,J2,RADIUS, got {quoted(circle)}")
        (radius,) = numbers_in(words[2], "circle") or [0.0]
        cos, sin = zero.copy(), zero.copy()
        cos[0, joint_index(words[0], system.shape_names, "--circle")] = radius
        sin[0, joint_index(words[1], system.shape_names, "--circle")] = radius
        path = Gait.fourier(zero[0], cos, sin)
    return GaitFile(system, connection, path, np.zeros(system.r))
