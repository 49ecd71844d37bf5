"""The key `run.method` of scene files: integrators with their options, as text or as a table."""

from __future__ import annotations

from math import inf

from ...common.default_marker import Default
from ...integrators.methods import METHODS, Method, Option, options_of
from .schema import Either, Key, Node, Table, Tagged, Text, Whole
from .signal_tables import POSITIVE


def _method_table(method: type[Method]) -> Table:
    """Return the table (keys of a scene file) for a method's options."""
    keys = {
        option.name: Key(
            _option_node(option),
            option.about,
            required=option.required,
            default=_default_of(option),
        )
        for option in options_of(method)
    }
    return Table(keys, method.about)


def _option_node(option: Option) -> Node:
    if option.kind == "float":
        return POSITIVE
    if option.kind == "int":
        return Whole(option.least, option.most)
    return Text(option.among)


def _default_of(option: Option) -> str:
    """Describe the default of an option; a tolerance defaults to a tenth of the scene's."""
    if not isinstance(option.default, Default):
        return "" if option.required else _in_words(option.default)
    other = {"rtol": "atol", "atol": "rtol"}[option.name]
    return f"a tenth of run.{option.name}, or {_in_words(option.default)} beside {other}"


def _in_words(value: float | str) -> str:
    if value == inf:
        return "none"
    return f"{value:g}".replace("e-0", "e-") if isinstance(value, float) else str(value)


METHOD_TABLES = {
    "auto": Table({}, "choose a method that suits the scene and its tolerance"),
    **{name: _method_table(method) for name, method in METHODS.items()},
}
METHOD_NAMES = tuple(METHOD_TABLES)
METHOD = Either(
    (
        Text((), "an integrator as text"),
        Tagged("name", METHOD_TABLES, "an integrator {name = …}"),
    )
)
