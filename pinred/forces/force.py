"""Forces as functions or formulas of the state: base class, accepted arguments, and formulas."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import pinocchio as pin

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, positive
from ..common.errors import InputError
from ..common.names import brief
from ..common.parameter import Parameter, checked_number, parameter_of, value_in
from ..reduction.tree.all_joints import height
from ..system.force_interface import Force as Force
from ..system.force_interface import Symbols as Symbols
from ..system.force_interface import Terms as Terms
from ..system.force_interface import entries as entries
from ..system.force_interface import finite as finite
from ..system.system import System
from .columns import seen_of_base, symbols_of, terms_of
from .signals import Signal
from .signals.expressions import parse
from .switch_times import SignChanges

PerJoint: TypeAlias = float | Parameter | Mapping[str, float | Parameter]


class Named(Force):
    """A force with a name."""

    name: str

    @property
    def label(self) -> str:
        """Name of the force."""
        return self.name


@checks_arguments
@dataclass(frozen=True)
class Limit:
    """Bounds on torques.

    Attributes:
        most: Largest absolute torque [N·m | N]: one value for all joints, or values by joint name.
        smooth: Whether the torque saturates smoothly (tanh) instead of being clipped with a kink.
    """

    most: PerJoint
    smooth: bool = False

    def apply(
        self, s: Symbols, torque: dict[int, Any], number: Callable[[Any], Any], what: str
    ) -> dict[int, Any]:
        """Return the torques with the bounds applied.

        Args:
            s: Variables of the forces.
            torque: Torques by joint index.
            number: Function that replaces a number by a symbol.
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


def of_time(value: Any, s: Symbols, number: Callable[[Any], Any], what: str) -> Any:
    """Return a Signal or a number as a CasADi expression of time.

    Args:
        value: The value to convert or check.
        s: Variables of the forces.
        number: Function that replaces a number by a symbol.
        what: Name of the value in messages.
    Returns:
        The expression.
    """
    if isinstance(value, Signal):
        return value.written(s.t, s.within, number)
    return number(finite(value, what, "a Signal or a number"))


def signals_in(values: Iterable[Any]) -> list[Signal]:
    """Return the Signals that a collection of values contains."""
    return [value for value in values if isinstance(value, Signal)]


def checked(what: str, wanted: str, value: Any, *kinds: type) -> None:
    """Raise InputError if a value is neither callable nor of one of the types.

    Args:
        what: Name of the value in messages.
        wanted: Description of valid values, for the message.
        value: The value to convert or check.
        *kinds: Valid types.
    Raises:
        InputError: The value is invalid.
    """
    if not (callable(value) or isinstance(value, kinds)):
        raise InputError(f"{what} must be {wanted}, got {value!r}")


def limited(
    limit: Limit | None,
    s: Symbols,
    torque: dict[int, Any],
    number: Callable[[Any], Any],
    what: str,
) -> dict[int, Any]:
    """Apply a limit to torques, or return them unchanged if the limit is None.

    Args:
        limit: The limit, or None.
        s: Variables of the forces.
        torque: Torques by joint index.
        number: Function that replaces a number by a symbol.
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
    """Return the value for each joint, given one value for all joints or values by joint name.

    Args:
        values: One value, or values by name of a joint or of an axis of a ball.
        joints: Indices of the joints that need a value.
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
    by_joint = {
        k: finite(v, f"{what} at '{name}'")
        for name, v in values.items()
        for k in s.rates(name, what)
    }
    missing = [s.every_name[k] for k in joints if k not in by_joint]
    if missing:
        raise InputError(f"{what} has no value for '{missing[0]}'")
    return {k: by_joint[k] for k in joints}


def scalar(value: Any, what: str) -> Any:
    """Return a scalar value as an SX expression.

    Args:
        value: The value to convert or check.
        what: Name of the function or value in messages.
    Returns:
        The expression.
    Raises:
        InputError: The value is neither a finite number nor a scalar SX expression.
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


Action: TypeAlias = Callable[..., Any]

_MANY = 1_000_000  # number of arguments assumed for a function with *args
_POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
FORMS = "(t, x, xdot, mu), or one state s with s.t, s.x, s.xdot, s.pose, s.xi, s.mu and s.J"


def takes_state(function: Callable[..., Any], what: str) -> bool:
    """Return whether a function takes one SeenState instead of (t, x, xdot, mu).

    Args:
        function: The function.
        what: Name of the function or value in messages.
    Returns:
        True for one argument, False for four.
    Raises:
        InputError: The function accepts neither one nor four arguments, or accepts both.
    """
    least, most = _counts(function, what)
    if least > 4 or most < 1 or (least > 1 and most < 4):
        takes = f"{least}" if least == most else f"{least} to {most}"
        raise InputError(f"{what} must be a function of {FORMS}, but it takes {takes} arguments")
    if most < 4:
        return True
    if least <= 1 and most < _MANY:
        raise InputError(
            f"{what} accepts one argument and also four, because of defaults, so its form is "
            f"ambiguous: {FORMS}; write 'lambda s: f(s)', or make arguments with defaults "
            "keyword-only"
        )
    return False


def _counts(function: Callable[..., Any], what: str) -> tuple[int, int]:
    """Return the smallest and the largest number of positional arguments of a function."""
    if hasattr(function, "n_in"):  # a CasADi Function
        return function.n_in(), function.n_in()
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        raise InputError(
            f"{what}: {brief(function)} has no signature that Python can read; "
            f"write a lambda of {FORMS}"
        ) from None
    plain = [p for p in parameters if p.kind in _POSITIONAL]
    starred = any(p.kind is inspect.Parameter.VAR_POSITIONAL for p in parameters)
    needed = sum(p.default is inspect.Parameter.empty for p in plain)
    if any(
        p.kind is inspect.Parameter.KEYWORD_ONLY and p.default is inspect.Parameter.empty
        for p in parameters
    ):
        raise InputError(f"{what} has a keyword-only argument without a default")
    return needed, _MANY if starred else len(plain)


class SymbolFunction:
    """A function that is called with the whole `Symbols`, unlike user functions."""

    def __call__(self, s: Symbols) -> Any:
        """Return the expression."""
        raise NotImplementedError


def called(function: Callable[..., Any], s: Symbols, what: str) -> Any:
    """Call a function of the state with symbols, and return its result.

    Args:
        function: The function, or a Formula.
        s: Variables of the forces.
        what: Name of the function in messages.
    Returns:
        The return value of the function.
    """
    if isinstance(function, SymbolFunction):
        return function(s)
    if takes_state(function, what):
        return function(s.seen)
    return function(s.t, s.x, s.xdot, s.mu)


def acting_value(value: Any, s: Symbols, number: Callable[[Any], Any], what: str) -> Any:
    """Return a Signal, a number or a function of the state as an expression.

    Args:
        value: The value to convert or check.
        s: Variables of the forces.
        number: Function that replaces a number by a symbol.
        what: Name of the value in messages.
    Returns:
        A scalar expression.
    """
    if callable(value):
        return scalar(called(value, s, what), what)
    return of_time(value, s, number, what)


NAMES = ("t", "x", "xdot", "mu", "pose", "xi", "J", "height")


@dataclass(frozen=True)
class Formula(SymbolFunction):
    """An expression in t, x, xdot, mu, pose, xi and J.

    mu is the momentum about the centre of mass. pose, xi and J describe the base in space, as in a
    SeenState.

    Attributes:
        text: The formula, see signals/expressions.py.
        others: Further names that the formula may use, {name: SX}.
        system: Robot of whose links the formula may use the height; None for no heights.
    """

    text: str
    others: Mapping[str, Any] = field(default_factory=dict)
    system: System | None = None

    def __call__(self, s: Symbols) -> ca.SX:
        """Return the CasADi expression of the formula in the variables of forces.

        Args:
            s: Variables of the forces.
        Returns:
            The expression.
        """
        heights = {} if self.system is None else {"height": _Heights(self.system, s)}
        return parse(self.text, formula_names(s) | dict(self.others) | heights)


def formula_names(s: Symbols) -> dict[str, Any]:
    """Return the variables of the state that formulas may use, {name: symbols}."""
    observed = s.seen
    columns = {"mu": s.mu, "pose": observed.pose, "xi": observed.xi, "J": observed.J}
    return {
        "t": s.t,
        "x": {name: s.x[k] for k, name in enumerate((*s.x_names, *s.followers))},
        "xdot": {name: s.xdot[k] for k, name in enumerate(s.every_name)},
        **{name: _Components(column) for name, column in columns.items()},
    }


class _Components(dict[str, ca.SX]):
    """The entries of a pose, twist or momentum by their first names; others are accepted, too."""

    def __init__(self, column: Any) -> None:
        self._index: Mapping[str, int] = column.names
        super().__init__(zip(column.names, map(ca.SX, ca.vertsplit(column)), strict=False))

    def __contains__(self, name: object) -> bool:
        return name in self._index

    def __missing__(self, name: str) -> ca.SX:
        entry: ca.SX = list(self.values())[self._index[name]]
        return entry


class _Heights(dict[str, ca.SX]):
    """Heights of links and frames by name, computed when a formula asks for them."""

    def __init__(self, system: System, s: Symbols) -> None:
        model = system.sorted_model
        self._system, self._seen = system, s.seen
        frames = [f for f in model.frames if f.parentJoint > 0 and f.type != pin.FrameType.JOINT]
        super().__init__((str(f.name), ca.SX(0.0)) for f in frames)

    def __getitem__(self, name: str) -> ca.SX:
        observed = self._seen
        return height(
            self._system, ca.SX(observed.pose), ca.SX(observed.x)[: self._system.nx], name
        )


class _Expression:
    """An expression wrapped as a force, so that `terms_of` reports its errors."""

    def __init__(self, system: System, expression: Callable[..., Any] | str, label: str) -> None:
        self._system, self._expression, self.label = system, expression, label

    def terms(self, s: Any, number: Any) -> Terms:  # noqa: ARG002
        function = self._expression
        if isinstance(function, str):
            function = Formula(function, system=self._system)
        return Terms(potential=scalar(called(function, s, self.label), self.label))


class Watched:
    """Compiled expressions of the state of one system, e.g. event functions.

    Attributes:
        parameters: Parameters in the expressions.
        of_time: The sign changes of each expression of time alone, {index: sign changes}.
        sees_base: Whether any expression depends on the base in space.
        sees_momentum: Whether any expression depends on ξ or μ relative to the centre of mass.
    """

    def __init__(
        self, system: System, expressions: Sequence[Callable[..., Any] | str], labels: Sequence[str]
    ) -> None:
        """Compile the expressions.

        Args:
            system: The robot.
            expressions: Functions of the state, or formulas as text.
            labels: Names of the expressions in messages.
        Raises:
            InputError: An expression is invalid.
        """
        s, base = symbols_of(system, None)
        values = []
        for expression, label in zip(expressions, labels, strict=True):
            terms = terms_of(_Expression(system, expression, label), s, float)  # type: ignore[arg-type]
            values.append(ca.SX(terms.potential))
        column = ca.vertcat(ca.SX(0, 1), *values)
        arguments = [s.t, s.x, s.xdot, s.xi, s.mu, *base]
        known_hashes = {symbol.element_hash() for symbol in ca.symvar(ca.vertcat(*arguments))}
        free = [symbol for symbol in ca.symvar(column) if symbol.element_hash() not in known_hashes]
        self.parameters: list[Parameter] = []
        for symbol in free:
            parameter = parameter_of(symbol)
            if parameter is None:
                raise InputError(
                    f"an event has a symbol '{symbol}' that is not one of its arguments. "
                    "Use those or a Parameter"
                )
            self.parameters.append(parameter)
        symbols: ca.SX = ca.vertcat(ca.SX(0, 1), *free)
        self.sees_base = any(seen_of_base(system, column, base))
        self.sees_momentum = ca.depends_on(column, ca.vertcat(s.xi, s.mu))
        states = ca.vertcat(*arguments[1:])
        self.of_time = {
            k: SignChanges(value, s.t, free)
            for k, value in enumerate(values)
            if ca.depends_on(value, s.t) and not ca.depends_on(value, states)
        }
        self._function = ca.Function("watched", [*arguments, symbols], [ca.densify(column)])

    @property
    def text(self) -> str:
        """The expressions as text, equal in all processes."""
        return str(self._function.serialize())

    def numbers(self, values: Mapping[str, Any]) -> Array:
        """Return the values (p,) of the parameters in the expressions.

        Args:
            values: Values of parameters by name.
        Returns:
            The values; parameters that are not named keep their own.
        """
        return np.array([value_in(values, p) for p in self.parameters], dtype=float)

    def __call__(self, columns: Sequence[Array], values: Mapping[str, Any]) -> Array:
        """Evaluate the expressions.

        Args:
            columns: t (1, T), then x, xdot, ξ and μ relative to the centre of mass, and pose,
                twist, μ and J of the base in space, (…, T) each; zeros for arguments that no
                expression depends on.
            values: Values of parameters by name.
        Returns:
            Values of the E expressions at the T times, (E, T).
        """
        numbers = self.numbers(values)
        repeated = np.repeat(numbers[:, None], columns[0].shape[1], axis=1)
        return np.asarray(self._function(*columns, repeated))
