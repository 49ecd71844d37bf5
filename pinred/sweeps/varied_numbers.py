"""The numbers of a scene that a sweep can vary: their keys, units, and values for members."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from numbers import Real
from typing import Any

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError, PinredError
from ..common.names import listed, nearest, quoted
from ..common.parameter import Parameter, VectorParameter, value_in
from ..forces.signals import Constant
from ..scene.scene import Scene
from ..scene.stop import is_number_of_stop, number_of_stop, numbers_of_stop, parse_stops
from ..simulation.members.member_options import force_parameters
from ..system.model_parameters import ModelParameters, kinds_near, size_of
from ..system.state_fields import entry_names, label_entries
from ..system.system import System, nominal

_XYZ = ("x", "y", "z")
# Labels of the entries of robot parameters with several entries, by kind.
_ENTRIES: Mapping[str, Sequence[str]] = {
    "com": _XYZ, "at": _XYZ, "translation": _XYZ, "gravity": _XYZ,
    "inertia": ("xx", "xy", "xz", "yy", "yz", "zz"),
    "placement": (*_XYZ, "roll", "pitch", "yaw"),
    "log_cholesky": tuple(map(str, range(10))),
}  # fmt: skip
_UNITS = {
    "mass": "kg", "com": "m", "inertia": "kg·m²", "at": "m", "translation": "m",
    "gravity": "m/s²", "strength": "m/s²",
}  # fmt: skip
_ANGLES = ("roll", "pitch", "yaw")
_FORCE = re.compile(r"forces\[(\d+)\]\.(\w+)")
# Options that cannot differ between points, with the remedy.
_FIXED = {
    "duration": "store an output over time, such as 'x(t)', and read it at the times",
    "times": "store an output over time, such as 'x(t)', and read it at the times",
    "rtol": "run one sweep for each tolerance", "atol": "run one sweep for each tolerance",
}  # fmt: skip


@dataclass(frozen=True)
class VariedNumber:
    """A number that varies.

    Attributes:
        key: Its name, such as "base.mass", "x0.bend" or "gravity.z".
        member: Name of the member values of simulate_many that contain it.
        entry: Index among the entries of these values; None if they are one number per member.
        unit: Its unit; "" if unknown.
    """

    key: str
    member: str
    entry: int | None
    unit: str


class VariedScene:
    """A scene with some numbers that vary.

    Attributes:
        scene: The scene, in which these numbers are inputs of its kernel.
        numbers: The numbers, in the order of their keys.
    """

    def __init__(self, scene: Scene, keys: Sequence[str]) -> None:
        """Prepare a scene.

        Args:
            scene: The scene.
            keys: Names of the numbers that vary; docs/sweeps.md lists their forms.
        Raises:
            InputError: A name is unknown, or its number cannot vary.
        """
        self.scene = scene
        self.numbers = tuple(self._find(key) for key in keys)
        first: dict[tuple[str, int | None], str] = {}
        for number in self.numbers:
            other = first.setdefault((number.member, number.entry), number.key)
            if other != number.key:
                raise InputError(
                    f"vary: {quoted(other)} and {quoted(number.key)} are one number. Omit one"
                )
        if any(number.member in _states(scene) for number in self.numbers):
            self.scene = _with_stated_start(self.scene)

    def member_values(self, values: Array) -> tuple[dict[str, Any], list[int] | None]:
        """Return the values of members, {name: (N, …)}, and their seeds.

        Args:
            values: Values of the numbers, (N, number of numbers).
        Returns:
            The values as the argument `members` of simulate_many, and its argument `seeds`.
        """
        members: dict[str, Any] = {}
        seeds = None
        for number, column in zip(self.numbers, values.T, strict=True):
            if number.member == "seed":
                seeds = column.astype(int).tolist()
            elif number.entry is None:
                members[number.member] = np.ascontiguousarray(column)
            else:
                if number.member not in members:
                    nominal_value = _nominal(self.scene, number.member)
                    members[number.member] = np.repeat(nominal_value[None], len(values), axis=0)
                members[number.member][:, number.entry] = column
        space = self.scene.system.space
        if "x0" in members and space.balls:  # The columns of a ball are a rotation vector.
            members["x0"] = space.integrate(space.neutral, members["x0"])
        return members, seeds

    def nominal_values(self) -> Array:
        """Return the values of the numbers in the scene; 0 for a seed."""
        values, parameters, system = [], _parameters_of(self.scene), self.scene.system
        for number in self.numbers:
            if number.member == "seed":
                values.append(0.0)
            elif number.entry is not None:
                values.append(float(_nominal(self.scene, number.member)[number.entry]))
            elif number.member not in parameters and is_number_of_stop(number.member, system):
                stops = parse_stops(self.scene.stops, system)
                values.append(number_of_stop(stops, number.member, "vary"))
            elif number.member in parameters:
                values.append(float(value_in(self.scene.parameters, parameters[number.member])))
            else:
                values.append(float(np.ravel(_nominal(self.scene, number.member))[0]))
        return np.array(values)

    def _find(self, key: str) -> VariedNumber:
        scene, system = self.scene, self.scene.system
        if key in _FIXED:
            raise InputError(f"vary: {quoted(key)} is the same for all points; {_FIXED[key]}")
        if key == "seed":
            return VariedNumber(key, key, None, "1")
        word, _, end = key.partition(".")
        states = _states(scene)
        parameters = _parameters_of(scene)
        names = [
            f"{key}.{label}"
            for label in _first_names(states.get(key, {})) or _labels_of(system, key)
        ]
        names += [p.name for p in parameters.values() if p.place and p.place[0].name == key]
        if names:
            raise InputError(
                f"vary: {quoted(key)} is a vector. Vary some of its entries: {listed(names, 60)}"
            )
        if is_number_of_stop(key, system) and key not in parameters:
            number_of_stop(parse_stops(scene.stops, system), key, "vary")
            return VariedNumber(key, key, None, _unit_of_stop(system, key))
        if word in states and end in states[word]:
            entry, unit = states[word][end]
            return VariedNumber(key, word, entry, unit)
        if key in parameters:
            if (place := parameters[key].place) is not None:
                return VariedNumber(key, place[0].name, place[1], "")
            return VariedNumber(key, key, None, "")
        if key == "gravity.strength" and not system.gravity.any():
            raise InputError(
                f"vary: {quoted(system.name)} has zero gravity, so 'gravity.strength' has no "
                "direction to scale; vary 'gravity.z'"
            )
        if (number := _robot_number(system, key)) is not None:
            return number
        if (changed := _with_parameter(scene, key)) is not None:
            self.scene, unit = changed
            return VariedNumber(key, key, None, unit)
        raise InputError(f"vary: there is no {quoted(key)}; {_hint(scene, key)}")


def size_of_robot(system: System, name: str) -> int | None:
    """Return the number of entries of a robot parameter; None for any other name."""
    try:
        return size_of(nominal(system), name)
    except PinredError:
        return None


def _parameters_of(scene: Scene) -> dict[str, Parameter]:
    """Return the Parameters in forces and signals, and all entries of vectors, by name."""
    parameters: list[Parameter] = []
    for parameter in force_parameters(scene).values():
        parameters.extend(parameter if isinstance(parameter, VectorParameter) else [parameter])
    return {parameter.name: parameter for parameter in parameters}


def _states(scene: Scene) -> dict[str, dict[str, tuple[int, str]]]:
    """Return {option: {name: (entry, unit)}} of the initial state, by all names of an entry."""
    system = scene.system
    motion = "momentum" if scene.given.mu is not None else "xi0"
    fields_of_options = {"x0": "chart", "xdot0": "joint_rate", "pose0": "pose0", motion: motion}
    return {
        option: {
            name: (k, units[k])
            for name, k in entry_names(system, field).items()
            if not (option == "pose0" and name.startswith("q"))  # entries of a unit quaternion
        }
        for option, field in fields_of_options.items()
        for units in [[unit for _, unit in label_entries(system, field)]]
    }


def _first_names(entries: Mapping[str, tuple[int, str]]) -> list[str]:
    """Return the first name of each entry."""
    names: dict[int, str] = {}
    for name, (entry, _) in entries.items():
        names.setdefault(entry, name)
    return list(names.values())


def _robot_number(system: System, key: str) -> VariedNumber | None:
    """Return a robot parameter, or an entry of one; None if the key has another form."""
    if size_of_robot(system, key) == 1:
        return VariedNumber(key, key, None, _unit(system, key, ""))
    member, _, label = key.rpartition(".")
    if label not in (labels := _labels_of(system, member)):
        return None
    return VariedNumber(key, member, labels.index(label), _unit(system, member, label))


def _labels_of(system: System, name: str) -> Sequence[str]:
    """Return the labels of the entries of a robot parameter that is a vector."""
    labels = _ENTRIES.get(name.rpartition(".")[2], ())
    return labels if labels and size_of_robot(system, name) == len(labels) else ()


def _unit(system: System, name: str, label: str) -> str:
    quantity = name.rpartition(".")[2]
    if quantity == "lock":
        joint = system.sorted_model.joints[
            system.sorted_model.getJointId(name.removesuffix(".lock"))
        ]
        return "m" if joint.shortname().startswith("JointModelP") else "rad"
    if quantity == "placement":
        return "rad" if label in _ANGLES else "m"
    return _UNITS.get(quantity, "1")


def _unit_of_stop(system: System, key: str) -> str:
    """Return the unit of a number of a stop."""
    joint, _, field = key.rpartition(".stop.")
    unit = {tree_joint.name: tree_joint.kind.units[0] for tree_joint in system.tree.joints}[joint]
    return {"restitution": "1", "rest_rate": f"{unit}/s"}.get(field, unit)


def _with_parameter(scene: Scene, key: str) -> tuple[Scene, str] | None:
    """Replace a number of springs, forces, controls or prescribed joints by a Parameter.

    Args:
        scene: The scene.
        key: Name of the number, which becomes that of the Parameter.
    Returns:
        The changed scene and the unit, or None if there is no such number.
    """
    word, _, place = key.partition(".")
    joint, _, which = place.rpartition(".")
    if word == "springs" and joint in scene.springs and which in ("stiffness", "rest"):
        pair = list(scene.springs[joint])
        k = ("stiffness", "rest").index(which)
        if not _is_number(pair[k]):
            return None
        pair[k] = Parameter(key, float(pair[k]))  # type: ignore[arg-type]
        springs = {**scene.springs, joint: (pair[0], pair[1])}
        return replace(scene, springs=springs), ""
    if word == "prescribed" and place in scene.prescribed:
        plan = scene.prescribed[place]
        if not (isinstance(plan, Constant) and _is_number(plan.level)):
            return None
        prescribed = {**scene.prescribed, place: Parameter(key, float(plan.level))}  # type: ignore[arg-type]
        return replace(scene, prescribed=prescribed), ""
    if word == "controls" and place in _constant_controls(scene):
        parameter = Parameter(key, float(scene.controls[place]))  # type: ignore[arg-type, index]
        return replace(scene, controls={**scene.controls, place: parameter}), ""  # type: ignore[dict-item]
    match = _FORCE.fullmatch(key)
    forces: list[Any] = list(vars(scene)["forces"])
    if match is None or int(match[1]) >= len(forces):
        return None
    force, name = forces[int(match[1])], match[2]
    if name not in _numbers_of(force):
        return None
    parameter = Parameter(key, float(getattr(force, name)))
    forces[int(match[1])] = replace(force, **{name: parameter})
    return replace(scene, forces=forces), ""


def _constant_controls(scene: Scene) -> list[str]:
    """Return the names of the actuators with a number as control."""
    controls = scene.controls if isinstance(scene.controls, Mapping) else {}
    return [name for name, control in controls.items() if _is_number(control)]


def _numbers_of(force: Any) -> list[str]:
    """Return the fields of a force that are numbers and can be Parameters."""
    entries = fields(force) if is_dataclass(force) else ()
    return [
        entry.name
        for entry in entries
        if "Parameter" in str(entry.type) and _is_number(getattr(force, entry.name))
    ]


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _with_stated_start(scene: Scene) -> Scene:
    """Return a scene that states its initial state by x0, xdot0, pose0 and xi0 or momentum."""
    start = scene.given
    states: dict[str, Any] = dict.fromkeys(("q0", "v0", "seed", "keyframe", "xi0", "momentum"))
    states |= {"pose0": start.pose[0], "x0": start.x[0], "xdot0": start.xdot[0]}
    states["xi0" if start.mu is None else "momentum"] = start.motion[0]
    return replace(scene, **states)


def _nominal(scene: Scene, member: str) -> Array:
    """Return the value of a vector in the scene; balls have rotation vectors in x0."""
    start, system = scene.given, scene.system
    if member == "x0":
        return np.asarray(system.space.chart(start.x)[0])
    states = {"xdot0": start.xdot, "pose0": start.pose, "xi0": start.xi, "momentum": start.mu}
    if member in states:
        states_of_members = states[member]
        assert states_of_members is not None
        return np.asarray(states_of_members[0])
    if member == "gravity":
        return np.asarray(system.gravity)
    if (parameter := force_parameters(scene).get(member)) is not None:
        return np.asarray(scene.parameters.get(member, parameter.value))
    return np.asarray(ModelParameters(system, [member]).own()[member])


def _hint(scene: Scene, key: str) -> str:
    """Return a list of the numbers that can vary, with the nearest one first."""
    states = [
        f"{option}.{label}"
        for option, entries in _states(scene).items()
        for label in _first_names(entries)
    ]
    system = scene.system
    parameters = list(_parameters_of(scene))
    forces: tuple[Any, ...] = vars(scene)["forces"]
    numbers = [f"springs.{joint}.{end}" for joint in scene.springs for end in ("stiffness", "rest")]
    numbers += [f"forces[{k}].{name}" for k, f in enumerate(forces) for name in _numbers_of(f)]
    numbers += [f"controls.{name}" for name in _constant_controls(scene)]
    numbers += [
        f"{joint}.stop.{end}"
        for joint, stop in parse_stops(scene.stops, system).items()
        for end in numbers_of_stop(stop)
    ]
    numbers += [
        f"prescribed.{joint}"
        for joint, plan in scene.prescribed.items()
        if isinstance(plan, Constant)
    ]
    names = [*parameters, *numbers, *states, "seed"]
    return (
        f"{nearest(key, names)}the numbers of the scene are {listed(names, 60)}; "
        f"{kinds_near(nominal(system), key)}, and .x, .y, .z and so on of vectors"
    )
