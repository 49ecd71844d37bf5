"""The kinds of forces in scene files: what each takes, and what it makes of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from ...forces import kinds as acting
from ...forces.force import Force
from ...forces.wrench import AXES
from .schema import ByName, Flag, Key, ListOf, Table, Tagged, Text
from .signal_keys import ACTION, NUMBER, NUMBERS, PER_JOINT, POSITIVE, SIGNAL


@dataclass(frozen=True)
class ForceKind:
    """A kind of force.

    make: makes it of the entries of its table, by their names.  table: its keys.  function:
    how the key `function` is read: as a formula "of the shape", as an action "by joint", as a
    list of actions "on the base"; None where there is no such key.
    """

    make: Callable[..., Force]
    table: Table
    function: Literal["of the shape", "by joint", "on the base"] | None = None


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
FORCES: dict[str, ForceKind] = {
    "spring": ForceKind(
        acting.Spring,
        Table(
            {
                "joint": _JOINT,
                "stiffness": Key(NUMBER, "[N·m/rad | N/m]", required=True),
                "rest": Key(NUMBER, "where it is relaxed [rad | m]", default="0"),
                "to": _TO,
                "polynomial": Key(
                    NUMBERS, "k₂, k₃, … of −τ = k y + k₂ y² + k₃ y³ + …", default="none"
                ),
            },
            "a spring at a joint, or between two",
        ),
    ),
    "damper": ForceKind(
        acting.Damper,
        Table(
            {
                "joint": _JOINT,
                "coefficient": Key(NUMBER, "[N·m·s/rad | N·s/m]", required=True),
                "to": _TO,
                "polynomial": Key(
                    NUMBERS, "c₂, c₃, … of −τ = v (c + c₂ |v| + c₃ |v|² + …)", default="none"
                ),
            },
            "a damper at a joint, or between two",
        ),
    ),
    "friction": ForceKind(
        acting.Friction,
        Table(
            {
                "joint": _JOINT,
                "most": Key(NUMBER, "the torque of dry friction [N·m | N]", required=True),
                "width": Key(
                    POSITIVE, "the rate within which it turns round [rad/s | m/s]", required=True
                ),
            },
            "dry friction at a joint, smooth: −most·tanh(v/width)",
        ),
    ),
    "potential": ForceKind(
        acting.PotentialEnergy,
        Table(
            {"function": Key(Text((), "a formula in x"), "V(x) [J], a formula in x", required=True)}
            | _NAME,
            "a potential energy of the shape",
        ),
        function="of the shape",
    ),
    "torque": ForceKind(
        acting.Torque,
        Table(
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
        function="by joint",
    ),
    "pd": ForceKind(
        acting.PD,
        Table(
            {"reference": _REFERENCE} | _FOLLOWING | _LIMITED | _NAME,
            "a PD controller of the joints",
            needs=_SMOOTH,
        ),
    ),
    "computed_torque": ForceKind(
        acting.ComputedTorque,
        Table(
            {"reference": _REFERENCE} | _FOLLOWING | _LIMITED | _NAME,
            "torques that make every joint follow its reference exactly",
            needs=_SMOOTH,
        ),
    ),
    "wrench": ForceKind(
        acting.Wrench,
        Table(
            {
                "function": Key(
                    ListOf(ACTION),
                    "wrench [linear; angular]: on the base as many entries as the group has "
                    "dimensions, on a link a force of 3, or force and moment; each a number, "
                    "formula or signal table",
                    required=True,
                ),
                "link": Key(Text((), "the name of a link"), "where it acts", default="the base"),
                "at": Key(
                    ListOf(NUMBER, 3), "the point, in the link's frame [m]", default="its origin"
                ),
                "frame": Key(
                    Text(AXES),
                    "whose axes its entries are along: the base's or link's own, or those in which "
                    "the pose of the base is",
                    default=AXES[0],
                ),
            }
            | _NAME,
            "a wrench on the base, such as thrusters, or on a link",
            needs={"at": "link"},
        ),
        function="on the base",
    ),
}
_NO_FUNCTIONS = (
    "a Controller is a Python function, and what stands in a file is never executed; "
    "write it in Python, or use pd, computed_torque or torque"
)
FORCE = Tagged(
    "kind",
    {name: kind.table for name, kind in FORCES.items()},
    "a force {kind = …}",
    {"controller": _NO_FUNCTIONS},
)
