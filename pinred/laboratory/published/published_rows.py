"""The rows of the table in order, and the table as text."""

from __future__ import annotations

from collections.abc import Sequence

from ...common.errors import InputError
from ...common.names import nearest
from . import collisions, dynamics, locomotion, turns
from .row import Result, Row

# All rows by name, in the order of the table.
ROWS: dict[str, Row] = {
    row.name: row
    for row in (
        *(*dynamics.FREE, *dynamics.TOPS, *turns.CATS, *dynamics.PLANAR, *dynamics.PENDULUMS),
        *(*locomotion.CHAINS, *locomotion.WHEELS, *turns.ARMS, *collisions.COLLISIONS),
    )
}
_NAME, _NUMBER = 22, 34  # widths of columns


def select_rows(names: Sequence[str]) -> list[Row]:
    """Return the named rows, or all if `names` is empty; raise InputError for an unknown name."""
    for name in names:
        if name not in ROWS:
            raise InputError(
                f"no row '{name}'; {nearest(name, list(ROWS))}the rows are {', '.join(ROWS)}"
            )
    return [ROWS[name] for name in names or ROWS]


def heading() -> str:
    """Return the head of the table."""
    return (
        f"{'row':<{_NAME}} {'published or closed form':<{_NUMBER}} {'pinred':<{_NUMBER}} "
        "difference   bound"
    )


def line(result: Result) -> str:
    """Return a row of the table; further numbers of a row are left out."""
    columns = [_first(text) for text in (result.expected, result.found)]
    verdict = "ok" if result.passed else "FAILED"
    return (
        f"{result.row.name:<{_NAME}} {columns[0]:<{_NUMBER}} {columns[1]:<{_NUMBER}} "
        f"{result.difference:10.1e} {result.bound:7.0e} {verdict}"
    )


def report(result: Result) -> str:
    """Return one row in full: quantity, source, both routes, difference and code."""
    row = result.row
    labels = ("published" if row.printed else "closed form", "pinred", "difference")
    values = (result.expected, result.found, f"{result.difference:.1e}, at most {result.bound:.0e}")
    lines = [f"{row.name}: {row.quantity}", f"  {'source':<12} {row.source}"]
    lines += [f"  {label:<12} {value}" for label, value in zip(labels, values, strict=True)]
    lines += [f"  {'verdict':<12} {'ok' if result.passed else 'FAILED'}", "", row.code]
    return "\n".join(lines)


def summary(results: Sequence[Result]) -> str:
    """Return the last line of the table."""
    passed = sum(result.passed for result in results)
    return f"{passed} of {len(results)} rows agree"


def _first(text: str) -> str:
    """Return at most two of the numbers of a text."""
    values = text.split(", ")
    return ", ".join(values[:2]) + (", …" if len(values) > 2 else "")
