"""Options and files that several commands share: a robot, the options of a scene, and outputs.

Texts of option values are parsed: numbers, values by joint, motions of joints.  Commands read
motions from files, and write figures, tables and messages.

Modules that import numpy or Pinocchio are imported inside the functions.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ..common.errors import InputError
from ..common.files import FIGURES, check_path, write_atomic, write_table
from ..common.names import is_number, quoted
from ..common.waiting import ProgressBar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..judge.impact_checks import ChainReport
    from ..judge.verdict import Report
    from ..planning.gait_file import GaitFile
    from ..planning.optimisation.optimise import BestGait
    from ..planning.reorientation.flight_search import FlightPlan
    from ..planning.reorientation.turning_loop import TurnPlan
    from ..scene.event import Event
    from ..scene.scene import Scene
    from ..scene.stop import BallStop
    from ..scene.toml.schema import Key
    from ..system.system import System
    from ..views.motion_source import MotionSource
    from ..views.playback.colours_and_view_options import View

T = TypeVar("T")


def numbers_in(text: str | None, option: str) -> list[float] | None:
    """Parse the numbers in a text V1,V2,…; None stays None.  Raises InputError."""
    if text is None:
        return None
    try:
        return floats_in(text) if text else []
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
        except InputError as error:
            raise InputError(f"--{option} {quoted(name)}: {error}") from None
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
    entries = _joined(text, lambda word: "=" not in word)
    usage = "numbers, or JOINT=NUMBER for each, or JOINT=V1,V2,V3 for a ball"
    return assigned_in(entries, option, _number_or_list, usage)


def _joined(text: str, continues: Callable[[str], bool]) -> list[str]:
    """Split a text at commas, and join the words that continue a word J=V1.

    Args:
        text: The text; empty for no words.
        continues: Predicate of words that may be a further number of the word before.
    Returns:
        The entries J, J=V1 or J=V1,V2,….
    """
    entries: list[str] = []
    for word in text.split(",") if text else ():
        if entries and "=" in entries[-1] and continues(word):
            entries[-1] += f",{word}"
        else:
            entries.append(word)
    return entries


def _number_or_list(text: str) -> float | list[float]:
    return floats_in(text) if "," in text else float(text)


def floats_in(text: str) -> list[float]:
    """Parse a text V1,V2,….  Raises ValueError."""
    return [float(word) for word in text.split(",")]


def spring_in(text: str) -> tuple[float, float]:
    """Parse a text STIFFNESS or STIFFNESS,REST; the rest is zero by default.  Raises ValueError."""
    stiffness, rest_length = floats_in(text if "," in text else f"{text},0")
    return stiffness, rest_length


def stop_in(text: str) -> list[float] | BallStop:
    """Parse LOWER,UPPER or LOWER,UPPER,RESTITUTION, or swing:ANGLE,twist:LOWER:UPPER,… of a ball.

    Args:
        text: The text.
    Returns:
        The numbers, or the stops of the ball.
    Raises:
        ValueError: The text has another form.
        InputError: No ball has such stops.
    """
    if ":" in text:
        import numpy as np

        from ..scene.stop import BallStop

        defaults: dict[str, Any] = {field.name: field.default for field in fields(BallStop)}
        counts = {name: np.size(default) for name, default in defaults.items()}
        values: dict[str, Any] = {}
        for entry in text.split(","):
            name, *texts = entry.split(":")
            if name in values or len(texts) != counts.get(name):
                raise ValueError
            values[name] = tuple(map(float, texts)) if len(texts) > 1 else float(texts[0])
        return BallStop(**values)
    numbers = floats_in(text)
    if len(numbers) not in (2, 3):
        raise ValueError
    return numbers


def lock_in(text: str, option: str) -> dict[str, float | list[float]]:
    """Parse J1,J2=VALUE,J3=V1,V2,V3 into {joint: value}, with zero for joints without a value."""
    lock: dict[str, float | list[float]] = {}
    for entry in _joined(text, is_number):
        name, _, value = entry.partition("=")
        numbers = numbers_in(value, option) or [0.0]
        lock[name] = numbers[0] if len(numbers) == 1 else numbers
    return lock


def parse_plan(text: str) -> Any:
    """Parse the motion of a joint.

    Args:
        text: A number or a formula in t; for a ball three of these, separated by commas, and
            optionally its centre behind "@".
    Returns:
        The number, the formula, a list of these, or an Attitude.
    Raises:
        ValueError: A part of the text is empty, or the centre is not a list of numbers.
    """
    from ..forces.signals import Attitude

    text, has_centre, centre = text.partition("@")
    entries = _split_outside_brackets(text)
    values = [number_or_formula(entry) for entry in entries]
    if has_centre:
        return Attitude(values, [float(number) for number in centre.split(",")])
    return values if len(values) > 1 else values[0]


def _split_outside_brackets(text: str) -> list[str]:
    """Split a text at the commas that are not inside of brackets."""
    entries, depth = [""], 0
    for letter in text:
        depth += (letter in "([") - (letter in ")]")
        if letter == "," and not depth:
            entries.append("")
        else:
            entries[-1] += letter
    return entries


def number_or_formula(text: str) -> float | str:
    """Parse a number, or return the text of a formula.  Raises ValueError if it is empty."""
    try:
        return float(text)
    except ValueError:
        if not text:
            raise
        return text


# Former names of options, which are accepted and not shown.
FORMER = {
    "--duration": "--time",
    "--springs": "--spring",
    "--parameters": "--parameter",
    "--events": "--event",
    "--outputs": "--output",
    "--controls": "--control",
    "--validate": "--check",
}
ROBOT = "robot: a name (see `pinred robots`), or a URDF or MJCF file"


def option_adder(sub: argparse.ArgumentParser) -> Callable[..., None]:
    """Return a function that adds one option to a parser.

    Its arguments are the name and value format ("--port P", or "--list" for a flag), the help
    text, and optionally the type (text) and the default, which is appended to the help text.
    """

    def add(usage: str, text: str, kind: type = str, default: Any = None, **more: Any) -> None:
        flag, _, metavar = usage.partition(" ")
        more |= {"metavar": metavar, "type": kind} if metavar else {"action": "store_true"}
        shown = f"{default:g}" if isinstance(default, float) else default
        text += "" if default in (None, []) else f" (default: {shown})"
        action = sub.add_argument(flag, default=default if metavar else False, help=text, **more)
        if former := FORMER.get(flag):
            more["dest"] = action.dest
            sub.add_argument(former, default=argparse.SUPPRESS, help=argparse.SUPPRESS, **more)

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
            value_type = {Number: float, Whole: int}.get(type(key.node), str)
            action = "append" if isinstance(key.node, ByName) or name == "stops" else "store"
            add(key.command, key.description, value_type, dest=name, action=action)


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
    from ..scene.scene_options import LOAD

    sub.add_argument("robot", metavar="ROBOT", help=text)
    add_options(sub, {name: key for name, key in LOAD.keys.items() if key.command})
    add_parameters(sub)


def add_parameters(sub: argparse.ArgumentParser, text: str = "value of a robot parameter") -> None:
    """Add the option --parameters; `text` says which parameters it accepts."""
    text += ", such as hand.mass=1.3 or elbow.placement=X,Y,Z,ROLL,PITCH,YAW; repeatable"
    add_repeated(sub, "--parameters NAME=VALUE", text)


def add_repeated(sub: argparse.ArgumentParser, usage: str, text: str) -> None:
    """Add an option, such as "--parameters NAME=VALUE", that may occur several times."""
    option_adder(sub)(usage, text, action="append", default=[])


def parameters_in(entries: Sequence[str]) -> dict[str, Any]:
    """Parse texts NAME=VALUE into {name: number or list of numbers}.  Raises InputError."""
    usage = "NAME=NUMBER, or NAME=V1,V2,…"
    values = assigned_in(entries, "parameters", floats_in, usage, noun="")
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
    from ..scene.scene_options import LOAD
    from ..system.load import load

    parameters = parameters_in(arguments.parameters)
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
    for name, text in (("events", "report when"), ("until", "end the motion when")):
        text += " a formula of the state crosses zero, such as 'x[0] - 0.5'; repeatable"
        add_repeated(sub, f"--{name} [NAME=]FORMULA", text)


def scene_of(arguments: argparse.Namespace) -> Scene:
    """Return the scene that the options of add_robot and add_scene describe."""
    from ..scene.scene_options import SCENE_OPTIONS

    system = system_of(arguments)
    options = options_in(arguments, SCENE_OPTIONS)
    options["method"] = _method(arguments)
    options["events"] = [
        *_events(arguments.events, terminal=False),
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


def _limits_in(text: str, option: str) -> float | list[float] | dict[str, float]:
    values = by_joint_in(text, option)
    if not values:
        raise InputError(f"--{option} takes {_LIMITS}, got nothing")
    return values[0] if isinstance(values, list) and len(values) == 1 else values


_LIMITS = "R, R1,R2,… or J1=R1,…"
_STOPS = "file, JOINT=LOWER,UPPER[,RESTITUTION], or BALL=swing:ANGLE,twist:LOWER:UPPER,…"
# Parsers of option values. Each key is the value format with which `command` declares an option.
_PARSERS: dict[str, Callable[[Any, str], Any]] = {
    "V1,V2,…": numbers_in,
    "V1,V2,… or J1=V1,…": shape_in,
    "J1,J2=VALUE,…": lock_in,
    "J1,J2,…": lambda text, _: text.split(",") if text else [],
    "all or B1,B2,…": lambda text, _: True if text == "all" else text.split(",") if text else [],
    "J=K,REST": lambda entries, _: assigned_in(
        entries, "springs", spring_in, "JOINT=STIFFNESS or JOINT=STIFFNESS,REST"
    ),
    "file or J=LOWER,UPPER,E": lambda entries, _: (
        entries[0]
        if len(entries) == 1 and "=" not in entries[0]
        else assigned_in(entries, "stops", stop_in, _STOPS)
    ),
    "J=PLAN": lambda entries, name: assigned_in(
        entries, name, parse_plan, "JOINT=NUMBER, JOINT=FORMULA, or BALL=W1,W2,W3[@C1,C2,C3]"
    ),
    "A=CONTROL": lambda entries, _: assigned_in(
        entries, "control", number_or_formula, "ACTUATOR=NUMBER or ACTUATOR=FORMULA", "actuator "
    ),
    "AXIS": lambda text, name: text if text[:1].isalpha() else numbers_in(text, name),
    _LIMITS: _limits_in,
}


def _events(entries: Sequence[str], *, terminal: bool) -> list[Event]:
    """Return the events of --events or --until; the default names are "event" and "until"."""
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
            key: [
                m
                for m, method_class in METHODS.items()
                if key in [o.name for o in options_of(method_class)]
            ]
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
    text = "gait file (.toml), or robot: a name (see `pinred robots`) or a file"
    sub.add_argument("source", metavar="SOURCE", help=text)
    add_options(sub, connection_keys())
    add_parameters(sub)
    add = option_adder(sub)
    add("--gait FILE", "recorded joint data (.csv, .npz) of a robot")
    add("--circle J1,J2,RADIUS", "gait of a robot: a circle of two joints about rest [rad | m]")


def connection_keys() -> dict[str, Key]:
    """Return the keys of files that a robot's connection takes as options."""
    from ..planning.gait_file import GAIT_FILE
    from ..scene.scene_options import LOAD

    keys = {name: LOAD.keys[name] for name in ("group", "loops")}
    return keys | {name: GAIT_FILE.keys[name] for name in ("independent", "centre")}


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

    from ..analysis.connections.connection import Connection, rest_of
    from ..analysis.phases.gait import Gait
    from ..common.names import joint_index
    from ..planning.gait_file import GaitFile, load_gait
    from ..system.load import load

    if Path(arguments.source).suffix == ".toml":
        names = (*connection_keys(), "gait", "circle", "parameters")
        refuse_of_robots(arguments, arguments.source, *names)
        return load_gait(arguments.source)
    parameters = parameters_in(arguments.parameters)
    stated = options_in(arguments, connection_keys())
    independent, centre = stated.pop("independent", None), stated.pop("centre", None)
    system = load(arguments.source, parameters=parameters, **stated)
    connection = Connection.mechanical(system, independent=independent).in_chart(centre)
    file, circle = arguments.gait, arguments.circle
    if (file is None) == (circle is None) and (gait or file is not None):
        raise InputError("a robot needs a gait: pass --gait FILE or --circle J1,J2,RADIUS")
    zero, path = np.zeros((1, connection.m)), None
    if file is not None:
        path = Gait.read(file)
    elif circle is not None:
        words = circle.split(",")
        if len(words) != 3:
            raise InputError(f"--circle takes J1,J2,RADIUS, got {quoted(circle)}")
        (radius,) = numbers_in(words[2], "circle") or [0.0]
        cos, sin = zero.copy(), zero.copy()
        cos[0, joint_index(words[0], connection.joints, "--circle")] = radius
        sin[0, joint_index(words[1], connection.joints, "--circle")] = radius
        path = Gait.fourier(rest_of(connection), cos, sin)
    return GaitFile(system, connection, path, np.zeros(system.r))


_NO_DATE: dict[str, dict[str, Any]] = {  # Without a date, equal figures produce equal files.
    ".png": {},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}


def out_path(
    arguments: argparse.Namespace, suffixes: Sequence[str], folders: Sequence[str] = ()
) -> Path | None:
    """Check the option --out before the work starts.

    Args:
        arguments: Parsed arguments of the command.
        suffixes: Allowed suffixes.
        folders: Suffixes of formats that are folders.
    Returns:
        The path, or None without the option.
    Raises:
        InputError: No such file can be written; see `check_path`.
        OutputError: The folder or an existing file is read-only.
    """
    return None if arguments.out is None else check_path(arguments.out, suffixes, folders)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure to a .png, .pdf or .svg file; raise OutputError if that fails."""
    suffix = path.suffix
    write_atomic(
        path, lambda file: figure.savefig(file, format=suffix[1:], metadata=_NO_DATE[suffix])
    )


def describe_file(path: Path) -> str:
    """Return the message that a file or a folder was written, with its size."""
    size = sum(file.stat().st_size for file in (path, *path.rglob("*")) if file.is_file())
    return f"written to {path} ({size / 1e3:.0f} kB)"


def write_series(path: Path, names: Sequence[str], arrays: Mapping[str, Any]) -> None:
    """Write values over time to an .npz or .csv file.

    Args:
        path: The file.
        names: Names of the columns of the .csv file.
        arrays: Times, (T,), values, (T, n), and further arrays, by their names in the .npz file.
            The .csv file has times and values only.
    """
    import numpy as np

    if path.suffix == ".npz":
        write_atomic(path, lambda file: np.savez(file, **arrays))
        return
    t, values, *_ = arrays.values()
    records = np.column_stack([t, values]).tolist()
    write_table(path, names, (dict(zip(names, cells, strict=True)) for cells in records))


def print_report(report: Report | ChainReport) -> int:
    """Print a comparison with full ABA; return the exit code of its verdict."""
    from ..judge.verdict import EXIT_CODES

    print(report)
    return EXIT_CODES[report.verdict]


def write_plan(
    plan: BestGait | TurnPlan | FlightPlan,
    path: Path | None,
    write_data: Callable[[Path], None],
    *,
    compare: bool,
) -> int:
    """Write a plan as a figure or as data, and compare it with full ABA.

    Args:
        plan: The gait or motion.
        path: Path of a figure or of data; None to write nothing.
        write_data: Function that writes data to the path, called if its suffix is not that of
            a figure.
        compare: Whether to print the comparison.
    Returns:
        0, or the exit code of the comparison.
    """
    if path is not None:
        if path.suffix in FIGURES:
            from ..views.plots.by_kind import plot

            is_loop = hasattr(plan, "gait")
            save_figure(plot(plan, "loop") if is_loop else plot(plan.trajectory, "shape"), path)
        else:
            write_data(path)
        print(describe_file(path))
    return print_report(plan.report) if compare else 0


def motion_in(path: str, robot: str | None) -> MotionSource:
    """Return the motion in a .npz file, or simulate a scene file.

    `robot` names the robot of a .npz file that does not name one itself.
    """
    check_robot(path, robot)
    if Path(path).suffix == ".npz":
        from ..simulation.read_recording import read_recording

        return read_recording(path, robot)
    from ..scene.toml.reader import read_scene_file
    from ..simulation.simulate import simulate

    file = read_scene_file(path)
    if file.phases:
        from ..simulation.contact.chain import run_phases

        return run_phases(file, progress=True)
    return simulate(file.scene, engine=file.engine, check=file.check, progress=True)


def show_motion(
    motion: MotionSource, out: Path | None, view: View, *, viewer: str | None = None,
    port: int | None = None, show: bool = True,
) -> None:  # fmt: skip
    """Play a motion in a browser, or write it as a page, a recording for rerun, or a film.

    Args:
        motion: The motion.
        out: File to write; None to play.
        view: Options of the view.
        viewer: Name of the viewer; the default one if None.
        port: Port of the web server; any free one if None.
        show: Whether to open the browser.
    """
    if out is None:
        from ..views.motions import play_view
        from ..views.playback.colours_and_view_options import VIEWER

        name = viewer or VIEWER
        play_view(motion, view, viewer=name, port=port, show=show, wait=True)
    elif out.suffix == ".html":
        from ..views.playback.page import save_html

        print(f"written to {out} ({save_html(motion, out, view) / 1e6:.2f} MB)")
    elif out.suffix == ".rrd":
        from ..views.playback.rerun_file import save_rrd

        print(f"written to {out} ({save_rrd(motion, out, view) / 1e6:.2f} MB)")
    else:
        from ..views.playback.film import save_film

        with ProgressBar("film   ", what="renders a film") as bar:
            count = save_film(motion, out, view, progress=bar)
        print(f"{count} frames written to {out}")


def check_robot(source: str, robot: str | None) -> None:
    """Raise InputError for the option --robot with any source except a .npz file."""
    if robot is not None and Path(source).suffix != ".npz":
        raise InputError(f"--robot applies to .npz files only; '{source}' names its robot")
