"""Descriptions of values in a file, which check them and write themselves as JSON Schema.

A description reads a value of TOML at a place and returns it in plain form, or raises an
InputError that names the place.  The same object writes the schema, so that the two say the
same.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

from .places import Place, shown, unknown

Schema: TypeAlias = dict[str, Any]


class Node(ABC):
    """A description of a value.  types: of Python, that it may have.  words: for messages."""

    types: tuple[type, ...]
    words: str

    def fits(self, value: Any) -> bool:
        """Return whether a value has a type that this describes; a bool is no number."""
        return isinstance(value, self.types) and isinstance(value, bool) == (self.types == (bool,))

    def read(self, value: Any, place: Place) -> Any:
        """Return a value in plain form.  Raises InputError."""
        if not self.fits(value):
            place.fail(f"must be {self.words}, got {shown(value)}")
        return self._read(value, place)

    @abstractmethod
    def _read(self, value: Any, place: Place) -> Any:
        """Return a value of the right type in plain form."""

    @abstractmethod
    def schema(self, defs: dict[str, Schema]) -> Schema:
        """Return the JSON Schema; what has a name goes into defs."""


@dataclass(frozen=True)
class Number(Node):
    """A finite number.  positive: above zero."""

    positive: bool = False
    types = (int, float)

    @property
    def words(self) -> str:  # type: ignore[override]
        """The description in words, for messages."""
        return "a number above 0" if self.positive else "a number"

    def _read(self, value: Any, place: Place) -> float:
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number) or (self.positive and number <= 0.0):
            place.fail(f"must be finite and {self.words}, got {shown(value)}")
        return number

    def schema(self, defs: dict[str, Schema]) -> Schema:  # noqa: ARG002
        """Return the JSON Schema."""
        return {"type": "number"} | ({"exclusiveMinimum": 0} if self.positive else {})


@dataclass(frozen=True)
class Whole(Node):
    """A whole number from `least` to `most`."""

    least: int = 0
    most: int = 2**63 - 1
    types = (int,)

    @property
    def words(self) -> str:  # type: ignore[override]
        """The description in words, for messages."""
        return f"a whole number from {self.least}"

    def _read(self, value: Any, place: Place) -> int:
        if not self.least <= value <= self.most:
            place.fail(f"must be {self.words} to {self.most}, got {shown(value)}")
        return int(value)

    def schema(self, defs: dict[str, Schema]) -> Schema:  # noqa: ARG002
        """Return the JSON Schema."""
        return {"type": "integer", "minimum": self.least, "maximum": self.most}


@dataclass(frozen=True)
class Flag(Node):
    """true or false."""

    types = (bool,)
    words = "true or false"

    def _read(self, value: Any, place: Place) -> bool:  # noqa: ARG002
        return bool(value)

    def schema(self, defs: dict[str, Schema]) -> Schema:  # noqa: ARG002
        """Return the JSON Schema."""
        return {"type": "boolean"}


@dataclass(frozen=True)
class Text(Node):
    """Text, not empty.  among: the texts it may be, any if empty.  words: its name in messages."""

    among: tuple[str, ...] = ()
    words: str = "text"
    types = (str,)

    def _read(self, value: Any, place: Place) -> str:
        if self.among and value not in self.among:
            place.fail(unknown(value, "value", self.among, "it can be"))
        if not value:
            place.fail(f"must be {self.words}, got no text")
        return str(value)

    def schema(self, defs: dict[str, Schema]) -> Schema:  # noqa: ARG002
        """Return the JSON Schema."""
        return {"enum": list(self.among)} if self.among else {"type": "string", "minLength": 1}


@dataclass(frozen=True)
class ListOf(Node):
    """A list.  item: of what.  count: of how many; any number if 0."""

    item: Node
    count: int = 0
    types = (list,)

    @property
    def words(self) -> str:  # type: ignore[override]
        """The description in words, for messages."""
        many = f"{self.count} entries" if self.count else "entries"
        return f"a list of {many}, each {self.item.words}"

    def _read(self, value: Any, place: Place) -> list[Any]:
        if self.count and len(value) != self.count:
            place.fail(f"must be {self.words}, got {shown(value)}")
        return [self.item.read(entry, place / k) for k, entry in enumerate(value)]

    def schema(self, defs: dict[str, Schema]) -> Schema:
        """Return the JSON Schema."""
        size = {"minItems": self.count, "maxItems": self.count} if self.count else {}
        return {"type": "array", "items": self.item.schema(defs), **size}


@dataclass(frozen=True)
class ByName(Node):
    """A table from names, such as those of joints, to values."""

    item: Node
    types = (dict,)

    @property
    def words(self) -> str:  # type: ignore[override]
        """The description in words, for messages."""
        return f"a table {{joint = {self.item.words}}}"

    def _read(self, value: Any, place: Place) -> dict[str, Any]:
        return {name: self.item.read(entry, place / name) for name, entry in value.items()}

    def schema(self, defs: dict[str, Schema]) -> Schema:
        """Return the JSON Schema."""
        return {"type": "object", "additionalProperties": self.item.schema(defs)}


@dataclass(frozen=True)
class Either(Node):
    """One of several descriptions, told apart by their types."""

    nodes: tuple[Node, ...]

    @property
    def types(self) -> tuple[type, ...]:  # type: ignore[override]
        """The types of all descriptions."""
        return tuple(kind for node in self.nodes for kind in node.types)

    @property
    def words(self) -> str:  # type: ignore[override]
        """The description in words, for messages."""
        return ", or ".join(node.words for node in self.nodes)

    def fits(self, value: Any) -> bool:
        """Return whether a value fits one of the descriptions."""
        return any(node.fits(value) for node in self.nodes)

    def _read(self, value: Any, place: Place) -> Any:
        return next(node for node in self.nodes if node.fits(value)).read(value, place)

    def schema(self, defs: dict[str, Schema]) -> Schema:
        """Return the JSON Schema."""
        return {"anyOf": [node.schema(defs) for node in self.nodes]}


@dataclass(frozen=True)
class Key:
    """A key of a table.  text: its meaning.  default: the value without it, in words."""

    node: Node
    text: str
    required: bool = False
    default: str = ""

    def schema(self, defs: dict[str, Schema]) -> Schema:
        """Return the JSON Schema."""
        text = self.text + (f" (default: {self.default})" if self.default else "")
        return {**self.node.schema(defs), "description": text}


@dataclass(frozen=True)
class Table(Node):
    """A table of known keys.

    words: its name in messages.  apart: pairs of keys that exclude each other.  needs: a key
    and the key that has to come with it.  least_one, only_one: whether it must have a key, or
    one only.
    """

    keys: Mapping[str, Key]
    words: str = "a table"
    apart: tuple[tuple[str, str], ...] = ()
    needs: Mapping[str, str] = field(default_factory=dict)
    one_of: tuple[str, ...] = ()
    types = (dict,)

    def _read(self, value: Any, place: Place) -> dict[str, Any]:
        for name in value:
            if name not in self.keys:
                (place / name).fail(unknown(name, "key", self.keys, "the keys here are"))
        for name, key in self.keys.items():
            if key.required and name not in value:
                place.fail(f"'{name}' is missing: {key.text}")
        for one, other in self.apart:
            if one in value and other in value:
                (place / other).fail(f"give {one} or {other}, not both")
        for name, other in self.needs.items():
            if name in value and other not in value:
                (place / name).fail(f"'{name}' has no meaning without '{other}'")
        if self.one_of and sum(name in value for name in self.one_of) != 1:
            place.fail(f"must have one of the keys {', '.join(self.one_of)}")
        return {
            name: self.keys[name].node.read(entry, place / name) for name, entry in value.items()
        }

    def schema(self, defs: dict[str, Schema]) -> Schema:
        """Return the JSON Schema."""
        out: Schema = {
            "type": "object",
            "properties": {name: key.schema(defs) for name, key in self.keys.items()},
            "additionalProperties": False,
        }
        required = [name for name, key in self.keys.items() if key.required]
        if required:
            out["required"] = required
        if self.apart:
            out["allOf"] = [{"not": {"required": list(pair)}} for pair in self.apart]
        if self.needs:
            out["dependentRequired"] = {name: [other] for name, other in self.needs.items()}
        if self.one_of:
            out["oneOf"] = [{"required": [name]} for name in self.one_of]
        return out


@dataclass(frozen=True)
class Tagged(Node):
    """A table whose keys depend on the value of the key `tag`.

    text: the meaning of the tag.  refused: values of the tag that are refused for a reason of
    their own.
    """

    tag: str
    tables: Mapping[str, Table]
    words: str
    refused: Mapping[str, str] = field(default_factory=dict)
    types = (dict,)

    def _read(self, value: Any, place: Place) -> dict[str, Any]:
        listed = f"the {self.tag}s are {', '.join(self.tables)}"
        if self.tag not in value:
            place.fail(f"'{self.tag}' is missing; {listed}")
        kind, here = value[self.tag], place / self.tag
        if not isinstance(kind, str):
            here.fail(f"must be text, got {shown(kind)}; {listed}")
        if kind in self.refused:
            here.fail(self.refused[kind])
        if kind not in self.tables:
            here.fail(unknown(kind, self.tag, self.tables, f"the {self.tag}s are"))
        table: dict[str, Any] = self._table(kind).read(value, place)
        return table

    def _table(self, kind: str) -> Table:
        """Return the table of a kind with its tag among the keys."""
        tag = Key(Text((kind,)), self.tables[kind].words, required=True)
        return replace(self.tables[kind], keys={self.tag: tag, **self.tables[kind].keys})

    def schema(self, defs: dict[str, Schema]) -> Schema:
        """Return the JSON Schema."""
        return {"oneOf": [self._table(kind).schema(defs) for kind in self.tables]}


@dataclass(frozen=True)
class Named(Node):
    """A description that the schema holds once, under a name."""

    name: str
    node: Node

    @property
    def types(self) -> tuple[type, ...]:  # type: ignore[override]
        """The types of the description that has the name."""
        return self.node.types

    @property
    def words(self) -> str:  # type: ignore[override]
        """The description in words, for messages."""
        return self.node.words

    def fits(self, value: Any) -> bool:
        """Return whether a value fits the description that has the name."""
        return self.node.fits(value)

    def _read(self, value: Any, place: Place) -> Any:
        return self.node.read(value, place)

    def schema(self, defs: dict[str, Schema]) -> Schema:
        """Return a reference, and put the schema itself among defs."""
        if self.name not in defs:
            defs[self.name] = self.node.schema(defs)
        return {"$ref": f"#/$defs/{self.name}"}


def document_schema(table: Table, title: str) -> Schema:
    """Return the JSON Schema (draft 2020-12) of documents of TOML that are such a table."""
    defs: dict[str, Schema] = {}
    body = table.schema(defs)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        **body,
        "$defs": defs,
    }
