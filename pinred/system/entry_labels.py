"""Labels and units of the entries of states, for files, labelled arrays and sweeps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from .state_fields import FIELDS, axis_labels
from .system import System

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
