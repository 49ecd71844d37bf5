"""A figure by the name of its kind: the function of that name, with the options it takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ...common.errors import InputError
from .. import plots

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot(source: Any, kind: str, **options: Any) -> Figure:
    """Return the figure of a kind: the function of that name in pinred.plots.

    source: what the function takes, a Trajectory for all but work_precision.
    Raises InputError for a kind or option that there is not, listing those there are;
    MissingPackageError if matplotlib is not installed.
    """
    known = options_of(kind)
    for option in options:
        if option not in known:
            has = f"its options are {', '.join(known)}" if known else "it has none"
            raise InputError(f"plot '{kind}' has no option '{option}'; {has}")
    figure: Figure = getattr(plots, kind)(source, **options)
    return figure


def options_of(kind: str) -> tuple[str, ...]:
    """Return the names of the options that a kind of plot takes.  Raises as `plot`."""
    if kind not in plots.KINDS:
        raise InputError(f"no plot of kind {kind!r}; the kinds are {', '.join(plots.KINDS)}")
    return tuple(getattr(plots, kind).__wrapped__.__kwdefaults__ or ())
