"""Rows of the table of published results: a number from the literature beside pinred's.

The decorator `row` adds a row to the table.
"""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, FrozenArrays

_WIDTH = 12  # significant digits of a closed form
_ROUND_OFF = 1e-12  # fraction of the largest number below which a number is shown as zero


@dataclass(frozen=True)
class Numbers(FrozenArrays):
    """A quantity by two routes.

    Attributes:
        expected: Published number or closed form, (k,).
        found: The same quantity by pinred, (k,).
    """

    expected: Array
    found: Array


def numbers(expected: ArrayLike, found: ArrayLike) -> Numbers:
    """Return the numbers of a row.

    Args:
        expected: Published number or closed form: one number or (k,).
        found: The same quantity by pinred.
    Returns:
        The numbers, as vectors of equal length.
    Raises:
        ValueError: The routes do not have equally many numbers.
    """
    routes = [np.atleast_1d(np.asarray(value, dtype=float)) for value in (expected, found)]
    if routes[0].ndim != 1 or routes[0].shape != routes[1].shape:
        raise ValueError(f"expected {routes[0].shape} numbers, found {routes[1].shape}")
    return Numbers(*routes)


@dataclass(frozen=True)
class Row:
    """A row of the table.

    Attributes:
        name: Name of the row.
        quantity: System and compared quantity, with its unit.
        source: Publication of the number, or of the system whose closed form is derived.
        compute: Function that returns both numbers.
        relative: Largest accepted difference, relative to the largest expected number.
        printed: The number as printed in the source; "" for a closed form.  Half a unit of its
            last digit is then the largest accepted difference.
    """

    name: str
    quantity: str
    source: str
    compute: Callable[[], Numbers] = field(repr=False)
    relative: float = 0.0
    printed: str = ""

    def bound(self, expected: Array) -> float:
        """Return the largest accepted difference for the expected numbers (k,)."""
        if self.printed:
            return 0.5 * 10.0 ** -len(self.printed.partition(".")[2])
        return self.relative * float(np.abs(expected).max())

    def run(self) -> Result:
        """Compute both numbers and compare them."""
        pair = self.compute()
        difference = float(np.abs(pair.expected - pair.found).max())
        return Result(self, pair, difference, self.bound(pair.expected))

    @property
    def code(self) -> str:
        """Source code of the row, without its decorator."""
        source = textwrap.dedent(inspect.getsource(self.compute))
        return source[source.index("def ") :]


@dataclass(frozen=True)
class Result:
    """The result of a row.

    Attributes:
        row: The row.
        pair: Both numbers.
        difference: Largest absolute difference; NaN if a number is NaN.
        bound: Largest accepted difference.
    """

    row: Row
    pair: Numbers
    difference: float
    bound: float

    @property
    def passed(self) -> bool:
        """Whether the difference is within its bound; NaN never is."""
        return self.difference <= self.bound

    @property
    def expected(self) -> str:
        """The printed number, or the digits of the closed form."""
        return self.row.printed or digits(self.pair.expected)

    @property
    def found(self) -> str:
        """Digits of pinred's number."""
        return digits(self.pair.found)


def digits(values: Array) -> str:
    """Return numbers (k,) as text, with twelve significant digits, and round-off as zero."""
    values = np.where(np.abs(values) > _ROUND_OFF * np.abs(values).max(), values, 0.0)
    return ", ".join(f"{value:.{_WIDTH}g}" for value in values)


ROWS: dict[str, Row] = {}  # all rows by name, in the order of the table


def row(
    source: str, *, relative: float = 0.0, printed: str = ""
) -> Callable[[Callable[[], Numbers]], Row]:
    """Return a decorator that makes a row of a function; see Row for the arguments.

    The function has the name of the row. The section Returns of its docstring is the quantity.
    """

    def decorate(compute: Callable[[], Numbers]) -> Row:
        name = compute.__name__.replace("_", "-")
        quantity = " ".join((compute.__doc__ or "").partition("Returns:")[2].split()).rstrip(".")
        ROWS[name] = Row(name, quantity, source, compute, relative, printed)
        return ROWS[name]

    return decorate


_NAME, _NUMBER = 22, 34  # widths of columns


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
    words = text.split(", ")
    return ", ".join(words[:2]) + (", …" if len(words) > 2 else "")
