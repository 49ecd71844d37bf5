"""The fields of a state, in one table, and the classes State and ShapeState with these fields.

Labels and units of entries serve files, labelled arrays and sweeps.

Files, labelled arrays, kernels and flows read names, axes and units from FIELDS.  To add a field:

1. Add it to FIELDS, to State (and to ShapeState if it does not need the base), to StateArrays,
   and to Outcome if flows differentiate it.
2. Compute its value for the compiled engine in kernels/reduced_graph.py, or in
   kernels/reduced_graph.py if it needs the base.
3. Compute its value for the other engine in `states()` of simulation/pinocchio_engine.py.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, NoReturn, TypeVar

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays
from ..common.errors import InputError
from .system import System

Axis = Literal["shape", "joint", "twist", "coordinate", "nq", "nv"]
Outcome = Literal["x", "xdot", "pose", "xi", "body_momentum", "spatial_momentum", "energy"]
_Kind = TypeVar("_Kind", bound="type[State | ShapeState]")

# The symbol of each axis length in documented array shapes.
_SYMBOLS: dict[Axis, str] = {
    "shape": "nx", "joint": "m", "twist": "r", "coordinate": "size", "nq": "nq", "nv": "nv",
}  # fmt: skip


@dataclass(frozen=True)
class StateField:
    """The description of one quantity of a state.

    Attributes:
        name: Name of the field in State, in files and among the outputs of flows.
        unit: Unit of the entries; " | " separates the units of different entries.
        axis: The axis after time; None for a scalar at each time.
        derivative: How flows differentiate the field: by its "entries", along the "frame" of the
            shape, as the body "twist" of a change of pose, or not ("none").
        meaning: Name of the quantity, a phrase that starts a sentence.
        needs_base: Whether the field is missing if the scene leaves out the base.
    """

    name: str
    unit: str
    axis: Axis | None
    derivative: Literal["entries", "frame", "twist", "none"]
    meaning: str
    needs_base: bool = True

    @property
    def description(self) -> str:
        """The meaning, shape and unit in one sentence."""
        shape = f"(…, {_SYMBOLS[self.axis]})" if self.axis else "(…,)"
        return f"{self.meaning}, {shape} [{self.unit}]."


_TABLE = (
    StateField("t", "s", None, "none", "Time", needs_base=False),
    StateField("x", "rad | m | 1", "shape", "frame", "Shape", needs_base=False),
    StateField("xdot", "rad/s | m/s", "joint", "entries", "Shape rate", needs_base=False),
    StateField("xi", "m/s | rad/s", "twist", "entries", "Body twist [linear; angular] of the base"),
    StateField("pose", "m | rad | 1", "coordinate", "twist", "Pose of the base"),
    StateField("q", "m | rad | 1", "nq", "none", "Configuration of `system.model`"),
    StateField("v", "m/s | rad/s", "nv", "none", "Velocity of `system.model`"),
    StateField(
        "body_momentum", "N·s | N·m·s", "twist", "entries",
        "Body momentum μ, in the body frame, about its origin",
    ),
    StateField(
        "spatial_momentum", "N·s | N·m·s", "twist", "entries",
        "Spatial momentum J = Ad*_{g⁻¹} μ, in the root joint's fixed frame, about its origin",
    ),
    StateField(
        "energy", "J", None, "entries",
        "Kinetic and potential energy, of free fall too, with zero height at the world's origin; "
        "without the base, the energy about the centre of mass", needs_base=False,
    ),
)  # fmt: skip
FIELDS: Mapping[str, StateField] = MappingProxyType({field.name: field for field in _TABLE})


def _describe_fields(kind: _Kind) -> _Kind:
    """Append the field descriptions in FIELDS to the docstring of a state class."""
    entries = [f"    {name}: {FIELDS[name].description}" for name in kind.__dataclass_fields__]
    kind.__doc__ = "\n".join([f"{kind.__doc__}\n\nAttributes:", *entries])
    return kind


@checks_arguments
@_describe_fields
@dataclass(frozen=True)
class ShapeState(FrozenArrays):
    """The shape at one time or over time (time first), without the base; read-only arrays."""

    t: Array
    x: Array
    xdot: Array
    energy: Array


@checks_arguments
@_describe_fields
@dataclass(frozen=True)
class State(FrozenArrays):
    """The state of a system at one time or over time (time first); read-only arrays."""

    t: Array
    x: Array
    xdot: Array
    xi: Array
    pose: Array
    q: Array
    v: Array
    body_momentum: Array
    spatial_momentum: Array
    energy: Array


class _Column:
    """A descriptor: a read-only attribute of motions that returns one field of their states."""

    def __init__(self, name: str) -> None:
        self._field = FIELDS[name]
        self.__doc__ = self._field.description

    def __get__(self, motion: StateArrays | None, owner: type | None = None) -> Array:
        if motion is None:
            return self  # type: ignore[return-value]
        states = motion.states if self._field.needs_base else motion.outputs
        values: Array = getattr(states, self._field.name)
        return values

    def __set__(self, motion: StateArrays, value: object) -> NoReturn:
        raise AttributeError(f"'{self._field.name}' of a motion is read-only")


class StateArrays(ABC):
    """Attributes for the fields of a motion's states.

    Fields that need the base raise InputError if the scene leaves out the base.
    """

    x = _Column("x")
    xdot = _Column("xdot")
    xi = _Column("xi")
    pose = _Column("pose")
    q = _Column("q")
    v = _Column("v")
    body_momentum = _Column("body_momentum")
    spatial_momentum = _Column("spatial_momentum")
    energy = _Column("energy")

    @property
    @abstractmethod
    def outputs(self) -> State | ShapeState:
        """The states at all report times."""

    @property
    @abstractmethod
    def states(self) -> State:
        """The states with the base.  Raises InputError if the base was left out."""


def with_base(state: State | ShapeState, name: str) -> State:
    """Check that a state includes the base, and return it.

    Args:
        state: A state, with or without the base.
        name: Name of the robot or motion in the message.
    Returns:
        The same state.
    Raises:
        InputError: The base was left out.
    """
    if isinstance(state, State):
        return state
    raise InputError(
        f"the scene of '{name}' has outputs='shape', which leaves out the base; "
        "simulate with outputs='all'"
    )


def arrays_of(state: State | ShapeState) -> dict[str, Array]:
    """Return the arrays of a state by field name."""
    return {name: getattr(state, name) for name in state.__dataclass_fields__}


def map_arrays(
    function: Callable[..., Array], first: State | ShapeState, *others: State | ShapeState
) -> State | ShapeState:
    """Apply a function to each field of one or several states; return the resulting state."""
    names = first.__dataclass_fields__
    states = (first, *others)
    kind = State if isinstance(first, State) else ShapeState
    return kind(**{name: function(*(getattr(state, name) for state in states)) for name in names})


def axis_labels(system: System) -> dict[Axis, Sequence[Any]]:
    """Return the labels of the entries along each axis of a system's states."""
    return {
        "shape": system.x_names,
        "joint": system.shape_names,
        "twist": system.group.twist_names,
        "coordinate": system.group.pose_names,
        **_model_labels(system),
    }


# Labels of the entries of joints with several coordinates, by (nq, nv).
_JOINT_ENTRIES: Mapping[tuple[int, int], tuple[tuple[str, ...], tuple[str, ...]]] = {
    (2, 1): (("cos", "sin"), ("",)),
    (4, 3): (("qx", "qy", "qz", "qw"), ("x", "y", "z")),
}


def _model_labels(system: System) -> dict[Axis, Sequence[str]]:
    """Return labels of the entries of q and v of the model: "base.x", "elbow", "wheel.cos"."""
    group, model = system.group, system.model
    joints, names = model.joints[1:] if model.njoints > 1 else [], list(model.names)[1:]
    q: list[str] = []
    v: list[str] = []
    for k, (name, joint) in enumerate(zip(names, joints, strict=True)):
        pair = (joint.nq, joint.nv)
        if k == 0:
            turn = ("cos", "sin") if joint.nq == group.size + 1 else group.pose_names[-1:]
            entries_of_pair: tuple[Sequence[str], Sequence[str]] = (
                (*group.pose_names[:-1], *turn), group.velocity_names,
            )  # fmt: skip
            name = "base"
        elif joint.shortname() == "JointModelPlanar":
            entries_of_pair = ("x", "y", "cos", "sin"), ("vx", "vy", "w")
        elif pair in ((1, 1), *_JOINT_ENTRIES):
            entries_of_pair = _JOINT_ENTRIES.get(pair, (("",), ("",)))
        else:
            entries_of_pair = [str(i) for i in range(joint.nq)], [str(i) for i in range(joint.nv)]
        for labels, entries in zip((q, v), entries_of_pair, strict=True):
            labels += [f"{name}.{entry}" if entry else name for entry in entries]
    return {"nq": q, "nv": v}


def dimension(system: System, axis: Axis) -> str:
    """Return the name of an axis in labelled arrays; without balls, x and xdot share one."""
    return "joint" if axis == "shape" and not system.space.balls else axis


def axis_lengths(system: System) -> dict[Axis | None, int]:
    """Return the number of entries along each axis of a system's states; 1 for scalars."""
    return {None: 1} | {axis: len(labels) for axis, labels in axis_labels(system).items()}


# Axis of the derivative rows by the kind of derivative; other fields have rows along their axis.
_TANGENT_AXES: Mapping[str, Axis] = {"frame": "joint", "twist": "twist"}


def derivative_rows(system: System) -> dict[str, int]:
    """Return the number of derivative rows of each field that flows differentiate."""
    lengths = axis_lengths(system)
    return {
        name: lengths[_TANGENT_AXES.get(field.derivative, field.axis)]
        for name, field in FIELDS.items()
        if field.derivative != "none"
    }


_SPELLED_OUT = str.maketrans({"θ": "theta", "ω": "omega"})
# The quantities of the symmetry group, by field or option.
_OF_GROUP: Mapping[str, Literal["twist", "pose", "momentum"]] = {
    "xi": "twist", "xi0": "twist", "pose": "pose", "pose0": "pose", "momentum": "momentum",
    "body_momentum": "momentum", "spatial_momentum": "momentum",
}  # fmt: skip


def entry_names(system: System, field: str) -> dict[str, int]:
    """Return the index of each entry of a quantity by all its names, its labels first.

    Args:
        system: The robot.
        field: As for label_entries.
    """
    labels = {label: k for k, (label, _) in enumerate(label_entries(system, field))}
    if field in _OF_GROUP:
        return system.group.components(_OF_GROUP[field]) | labels
    if field in ("q", "v"):  # The entries of the model may be numbered, too.
        labels |= {str(k): k for k in range(len(labels))}
    return labels | {label.translate(_SPELLED_OUT): k for label, k in labels.items()}


def column_names(system: System, field: str) -> list[str]:
    """Return the names of the columns of a field in plain letters, such as "xi.vx".

    Args:
        system: The robot.
        field: A field of State.
    """
    group = system.group
    if FIELDS[field].axis is None:
        return [field]
    if field == "xi":
        names: tuple[str, ...] = group.velocity_names
    elif field in _OF_GROUP and field != "pose":
        names = group.momentum_names
    else:
        names = tuple(label.translate(_SPELLED_OUT) for label, _ in label_entries(system, field))
    return [f"{field}.{name}" for name in names]


def field_attributes(system: System, field: str) -> dict[str, str]:
    """Return unit and long name of a field, the attributes of labelled arrays and their files.

    Args:
        system: The robot.
        field: A field of State.
    Returns:
        {"units": …, "long_name": …}; " | " separates the units of different entries.
    """
    units = dict.fromkeys(unit for _, unit in label_entries(system, field))
    unit = " | ".join(units) if all(units) else FIELDS[field].unit
    return {"units": unit, "long_name": FIELDS[field].meaning}


def torque_unit(system: System) -> str:
    """Return the unit of torques on the joints; " | " separates those of hinges and slides."""
    return " | ".join(dict.fromkeys("N" if unit == "m" else "N·m" for unit in system.units))


def label_entries(system: System, field: str) -> list[tuple[str, str]]:
    """Return the label and unit of each entry of a quantity.

    Args:
        system: The robot.
        field: A field of State; or "chart" for the shape with rotation vectors of balls,
            "joint_rate" for its rate, and "xi0", "pose0" or "momentum" for an initial motion.
    Returns:
        (label, unit) of each entry; [("", unit)] for a scalar.
    """
    group = system.group
    if field in ("chart", "x"):
        if field == "chart" or not system.space.balls:
            return list(zip(system.shape_names, system.units, strict=True))
        units = [unit for joint in system.space.joints for unit in joint.kind.coordinate_units]
        return list(zip(system.x_names, units, strict=True))
    if field in ("joint_rate", "xdot"):
        return [
            (name, f"{unit}/s") for name, unit in zip(system.shape_names, system.units, strict=True)
        ]
    if field in ("xi", "xi0"):
        units = [*["m/s"] * group.linear, *["rad/s"] * group.dim]
        return list(zip(group.twist_names, units, strict=False))
    if field in ("momentum", "body_momentum", "spatial_momentum"):
        units = [*["N·s"] * group.linear, *["N·m·s"] * group.dim]
        return list(zip(group.twist_names, units, strict=False))
    if field in ("pose", "pose0"):
        return [(name, _pose_unit(name)) for name in group.pose_names]
    axis = FIELDS[field].axis
    if axis is None:
        return [("", FIELDS[field].unit)]
    return [(str(label), "") for label in axis_labels(system)[axis]]


def _pose_unit(name: str) -> str:
    if name == "θ":
        return "rad"
    return "1" if name.startswith("q") else "m"
