"""Base classes and helpers for forces as expressions in t, x, ẋ and μ."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from ..common.arrays import positive
from ..common.errors import InputError
from ..common.parameter import Parameter, checked_number
from ..system.force_interface import Force as Force
from ..system.force_interface import Symbols as Symbols
from ..system.force_interface import Terms as Terms
from ..system.force_interface import entries as entries
from ..system.force_interface import finite as finite
from .signals import Signal

PerJoint: TypeAlias = float | Parameter | Mapping[str, float | Parameter]
Reference: TypeAlias = Mapping[str, Signal | float | Parameter]


class Named(Force):
    """A force with a name."""

    name: str

    @property
    def label(self) -> str:
        """Name of the force."""
        return self.name


@dataclass(frozen=True)
class Limit:
    """Bounds on torques.

    Attributes:
        most: Largest absolute torque [N·m | N], one for all joints or by name.
        smooth: Whether the bound is a tanh instead of a kink.
    """

    most: PerJoint
    smooth: bool = False

    def apply(
        self, s: Symbols, torque: dict[int, Any], number: Callable[[Any], Any], what: str
    ) -> dict[int, Any]:
        """Return the bounded torques.

        Args:
            s: Variables of the forces.
            torque: Torques by joint index.
            number: Converts a number to a symbol.
            what: Name of the force in messages.
        Returns:
            Torques by joint index.
        """
        import casadi as ca

        bounded = dict(torque)
        for k, bound in per_joint(self.most, torque, s, f"the limit of {what}").items():
            description = f"the limit of {what} at '{s.every_name[k]}'"
            most = number(checked_number(bound, partial(positive, what=description)))
            if self.smooth:
                bounded[k] = most * ca.tanh(torque[k] / most)
            else:
                bounded[k] = ca.fmin(ca.fmax(torque[k], -most), most)
        return bounded


def motions(
    reference: Reference, s: Symbols, number: Callable[[Any], Any], what: str
) -> dict[int, tuple[Any, Any, Any]]:
    """Return the reference motion of each joint.

    Args:
        reference: Signal or number by joint name.
        s: Variables of the forces.
        number: Converts a number to a symbol.
        what: Name of the force in messages.
    Returns:
        Position, rate and acceleration, (x_d, ẋ_d, ẍ_d), by joint index.
    """
    import casadi as ca

    by_joint = {}
    for name, value in reference.items():
        x = of_time(value, s, number, f"{what}['{name}']")
        xdot = ca.jacobian(x, s.t)
        by_joint[s.joint(name, what)] = (x, xdot, ca.jacobian(xdot, s.t))
    return by_joint


def of_time(value: Any, s: Symbols, number: Callable[[Any], Any], what: str) -> Any:
    """Return a Signal or a number as an expression.

    Args:
        value: The value.
        s: Variables of the forces.
        number: Converts a number to a symbol.
        what: Name of the value in messages.
    Returns:
        The expression.
    """
    if isinstance(value, Signal):
        return value.written(s.t, s.within, number)
    return number(finite(value, what, "a Signal or a number"))


def signals_in(values: Iterable[Any]) -> list[Signal]:
    """Return the Signals among values."""
    return [value for value in values if isinstance(value, Signal)]


def checked(what: str, wanted: str, value: Any, *kinds: type) -> None:
    """Raise InputError if a value is neither callable nor of one of the types.

    Args:
        what: Name of the value in messages.
        wanted: Description of valid values.
        value: The value.
        *kinds: Valid types.
    Raises:
        InputError: The value is invalid.
    """
    if not (callable(value) or isinstance(value, kinds)):
        raise InputError(f"{what} must be {wanted}, got {value!r}")


def checked_reference(reference: Any, what: str) -> None:
    """Raise InputError if a value is not a mapping from joints to signals."""
    if not isinstance(reference, Mapping):
        raise InputError(f"{what} must have {{joint: Signal or number}}, got {reference!r}")


def limited(
    limit: Limit | None,
    s: Symbols,
    torque: dict[int, Any],
    number: Callable[[Any], Any],
    what: str,
) -> dict[int, Any]:
    """Apply a limit to torques, if there is one.

    Args:
        limit: The limit, or None.
        s: Variables of the forces.
        torque: Torques by joint index.
        number: Converts a number to a symbol.
        what: Name of the force in messages.
    Returns:
        Torques by joint index.
    Raises:
        InputError: The limit is not a Limit.
    """
    if limit is None:
        return torque
    if not isinstance(limit, Limit):
        raise InputError(f"limit of {what} must be a Limit, got {limit!r}")
    return limit.apply(s, torque, number, what)


def per_joint(
    values: PerJoint, joints: Iterable[int], s: Symbols, what: str
) -> dict[int, float | Parameter]:
    """Return the value for each joint, from one value for all or values by name.

    Args:
        values: One value, or values by joint name.
        joints: Indices of the joints.
        s: Variables of the forces.
        what: Name of the values in messages.
    Returns:
        Values by joint index.
    Raises:
        InputError: A value is missing or not finite.
    """
    joints = list(joints)
    if not isinstance(values, Mapping):
        return dict.fromkeys(joints, finite(values, what))
    by_joint = {s.joint(name, what): finite(v, f"{what} at '{name}'") for name, v in values.items()}
    missing = [s.every_name[k] for k in joints if k not in by_joint]
    if missing:
        raise InputError(f"{what} has no value for '{missing[0]}'")
    return {k: by_joint[k] for k in joints}


def scalar(value: Any, what: str) -> Any:
    """Return one value as an SX expression.

    Args:
        value: The value.
        what: Its name in messages.
    Returns:
        The expression.
    Raises:
        InputError: It is not one finite number or SX expression.
    """
    import casadi as ca

    try:
        expression = ca.SX(value)
    except NotImplementedError:
        raise InputError(
            f"{what} must be a number or a CasADi SX expression, got {type(value).__name__}; "
            "use CasADi's functions (casadi.sin, …) on the arguments"
        ) from None
    if expression.numel() != 1:
        raise InputError(f"{what} must be one value, got shape {expression.shape}")
    if expression.is_constant() and not np.isfinite(float(expression)):
        raise InputError(f"{what} must be finite, got {float(expression)}")
    return ca.densify(expression)
