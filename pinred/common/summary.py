"""Results that are shown as a title with rows, in a terminal and in notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from .html import card, table

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
