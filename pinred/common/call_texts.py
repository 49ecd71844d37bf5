"""Objects from texts such as "Gauss(0.01, 8)", which are parsed and never executed."""

from __future__ import annotations

import ast
import warnings
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

from .errors import InputError
from .names import nearest, quoted


def build_from_text(
    text: str, kinds: Mapping[str, type], what: str, others: str, example: str
) -> Any:
    """Return the object that a text describes: the name of a class, and its options.

    Args:
        text: A name with options in Python notation, or a name alone.
        kinds: Dataclasses by name.
        what: Kind of object, for messages.
        others: Text that is appended to the list of names in messages.
        example: An example of a text, for messages.
    Returns:
        The object.
    Raises:
        InputError: The text has another form, or the name or an option is unknown.
    """
    name, positional, named = parse_call(text, kinds, what, others, example)
    if name not in kinds:
        raise InputError(
            f"unknown {what} {quoted(name)}; {nearest(name, list(kinds))}"
            f"the {what}s are {', '.join(kinds)}{others}"
        )
    kind = kinds[name]
    options = {entry.name: entry.default for entry in fields(kind)}
    unknown = [key for key in named if key not in options]
    if unknown or len(positional) > len(options):
        excess = f"option {quoted(unknown[0])}" if unknown else f"{len(positional)} options"
        raise InputError(f"{what} {name} has no {excess}; its options are {', '.join(options)}")
    repeated = [key for key in list(options)[: len(positional)] if key in named]
    if repeated:
        raise InputError(f"{what} {quoted(text)} sets {repeated[0]} twice; set it once")
    named |= dict(zip(options, positional, strict=False))
    missing = [key for key, default in options.items() if default is MISSING and key not in named]
    if missing:
        options_shown = example[example.index("(") :]
        raise InputError(f"{what} {quoted(text)} needs a {missing[0]}, as in {name}{options_shown}")
    return kind(**named)


def parse_call(
    text: str, kinds: Mapping[str, type], what: str, others: str, example: str
) -> tuple[str, list[Any], dict[str, Any]]:
    """Parse a text NAME or NAME(1, key=2).

    Args:
        text: The text.
        kinds: Classes by name, for messages.
        what: Kind of object, for messages.
        others: Text that is appended to the list of names in messages.
        example: An example of a text, for messages.
    Returns:
        The name, the positional options and the named options.
    Raises:
        InputError: The text has another form.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Treat syntax warnings as errors.
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
        f"{what} {quoted(text)} must be a name, or a name with options such as {example}; "
        f"the {what}s are {', '.join(kinds)}{others}"
    )


def _value(node: ast.expr) -> Any:
    """Return the number or text of a syntax node; inf and nan are numbers, as in repr."""
    if isinstance(node, ast.Name) and node.id in ("inf", "nan"):
        return float(node.id)
    return ast.literal_eval(node)
