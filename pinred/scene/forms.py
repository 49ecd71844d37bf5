"""The forms in which options of a Scene may be given, and the one in which it keeps each.

Python, the command line and scene files take the same: joints by name or in their order, an
integrator as a value or as text, a plan as a Signal, a number or a formula, and Pinocchio's
(q, v) in the place of pose, shape and velocities.
"""

from __future__ import annotations

import ast
import warnings
from collections.abc import Mapping
from dataclasses import MISSING, fields
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..common.arrays import Array, as_floats, read_only, vector
from ..common.errors import InputError, PinredError, ShapeError
from ..common.names import joint_index, nearest
from ..common.parameter import Parameter
from ..common.plain_names import brief, quoted
from ..forces.signals import Constant, Expression, Signal
from ..integrators.methods import METHODS, Method
from ..system.coordinates import Configuration, Velocity
from ..system.coupling import following
from ..system.system import System

_UNIT = 1e-3  # by how much a cosine and sine may miss norm 1, as those of few decimals do


def in_order(value: Any, system: System, what: str) -> Any:
    """Return values by joint as one array, (m,) or (N, m), with zeros where none is given.

    value: {joint: number, or (N,) numbers of as many members}; what is no mapping is returned
    as it is.  Raises InputError for joints that are not there, ShapeError for lengths that
    differ.
    """
    if not isinstance(value, Mapping):
        return value
    for name in value:
        system.refuse_follower(name, what)
    columns = {
        joint_index(name, system.shape_names, what): as_floats(entry, f"{what}['{name}']")
        for name, entry in value.items()
    }
    shapes = {column.shape for column in columns.values()} - {()}
    if len(shapes) > 1 or any(len(shape) > 1 for shape in shapes):
        raise ShapeError(
            f"{what} must have a number for each joint, or as many for each as there are "
            f"members, got shapes {', '.join(map(str, sorted(shapes)))}"
        )
    array = np.zeros((*(shapes.pop() if shapes else ()), system.m))
    for k, column in columns.items():
        array[..., k] = column
    return read_only(array)


def signal(value: Any, what: str) -> Signal:
    """Return the motion of a prescribed joint as a Signal.

    value: a Signal, a number, a Parameter or a formula in t.  Raises InputError naming `what`.
    """
    if isinstance(value, Signal):
        return value
    try:
        if isinstance(value, str):
            return Expression(value)
        if isinstance(value, Parameter):
            return Constant(value)
        if isinstance(value, Real) and not isinstance(value, bool):
            return Constant(float(value))
    except OverflowError:
        raise InputError(f"{what} is larger than any number of 64 bits") from None
    except PinredError as error:
        raise type(error)(f"{what}: {error}") from None
    raise InputError(f"{what} must be a Signal, a number or a formula in t, got {brief(value)}")


def configuration(q: ArrayLike, system: System) -> Configuration:
    """Return pose (size,) and shape (m,) of Pinocchio's q (nq,), angles in (−π, π].

    Raises ShapeError for another length or what is not finite, InputError for quaternions, or
    cosines and sines, that are not of norm 1.
    """
    q = vector(q, system.model.nq, "q0")
    root, *joints = list(system.model.joints)[1:]
    names = list(system.model.names)[2:]
    try:
        system.group.pose(q[: root.nq])
    except PinredError as error:
        raise type(error)(f"q0: {error}") from None
    for name, joint in zip(names, joints, strict=True):
        norm = float(np.linalg.norm(q[joint.idx_q : joint.idx_q + joint.nq]))
        if joint.nq == 2 and abs(norm - 1.0) > _UNIT:
            raise InputError(
                f"q0: cosine and sine of joint '{name}' must have norm 1, got {norm:g}"
            )
    found = system.configuration(q)
    if system.coupled is not None:
        _refuse_apart(system, system.sorted_q(q), system.model_q(found.pose, found.x), "q0")
    return Configuration(pose=system.group.normalize(found.pose), x=found.x)


def velocity(v: ArrayLike, system: System) -> Velocity:
    """Return body twist (r,) and shape rate (m,) of Pinocchio's v (nv,).

    Raises ShapeError for another length or what is not finite, InputError for joints that do not
    follow as they are coupled.
    """
    v = vector(v, system.model.nv, "v0")
    found = system.velocity(v)
    if system.coupled is not None:
        _refuse_apart(system, system.sorted_v(v), system.model_v(found.xi, found.xdot), "v0")
    return found


def _refuse_apart(system: System, given: Array, coupled: Array, what: str) -> None:
    """Refuse a configuration or velocity of the model in which a follower does not follow."""
    for name in system.followers:
        joint = system.model.joints[2 + system.joint_number(name)]
        at = slice(joint.idx_q, joint.idx_q + joint.nq)
        if what == "v0":
            at = slice(joint.idx_v, joint.idx_v + 1)
        # Against its own size, for a rate of any size is one.
        most = _UNIT * max(1.0, float(np.abs(coupled[at]).max()))
        if np.abs(given[at] - coupled[at]).max() > most:
            shown = ", ".join(f"{value:g}" for value in coupled[at])
            words = following(name, system.couplings)
            raise InputError(f"{what}: {words} and must be at {shown} there, got {given[at]}")


def method(value: Any) -> Method | Literal["auto"]:
    """Return an integrator, or "auto".

    value: either of them, or text: a name, or a name with options as Python writes them, such
    as "RKMK4(0.01)" or "DOP853(max_step=0.1)".  Raises InputError.
    """
    if isinstance(value, str):
        return _method_of_text(value)
    if isinstance(value, Method):
        return value
    names = " or ".join(f"{name}(…)" for name in METHODS)
    raise InputError(
        f"method must be 'auto' or {names}, or one of these as text, got {brief(value)}"
    )


def _method_of_text(text: str) -> Method | Literal["auto"]:
    """Return the integrator that a text stands for; nothing in it is executed."""
    if text == "auto":  # nearly always
        return "auto"
    name, given, named = _call(text)
    if name == "auto":
        if given or named:
            raise InputError(f"method auto has no options, got {quoted(text)}")
        return "auto"
    if name not in METHODS:
        raise InputError(
            f"unknown method {quoted(name)}; {nearest(name, list(METHODS))}"
            f"the methods are {', '.join(METHODS)} and auto"
        )
    kind = METHODS[name]
    options = {entry.name: entry.default for entry in fields(kind)}
    unknown = [key for key in named if key not in options]
    if unknown or len(given) > len(options):
        told = f"option {quoted(unknown[0])}" if unknown else f"{len(given)} options"
        raise InputError(f"method {name} has no {told}; its options are {', '.join(options)}")
    twice = [key for key in list(options)[: len(given)] if key in named]
    if twice:
        raise InputError(f"method {quoted(text)} gives {twice[0]} twice")
    named |= dict(zip(options, given, strict=False))
    missing = [key for key, default in options.items() if default is MISSING and key not in named]
    if missing:
        raise InputError(f"method {quoted(text)} needs a {missing[0]}, as in {name}(0.01)")
    return kind(**named)


def _call(text: str) -> tuple[str, list[Any], dict[str, Any]]:
    """Return name and options of NAME or NAME(1, key=2), as Python writes them."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # what Python doubts is an error here
            node = ast.parse(text.strip(), mode="eval").body
        if isinstance(node, ast.Name):
            return node.id, [], {}
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            return (
                node.func.id,
                [_value(argument) for argument in node.args],
                {str(word.arg): _value(word.value) for word in node.keywords},
            )
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        pass
    raise InputError(
        f"method {quoted(text)} must be a name, or a name with options such as RKMK4(0.01); "
        f"the methods are {', '.join(METHODS)} and auto"
    )


def _value(node: ast.expr) -> Any:
    """Return a number or text; inf and nan are numbers, as in what Python shows of a method."""
    if isinstance(node, ast.Name) and node.id in ("inf", "nan"):
        return float(node.id)
    return ast.literal_eval(node)
