"""Playback of a motion in the viewer with a given name."""

from __future__ import annotations

from ...common.errors import InputError
from ..motion_source import MotionSource
from .server import Player, play, run
from .view_options import View
from .viewers import VIEWERS


def play_in_viewer(
    source: MotionSource,
    view: View,
    *,
    viewer: str,
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
    if viewer not in VIEWERS:
        raise InputError(f"viewer must be {' or '.join(map(repr, VIEWERS))}, got {viewer!r}")
    if viewer == "viser":
        from .viser_player import ViserPlayer

        return run(ViserPlayer(source, view, port), "playing at", show=show, wait=wait)
    return play(source, view, port=port, show=show, wait=wait)
