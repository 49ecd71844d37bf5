"""Output for terminals that cannot encode all characters: the nearest ASCII text."""

from __future__ import annotations

import codecs
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_ERRORS = "pinred-ascii"
_ASCII = {
    "×": "x", "·": "*", "²": "^2", "³": "^3", "−": "-", "–": "-", "—": "-", "→": "->", "…": "...",
    "±": "+-", "≤": "<=", "≥": ">=", "≈": "~", "√": "sqrt", "∞": "inf", "°": "deg", "█": "#",
    "ẋ": "xdot", "ẍ": "xddot", "ξ": "xi", "μ": "mu", "µ": "mu", "θ": "theta", "ω": "omega",
    "Ω": "Omega", "π": "pi", "τ": "tau", "α": "alpha", "β": "beta", "∂": "d", "ℝ": "R",
    "Δ": "Delta",
}  # fmt: skip


def nearest_ascii(character: str) -> str:
    """Return the nearest ASCII text of a character, or an escape sequence."""
    if character in _ASCII:
        return _ASCII[character]
    if "\udc80" <= character <= "\udcff":  # an undecodable byte of a file name
        return f"\\x{ord(character) - 0xDC00:02x}"
    plain = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return plain or character.encode("ascii", "backslashreplace").decode()


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    return "".join(map(nearest_ascii, text)), error.end


@contextmanager
def showing_all() -> Iterator[None]:
    """Make standard output and error accept any text; unknown characters become ASCII."""
    codecs.register_error(_ERRORS, _replaced)
    before: list[tuple[Any, str | None]] = []
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # A replaced stream may lack it.
            before.append((stream, stream.errors))
            stream.reconfigure(errors=_ERRORS)
    try:
        yield
    finally:
        for stream, errors in before:
            if not stream.closed:
                stream.reconfigure(errors=errors)
