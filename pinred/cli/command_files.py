"""Files of commands: motions that they read, and figures, tables and messages that they write."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from ..common.files import FIGURES, check_path, write_atomic, write_table
from ..common.waiting import ProgressBar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..judge.impact_checks import ChainReport
    from ..judge.verdict import Report
    from ..planning.optimisation.optimise import BestGait
    from ..planning.reorientation.flight_search import FlightPlan
    from ..planning.reorientation.turning_loop import TurnPlan
    from ..views.motion_source import MotionSource
    from ..views.playback.view_options import View

_NO_DATE: dict[str, dict[str, Any]] = {  # Without a date, equal figures produce equal files.
    ".png": {},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}


def out_path(
    arguments: argparse.Namespace, suffixes: Sequence[str], folders: Sequence[str] = ()
) -> Path | None:
    """Check the option --out before the work starts.

    Args:
        arguments: Parsed arguments of the command.
        suffixes: Allowed suffixes.
        folders: Suffixes of formats that are folders.
    Returns:
        The path, or None without the option.
    Raises:
        InputError: No such file can be written; see `check_path`.
        OutputError: The folder or an existing file is read-only.
    """
    return None if arguments.out is None else check_path(arguments.out, suffixes, folders)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure to a .png, .pdf or .svg file; raise OutputError if that fails."""
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

    if path.suffix == ".npz":
        write_atomic(path, lambda file: np.savez(file, **arrays))
        return
    t, values, *_ = arrays.values()
    records = np.column_stack([t, values]).tolist()
    write_table(path, names, (dict(zip(names, cells, strict=True)) for cells in records))


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
    if path is not None:
        if path.suffix in FIGURES:
            from ..views.plots.by_kind import plot

            is_loop = hasattr(plan, "gait")
            save_figure(plot(plan, "loop") if is_loop else plot(plan.trajectory, "shape"), path)
        else:
            write_data(path)
        print(describe_file(path))
    return print_report(plan.report) if compare else 0


def motion_in(path: str, robot: str | None) -> MotionSource:
    """Return the motion in a .npz file, or simulate a scene file.

    `robot` names the robot of a .npz file that does not name one itself.
    """
    check_robot(path, robot)
    if Path(path).suffix == ".npz":
        from ..simulation.recording import read_recording

        return read_recording(path, robot)
    from ..scene.toml.reader import read_scene_file
    from ..simulation.simulate import simulate

    file = read_scene_file(path)
    if file.phases:
        from ..simulation.contact.chain import run_phases

        return run_phases(file, progress=True)
    return simulate(file.scene, engine=file.engine, check=file.check, progress=True)


def show_motion(
    motion: MotionSource, out: Path | None, view: View, *, viewer: str | None = None,
    port: int | None = None, show: bool = True,
) -> None:  # fmt: skip
    """Play a motion in a browser, or write it as a page, a recording for rerun, or a film.

    Args:
        motion: The motion.
        out: File to write; None to play.
        view: Options of the view.
        viewer: Name of the viewer; the default one if None.
        port: Port of the web server; any free one if None.
        show: Whether to open the browser.
    """
    if out is None:
        from ..views.motions import play_view
        from ..views.playback.view_options import VIEWER

        name = viewer or VIEWER
        play_view(motion, view, viewer=name, port=port, show=show, wait=True)
    elif out.suffix == ".html":
        from ..views.playback.page import save_html

        print(f"written to {out} ({save_html(motion, out, view) / 1e6:.2f} MB)")
    elif out.suffix == ".rrd":
        from ..views.playback.rerun_file import save_rrd

        print(f"written to {out} ({save_rrd(motion, out, view) / 1e6:.2f} MB)")
    else:
        from ..views.playback.film import save_film

        with ProgressBar("film   ", what="renders a film") as bar:
            count = save_film(motion, out, view, progress=bar)
        print(f"{count} frames written to {out}")


def check_robot(source: str, robot: str | None) -> None:
    """Raise InputError for the option --robot with any source except a .npz file."""
    if robot is not None and Path(source).suffix != ".npz":
        raise InputError(f"--robot applies to .npz files only; '{source}' names its robot")
