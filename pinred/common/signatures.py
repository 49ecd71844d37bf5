"""Signatures that show by name what a function takes as `**options`.

For type checkers and editors, `**options: Unpack[…]` says it; what `help` and
`inspect.signature` show is written by the decorator here, from the dataclass that holds the
options, so that both are told from one place.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from dataclasses import MISSING, fields
from inspect import Parameter
from typing import Any, TypeVar, get_overloads

F = TypeVar("F", bound=Callable[..., Any])


def shows_fields(kind: type, **defaults: Any) -> Callable[[F], F]:
    """Return what makes a function show fields of a dataclass in the place of its **options.

    Fields without a default are no options.  defaults: where the function has others.
    """
    options = []
    for entry in fields(kind):
        default = defaults.get(entry.name, entry.default)
        if entry.default_factory is not MISSING:
            default = entry.default_factory()
        if default is not MISSING:
            options.append(
                Parameter(
                    entry.name, Parameter.KEYWORD_ONLY, default=default, annotation=entry.type
                )
            )

    def shown(function: F) -> F:
        return _showing(function, options)

    return shown


def shows_overloads(function: F) -> F:
    """Make a function show, in the place of its **options, those of all its overloads."""
    options: dict[str, Parameter] = {}
    for overload in get_overloads(function):
        for parameter in inspect.signature(overload).parameters.values():
            if parameter.kind is Parameter.KEYWORD_ONLY:
                options.setdefault(parameter.name, parameter)
    return _showing(function, options.values())


def _showing(function: F, options: Iterable[Parameter]) -> F:
    """Give a function the signature with options in the place of **options."""
    own = inspect.signature(function)
    plain = [p for p in own.parameters.values() if p.kind is not Parameter.VAR_KEYWORD]
    function.__signature__ = own.replace(parameters=[*plain, *options])  # type: ignore[attr-defined]
    return function
