"""Public functions for views of a motion: figure, player, HTML page, film."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from ..analysis.connections.connection import Connection
from ..common.argument_kinds import checks_arguments, shows_fields
from ..common.errors import InputError
from ..system.system import System
from .motion_source import MotionSource
from .playback.colours_and_view_options import FILM_FPS, VIEWER, VIEWERS, View, ViewOptions, as_view
from .plots.by_kind import plot as plot

if TYPE_CHECKING:
    from .playback.page import Player


@checks_arguments
@shows_fields(View)
def play(
    traj: MotionSource,
    *,
    viewer: str = VIEWER,
    port: int | None = None,
    show: bool = True,
    wait: bool | None = None,
    **options: Unpack[ViewOptions],
) -> Player:
    """Play a motion in a browser on this machine.

    Args:
        traj: The motion: a Trajectory, or a recording read from a file.
        viewer: "pinred" for pinred's page, or "viser" for the page of viser, which the extra
            viser installs.
        port: Port of the server; an unused port if None.
        show: Open the user's browser.
        wait: Serve until Ctrl-C. If None, wait in scripts but not in interactive sessions.
        ghost: Also draw the full simulation (Pinocchio's ABA) next to the motion.
        speed: Seconds of the motion in one second of playback, initially.
        fps: Frames per second of playback.
        pair: Names of two joints for the axes of the shape panel. If None, the two that move most
            without full rotations.
        sphere: Name of a joint, or "base": draw the sphere on which its body sees the conserved
            angular momentum.
        meshes: Draw the shapes of the robot's file; False draws ellipsoids of its inertias. Folders
            are searched for meshes.
        **options: The options of View, listed above.
    Returns:
        The server of the page.
    Raises:
        InputError: An option is invalid, or the port is taken.
        MissingPackageError: viser is requested and not installed.
        OutputError: The page cannot be served.
    """
    view = as_view(options, "play")
    return play_view(traj, view, viewer=viewer, port=port, show=show, wait=wait)


def play_view(
    source: MotionSource,
    view: View,
    *,
    viewer: str = VIEWER,
    port: int | None = None,
    show: bool = True,
    wait: bool | None = None,
) -> Player:
    """Serve the playback of a motion and print its address.

    Args:
        source: The motion.
        view: Options of the drawing.
        viewer: Name of a viewer in VIEWERS.
        port: Port; an unused port if None.
        show: Open the user's browser.
        wait: Serve until Ctrl-C. If None, wait in scripts but not in interactive sessions.
    Returns:
        The server.
    Raises:
        InputError: The viewer is unknown.
    """
    from .playback.page import check_port, page, run, serve

    if viewer not in VIEWERS:
        raise InputError(f"viewer must be {' or '.join(map(repr, VIEWERS))}, got {viewer!r}")
    if viewer == "viser":
        from .playback.viser_player import ViserPlayer

        return run(ViserPlayer(source, view, port), "playing at", show=show, wait=wait)
    check_port(port)  # check the port first, because building the page may take long
    return serve(page(source, view), "playing at", port=port, show=show, wait=wait)


@checks_arguments
@shows_fields(View)
def save_html(
    traj: MotionSource | System | Connection,
    path: str | Path,
    *,
    feel: bool = False,
    **options: Unpack[ViewOptions],
) -> int:
    """Write the playback of a motion, or the page of `feel`, as one self-contained HTML file.

    Args:
        traj: The motion: a Trajectory, or a recording read from a file. With `feel`, a System or a
            Connection.
        path: The .html file.
        feel: Write the page on which joints are moved by hand and the base follows (see `feel`).
            It takes only the options `pair` and `meshes`.
        ghost: Also draw the full simulation (Pinocchio's ABA) next to the motion.
        speed: Seconds of the motion in one second of playback, initially.
        fps: Frames per second of playback.
        pair: Names of two joints for the axes of the shape panel, see `play`.
        sphere: Body whose momentum sphere is drawn, see `play`.
        meshes: Draw the shapes of the robot's file, see `play`.
        **options: The options of View, listed above.
    Returns:
        Size of the file in bytes.
    Raises:
        InputError: An option or the suffix is invalid.
        OutputError: The file cannot be written.
    """
    if feel:
        from .feel.feel_page import save_feel

        return save_feel(_as_source(traj), path, **_feel_options(options))
    if isinstance(traj, System | Connection):
        raise InputError(
            "save_html: expected a motion, got a "
            f"{type(traj).__name__}. Pass feel=True for the page on which joints are moved by hand."
        )
    from .playback.page import save_html as write

    return write(traj, path, as_view(options, "save_html"))


@checks_arguments
def feel(
    source: System | Connection,
    *,
    pair: Sequence[str] | None = None,
    meshes: bool | str | Path | Sequence[str | Path] = True,
    port: int | None = None,
    show: bool = True,
    wait: bool | None = None,
) -> Player:
    """Open a page on which joints are moved by hand and the base turns by the connection.

    Args:
        source: A system, at zero momentum, or a connection of a system.
        pair: Names of the joints on the axes of the shape plane. If None, the two with the largest
            curvature.
        meshes: Draw the shapes of the robot's file, see `play`.
        port: Port of the server; an unused port if None.
        show: Open the user's browser.
        wait: Serve until Ctrl-C. If None, wait in scripts but not in interactive sessions.
    Returns:
        The server of the page.
    Raises:
        InputError: The robot has no joints, an option is invalid, or the port is taken.
        SymmetryError: Gravity changes the momenta.
    """
    from .feel.feel_page import feel_page
    from .playback.page import check_port, serve

    options = _feel_options({"pair": pair, "meshes": meshes})
    check_port(port)
    return serve(feel_page(source, **options), "page at", port=port, show=show, wait=wait)


def _as_source(value: MotionSource | System | Connection) -> System | Connection:
    if isinstance(value, System | Connection):
        return value
    raise InputError(
        f"save_html: with feel=True, expected a System or a Connection, got {type(value).__name__}."
    )


def _feel_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Check the options of the page of `feel`: pair and meshes."""
    for name in options:
        if name not in ("pair", "meshes"):
            raise InputError(
                f"feel: the page has no option '{name}'; the options are pair, meshes."
            )
    view = as_view(options, "feel")
    return {"pair": view.pair, "meshes": view.meshes}


@checks_arguments
@shows_fields(View, fps=FILM_FPS)
def save_film(
    traj: MotionSource,
    path: str | Path,
    *,
    size: tuple[int, int] = (960, 720),
    progress: Callable[[float], None] | None = None,
    **options: Unpack[ViewOptions],
) -> int:
    """Write the playback as film.mp4 or film.gif, or as frames film_0000.png and so on.

    Args:
        traj: The motion: a Trajectory, or a recording read from a file.
        path: The file; its suffix .mp4, .gif or .png determines the format.
        size: Width and height in pixels.
        progress: Called with the completed fraction.
        ghost: Also draw the full simulation (Pinocchio's ABA) next to the motion.
        speed: Seconds of the motion in one second of the film.
        fps: Frames per second of the film.
        pair: Names of two joints for the axes of the shape panel, see `play`.
        sphere: Body whose momentum sphere is drawn, see `play`.
        meshes: Draw the shapes of the robot's file, see `play`.
        **options: The options of View, listed above.
    Returns:
        Number of frames.
    Raises:
        InputError: An option is invalid, or ffmpeg is not installed.
        OutputError: Rendering or writing fails.
    """
    from .playback.film import save_film as write

    view = as_view({"fps": FILM_FPS, **options}, "save_film")
    return write(traj, path, view, size=size, progress=progress)


@checks_arguments
@shows_fields(View)
def save_rrd(traj: MotionSource, path: str | Path, **options: Unpack[ViewOptions]) -> int:
    """Write a motion as a recording for the rerun viewer, which the extra rerun installs.

    The file contains the placements of all bodies with their shapes, and energy, momentum and
    shape over time.  Its layout has a 3D view whose camera sees the robot at all times.

    Args:
        traj: The motion: a Trajectory, or a recording read from a file.
        path: The .rrd file.
        ghost: Also draw the full simulation (Pinocchio's ABA) next to the motion.
        speed: Seconds of the motion in one second of playback, initially.
        fps: Frames per second of playback.
        pair: For other views; it must be None.
        sphere: Body whose momentum sphere is drawn, see `play`.
        meshes: Draw the shapes of the robot's file, see `play`.
        **options: The options of View, listed above.
    Returns:
        Size of the file in bytes.
    Raises:
        InputError: An option or the suffix is invalid.
        MissingPackageError: rerun-sdk is not installed.
        OutputError: The file cannot be written.
    """
    from .playback.rerun_file import save_rrd as write

    return write(traj, path, as_view(options, "save_rrd"))
