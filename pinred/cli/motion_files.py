"""Source of the motions in commands: a .npz file, or the simulation of a scene file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import InputError

if TYPE_CHECKING:
    from ..views.motion_source import MotionSource
    from ..views.playback.view_options import View


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
        from ..common.progress import ProgressBar
        from ..views.playback.film import save_film

        with ProgressBar("film   ", what="renders a film") as bar:
            count = save_film(motion, out, view, progress=bar)
        print(f"{count} frames written to {out}")


def check_robot(source: str, robot: str | None) -> None:
    """Raise InputError for the option --robot with any source except a .npz file."""
    if robot is not None and Path(source).suffix != ".npz":
        raise InputError(f"--robot applies to .npz files only; '{source}' names its robot")
