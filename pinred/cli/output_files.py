"""Results of commands: figures and other files, their messages, and comparisons."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..judge.compare_chain import ChainReport
    from ..judge.verdict import Report
    from ..planning.optimisation.best_gait import BestGait
    from ..planning.reorientation.flight_plan import FlightPlan
    from ..planning.reorientation.turn_plan import TurnPlan

_NO_DATE: dict[str, dict[str, Any]] = {  # Without a date, equal figures produce equal files.
    ".png": {},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure to a .png, .pdf or .svg file; raise OutputError if that fails."""
    from ..common.files import write_atomic

    suffix = path.suffix
    write_atomic(
        path, lambda file: figure.savefig(file, format=suffix[1:], metadata=_NO_DATE[suffix])
    )


def describe_file(path: Path) -> str:
    """Return the message that a file or a folder was written, with its size."""
    size = sum(file.stat().st_size for file in (path, *path.rglob("*")) if file.is_file())
    return f"written to {path} ({size / 1e3:.0f} kB)"


def write_series(path: Path, names: Sequence[str], arrays: Mapping[str, Any]) -> None:
    """Write values over time to an .npz or .csv file.

    Args:
        path: The file.
        names: Names of the columns of the .csv file.
        arrays: Times, (T,), values, (T, n), and further arrays, by their names in the .npz file.
            The .csv file has times and values only.
    """
    import numpy as np

    from ..common.files import write_atomic, write_table

    if path.suffix == ".npz":
        write_atomic(path, lambda file: np.savez(file, **arrays))
        return
    t, values, *_ = arrays.values()
    rows = np.column_stack([t, values]).tolist()
    write_table(path, names, (dict(zip(names, row, strict=True)) for row in rows))


def print_report(report: Report | ChainReport) -> int:
    """Print a comparison with full ABA; return the exit code of its verdict."""
    from ..judge.verdict import EXIT_CODES

    print(report)
    return EXIT_CODES[report.verdict]


def write_plan(
    plan: BestGait | TurnPlan | FlightPlan,
    path: Path | None,
    write_data: Callable[[Path], None],
    *,
    compare: bool,
) -> int:
    """Write a plan as a figure or as data, and compare it with full ABA.

    Args:
        plan: The gait or motion.
        path: Path of a figure or of data; None to write nothing.
        write_data: Function that writes data to the path, called if its suffix is not that of
            a figure.
        compare: Whether to print the comparison.
    Returns:
        0, or the exit code of the comparison.
    """
    from ..common.files import FIGURES

    if path is not None:
        if path.suffix in FIGURES:
            from ..views.plots.by_kind import plot

            is_loop = hasattr(plan, "gait")
            save_figure(plot(plan, "loop") if is_loop else plot(plan.trajectory, "shape"), path)
        else:
            write_data(path)
        print(describe_file(path))
    return print_report(plan.report) if compare else 0
