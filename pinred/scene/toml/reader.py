"""TOML documents: their keys, derived from the options, and scenes read from them.

Every key is validated.  No text in a file is executed.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError, LoadError, PinredError
from ...common.files import is_file
from ...common.parameter import Parameter
from ...forces.columns import symbols_of
from ...forces.force import NAMES, Force, Formula, Limit
from ...forces.force_model_cache import cached_force_model
from ...forces.signals import Signal
from ...forces.signals.expressions import FUNCTIONS, parse
from ...integrators.methods import METHODS
from ...system.assembly import link_frame
from ...system.find_robot_files import bundled_robots
from ...system.load import load
from ...system.loops.loop import SUFFIXES
from ...system.model_parameters import size_of
from ...system.system import System
from ..event import Event
from ..initial_state import DURATION
from ..parse_options import parse_control, parse_controls, parse_method
from ..scene import ENGINES, Engine, Scene
from ..scene_options import LOAD, RUN_OPTIONS, SCENE_OPTIONS, SWEEP, Option, list_conflicts
from ..stop import parse_stops, stop_of_table
from .schema import (
    Either,
    Flag,
    Key,
    ListOf,
    Number,
    Place,
    Schema,
    Table,
    Text,
    document_schema,
    naming,
    one_line,
    read_text,
    unknown,
    with_places,
)
from .value_tables import (
    FORCES,
    FileParameter,
    SignalReader,
    file_parameters,
    refuse_others,
    with_robot_parameters,
)

# The keys of scene files and gait files that name the robot.
ROBOT = {
    "robot": Key(
        Text(),
        "a robot's name, or a URDF or MJCF file relative to this file (with a suffix or /)",
        required=True,
    ),
    "load": Key(LOAD, "how to read the robot: the options of pinred.load"),
}
_TABLES = {"start": "the initial state", "run": "how to simulate"}
FILE_OPTIONS: Mapping[str, Option] = {**SCENE_OPTIONS, **RUN_OPTIONS}


# Options of a run that a part of a chain does not have, and those that only its first robot has.
_OF_ONE_MOTION = ("outputs", "checkpoint")
_OF_FIRST = ("duration", "times", "samples", "events")
# What happens before a later phase, by key.
IMPACTS = {
    "capture": Key(
        Table(
            {
                "at": Key(Text(), "link or frame of the first robot", required=True),
                "onto": Key(Text(), "link or frame of the second one", required=True),
                "tolerance": Key(
                    Number(positive=True),
                    "largest distance [m] and angle [rad] of the frames",
                    default="1e-6",
                ),
                "prefix": Key(
                    Text(),
                    "text before the names of the second",
                    default="its name if names collide",
                ),
                "align": Key(
                    Flag(),
                    "move the start of the second robot, so that the frames meet",
                    default="false",
                ),
            },
            "a capture",
        ),
        "the robots become one, by a plastic impact (docs/capture.md)",
    ),
    "release": Key(
        Table(
            {
                "link": Key(
                    Text(), "link behind the joint that opens, or the joint", required=True
                ),
                "root": Key(
                    Text(), "link of the released part that its pose describes", default="link"
                ),
            },
            "a release",
        ),
        "the robot becomes two; the released part is the second",
    ),
    "land": Key(
        Table(
            {
                "frame": Key(
                    Either((Text(), ListOf(Text()))), "frame that stops, or several", required=True
                ),
                "contact": Key(
                    Text(("point", "flat")),
                    "point: its origin stops; flat: it stops turning, too",
                    default="point",
                ),
            },
            "a landing",
        ),
        "the robot stops at the ground and turns about its foot",
    ),
}


def scene_table(options: Mapping[str, Option]) -> Table:
    """Return the table of keys of a scene file with these options."""
    remaining = {name: option for name, option in options.items() if name not in _OF_ONE_MOTION}
    second = {name: option for name, option in remaining.items() if name not in _OF_FIRST}
    later = {name: option for name, option in remaining.items() if option.table != "start"}
    beside = {name: option for name, option in second.items() if option.table != "start"}
    pairs = [(a, b) for a in IMPACTS for b in IMPACTS if a < b]
    words = "forces, prescribed joints and so on of the second robot"
    motion = Table(_motion_keys(beside), words)
    phase = Table(
        {**IMPACTS, **_motion_keys(later), "second": Key(motion, words)},
        "a phase",
        apart=tuple(pairs),
    )
    another = Table({**ROBOT, **_motion_keys(second)}, "another robot")
    keys = {
        "sweep": SWEEP,
        "second": Key(another, "another robot, which moves at the same time until both become one"),
        "phases": Key(
            ListOf(phase),
            "what follows the motion, each with an impact before it or without",
            default="none",
        ),
    }
    return with_places(
        Table(
            {**ROBOT, **_motion_keys(options), **keys},
            "a scene",
            apart=(("sweep", "phases"),),
        )
    )


def _motion_keys(options: Mapping[str, Option]) -> dict[str, Key]:
    """Return the keys of the options of a motion, in their tables."""

    def keys_in(table: str) -> dict[str, Key]:
        return {name: option for name, option in options.items() if option.table == table}

    tables = {
        name: Table(
            keys_in(name),
            words,
            apart=tuple(p for p in list_conflicts(options) if {*p} <= keys_in(name).keys()),
        )
        for name, words in _TABLES.items()
        if keys_in(name)
    }
    return {name: Key(table, table.words) for name, table in tables.items()} | keys_in("")


def options_in(document: Mapping[str, Any], options: Mapping[str, Option]) -> dict[str, Any]:
    """Return {option: value} of a document that scene_table has validated."""
    tables = {"": document, **{name: document.get(name, {}) for name in _TABLES}}
    return {
        name: tables[option.table][name]
        for name, option in options.items()
        if name in tables[option.table]
    }


SCENE = scene_table(FILE_OPTIONS)


@checks_arguments
def scene_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of scene files, as parsed from TOML.

    Returns:
        The schema, as a dictionary that can be written as JSON.
    """
    return document_schema(SCENE, "pinred scene")


_LONG_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]+\s*\.\s*){50}""")


def read_document(path: str | Path, table: Table, kind: str) -> tuple[dict[str, Any], Place]:
    """Read a TOML file and validate its keys.

    Args:
        path: Path of the file.
        table: The valid keys.
        kind: "scene" or "gait", for messages.
    Returns:
        The document, and the place of its top level.
    Raises:
        InputError: a key or a value is not valid.
        LoadError: the file cannot be read.
    """
    if not isinstance(path, (str, Path)):
        raise InputError(f"load_{kind} takes the path of a TOML file, got {type(path).__name__}")
    text = read_text(Path(path), f"{kind} file")
    place = Place(str(Path(path)), text)
    return table.read(_parsed(text, place, f"a {kind}"), place), place


def _parsed(text: str, place: Place, what: str) -> dict[str, Any]:
    """Parse a TOML text.  Raises LoadError if it is not TOML; `what` names the expected content."""
    if _LONG_KEY.search(text):
        raise LoadError(f"{place.file}: not {what}: a key of more than 50 parts")
    try:
        return tomllib.loads(text + "\n")  # With a final line break, every error has a line number.
    except tomllib.TOMLDecodeError as error:
        match = re.fullmatch(r"(.*) \(at (?:(line \d+, column \d+)|end of document)\)", str(error))
        problem, where = match.groups() if match else (str(error), None)
        raise LoadError(f"{place.file}, {where or 'at its end'}: not TOML: {problem}") from None
    except RecursionError:
        raise LoadError(f"{place.file}: not {what}: tables or lists nested too deeply") from None
    except ValueError:
        raise LoadError(f"{place.file}: not TOML: a number with thousands of digits") from None


def robot_in(document: Mapping[str, Any], folder: Path, place: Place) -> System:
    """Load the robot that a document names, with the options in its table `load`.

    Args:
        document: The document.
        folder: Folder of the file; paths in the document are relative to it.
        place: Place of the top level of the document.
    Returns:
        The robot.
    Raises:
        InputError: the file of the robot does not exist.
        PinredError: `pinred.load` fails; the message names the key.
    """
    robot, options = document["robot"], dict(document.get("load", {}))
    if "meshes" in options:
        meshes = options["meshes"]
        paths = [meshes] if isinstance(meshes, str) else meshes
        options["meshes"] = [folder / path for path in paths]
    loops = options.get("loops")
    if isinstance(loops, str) and loops.endswith(SUFFIXES):
        options["loops"] = folder / loops
    source: str | Path = robot
    file = folder / robot
    exists = is_file(file)
    if robot not in bundled_robots() and (exists or "/" in robot or Path(robot).suffix):
        if not exists:
            (place / "robot").fail(f"no such file: {str(file)!r}")
        source = file
    try:
        return load(source, **options)
    except PinredError as error:
        key = "load" if isinstance(error, InputError) else "robot"
        raise type(error)((place / key).message(one_line(error))) from None


@dataclass(frozen=True)
class SceneFile:
    """The contents of a scene file.

    Attributes:
        scene: The scene.
        engine: The engine that simulates it.
        check: Whether to find forces that steps skip.
        checkpoint: Checkpoint file of the run, or None.
        sweep: Arguments of `pinred.sweep`, {} without a table `sweep`.
        place: Place of the table `sweep`, for messages.
        second: The scene of a second robot, which moves at the same time, or None.
        phases: What follows the motion.
    """

    scene: Scene
    engine: Engine
    check: bool
    checkpoint: Path | None
    sweep: Mapping[str, Any]
    place: Place
    second: SceneFile | None = None
    phases: tuple[LaterPhase, ...] = ()


@dataclass(frozen=True)
class LaterPhase:
    """A later phase of a chain, whose robots are known when the phases before it have run.

    Attributes:
        document: The table of the phase.
        place: Its place in the file.
        folder: Folder of the file.
    """

    document: Mapping[str, Any]
    place: Place
    folder: Path

    @property
    def impact(self) -> tuple[str, dict[str, Any]] | None:
        """Name and arguments of the impact before the phase; None if there is none."""
        names = [name for name in IMPACTS if name in self.document]
        return (names[0], dict(self.document[names[0]])) if names else None

    def scene_file(self, system: System, start: Mapping[str, Any], *, second: bool) -> SceneFile:
        """Return the scene of a robot in this phase.

        Args:
            system: The robot.
            start: Options that start it: pose0, x0, xdot0 and xi0.
            second: Whether it is the second robot of the phase.
        Returns:
            The scene, and how to simulate it.
        Raises:
            InputError: a key or value is not valid.
        """
        document, place = self.document, self.place
        if second:
            document, place = document.get("second", {}), place / "second"
        parameters = file_parameters(document, place)
        for parameter in parameters:
            if size_of(system, parameter.name) is not None:
                parameter.place.fail("a robot keeps its parameters; state them above all phases")
        return _Builder(self.folder, place, document, system, parameters).build(start)


@checks_arguments
def load_scene(path: str | Path) -> Scene:
    """Read a scene from a TOML file; docs/scenes.md lists the keys.

    Args:
        path: Path of the file.
    Returns:
        The scene.
    Raises:
        InputError: a key or value is not valid; the message names file, line and key.  Or the
            file has several phases, which `simulate_chain` simulates.
        LoadError: the file, or a file that it names, cannot be read.
        PinredError: `load` or `Scene` rejects the robot or the scene.
    """
    file = read_scene_file(path)
    refuse_phases(file)
    return file.scene


def refuse_phases(file: SceneFile) -> None:
    """Raise InputError if a file has several phases, where one motion is needed."""
    if file.phases:
        file.phases[0].place.fail(
            "this file has several phases; pinred.simulate_chain and `pinred run` simulate them"
        )


def read_scene_file(path: str | Path) -> SceneFile:
    """Read a TOML file: the scene, how to simulate it, and what follows (see load_scene)."""
    document, place = read_document(path, SCENE, "scene")
    folder, phases = Path(path).parent, document.get("phases", [])
    if phases:
        for name in ("outputs", "checkpoint"):
            if name in document.get("run", {}):
                (place / "run" / name).fail("a file with several phases has no such option")
    second = document.get("second")
    if second is not None and not phases:
        (place / "second").fail("a second robot needs [[phases]], in which both become one")
    return replace(
        _robot_file(folder, place, document),
        second=None if second is None else _robot_file(folder, place / "second", second),
        phases=tuple(
            LaterPhase(phase, place / "phases" / k, folder) for k, phase in enumerate(phases)
        ),
    )


def _robot_file(folder: Path, place: Place, document: dict[str, Any]) -> SceneFile:
    """Return the scene of the robot that a document names."""
    parameters = file_parameters(document, place)
    robot = robot_in(document, folder, place)
    return _Builder(
        folder, place, document, *with_robot_parameters(robot, parameters, place)
    ).build()


class _Builder:
    """Conversion of a validated document to a scene."""

    def __init__(
        self,
        folder: Path,
        place: Place,
        document: Mapping[str, Any],
        system: System,
        parameters: Sequence[FileParameter],
    ) -> None:
        self.place, self.document = place, document
        self.signals, self.folder = SignalReader(folder), folder
        self.system = system
        self.parameter_places = {parameter.name: parameter.place for parameter in parameters}
        self.parameters = self._formula_parameters(parameters)
        self.symbols, _ = symbols_of(self.system, None)

    def build(self, start: Mapping[str, Any] | None = None) -> SceneFile:
        """Return the contents of the file, with options that state the start if it does not."""
        options = options_in(self.document, FILE_OPTIONS)
        options["parameters"] = {
            name: parameter.value for name, parameter in self.parameters.items()
        }
        engine, check = options.pop("engine", ENGINES[0]), options.pop("check", False)
        file = options.pop("checkpoint", None)
        if "samples" in options:
            initial = self.system.initial
            end = options.get("duration", DURATION if initial is None else initial.duration)
            options["times"] = np.linspace(0.0, end, options.pop("samples"))
        convert: dict[str, Callable[[Any, Place], Any]] = {
            "method": self._method,
            "prescribed": lambda value, at: self._by_joint(value, at, self.signals.motion),
            "springs": self._per_joint,
            "stops": self._stops,
            "controls": self._controls,
            "forces": lambda value, at: [self._force(v, at / k) for k, v in enumerate(value)],
            "events": lambda value, at: [self._event(v, at / k) for k, v in enumerate(value)],
            "x0": self._per_joint,
            "xdot0": self._per_joint,
            "pose0": self._pose,
            "momentum": self._momentum,
        }
        if options.get("prescribed", {}).get("others") == "hold":  # a short form of hold
            plans = options["prescribed"].items()
            options["prescribed"] = {name: plan for name, plan in plans if name != "others"}
            options["hold"] = "others"
        for name in convert:
            if name in options:
                options[name] = convert[name](options[name], self._option_place(name))
        options |= start or {}
        if options.get("method", "auto") != "auto" and engine != "compiled":
            self._option_place("method").fail("engine 'pinocchio' has an integrator of its own")
        try:
            scene = Scene(system=self.system, **options)
            _ = scene.start  # Evaluated here, so that errors name the file, too.
        except PinredError as error:
            self._explain(error, options)
        sweep = dict(self.document.get("sweep", {}))
        if "store" in sweep:
            sweep["store"] = self.folder / sweep["store"]
        checkpoint = None if file is None else self.folder / file
        return SceneFile(scene, engine, check, checkpoint, sweep, self.place / "sweep")

    def _option_place(self, name: str) -> Place:
        table = FILE_OPTIONS[name].table
        return self.place / table / name if table else self.place / name

    def _formula_parameters(self, parameters: Sequence[FileParameter]) -> dict[str, Parameter]:
        """Return the parameters that formulas may use, in addition to the names of the state."""
        by_name = {}
        for parameter in parameters:
            if "." in parameter.name:
                refuse_others(self.system, [parameter])
            if not parameter.name.isidentifier() or parameter.name in (*NAMES, *FUNCTIONS):
                parameter.place.fail("must be a name of letters and digits that is not taken")
            if not isinstance(parameter.value, float):
                parameter.place.fail("a number that formulas use must be one, got a list")
            by_name[parameter.name] = Parameter(parameter.name, parameter.value)
        return by_name

    def _method(self, value: str | dict[str, Any], place: Place) -> Any:
        """Return the integrator that a text or a table describes, or "auto"."""
        with naming(place):
            if isinstance(value, str):
                return parse_method(value)
            options = dict(value)
            name = options.pop("name")
            return "auto" if name == "auto" else METHODS[name](**options)

    def _pose(self, value: list[float], place: Place) -> list[float]:
        with naming(place):
            self.system.group.pose(value)
        return value

    def _momentum(self, value: float | list[float], place: Place) -> Any:
        if isinstance(value, float) and value != 0.0 and self.system.r > 1:
            place.fail(f"must be a list of {self.system.r} numbers, or 0")
        return value

    def _force(self, entry: dict[str, Any], place: Place) -> Force:
        """Return a force, with its joint names validated and its formulas parsed."""
        options = dict(entry)
        kind = FORCES[options.pop("kind")]
        for name in ("joint", "to"):
            if name in options:
                self._joint(options[name], place / name)
        if "limit" in options:
            most = self._per_joint(options["limit"], place / "limit")
            options["limit"] = Limit(most, smooth=options.pop("smooth", False))
        for name in ("kp", "kd"):
            if name in options:
                options[name] = self._per_joint(options[name], place / name)
        if "reference" in options:
            at = place / "reference"
            options["reference"] = self._by_joint(options["reference"], at, self.signals.plan)
        if "attitude" in options:
            options["attitude"] = self._attitude(options["attitude"], place / "attitude")
        at = place / "function"
        if kind.function == "of the shape":
            options["function"] = self._potential(options["function"], at)
        elif kind.function == "by joint":
            options["function"] = self._by_joint(options["function"], at, self._action)
        elif kind.function == "on the base":
            entries, link = options["function"], options.get("link")
            if link is not None:
                with naming(place / "link"):
                    link_frame(self.system, link, "link")
                if len(entries) not in (3, 6):
                    at.fail(f"must have 3 or 6 entries on a link, got {len(entries)}")
            elif len(entries) != self.system.r:
                group = self.system.group.name
                at.fail(f"must have {self.system.r} entries for {group}, got {len(entries)}")
            options["function"] = [self._action(v, at / k) for k, v in enumerate(entries)]
        with naming(place):
            return kind.make(**options)

    def _attitude(self, value: Any, place: Place) -> Any:
        """Convert signals or a table to an Attitude; return lists of numbers unchanged."""
        if isinstance(value, list) and all(isinstance(entry, float) for entry in value):
            return value
        return self.signals.attitude(value, place)

    def _action(self, value: Any, place: Place) -> Any:
        """Convert a number, a signal table, or the text of a formula of the state."""
        if isinstance(value, str):
            return self._formula(value, place)
        return self.signals.value(value, place)

    def _formula(self, text: str, place: Place, system: System | None = None) -> Formula:
        """Parse a formula and evaluate it once, to detect errors.  Raises InputError."""
        formula = Formula(text, self._parameter_symbols(), system)
        with naming(place):
            formula(self.symbols)
        return formula

    def _event(self, entry: dict[str, Any], place: Place) -> Event:
        options = dict(entry)
        expression = self._formula(options.pop("function"), place / "function", self.system)
        with naming(place):
            return Event(expression, **options)

    def _potential(self, text: str, place: Place) -> Callable[[Any], Any]:
        """Return a function of the shape x that evaluates the formula of a potential."""
        with naming(place):
            parse(text, {"x": self._shape(self.symbols.x)} | self._parameter_symbols())
        return lambda x: parse(text, {"x": self._shape(x)} | self._parameter_symbols())

    def _parameter_symbols(self) -> dict[str, Any]:
        return {name: parameter.symbol for name, parameter in self.parameters.items()}

    def _shape(self, x: Any) -> dict[str, Any]:
        """Return the shape as {label: entry}, mimic joints included."""
        labels = (*self.symbols.x_names, *self.symbols.followers)
        return {name: x[k] for k, name in enumerate(labels)}

    def _explain(self, error: PinredError, options: Mapping[str, Any]) -> NoReturn:
        """Raise an error of Scene again, with the place of the key that caused it."""
        text, place = one_line(error), self.place
        signal = self.signals.of_error(error)
        word = re.match(r"\w+", text)
        if signal is not None:
            place, text = signal
        elif text.startswith("parameters: "):
            places = [at for name, at in self.parameter_places.items() if f"'{name}'" in text]
            place = places[0] if places else place / "parameters"
            text = text.removeprefix("parameters: ")
        elif word and word[0] in FILE_OPTIONS and FILE_OPTIONS[word[0]].table:
            place = self._option_place(word[0])
            text = text.removeprefix(f"{word[0]}: ")
        else:
            for k, force in enumerate(options.get("forces", [])):
                try:
                    cached_force_model(self.system, {}, [force], options.get("prescribed", {}))
                except PinredError:
                    place = place / "forces" / k
                    break
        raise type(error)(place.message(text)) from None

    def _joint(self, name: str, place: Place) -> None:
        joints = [joint.name for joint in self.system.space.joints]
        if name not in (*joints, *self.system.shape_names, *self.system.followers):
            place.fail(unknown(name, "joint", joints, "the joints are"))

    def _stops(self, value: Any, place: Place) -> Any:
        """Return 'file', or the stops by joint; tables become Stops."""
        if not isinstance(value, dict):
            return value
        with naming(place):
            tables = {name: stop_of_table(e) for name, e in value.items() if isinstance(e, dict)}
            return {**value, **parse_stops({**value, **tables}, self.system)}

    def _controls(self, values: Mapping[str, Any], place: Place) -> dict[str, Any]:
        """Convert the controls of actuators; formulas of time alone stay texts."""
        names = [actuator.name for actuator in self.system.actuators]
        for name in values:
            if name not in names:
                with naming(place):
                    parse_controls({name: 0.0}, self.system)
        return {name: self._control(value, place / name) for name, value in values.items()}

    def _control(self, value: Any, place: Place) -> Any:
        is_signal = isinstance(value, str) and isinstance(parse_control(value, ""), Signal)
        return value if is_signal else self._action(value, place)

    def _by_joint(
        self, values: Mapping[str, Any], place: Place, convert: Callable[[Any, Place], Any]
    ) -> dict[str, Any]:
        """Convert the values of a table by joint; raise InputError for unknown joints."""
        for name in values:
            self._joint(name, place / name)
        return {name: convert(value, place / name) for name, value in values.items()}

    def _per_joint(self, value: Any, place: Place) -> Any:
        """Return a value unchanged, after validating the joint names if it is a table."""
        if isinstance(value, dict):
            self._by_joint(value, place, lambda entry, _: entry)
        return value
