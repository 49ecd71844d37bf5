"""The outputs of a sweep: fields of the states, their entries, and functions of the members."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from ..common.argument_kinds import call_function
from ..common.arrays import Array, as_floats
from ..common.errors import InputError, ShapeError
from ..common.names import brief, component_index, joint_index, listed, nearest, quoted
from ..scene.scene import Scene
from ..simulation.members.trajectories import Trajectories
from ..system.state_fields import FIELDS, ShapeState, State, dimension, entry_names, label_entries

Function: TypeAlias = Callable[[Trajectories], Any]
Outputs: TypeAlias = Mapping[str, str | Function] | Sequence[str]
_FIELD = re.compile(r"(\w+)(?:\.(.+?))?(\(t\))?")
_DEFAULT = ("x", "xdot", "pose", "energy")


@dataclass(frozen=True)
class Output:
    """One output of a sweep.

    Attributes:
        name: Name in the results.
        field: Field of State; "" for a function.
        entry: Index of the stored entry; None for all entries.
        over_time: Whether all report times are stored, not only the last one.
        function: Function of the members, or None.
        dims: Names of the dimensions after the point.
        unit: Unit; "" if unknown.
    """

    name: str
    field: str
    entry: int | None
    over_time: bool
    function: Function | None
    dims: tuple[str, ...]
    unit: str

    def read(self, fields: Mapping[str, Array], many: Trajectories) -> Array:
        """Return the values of all members, (N, …).

        Args:
            fields: Fields of State that the outputs need, (N, T, …).
            many: The members.
        Raises:
            InputError: The function raises an exception.
            ShapeError: The function returns other than one row of numbers for each member.
        """
        if self.function is not None:
            values = self._computed(self.function, many)
            if values.ndim == 0 or len(values) != len(many):
                raise ShapeError(
                    f"outputs: the function of {quoted(self.name)} must return one row for each of "
                    f"the {len(many)} members, got shape {values.shape}"
                )
            return values
        values = fields[self.field]
        if self.entry is not None:
            values = values[..., self.entry]
        return values if self.over_time else values[:, -1]

    def _computed(self, function: Function, many: Trajectories) -> Array:
        name = quoted(self.name)
        values = call_function(function, f"outputs: the function of {name}", many)
        if isinstance(values, np.ndarray) and values.dtype == bool:
            values = values.astype(float)
        return as_floats(values, f"outputs: the values of {name}")


@dataclass(frozen=True)
class Measure:
    """A named quantity of a motion, which a sweep stores for each point.

    Attributes:
        kind: A name in MEASURES.
        entry: Index of a joint, or of a coordinate of a position or of the rotation vector of a
            turn; None for the largest, for all coordinates or for the angle of a turn.
        frame: Name of the frame whose position is stored.
        joint: Name of the joint whose impacts count; "" for all.
    """

    kind: str
    entry: int | None
    frame: str = ""
    joint: str = ""

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields to pickle, without an empty `joint`, which older stores do not name."""
        return {name: value for name, value in vars(self).items() if value or name != "joint"}

    def __call__(self, many: Trajectories) -> Array:
        """Return one row for each member; NaN for members that did not reach their end.

        Args:
            many: The members.
        """
        measured: Array = getattr(self, f"_{self.kind}")(many)
        if self.entry is not None:
            return np.asarray(measured[:, self.entry])
        return np.asarray(measured.max(axis=1) if self.kind in _OF_JOINTS else measured)

    def _turn(self, many: Trajectories) -> Array:
        group, pose = many.system.group, many.fields(["pose"])["pose"]
        if group.turns == 1:
            return np.asarray(np.rad2deg(pose[:, -1, -1] - pose[:, 0, -1]))
        if self.entry is None:
            return np.asarray(np.rad2deg(group.error(pose[:, 0], pose[:, -1]).rotation))
        displacement = group.compose(group.inverse(pose[:, 0]), pose[:, -1])
        return np.asarray(np.rad2deg(group.log(displacement)[:, group.linear :]))

    def _excursion(self, many: Trajectories) -> Array:
        space, x = many.system.space, many.fields(["x"])["x"]
        if space.balls:
            x = np.stack([space.chart(shapes) for shapes in x])
        return np.asarray(np.abs(x - x[:, :1]).max(axis=1))

    def _peak_torque(self, many: Trajectories) -> Array:
        failed = {failure.member for failure in many.failures}
        peaks = np.full((len(many), many.system.m), np.nan)
        for k in range(len(many)):
            if k not in failed:
                peaks[k] = np.abs(many[k].torques).max(axis=0)
        return peaks

    def _impacts(self, many: Trajectories) -> Array:
        return self._of_impacts(many, 0.0, lambda t, _: len(np.unique(t)))

    def _first_impact(self, many: Trajectories) -> Array:
        return self._of_impacts(many, np.nan, lambda t, _: t[0])

    def _energy_lost(self, many: Trajectories) -> Array:
        return self._of_impacts(many, 0.0, lambda _, lost: lost.sum())

    def _of_impacts(
        self, many: Trajectories, none: float, value: Callable[[Array, Array], float]
    ) -> Array:
        """Return a number of each member, (N,), from the times and losses of its impacts.

        Args:
            many: The members.
            none: The number of members without impacts.
            value: Function of the times and the lost energies of the impacts of a member.
        """
        measured = np.full(len(many), none)
        for member in np.unique(many.impacts.member).tolist():
            table = many.impacts.of_member(member)
            counts = np.array([self.joint in ("", name) for name in table.joint])
            if counts.any():
                measured[member] = value(table.t[counts], table.energy_lost[counts])
        measured[[failure.member for failure in many.failures]] = np.nan
        return measured

    def _position(self, many: Trajectories) -> Array:
        failed = {failure.member for failure in many.failures}
        positions = np.full((len(many), 3), np.nan)
        for k, q in enumerate(many.fields(["q"])["q"][:, -1]):
            if k not in failed and np.isfinite(q).all():
                model = many[k].system.model  # Members may have robot parameters of their own.
                data = model.createData()
                pin.framesForwardKinematics(model, data, q)
                positions[k] = data.oMf[model.getFrameId(self.frame)].translation
        return positions


# The named quantities, with their form in texts and their meaning.
MEASURES: Mapping[str, tuple[str, str]] = {
    "turn": ("turn", "turn of the base from the first to the last report time, in degrees"),
    "position": ("position(FRAME)", "position of a frame at the end, in the world"),
    "peak_torque": ("peak_torque", "largest torque on a joint at the report times"),
    "excursion": ("excursion", "largest distance of a joint from its first value"),
    "impacts": ("impacts", "number of impacts at joint stops"),
    "first_impact": ("first_impact", "time of the first impact; NaN without impacts"),
    "energy_lost": ("energy_lost", "energy that impacts at joint stops remove"),
}
_OF_JOINTS = ("peak_torque", "excursion")  # measures that are largest values over joints
_OF_IMPACTS: Mapping[str, str] = {"impacts": "1", "first_impact": "s", "energy_lost": "J"}  # units
_MEASURE = re.compile(r"(\w+?)(?:\((.+)\))?(?:\.([^()]+))?")


def _measure(scene: Scene, name: str, text: str) -> Output | None:
    """Return the output of a named quantity, such as "turn" or "position(tool).x"; None if none."""
    match = _MEASURE.fullmatch(text)
    if (
        match is None
        or match[1] not in MEASURES
        or (match[2] is not None) != (match[1] == "position")
    ):
        return None
    measure_name, frame, label = match[1], match[2] or "", match[3]
    system, what = scene.system, f"outputs: {quoted(name)}"
    if measure_name in ("turn", "position") and scene.outputs != "all":
        raise InputError(f"{what}: the scene has outputs='shape', which leaves out the base")
    if measure_name == "turn" and (not system.group.turns or (label and system.group.turns < 3)):
        raise InputError(
            f"{what}: expected turn, of a base that can turn, with an entry x, y or z only if it "
            f"turns in space; the group is {system.group.name}"
        )
    frames = [str(entry.name) for entry in system.model.frames]
    if frame and frame not in frames:
        raise InputError(
            f"{what}: no frame {quoted(frame)}; {nearest(frame, frames)}the frames are "
            f"{listed(frames, 60)}"
        )
    if measure_name in _OF_IMPACTS:
        joint = _joint_with_stop(scene, label, what)
        measure = Measure(measure_name, None, joint=joint)
        return Output(name, "", None, False, measure, dims=(), unit=_OF_IMPACTS[measure_name])
    entry, units = None, ["°"] if measure_name == "turn" else ["m"]
    if measure_name in _OF_JOINTS:
        if not system.m:
            raise InputError(f"{what}: {quoted(system.name)} has no joints")
        is_torque = measure_name == "peak_torque"
        units = [("N" if unit == "m" else "N·m") if is_torque else unit for unit in system.units]
    if label is not None and measure_name in ("position", "turn"):
        entry = component_index(label, {"x": 0, "y": 1, "z": 2}, what)
    elif label is not None:
        entry = joint_index(label, system.shape_names, what)
        units = [units[entry]]
    unit = " | ".join(dict.fromkeys(units))
    over_time = measure_name != "position"
    return Output(
        name, "", None, over_time, Measure(measure_name, entry, frame), dims=(), unit=unit
    )


def _joint_with_stop(scene: Scene, label: str | None, what: str) -> str:
    """Return the name of a joint that has a stop, "" for all.  Raises InputError if it has none."""
    names = list(dict.fromkeys(bound.joint for bound in scene.bounds))
    if not names:
        raise InputError(f"{what}: expected a scene with joint stops, got none. Add stops")
    if label is None:
        return ""
    if label not in names:
        raise InputError(
            f"{what}: no joint {quoted(label)} has stops; {nearest(label, names)}the joints with "
            f"stops are {listed(names, 60)}"
        )
    return label


def parse_outputs(scene: Scene, outputs: Outputs | None) -> tuple[Output, ...]:
    """Return the outputs of a sweep.

    Args:
        scene: The scene.
        outputs: {name: field or function}, a list of fields, or None for the default.
    Returns:
        The outputs.
    Raises:
        InputError: A field is unknown, or the argument has another form.
    """
    fields = _fields_of(scene)
    if outputs is None:
        outputs = [name for name in _DEFAULT if name in fields]
    if not isinstance(outputs, Mapping):
        if isinstance(outputs, str) or not all(isinstance(name, str) for name in outputs):
            raise InputError(
                f"outputs: expected {{name: field or function}} or a list of fields, got "
                f"{brief(outputs)}"
            )
        outputs = {name.removesuffix("(t)"): name for name in outputs}
    if not outputs:
        raise InputError(f"outputs: expected at least one; the fields are {listed(fields, 60)}")
    return tuple(_output(scene, name, value, fields) for name, value in outputs.items())


def _fields_of(scene: Scene) -> list[str]:
    state_type = State if scene.outputs == "all" else ShapeState
    return [name for name in state_type.__dataclass_fields__ if name != "t"]


def _output(scene: Scene, name: str, value: str | Function, known: Sequence[str]) -> Output:
    if callable(value):
        return Output(name, "", None, over_time=True, function=value, dims=(), unit="")
    if isinstance(value, str) and (measure := _measure(scene, name, value)) is not None:
        return measure
    match = _FIELD.fullmatch(value) if isinstance(value, str) else None
    if match is None or match[1] not in known:
        near = nearest(match[1], known) if match else ""
        raise InputError(
            f"outputs: {quoted(name)}: expected a function or a field, got {brief(value)}; {near}"
            f"the fields are {listed(known, 60)}, each also as FIELD.ENTRY, and over time as "
            f"FIELD(t); and {', '.join(form for form, _ in MEASURES.values())}"
        )
    field, label, over_time = match[1], match[2], match[3] is not None
    dims, entry = ("t",) * over_time, None
    labels = label_entries(scene.system, field)
    unit = " | ".join(dict.fromkeys(unit for _, unit in labels)) or FIELDS[field].unit
    if label is not None:
        names = entry_names(scene.system, field)
        if FIELDS[field].axis is None or label not in names:
            entries = listed([text for text, _ in labels], 60) or "none"
            raise InputError(
                f"outputs: {quoted(name)}: {field} has no entry {quoted(label)}; "
                f"{nearest(label, list(names))}the entries are {entries}"
            )
        entry = names[label]
        unit = labels[entry][1] or unit
    elif (axis := FIELDS[field].axis) is not None:
        dims = (*dims, dimension(scene.system, axis))
    return Output(name, field, entry, over_time, None, dims, unit)
