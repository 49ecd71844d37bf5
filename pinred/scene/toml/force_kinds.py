"""The kinds of forces in scene files: their keys, and the classes that they build.

Required keys and defaults follow from the fields of the classes in pinred.forces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Any, Literal, TypeAlias

from ...forces import kinds
from ...forces.force import Force
from ...forces.kinds import AXES
from .schema import ByName, Either, Flag, Key, ListOf, Node, Table, Tagged, Text
from .signal_tables import ACTION, ATTITUDE, NUMBER, NUMBERS, PER_JOINT, PLAN, POSITIVE

FunctionFormat: TypeAlias = Literal["of the shape", "by joint", "on the base"]
KeyTexts: TypeAlias = Mapping[str, tuple[Node, str]]  # {key: (type of the value, meaning)}


@dataclass(frozen=True)
class ForceKind:
    """A kind of force in scene files.

    Attributes:
        make: Builds the force from the entries of its table.
        table: The keys of the table.
        function: Format of the key `function`: a formula "of the shape", actions "by joint", or
            a list of actions "on the base".  None for a kind without this key.
    """

    make: Callable[..., Force]
    table: Table
    function: FunctionFormat | None = None


def _force_kind(
    force: type[Force],
    words: str,
    texts: KeyTexts,
    *,
    function: FunctionFormat | None = None,
    defaults: Mapping[str, str] | None = None,
) -> ForceKind:
    """Return a kind of force with a key for each field of its class.

    Args:
        force: Class of the force.
        words: Description of the force.
        texts: {field: (type, meaning)}; the fields `limit` and `name` need no entry.
        function: See ForceKind.
        defaults: {field: default in words} for fields whose default value needs an explanation;
            "" makes the key required.
    Returns:
        The kind of force.
    """
    keys: dict[str, Key] = {}
    for field in fields(force):  # type: ignore[arg-type]
        node, text = {**_COMMON, **texts}[field.name]
        default = "" if field.default is MISSING else _in_words(field.default)
        if field.name == "name":
            default = "its kind"
        default = (defaults or {}).get(field.name, default)
        keys[field.name] = Key(node, text, required=not default, default=default)
        if field.name == "limit":
            keys["smooth"] = Key(Flag(), "limit by a tanh, without a kink", default="false")
    needs = {"smooth": "limit"} if "limit" in keys else {"at": "link"} if "at" in keys else {}
    return ForceKind(force, Table(keys, words, needs=needs), function)


def _in_words(default: Any) -> str:
    if isinstance(default, float):
        return f"{default:g}"
    return str(default) if default else "none"


_COMMON: KeyTexts = {
    "name": (Text(), "name in tables and messages"),
    "limit": (PER_JOINT, "largest torque [N·m | N]"),
}
_JOINT = (Text((), "the name of a joint"), "name of the joint")
_TO = (Text((), "the name of a joint"), "name of a second joint, at the other end")
_BALL = (Text((), "the name of a ball joint"), "name of the ball joint")
_ATTITUDE = "rotation vector [rad] or quaternion (x, y, z, w)"
_STIFFNESS = Either((NUMBER, ListOf(ListOf(NUMBER, 3), 3)))
_CONTROL: KeyTexts = {
    "reference": (
        ByName(PLAN),
        "desired motion of each joint [rad | m]; of a ball an attitude over time",
    ),
    "kp": (PER_JOINT, "gain of the position error"),
    "kd": (PER_JOINT, "gain of the rate error"),
}
FORCES: dict[str, ForceKind] = {
    "spring": _force_kind(
        kinds.Spring,
        "a spring at a joint, or between two",
        {
            "joint": _JOINT,
            "stiffness": (NUMBER, "stiffness k [N·m/rad | N/m]"),
            "rest": (NUMBER, "joint position without torque [rad | m]"),
            "to": _TO,
            "polynomial": (NUMBERS, "k₂, k₃, … of −τ = k y + k₂ y² + k₃ y³ + …"),
        },
    ),
    "damper": _force_kind(
        kinds.Damper,
        "a damper at a joint, or between two",
        {
            "joint": _JOINT,
            "coefficient": (NUMBER, "damping coefficient c [N·m·s/rad | N·s/m]"),
            "to": _TO,
            "polynomial": (NUMBERS, "c₂, c₃, … of −τ = v (c + c₂ |v| + c₃ |v|² + …)"),
        },
    ),
    "friction": _force_kind(
        kinds.Friction,
        "dry friction at a joint, smooth: −most·tanh(v/width)",
        {
            "joint": _JOINT,
            "most": (NUMBER, "torque of dry friction [N·m | N]"),
            "width": (POSITIVE, "joint rate over which the torque changes sign [rad/s | m/s]"),
        },
        defaults={"width": ""},
    ),
    "ball_spring": _force_kind(
        kinds.BallSpring,
        "a spring at a ball joint, with the angle θ and the rotation vector r from rest",
        {
            "joint": _BALL,
            "stiffness": (
                _STIFFNESS,
                "stiffness k [N·m/rad]; for the laws vector and trace also a symmetric matrix, "
                "in the axes of the child",
            ),
            "rest": (NUMBERS, f"attitude without torque: {_ATTITUDE}"),
            "law": (
                Text(kinds.BallSpring.LAWS),
                "potential: angle ½ k θ², cosine k (1 − cos θ), vector ½ rᵀ K r, or trace "
                "tr (G (1 − R))",
            ),
            "polynomial": (NUMBERS, "k₂, k₃, … of the law angle: torque −(k + k₂ θ + k₃ θ² + …) r"),
        },
        defaults={"rest": "no rotation"},
    ),
    "ball_pd": _force_kind(
        kinds.BallPD,
        "a PD controller of the attitude of a ball joint: torque −kp log(E) − kd (σ − Eᵀ σ_d), "
        "E = R_dᵀ R",
        {
            "joint": _BALL,
            "attitude": (
                ATTITUDE,
                f"desired attitude: {_ATTITUDE}, or an attitude over time",
            ),
            "kp": (NUMBER, "gain of the attitude error [N·m/rad]"),
            "kd": (NUMBER, "gain of the rate [N·m·s/rad]"),
            "limit": (PER_JOINT, "largest torque about each axis [N·m], such as neck.x"),
        },
    ),
    "ball_limit": _force_kind(
        kinds.BallLimit,
        "a smooth potential that limits the swing and the twist of a ball joint",
        {
            "joint": _BALL,
            "swing": (POSITIVE, "largest swing angle, less than π [rad]"),
            "twist": (POSITIVE, "largest twist angle, less than π [rad]"),
            "axis": (Text(("x", "y", "z")), "axis of the child about which it twists"),
            "stiffness": (NUMBER, "stiffness k [N·m]"),
            "width": (POSITIVE, "width of the transition, in cosines"),
        },
    ),
    "potential": _force_kind(
        kinds.PotentialEnergy,
        "a potential energy of the shape",
        {"function": (Text((), "a formula in x"), "potential V(x) [J], a formula in x")},
        function="of the shape",
    ),
    "torque": _force_kind(
        kinds.Torque,
        "torques at the joints",
        {
            "function": (
                ByName(ACTION),
                "torque at each joint [N·m | N], as a number, formula or signal table",
            )
        },
        function="by joint",
    ),
    "pd": _force_kind(
        kinds.PD, "a PD controller of the joints: torque kp (x_d − x) + kd (ẋ_d − ẋ)", _CONTROL
    ),
    "computed_torque": _force_kind(
        kinds.ComputedTorque,
        "torques that make every joint follow its reference exactly",
        _CONTROL,
    ),
    "wrench": _force_kind(
        kinds.Wrench,
        "a wrench on the base, such as thrusters, or on a link",
        {
            "function": (
                ListOf(ACTION),
                "wrench [linear; angular]: on the base one entry for each dimension of the group, "
                "on a link a force (3 entries) or a force and a moment (6); each entry is a "
                "number, formula or signal table",
            ),
            "link": (Text((), "the name of a link"), "link on which the wrench acts"),
            "at": (ListOf(NUMBER, 3), "point of application in the frame of the link [m]"),
            "frame": (
                Text(AXES),
                "axes of the entries: body for the axes of the base or link, world for the axes "
                "in which the pose of the base is stated",
            ),
        },
        function="on the base",
        defaults={"link": "the base", "at": "origin of the link"},
    ),
}
_NO_FUNCTIONS = (
    "a Controller is a Python function, and scene files are never executed; "
    "write it in Python, or use pd, computed_torque or torque"
)
FORCE = Tagged(
    "kind",
    {name: kind.table for name, kind in FORCES.items()},
    "a force {kind = …}",
    {"controller": _NO_FUNCTIONS},
)
