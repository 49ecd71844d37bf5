"""Views of a motion: a figure, a player, a page, a film."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from ..common.signatures import shows_fields
from ..simulation.trajectory import Trajectory
from .playback.view import FILM_FPS, View, ViewOptions, as_view
from .plots.by_kind import plot as plot

if TYPE_CHECKING:
    from .playback.server import Player


@shows_fields(View)
def play(
    traj: Trajectory,
    *,
    port: int | None = None,
    show: bool = True,
    wait: bool | None = None,
    **options: Unpack[ViewOptions],
) -> Player:
    """Play the motion in a browser on this machine, and return what serves it.

    port: any free one if None.  show: open the browser.  wait: serve until Ctrl-C (in a
    script; where somebody types on, return at once).  ghost: also draw the full simulation (ABA)
    beside it.  speed: seconds of the motion in one of playback, to begin with.  fps: frames in
    a second of playback.  pair: two joints, the axes of the shape panel (those that move the
    most without spinning).  meshes: draw what the robot's file says, else bodies made from the
    inertias; or folders in which meshes are looked for.  Raises InputError, OutputError.
    """
    from .playback.show import play as serve

    return serve(traj, as_view(options, "play"), port=port, show=show, wait=wait)


@shows_fields(View)
def save_html(traj: Trajectory, path: str | Path, **options: Unpack[ViewOptions]) -> int:
    """Write the playback as one HTML file that needs no network; return its size in bytes.

    options: as of `play`.  Raises InputError, OutputError.
    """
    from .playback.page import save_html as write

    return write(traj, path, as_view(options, "save_html"))


@shows_fields(View, fps=FILM_FPS)
def save_film(
    traj: Trajectory,
    path: str | Path,
    *,
    size: tuple[int, int] = (960, 720),
    progress: Callable[[float], None] | None = None,
    **options: Unpack[ViewOptions],
) -> int:
    """Write the playback as film.mp4 or film.gif, or as frames film_0000.png and so on.

    size: width and height in pixels.  progress: called with the part that is done.
    options: as of `play`.  Returns the number of frames.  Raises InputError, OutputError.
    """
    from .playback.film import save_film as write

    view = as_view({"fps": FILM_FPS, **options}, "save_film")
    return write(traj, path, view, size=size, progress=progress)
