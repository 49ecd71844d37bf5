"""Keys of values and signals in scene files: numbers, shapes, tables, formulas."""

from __future__ import annotations

from .schema import ByName, Either, Key, ListOf, Named, Number, Table, Text, Whole

ENDS = ("natural", "clamped", "not-a-knot", "periodic")
_BOTH = "time and value: two names in the header of the csv, or two columns counted from 0"

NUMBER, POSITIVE = Number(), Number(positive=True)
NUMBERS = ListOf(NUMBER)
PER_JOINT = Named("per_joint", Either((NUMBER, ByName(NUMBER))))
SHAPE = Named("shape", Either((NUMBERS, ByName(NUMBER))))


def _tabulated(words: str, **more: Key) -> Table:
    """Return the table of a signal through points, given in the table or in a csv file."""
    keys = {
        "times": Key(NUMBERS, "strictly increasing times [s], at most 1000"),
        "values": Key(NUMBERS, "as many values"),
        "file": Key(Text(), "a csv file with the times and values, relative to this file"),
        "columns": Key(ListOf(Either((Text((), "a name"), Whole())), 2), _BOTH, default="[0, 1]"),
        **more,
    }
    return Table(
        keys,
        words,
        needs={"times": "values", "values": "times", "columns": "file"},
        one_of=("times", "file"),
    )


_END = Key(Text(ENDS), "what holds at both ends", default="natural")
_FOURIER = Table(
    {
        "mean": Key(NUMBER, "the mean", default="0"),
        "cosines": Key(NUMBERS, "amplitudes of cos(2πk t/period), k from 1", default="none"),
        "sines": Key(NUMBERS, "amplitudes of sin(2πk t/period), k from 1", default="none"),
        "period": Key(POSITIVE, "period [s]", required=True),
    },
    "a Fourier series",
)
_KINDS = {
    "spline": Key(_tabulated("a cubic spline", end=_END), "the cubic spline through a table"),
    "linear": Key(_tabulated("straight lines"), "straight lines from entry to entry"),
    "hold": Key(_tabulated("steps"), "each value until the next"),
    "fourier": Key(_FOURIER, "mean + Σ aₖ cos(2πk t/period) + bₖ sin(2πk t/period)"),
}
SIGNAL_TABLE = Named("signal_table", Table(_KINDS, "a signal table", one_of=tuple(_KINDS)))
SIGNAL = Named("signal", Either((NUMBER, Text((), "a formula in t"), SIGNAL_TABLE)))
_FORMULA = Text((), "a formula in t, x, xdot and mu")
ACTION = Named("action", Either((NUMBER, _FORMULA, SIGNAL_TABLE)))
