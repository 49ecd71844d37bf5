"""The integrators: dataclasses that select a method and hold its options. METHODS lists them."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from importlib import import_module
from inspect import isabstract
from pkgutil import iter_modules
from typing import Any

from .method import DOP853 as DOP853
from .method import DOP853_LEAST as DOP853_LEAST
from .method import RKMK4 as RKMK4
from .method import AdaptiveGauss as AdaptiveGauss
from .method import EqualSteps as EqualSteps
from .method import ErrorControl as ErrorControl
from .method import Explicit as Explicit
from .method import Gauss as Gauss
from .method import Method as Method
from .method import Radau as Radau
from .method import Tsit5 as Tsit5
from .method import Variational as Variational


def _methods() -> dict[str, type[Method]]:
    """Return the method classes that the modules of this folder define, by class name."""
    methods: dict[str, type[Method]] = {}
    for module in iter_modules(__path__):
        definitions = import_module(f"{__name__}.{module.name}")
        for value in vars(definitions).values():
            is_defined_here = isinstance(value, type) and value.__module__ == definitions.__name__
            if is_defined_here and issubclass(value, Method) and not isabstract(value):
                methods[value.__name__] = value
    return dict(sorted(methods.items()))


METHODS = _methods()


@dataclass(frozen=True)
class Option:
    """Description of a method's option, used to list options and to read them from files.

    Attributes:
        name: Name of the field.
        kind: "float", "int" or "str".
        about: Description.
        required: Whether the option has no default value.
        default: Default value, None if the option is required.
        among: Allowed words of a "str" option.
        least: Smallest allowed integer.
        most: Largest allowed integer.
    """

    name: str
    kind: str
    about: str
    required: bool
    default: Any
    among: tuple[str, ...] = ()
    least: int = 0
    most: int = 2**63 - 1


def options_of(kind: type[Method]) -> list[Option]:
    """Return the options of a method; fields inherit their descriptions from base classes."""
    metadata: dict[str, dict[str, Any]] = {}
    for base in reversed(kind.__mro__):
        for option_field in getattr(base, "__dataclass_fields__", {}).values():
            metadata.setdefault(option_field.name, {}).update(option_field.metadata)
    return [
        Option(
            option_field.name,
            option_field.type if isinstance(option_field.type, str) else option_field.type.__name__,
            required=option_field.default is MISSING,
            default=None if option_field.default is MISSING else option_field.default,
            **{"about": option_field.name, **metadata[option_field.name]},
        )
        for option_field in fields(kind)
    ]
