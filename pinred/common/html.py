"""Pieces of HTML for notebooks: escaped, without scripts, for light and dark themes.

The only colours are two of middle brightness, so text keeps the colour of the theme; whatever
a colour says, the words beside it say too.  Long tables stay folded until they are opened.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from .arrays import Array

MOST_ROWS = 12  # of a table that is not folded
_GOOD, _BAD = "#2e9e5b", "#d9534f"
_CELL = "padding:0.1em 0.7em;vertical-align:top"
_LEFT, _RIGHT = f"{_CELL};text-align:left", f"{_CELL};text-align:right"


class Raw(str):
    """Text that is HTML already."""

    __slots__ = ()


def card(title: str, about: str, *parts: str) -> str:
    """Return a whole card: a title, a line about it, and parts that are HTML."""
    head = f"<div><strong>{escape(title)}</strong>: {escape(about)}</div>"
    return f'<div style="line-height:1.4">{head}{"".join(parts)}</div>'


def line(*words: str) -> str:
    """Return a line of text; words that are Raw stay as they are."""
    return f"<div>{' '.join(map(_html, words))}</div>"


def verdict(passed: bool, good: str = "ok", bad: str = "FAILED") -> Raw:
    """Return one of two words, in its colour."""
    color, word = (_GOOD, good) if passed else (_BAD, bad)
    return Raw(f'<strong style="color:{color}">{escape(word)}</strong>')


def table(title: str, head: Sequence[str], rows: Iterable[Sequence[str | float]]) -> str:
    """Return a table under its title, or nothing if it has no rows; numbers are right-aligned."""
    cells = [list(row) for row in rows]
    if not cells:
        return ""
    lines = [f"<tr>{''.join(map(_cell, row))}</tr>" for row in cells]
    sides = (_LEFT if isinstance(value, str) else _RIGHT for value in cells[0])
    top = "".join(
        f'<th style="{side}">{escape(name)}</th>' for side, name in zip(sides, head, strict=True)
    )
    body = (
        '<div style="overflow-x:auto"><table style="border-collapse:collapse">'
        f"<thead><tr>{top}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"
    )
    if len(lines) > MOST_ROWS:
        return f"<details><summary>{escape(title)} ({len(lines)} rows)</summary>{body}</details>"
    return f"{line(title)}{body}" if title else body


def matrix(title: str, values: Array, rows: Sequence[str], columns: Sequence[str]) -> str:
    """Return a matrix (k, l) as a table, with the names of its rows and columns.

    Entries that are round-off beside the largest are shown as 0.
    """
    if not values.size:
        return line(f"{title}: none, there are no joints")
    shown = np.where(np.abs(values) < 1e-14 * np.abs(values).max(), 0.0, values)
    named = ([name, *row.tolist()] for name, row in zip(rows, shown, strict=True))
    return table(title, ["", *columns], named)


def number(value: float) -> str:
    """Return a number with six digits."""
    return f"{value:.6g}"


def numbers(values: Array) -> str:
    """Return a vector with six digits."""
    return f"({', '.join(map(number, values))})"


def _cell(value: str | float) -> str:
    if isinstance(value, str):
        return f'<td style="{_LEFT}">{_html(value)}</td>'
    return f'<td style="{_RIGHT}">{number(value)}</td>'


def _html(text: str) -> str:
    return text if isinstance(text, Raw) else escape(text)
