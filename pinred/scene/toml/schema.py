"""Value types of TOML files: each type validates a value and describes it as JSON Schema.

Messages name the place of a value in its file.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

from ...common.errors import InputError, LoadError, PinredError
from ...common.names import nearest, quoted_path

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+", re.ASCII)
_SHOWN = 40  # largest number of characters of a value that a message shows
LARGEST = 10_000_000  # largest accepted size of a file [byte]
_SCANNED = 500  # number of lines at the top of a file in which the line of a key is searched


@dataclass(frozen=True)
class Place:
    """A place in a TOML file.

    Attributes:
        file: Path of the file.
        text: Text of the file.
        keys: Keys and list indices (from 0) on the path to the place.
    """

    file: str
    text: str = ""
    keys: tuple[str | int, ...] = ()

    def __truediv__(self, key: str | int) -> Place:
        return replace(self, keys=(*self.keys, key))

    def __str__(self) -> str:
        path = ""
        for key in self.keys:
            if isinstance(key, int):
                path += f"[{key}]"
                continue
            name = key if _BARE_KEY.fullmatch(key) else json.dumps(key)
            path += f".{name}" if path else name
        return path

    def message(self, problem: str) -> str:
        """Return a message of one line: file, line number if it is known, key, and problem."""
        line = self._line()
        words = [self.file + (f", line {line}" if line else ""), str(self), problem]
        return ": ".join(word for word in words if word)

    def fail(self, problem: str) -> NoReturn:
        """Raise an InputError whose message names this place."""
        raise InputError(self.message(problem)) from None

    def _line(self) -> int:
        """Return the line number, from 1, of the statement with this key; 0 if unknown.

        The file is parsed line by line until the key exists.
        """
        if not self.keys:
            return 0
        lines = self.text.splitlines(keepends=True)
        complete = 0  # number of lines that form complete statements without the key
        for count in range(1, min(len(lines), _SCANNED) + 1):
            try:
                value: Any = tomllib.loads("".join(lines[:count]))
                complete, before = count, complete
                for key in self.keys:
                    value = value[key]
            except (ValueError, KeyError, IndexError, TypeError, RecursionError):
                continue
            while before < count - 1 and re.match(r"\s*(#|$)", lines[before]):
                before += 1
            return before + 1
        return 0


@contextmanager
def naming(place: Place, prefix: str = "") -> Iterator[None]:
    """Prepend a place to the message of every pinred error that is raised in the block.

    `prefix` is removed from the start of the message, because the place already says it.
    """
    try:
        yield
    except PinredError as error:
        raise type(error)(place.message(one_line(error).removeprefix(prefix))) from None


def one_line(error: Exception) -> str:
    """Return the message of an error as one line, without the position markers under a formula."""
    lines = [line.strip() for line in str(error).splitlines()]
    return "; ".join(line for line in lines if line.strip("^"))


def unknown(name: str, kind: str, valid: Iterable[str], title: str) -> str:
    """Return the message about an unknown name, with the nearest valid name.

    Args:
        name: The unknown name.
        kind: The kind of name, such as "key" or "joint".
        valid: The valid names.
        title: Text before the list of valid names.
    Returns:
        The message.
    """
    names = list(valid)
    return (
        f"unknown {kind} {_quoted(name)}; {nearest(name, names)}{title} "
        f"{', '.join(names) or 'none'}"
    )


def shown(value: Any) -> str:
    """Return a short form of a value in TOML notation, for messages."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f"the text {_quoted(value)}"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, int) and abs(value) >= 10**_SHOWN:
        return "a huge number"
    return str(value)


def _quoted(value: str) -> str:
    short = value if len(value) <= _SHOWN else value[: _SHOWN - 1] + "…"
    return json.dumps(short).replace("\\u2026", "…")


def read_text(path: Path, what: str) -> str:
    """Return the text of a file.

    Args:
        path: The file.
        what: Kind of file in messages.
    Returns:
        The text.
    Raises:
        LoadError: The file is missing, too large, or not UTF-8.
    """
    try:
        if not path.is_file():
            raise LoadError(f"no such {what}: {quoted_path(path)}")
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
        if len(raw) > LARGEST:
            raise LoadError(f"{what} {quoted_path(path)} has more than {LARGEST} bytes")
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise LoadError(
            f"{what} {quoted_path(path)} is not UTF-8 text, at byte {error.start}"
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise LoadError(f"cannot read {what} {quoted_path(path)}: {reason}") from None


Schema: TypeAlias = dict[str, Any]
_TOP = "to the top level, above the first line with a [table]"


class Node(ABC):
    """The type of a value in a file.

    Attributes:
        types: Python types that the value may have.
        words: The value type in words, for messages.
        name: Name of the type in the JSON Schema; "" for a type that is used once.
    """

    types: tuple[type, ...] = ()
    words: str
    name: str = ""

    def describe(self) -> str:
        """Return the value type in words, for messages."""
        return self.words

    def fits(self, value: Any) -> bool:
        """Return whether a value has one of the accepted types; a bool is not a number."""
        return isinstance(value, self.types) and isinstance(value, bool) == (self.types == (bool,))

    def read(self, value: Any, place: Place) -> Any:
        """Validate a value and convert it to plain Python.

        Args:
            value: The value as tomllib returns it.
            place: Its place in the file, for messages.
        Returns:
            The value with floats for numbers.
        Raises:
            InputError: the value does not fit; the message names the place.
        """
        if not self.fits(value):
            place.fail(f"must be {self.describe()}, got {shown(value)}")
        return self._read(value, place)

    @abstractmethod
    def _read(self, value: Any, place: Place) -> Any:
        """Validate and convert a value that has an accepted type."""

    def schema(self, defs: dict[str, Schema]) -> Schema:
        """Return the JSON Schema; a type with a name is added to `defs` and referenced."""
        if not self.name:
            return self._schema(defs)
        if self.name not in defs:
            defs[self.name] = {}  # Reserve the entry first, because a type may contain itself.
            defs[self.name] = self._schema(defs)
        return {"$ref": f"#/$defs/{self.name}"}

    @abstractmethod
    def _schema(self, defs: dict[str, Schema]) -> Schema:
        """Return the JSON Schema without a reference to `defs`."""


@dataclass(frozen=True)
class Number(Node):
    """A finite number.

    Attributes:
        positive: Whether the number must be above zero.
    """

    positive: bool = False
    types = (int, float)

    def describe(self) -> str:
        """Return the value type in words, for messages."""
        return "a number above 0" if self.positive else "a number"

    def _read(self, value: Any, place: Place) -> float:
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number) or (self.positive and number <= 0.0):
            place.fail(f"must be finite and {self.describe()}, got {shown(value)}")
        return number

    def _schema(self, defs: dict[str, Schema]) -> Schema:  # noqa: ARG002
        return {"type": "number"} | ({"exclusiveMinimum": 0} if self.positive else {})


@dataclass(frozen=True)
class Whole(Node):
    """A whole number from `least` to `most`, both included."""

    least: int = 0
    most: int = 2**63 - 1
    types = (int,)

    def describe(self) -> str:
        """Return the value type in words, for messages."""
        return f"a whole number from {self.least}"

    def _read(self, value: Any, place: Place) -> int:
        if not self.least <= value <= self.most:
            place.fail(f"must be {self.describe()} to {self.most}, got {shown(value)}")
        return int(value)

    def _schema(self, defs: dict[str, Schema]) -> Schema:  # noqa: ARG002
        return {"type": "integer", "minimum": self.least, "maximum": self.most}


@dataclass(frozen=True)
class Flag(Node):
    """A boolean."""

    types = (bool,)
    words = "true or false"

    def _read(self, value: Any, place: Place) -> bool:  # noqa: ARG002
        return bool(value)

    def _schema(self, defs: dict[str, Schema]) -> Schema:  # noqa: ARG002
        return {"type": "boolean"}


@dataclass(frozen=True)
class Text(Node):
    """Text that is not empty.

    Attributes:
        among: The accepted texts; any text if empty.
        words: The value type in words, for messages.
    """

    among: tuple[str, ...] = ()
    words: str = "text"
    types = (str,)

    def _read(self, value: Any, place: Place) -> str:
        if self.among and value not in self.among:
            place.fail(unknown(value, "value", self.among, "it can be"))
        if not value:
            place.fail(f"must be {self.words}, got no text")
        return str(value)

    def _schema(self, defs: dict[str, Schema]) -> Schema:  # noqa: ARG002
        return {"enum": list(self.among)} if self.among else {"type": "string", "minLength": 1}


@dataclass(frozen=True)
class ListOf(Node):
    """A list.

    Attributes:
        item: Type of the entries.
        count: Number of entries; any number if 0.
    """

    item: Node
    count: int = 0
    types = (list,)

    def describe(self) -> str:
        """Return the value type in words, for messages."""
        entries = f"{self.count} entries" if self.count else "entries"
        return f"a list of {entries}, each {self.item.describe()}"

    def _read(self, value: Any, place: Place) -> list[Any]:
        if self.count and len(value) != self.count:
            place.fail(f"must be {self.describe()}, got {shown(value)}")
        return [self.item.read(entry, place / k) for k, entry in enumerate(value)]

    def _schema(self, defs: dict[str, Schema]) -> Schema:
        size = {"minItems": self.count, "maxItems": self.count} if self.count else {}
        return {"type": "array", "items": self.item.schema(defs), **size}


@dataclass(frozen=True)
class ByName(Node):
    """A table from names, such as joint names, to values of type `item`.

    Attributes:
        item: Type of the values.
        name: Name of the type in the JSON Schema.
        noun: What the names denote, for messages.
    """

    item: Node
    name: str = ""
    noun: str = "joint"
    types = (dict,)

    def describe(self) -> str:
        """Return the value type in words, for messages."""
        return f"a table {{{self.noun} = {self.item.describe()}}}"

    def _read(self, value: Any, place: Place) -> dict[str, Any]:
        return {name: self.item.read(entry, place / name) for name, entry in value.items()}

    def _schema(self, defs: dict[str, Schema]) -> Schema:
        return {"type": "object", "additionalProperties": self.item.schema(defs)}


@dataclass(frozen=True)
class Either(Node):
    """One of several value types; the Python type of the value selects the value type."""

    nodes: tuple[Node, ...]
    name: str = ""

    def describe(self) -> str:
        """Return the value type in words, for messages."""
        return ", or ".join(node.describe() for node in self.nodes)

    def fits(self, value: Any) -> bool:
        """Return whether a value fits one of the types."""
        return any(node.fits(value) for node in self.nodes)

    def _read(self, value: Any, place: Place) -> Any:
        return next(node for node in self.nodes if node.fits(value)).read(value, place)

    def _schema(self, defs: dict[str, Schema]) -> Schema:
        return {"anyOf": [node.schema(defs) for node in self.nodes]}


@dataclass(frozen=True)
class Key:
    """A key of a table.

    Attributes:
        node: Type of the value.
        text: Meaning, with unit.
        required: Whether the key must be present.
        default: Value that applies if the key is missing, in words.
        command: Name and value format on the command line, such as "--duration T"; "" for none.
    """

    node: Node
    text: str
    required: bool = False
    default: str = ""
    command: str = ""

    @property
    def description(self) -> str:
        """The meaning and the default, as in the schema, the docs, and `--help`."""
        return self.text + (f" (default: {self.default})" if self.default else "")

    def schema(self, defs: dict[str, Schema]) -> Schema:
        """Return the JSON Schema of the value, with a description."""
        return {**self.node.schema(defs), "description": self.description}


@dataclass(frozen=True)
class Table(Node):
    """A table with known keys.

    Attributes:
        keys: {name: key}.
        words: Description of the table, for messages.
        apart: Pairs of keys that exclude each other.
        needs: {key: another key that it requires}.
        one_of: Keys, exactly one of which must be present; no restriction if empty.
        name: Name of the type in the JSON Schema.
        elsewhere: {key of another table: the place where it belongs}, for messages.
    """

    keys: Mapping[str, Key]
    words: str = "a table"
    apart: tuple[tuple[str, str], ...] = ()
    needs: Mapping[str, str] = field(default_factory=dict)
    one_of: tuple[str, ...] = ()
    name: str = ""
    elsewhere: Mapping[str, str] = field(default_factory=dict)
    types = (dict,)

    def _read(self, value: Any, place: Place) -> dict[str, Any]:
        for name in value:
            if name not in self.keys:
                if name in self.elsewhere:
                    (place / name).fail(f"this key belongs {self.elsewhere[name]}")
                (place / name).fail(unknown(name, "key", self.keys, "the keys here are"))
        for name, key in self.keys.items():
            if key.required and name not in value:
                place.fail(f"'{name}' is missing: {key.text}")
        for first, second in self.apart:
            if first in value and second in value:
                (place / second).fail(f"give {first} or {second}, not both")
        for name, required in self.needs.items():
            if name in value and required not in value:
                (place / name).fail(f"'{name}' requires '{required}'")
        if self.one_of and sum(name in value for name in self.one_of) != 1:
            place.fail(f"must have one of the keys {', '.join(self.one_of)}")
        return {
            name: self.keys[name].node.read(entry, place / name) for name, entry in value.items()
        }

    def _schema(self, defs: dict[str, Schema]) -> Schema:
        schema: Schema = {
            "type": "object",
            "properties": {name: key.schema(defs) for name, key in self.keys.items()},
            "additionalProperties": False,
        }
        required = [name for name, key in self.keys.items() if key.required]
        if required:
            schema["required"] = required
        if self.apart:
            schema["allOf"] = [{"not": {"required": list(pair)}} for pair in self.apart]
        if self.needs:
            schema["dependentRequired"] = {name: [other] for name, other in self.needs.items()}
        if self.one_of:
            schema["oneOf"] = [{"required": [name]} for name in self.one_of]
        return schema


@dataclass(frozen=True)
class Tagged(Node):
    """A table whose keys depend on the value of the key `tag`.

    Attributes:
        tag: Name of the key that selects the table.
        tables: {value of the tag: table of the other keys}.
        words: Description of the table, for messages.
        refused: {value of the tag: reason why it is rejected}.
    """

    tag: str
    tables: Mapping[str, Table]
    words: str = "a table"
    refused: Mapping[str, str] = field(default_factory=dict)
    types = (dict,)

    def _read(self, value: Any, place: Place) -> dict[str, Any]:
        valid = f"the {self.tag}s are {', '.join(self.tables)}"
        if self.tag not in value:
            place.fail(f"'{self.tag}' is missing; {valid}")
        tag, tag_place = value[self.tag], place / self.tag
        if not isinstance(tag, str):
            tag_place.fail(f"must be text, got {shown(tag)}; {valid}")
        if tag in self.refused:
            tag_place.fail(self.refused[tag])
        if tag not in self.tables:
            tag_place.fail(unknown(tag, self.tag, self.tables, f"the {self.tag}s are"))
        table: dict[str, Any] = self._table(tag).read(value, place)
        return table

    def _table(self, tag: str) -> Table:
        """Return the table of one tag value, with the tag as its first key."""
        key = Key(Text((tag,)), self.tables[tag].words, required=True)
        return replace(self.tables[tag], keys={self.tag: key, **self.tables[tag].keys})

    def _schema(self, defs: dict[str, Schema]) -> Schema:
        return {"oneOf": [self._table(tag).schema(defs) for tag in self.tables]}


def with_places(table: Table) -> Table:
    """Return a table of a whole file whose messages say where misplaced keys belong.

    Args:
        table: The keys at the top level; those whose values are tables have known keys, too.
    """
    places: dict[str, list[str]] = {name: [_TOP] for name in table.keys}
    inner = {name: key for name, key in table.keys.items() if isinstance(key.node, Table)}
    for name, key in inner.items():
        for entry in key.node.keys:  # type: ignore[attr-defined]
            places.setdefault(entry, []).append(f"in the table [{name}]")
    elsewhere = {name: " or ".join(places[name]) for name in places}
    keys = {
        name: replace(key, node=replace(key.node, elsewhere=elsewhere))  # type: ignore[type-var]
        for name, key in inner.items()
    }
    return replace(table, keys={**table.keys, **keys}, elsewhere=elsewhere)


def document_schema(table: Table, title: str) -> Schema:
    """Return the JSON Schema (draft 2020-12) of TOML documents with the keys of a table."""
    defs: dict[str, Schema] = {}
    body = table.schema(defs)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        **body,
        "$defs": defs,
    }
