"""Scenes from TOML files: read, checked key by key, and built.  Nothing in them is executed."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np

from ...common.errors import PinredError
from ...common.parameter import Parameter
from ...forces.columns import symbols_of
from ...forces.force import Force, Limit
from ...forces.formula import NAMES, Formula
from ...forces.link_loads import link_frame
from ...forces.remembered import remembered_model
from ...forces.signals import Signal
from ...forces.signals.expressions import FUNCTIONS, parse
from ...integrators.methods import METHODS, Method
from .. import forms
from ..event import Event
from ..random_state import DURATION
from ..scene import Engine, Scene
from .documents import read_document, robot_in
from .force_kinds import FORCES
from .keys import SCENE
from .parameter_tables import FileParameter, file_parameters, refuse_others, with_robots_own
from .places import Place, naming, one_line, unknown
from .signal_reader import SignalReader

_SECTIONS = {
    **dict.fromkeys(("x0", "xdot0", "xi0", "momentum", "seed", "q0", "v0", "keyframe"), "start"),
    **dict.fromkeys(("duration", "times", "rtol", "atol"), "run"),
}


@dataclass(frozen=True)
class SceneFile:
    """The contents of a scene file.  engine: the one that is to integrate."""

    scene: Scene
    engine: Engine


def load_scene(path: str | Path) -> Scene:
    """Return the scene in a TOML file; docs/scenes.md lists what may stand in it.

    Raises LoadError if the file, or one that it names, cannot be read; InputError, or what
    load() and Scene raise, naming file and key, for what cannot be simulated.
    """
    return read_scene_file(path).scene


def read_scene_file(path: str | Path) -> SceneFile:
    """Return the scene in a TOML file and the engine it asks for; errors as of load_scene."""
    document, place = read_document(path, SCENE, "scene")
    return _Builder(Path(path).parent, place, document).built()


class _Builder:
    """A builder of the scene in a document that has the keys it should have."""

    def __init__(self, folder: Path, place: Place, document: dict[str, Any]) -> None:
        self.folder, self.place, self.document = folder, place, document
        self.signals = SignalReader(folder)
        given = file_parameters(document, place)
        self.system, others = with_robots_own(robot_in(document, folder, place), given, place)
        self.places = {each.name: each.place for each in others}
        self.parameters = self._parameters(others)
        self.symbols, _ = symbols_of(self.system, None)

    def built(self) -> SceneFile:
        """Return the scene and the engine."""
        run = dict(self.document.get("run", {}))
        engine = run.pop("engine", "compiled")
        place = self.place / "run"
        if "samples" in run:
            initial = self.system.initial
            end = run.get("duration", DURATION if initial is None else initial.duration)
            run["times"] = np.linspace(0.0, end, run.pop("samples"))
        if "method" in run:
            with naming(place / "method"):
                run["method"] = _method(run["method"])
            if run["method"] != "auto" and engine != "compiled":
                (place / "method").fail("engine 'pinocchio' has an integrator of its own")
        prescribed = self._by_joint(
            self.document.get("prescribed", {}), self.place / "prescribed", self.signals.motion
        )
        springs = self.document.get("springs", {})
        self._by_joint(springs, self.place / "springs", lambda value, _: value)
        forces = [
            self._force(entry, self.place / "forces" / k)
            for k, entry in enumerate(self.document.get("forces", []))
        ]
        events = [
            self._event(entry, self.place / "events" / k)
            for k, entry in enumerate(self.document.get("events", []))
        ]
        options = {**self._start(), **run, "springs": springs, "prescribed": prescribed}
        options["events"] = events
        options["parameters"] = {name: each.value for name, each in self.parameters.items()}
        options |= {k: self.document[k] for k in ("passive", "friction") if k in self.document}
        try:
            scene = Scene(system=self.system, forces=forces, **options)
            _ = scene.start  # which a Scene works out only when somebody asks
        except PinredError as error:
            self._explain(error, forces, prescribed)
        return SceneFile(scene, engine)

    def _parameters(self, given: Sequence[FileParameter]) -> dict[str, Parameter]:
        """Return the names that formulas may use beside those of the state."""
        found = {}
        for each in given:
            if "." in each.name:
                refuse_others(self.system, [each])
            if not each.name.isidentifier() or each.name in (*NAMES, *FUNCTIONS):
                each.place.fail("must be a name of letters and digits that is not taken")
            if not isinstance(each.value, float):
                each.place.fail("a number that formulas use must be one, got a list")
            found[each.name] = Parameter(each.name, each.value)
        return found

    def _start(self) -> dict[str, Any]:
        start, place = dict(self.document.get("start", {})), self.place / "start"
        for name in ("x0", "xdot0"):
            if isinstance(start.get(name), dict):
                self._by_joint(start[name], place / name, lambda value, _: value)
        if "pose0" in start:
            with naming(place / "pose0"):
                self.system.group.pose(start["pose0"])
        momentum = start.get("momentum")
        if isinstance(momentum, float) and momentum != 0.0:
            if self.system.r > 1:
                (place / "momentum").fail(f"must be a list of {self.system.r} numbers, or 0")
            start["momentum"] = [momentum]
        return start

    def _force(self, entry: dict[str, Any], place: Place) -> Force:
        """Return a force with its names of joints checked and its formulas read."""
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
            where = place / "reference"
            options["reference"] = self._by_joint(options["reference"], where, self.signals.value)
        where = place / "function"
        if kind.function == "of the shape":
            options["function"] = self._potential(options["function"], where)
        elif kind.function == "by joint":
            options["function"] = self._by_joint(options["function"], where, self._action)
        elif kind.function == "on the base":
            given, link = options["function"], options.get("link")
            if link is not None:
                with naming(place / "link"):
                    link_frame(self.system, link, "link")
                if len(given) not in (3, 6):
                    where.fail(f"must have 3 or 6 entries on a link, got {len(given)}")
            elif len(given) != self.system.r:
                group = self.system.group.name
                where.fail(f"must have {self.system.r} entries for {group}, got {len(given)}")
            options["function"] = [self._action(v, where / k) for k, v in enumerate(given)]
        with naming(place):
            return kind.make(**options)

    def _action(self, value: Any, place: Place) -> Any:
        """Return a number, a Signal, or the formula of the state that a text is."""
        return (
            self._formula(value, place)
            if isinstance(value, str)
            else (self.signals.value(value, place))
        )

    def _formula(self, text: str, place: Place) -> Formula:
        """Return a formula that has been read once.  Raises InputError."""
        formula = Formula(text, self._symbols())
        with naming(place):
            formula(self.symbols)
        return formula

    def _event(self, entry: dict[str, Any], place: Place) -> Event:
        options = dict(entry)
        expression = self._formula(options.pop("function"), place / "function")
        with naming(place):
            return Event(expression, **options)

    def _potential(self, text: str, place: Place) -> Callable[[Any], Any]:
        """Return the function of x that a formula is."""
        with naming(place):
            parse(text, {"x": self._shape(self.symbols.x)} | self._symbols())
        return lambda x: parse(text, {"x": self._shape(x)} | self._symbols())

    def _symbols(self) -> dict[str, Any]:
        """Return the symbols of the parameters."""
        return {name: parameter.symbol for name, parameter in self.parameters.items()}

    def _shape(self, x: Any) -> dict[str, Any]:
        """Return the entries of the shape by joint, those of followers included."""
        return {name: x[k] for k, name in enumerate(self.symbols.every_name)}

    def _explain(
        self, error: PinredError, forces: list[Force], prescribed: Mapping[str, Signal]
    ) -> NoReturn:
        """Raise a Scene's refusal again, with the key that it is about."""
        text, place = one_line(error), self.place
        found = self.signals.of_error(error)
        word = re.match(r"\w+", text)
        section = _SECTIONS.get(word[0]) if word else None
        if found is not None:
            place, text = found[0], found[1]
        elif word and section:
            place = place / section / word[0]
        elif text.startswith("parameters: "):
            named = [at for name, at in self.places.items() if f"'{name}'" in text]
            place = named[0] if named else place / "parameters"
            text = text.removeprefix("parameters: ")
        else:
            for k, force in enumerate(forces):
                try:
                    remembered_model(self.system, {}, [force], prescribed)
                except PinredError:
                    place = place / "forces" / k
                    break
        raise type(error)(place.tell(text)) from None

    def _joint(self, name: str, place: Place) -> None:
        if name not in (*self.system.shape_names, *self.system.followers):
            place.fail(unknown(name, "joint", self.system.shape_names, "the joints are"))

    def _by_joint(
        self, values: Mapping[str, Any], place: Place, read: Callable[[Any, Place], Any]
    ) -> dict[str, Any]:
        """Return each value as `read` gives it.  Raises InputError for unknown joints."""
        for name in values:
            self._joint(name, place / name)
        return {name: read(value, place / name) for name, value in values.items()}

    def _per_joint(self, value: Any, place: Place) -> Any:
        if isinstance(value, dict):
            self._by_joint(value, place, lambda entry, _: entry)
        return value


def _method(given: str | dict[str, Any]) -> Method | Literal["auto"]:
    """Return the integrator of a text or a table."""
    if isinstance(given, str):
        return forms.method(given)
    options = dict(given)
    name = options.pop("name")
    return "auto" if name == "auto" else METHODS[name](**options)
