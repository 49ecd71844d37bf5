"""Places in a file of TOML, and messages about what stands there."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NoReturn

from ...common.errors import InputError, PinredError
from ...common.names import nearest

_BARE = re.compile(r"[A-Za-z0-9_-]+", re.ASCII)
_SHOWN = 40  # characters of a value in a message
_SCANNED = 500  # lines of a file in which the line of a fault is looked for


@dataclass(frozen=True)
class Place:
    """A place in a file.  text: of the file.  keys: names and indices from 0."""

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
            plain = key if _BARE.fullmatch(key) else json.dumps(key)
            path += f".{plain}" if path else plain
        return path

    def tell(self, problem: str) -> str:
        """Return a message of one line: file, line if it can be found, key, problem."""
        line = self._line()
        parts = [self.file + (f", line {line}" if line else ""), str(self), problem]
        return ": ".join(part for part in parts if part)

    def fail(self, problem: str) -> NoReturn:
        """Raise an InputError that names this place."""
        raise InputError(self.tell(problem)) from None

    def _line(self) -> int:
        """Return the line, from 1, of the statement that holds this place; 0 if it is not found."""
        if not self.keys:
            return 0
        lines = self.text.splitlines(keepends=True)
        complete = 0  # lines that are whole statements without it
        for count in range(1, min(len(lines), _SCANNED) + 1):
            try:
                found: Any = tomllib.loads("".join(lines[:count]))
                complete, before = count, complete
                for key in self.keys:
                    found = found[key]
            except (ValueError, KeyError, IndexError, TypeError, RecursionError):
                continue
            while before < count - 1 and re.match(r"\s*(#|$)", lines[before]):
                before += 1
            return before + 1
        return 0


@contextmanager
def naming(place: Place, already: str = "") -> Iterator[None]:
    """Put a place in front of the message of any error of pinred raised inside.

    already: words at the front of messages that say the same.
    """
    try:
        yield
    except PinredError as error:
        raise type(error)(place.tell(one_line(error).removeprefix(already))) from None


def one_line(error: Exception) -> str:
    """Return a message as one line, without the marks under a formula."""
    lines = [line.strip() for line in str(error).splitlines()]
    return "; ".join(line for line in lines if line.strip("^"))


def unknown(name: str, kind: str, known: Iterable[str], title: str) -> str:
    """Return the message about an unknown name, with the nearest known one."""
    known = list(known)
    return (
        f"unknown {kind} {_text(name)}; {nearest(name, known)}{title} {', '.join(known) or 'none'}"
    )


def shown(value: Any) -> str:
    """Return a value as a message shows it: as TOML writes it, and short."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f"the text {_text(value)}"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, int) and abs(value) >= 10**_SHOWN:
        return "a huge number"
    return str(value)


def _text(value: str) -> str:
    return json.dumps(value if len(value) <= _SHOWN else value[: _SHOWN - 1] + "…").replace(
        "\\u2026", "…"
    )
