"""Decorators that list in a signature the options that a function accepts as `**options`.

Type checkers and editors use `**options: Unpack[…]`.  For `help` and `inspect.signature`, the
decorators below derive the signature and the descriptions from the same dataclass.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable
from dataclasses import MISSING, fields
from inspect import Parameter
from typing import Any, TypeVar, get_overloads

F = TypeVar("F", bound=Callable[..., Any])


def shows_fields(kind: type, **defaults: Any) -> Callable[[F], F]:
    """Create a decorator that replaces **options in a signature by dataclass fields.

    Args:
        kind: The dataclass.  Fields without a default are not shown.
        defaults: Defaults of the function that differ from the dataclass.
    Returns:
        The decorator.
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

    def decorate(function: F) -> F:
        _describe_options(function, kind, [option.name for option in options])
        return _set_options(function, options)

    return decorate


def shows_overloads(function: F) -> F:
    """Replace **options in a function's signature by the keyword arguments of its overloads."""
    options: dict[str, Parameter] = {}
    for overload in get_overloads(function):
        for parameter in inspect.signature(overload).parameters.values():
            if parameter.kind is Parameter.KEYWORD_ONLY:
                options.setdefault(parameter.name, parameter)
    return _set_options(function, options.values())


def _describe_options(function: Callable[..., Any], kind: type, names: Iterable[str]) -> None:
    """Replace the entry `options` under Args by the entries of the dataclass's Attributes."""
    doc, attributes = function.__doc__ or "", inspect.getdoc(kind) or ""
    entry = r"^    ((\w+): .*(?:\n {5,}.*)*)"
    entries = {match[2]: match[1] for match in re.finditer(entry, attributes, re.MULTILINE)}
    lines = [
        f"        {entries[name]}".replace("\n", "\n    ") for name in names if name in entries
    ]
    pattern = r"^        options: .*(?:\n {9,}.*)*$"
    if lines:
        text = "\n".join(lines)
        function.__doc__ = re.sub(pattern, lambda _: text, doc, count=1, flags=re.MULTILINE)


def _set_options(function: F, options: Iterable[Parameter]) -> F:
    """Replace **options in a function's signature with explicit keyword arguments."""
    signature = inspect.signature(function)
    plain = [p for p in signature.parameters.values() if p.kind is not Parameter.VAR_KEYWORD]
    function.__signature__ = signature.replace(parameters=[*plain, *options])  # type: ignore[attr-defined]
    return function
