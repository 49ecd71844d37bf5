"""Labels and units of the entries of states, for the keys and coordinates of sweeps."""

from __future__ import annotations

from ..system.state_fields import FIELDS, axis_labels
from ..system.system import System

_PLAIN = str.maketrans({"θ": "theta", "ω": "omega"})


def plain_label(label: str) -> str:
    """Return a label with Greek letters spelled out, so that both spellings are equal."""
    return label.translate(_PLAIN)


def label_entries(system: System, field: str) -> list[tuple[str, str]]:
    """Return the label and unit of each entry of a quantity.

    Args:
        system: The robot.
        field: A field of State; or "chart" for the shape with rotation vectors of balls,
            "joint_rate" for its rate, and "xi0" or "momentum" for an initial motion.
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
    if field == "pose":
        return [(name, _pose_unit(name)) for name in group.pose_names]
    axis = FIELDS[field].axis
    if axis is None:
        return [("", FIELDS[field].unit)]
    return [(str(label), "") for label in axis_labels(system)[axis]]


def _pose_unit(name: str) -> str:
    if name == "θ":
        return "rad"
    return "1" if name.startswith("q") else "m"
