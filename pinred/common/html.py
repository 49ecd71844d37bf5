"""HTML elements for notebooks: escaped, without scripts, for light and dark themes.

Text keeps the colour of the theme; verdicts use two colours of medium brightness, and also state
the result as text.  Long tables are collapsed. A Summary is a result that is shown as a title with
rows, in a terminal and in notebooks.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TypeAlias

import numpy as np

from .arrays import Array

MOST_ROWS = 12  # number of rows above which a table is collapsed
_GOOD, _BAD = "#2e9e5b", "#d9534f"
_CELL = "padding:0.1em 0.7em;vertical-align:top"
_LEFT, _RIGHT = f"{_CELL};text-align:left", f"{_CELL};text-align:right"


class Raw(str):
    """Text that is already HTML and needs no escaping."""

    __slots__ = ()


def card(title: str, about: str, *parts: str) -> str:
    """Format a card: a title, a short description, and further elements.

    Args:
        title: Title, as plain text.
        about: Description, as plain text.
        parts: Further elements, as HTML.
    Returns:
        The card as HTML.
    """
    head = f"<div><strong>{escape(title)}</strong>: {escape(about)}</div>"
    return f'<div style="line-height:1.4">{head}{"".join(parts)}</div>'


def line(*words: str) -> str:
    """Format words as one line of HTML; words of type Raw are not escaped."""
    return f"<div>{' '.join(map(_html, words))}</div>"


def verdict(passed: bool, good: str = "ok", bad: str = "FAILED") -> Raw:
    """Format the result of a check as a coloured word.

    Args:
        passed: The result.
        good: Word for a passed check.
        bad: Word for a failed check.
    Returns:
        The word as HTML.
    """
    color, word = (_GOOD, good) if passed else (_BAD, bad)
    return Raw(f'<strong style="color:{color}">{escape(word)}</strong>')


def table(title: str, head: Sequence[str], rows: Iterable[Sequence[str | float]]) -> str:
    """Format a table with a title; numbers are right-aligned.

    Args:
        title: Title, as plain text.
        head: Column names.
        rows: Cells of each row: text, or numbers shown with six digits.
    Returns:
        The table as HTML, collapsed if it is long; empty if there are no rows.
    """
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
    """Format a matrix as a table.

    Args:
        title: Title, as plain text.
        values: The matrix, (k, l).  Entries at round-off of the largest entry are shown as 0.
        rows: Names of the rows.
        columns: Names of the columns.
    Returns:
        The table as HTML.
    """
    if not values.size:
        return line(f"{title}: none, there are no joints")
    shown = np.where(np.abs(values) < 1e-14 * np.abs(values).max(), 0.0, values)
    named = ([name, *row.tolist()] for name, row in zip(rows, shown, strict=True))
    return table(title, ["", *columns], named)


def number(value: float) -> str:
    """Format a number with six digits."""
    return f"{value:.6g}"


def numbers(values: Array) -> str:
    """Format a vector with six digits."""
    return f"({', '.join(map(number, values))})"


def _cell(value: str | float) -> str:
    if isinstance(value, str):
        return f'<td style="{_LEFT}">{_html(value)}</td>'
    return f'<td style="{_RIGHT}">{number(value)}</td>'


def _html(text: str) -> str:
    return text if isinstance(text, Raw) else escape(text)


Rows: TypeAlias = Sequence[tuple[str, str]]

_WIDTH = 18  # least width of the labels


class Summary:
    """Base class of results that describe themselves by rows of a label and a text."""

    def title(self) -> str:
        """Return the first line."""
        raise NotImplementedError

    def rows(self) -> Rows:
        """Return the rows: labels, and values as text."""
        raise NotImplementedError

    def __str__(self) -> str:
        rows = self.rows()
        width = max([_WIDTH, *(len(label) for label, _ in rows)])
        return "\n".join([self.title(), *(f"  {label:<{width}} {text}" for label, text in rows)])

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        return card(type(self).__name__, self.title(), table("", ["", ""], self.rows()))
