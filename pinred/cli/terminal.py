"""Text for terminals that cannot show all of it: in ASCII, as near as that comes."""

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
    """Return ASCII in the place of a character; an escape where there is none."""
    if character in _ASCII:
        return _ASCII[character]
    if "\udc80" <= character <= "\udcff":  # a byte of a file name that is no text
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
    """Let standard output and error take any text: what they cannot encode becomes ASCII."""
    codecs.register_error(_ERRORS, _replaced)
    before: list[tuple[Any, str | None]] = []
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a stand-in of somebody else's may not have it
            before.append((stream, stream.errors))
            stream.reconfigure(errors=_ERRORS)
    try:
        yield
    finally:
        for stream, errors in before:
            if not stream.closed:
                stream.reconfigure(errors=errors)
