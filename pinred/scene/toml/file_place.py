"""Texts of files, places in them, and the messages that name them."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

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
