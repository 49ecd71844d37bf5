"""Forces as expressions in t, x, ẋ and μ, and the helpers to write them."""

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
    """A force with a name of its own."""

    name: str

    @property
    def label(self) -> str:
        """The name it was given."""
        return self.name


@dataclass(frozen=True)
class Limit:
    """Bounds on torques.  most: [N·m | N], of all joints or by name.  smooth: tanh, not a kink."""

    most: PerJoint
    smooth: bool = False

    def apply(
        self, s: Symbols, torque: dict[int, Any], number: Callable[[Any], Any], what: str
    ) -> dict[int, Any]:
        """Return the bounded torques; number: as for Force.terms."""
        import casadi as ca

        out = dict(torque)
        for k, bound in per_joint(self.most, torque, s, f"the limit of {what}").items():
            told = f"the limit of {what} at '{s.every_name[k]}'"
            most = number(checked_number(bound, partial(positive, what=told)))
            if self.smooth:
                out[k] = most * ca.tanh(torque[k] / most)
            else:
                out[k] = ca.fmin(ca.fmax(torque[k], -most), most)
        return out


def motions(
    reference: Reference, s: Symbols, number: Callable[[Any], Any], what: str
) -> dict[int, tuple[Any, Any, Any]]:
    """Return (x_d, ẋ_d, ẍ_d) of each joint of a reference."""
    import casadi as ca

    out = {}
    for name, value in reference.items():
        x = of_time(value, s, number, f"{what}['{name}']")
        xdot = ca.jacobian(x, s.t)
        out[s.joint(name, what)] = (x, xdot, ca.jacobian(xdot, s.t))
    return out


def of_time(value: Any, s: Symbols, number: Callable[[Any], Any], what: str) -> Any:
    """Return a Signal or a number as an expression.  Raises InputError naming `what`."""
    if isinstance(value, Signal):
        return value.written(s.t, s.within, number)
    return number(finite(value, what, "a Signal or a number"))


def signals_in(values: Iterable[Any]) -> list[Signal]:
    """Return the Signals among values."""
    return [value for value in values if isinstance(value, Signal)]


def checked(what: str, wanted: str, value: Any, *kinds: type) -> None:
    """Refuse a value that is neither callable nor of one of the kinds.  Raises InputError."""
    if not (callable(value) or isinstance(value, kinds)):
        raise InputError(f"{what} must be {wanted}, got {value!r}")


def checked_reference(reference: Any, what: str) -> None:
    """Refuse what is not a mapping from joints to signals.  Raises InputError."""
    if not isinstance(reference, Mapping):
        raise InputError(f"{what} must have {{joint: Signal or number}}, got {reference!r}")


def limited(
    limit: Limit | None,
    s: Symbols,
    torque: dict[int, Any],
    number: Callable[[Any], Any],
    what: str,
) -> dict[int, Any]:
    """Return torques within a limit, if there is one.  Raises InputError."""
    if limit is None:
        return torque
    if not isinstance(limit, Limit):
        raise InputError(f"limit of {what} must be a Limit, got {limit!r}")
    return limit.apply(s, torque, number, what)


def per_joint(
    values: PerJoint, joints: Iterable[int], s: Symbols, what: str
) -> dict[int, float | Parameter]:
    """Return the value of each joint, from one for all or one by name.  Raises InputError."""
    joints = list(joints)
    if not isinstance(values, Mapping):
        return dict.fromkeys(joints, finite(values, what))
    given = {s.joint(name, what): finite(v, f"{what} at '{name}'") for name, v in values.items()}
    missing = [s.every_name[k] for k in joints if k not in given]
    if missing:
        raise InputError(f"{what} has no value for '{missing[0]}'")
    return {k: given[k] for k in joints}


def scalar(value: Any, what: str) -> Any:
    """Return one value as an expression.  Raises InputError naming `what`."""
    import casadi as ca

    try:
        out = ca.SX(value)
    except NotImplementedError:
        raise InputError(
            f"{what} must be a number or a CasADi SX expression, got {type(value).__name__}; "
            "use CasADi's functions (casadi.sin, …) on the symbols that are given"
        ) from None
    if out.numel() != 1:
        raise InputError(f"{what} must be one value, got shape {out.shape}")
    if out.is_constant() and not np.isfinite(float(out)):
        raise InputError(f"{what} must be finite, got {float(out)}")
    return ca.densify(out)
