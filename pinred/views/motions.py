"""Views of a motion: a figure, a player, a page, a film."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..simulation.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .playback.server import Player


def plot(traj: Trajectory, kind: str = "shape", **options: Any) -> Figure:
    """Return a figure of the motion: pinred.plots has a function for each kind.

    Raises InputError for a kind or an option that there is not, listing those there are;
    MissingPackageError if matplotlib is not installed.
    """
    from .plots import plot as draw

    return draw(traj, kind, **options)


def play(
    traj: Trajectory,
    *,
    port: int | None = None,
    show: bool = True,
    wait: bool | None = None,
    **options: Any,
) -> Player:
    """Play the motion in a browser on this machine, and return what serves it.

    port: any free one if None.  show: open the browser.  wait: serve until Ctrl-C (in a
    script; where somebody types on, return at once).  options: ghost, speed, fps, pair,
    meshes (see views.playback.view.View).  Raises InputError, OutputError.
    """
    from .playback.show import play as serve
    from .playback.view import as_view

    return serve(traj, as_view(options, "play"), port=port, show=show, wait=wait)


def save_html(traj: Trajectory, path: str | Path, **options: Any) -> int:
    """Write the playback as one HTML file that needs no network; return its size in bytes.

    options: as of `play`.  Raises InputError, OutputError.
    """
    from .playback.page import save_html as write
    from .playback.view import as_view

    return write(traj, path, as_view(options, "save_html"))


def save_film(
    traj: Trajectory,
    path: str | Path,
    *,
    size: tuple[int, int] = (960, 720),
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> int:
    """Write the playback as film.mp4 or film.gif, or as frames film_0000.png and so on.

    size: width and height in pixels.  progress: called with the part that is done.
    options: as of `play`, with 30 for fps.  Returns the number of frames.  Raises
    InputError, OutputError.
    """
    from .playback.film import FPS
    from .playback.film import save_film as write
    from .playback.view import as_view

    view = as_view({"fps": FPS, **options}, "save_film")
    return write(traj, path, view, size=size, progress=progress)
