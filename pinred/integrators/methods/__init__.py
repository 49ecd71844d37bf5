"""The integrators as values, a file each: METHODS has every one that a file here defines."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from importlib import import_module
from inspect import isabstract
from pkgutil import iter_modules
from typing import Any

from .adaptive_gauss import AdaptiveGauss as AdaptiveGauss
from .dop853 import DOP853 as DOP853
from .gauss import Gauss as Gauss
from .method import DOP853_LEAST as DOP853_LEAST
from .method import EqualSteps as EqualSteps
from .method import ErrorControl as ErrorControl
from .method import Explicit as Explicit
from .method import Method as Method
from .radau import Radau as Radau
from .rkmk4 import RKMK4 as RKMK4
from .tsit5 import Tsit5 as Tsit5
from .variational import Variational as Variational


def _methods() -> dict[str, type[Method]]:
    """Return the methods that the files beside this one define, by their names."""
    found: dict[str, type[Method]] = {}
    for module in iter_modules(__path__):
        home = import_module(f"{__name__}.{module.name}")
        for value in vars(home).values():
            own = isinstance(value, type) and value.__module__ == home.__name__
            if own and issubclass(value, Method) and not isabstract(value):
                found[value.__name__] = value
    return dict(sorted(found.items()))


METHODS = _methods()


@dataclass(frozen=True)
class Option:
    """An option of a method, as lists and files tell it.

    kind: "float", "int" or "str".  required: whether there is no default.  among: the words it
    may be.  least, most: of whole numbers.
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
    """Return the options of a method; what a field is about may be said by a base class."""
    told: dict[str, dict[str, Any]] = {}
    for base in reversed(kind.__mro__):
        for entry in getattr(base, "__dataclass_fields__", {}).values():
            told.setdefault(entry.name, {}).update(entry.metadata)
    return [
        Option(
            entry.name,
            entry.type if isinstance(entry.type, str) else entry.type.__name__,
            required=entry.default is MISSING,
            default=None if entry.default is MISSING else entry.default,
            **{"about": entry.name, **told[entry.name]},
        )
        for entry in fields(kind)
    ]
