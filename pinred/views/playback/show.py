"""play(): serve the page of a motion to a browser on this machine."""

from __future__ import annotations

import sys

from ..motion_source import MotionSource
from .page import page
from .server import Player, check_port
from .view import View


def play(
    source: MotionSource,
    view: View,
    *,
    port: int | None = None,
    show: bool = True,
    wait: bool | None = None,
) -> Player:
    """Serve the playback of a motion and print its address.

    Args:
        source: The motion.
        view: Options of the drawing.
        port: Port; any free one if None.
        show: Open the user's browser.
        wait: Serve until Ctrl-C. If None, wait in scripts but not in interactive sessions.
    Returns:
        The server.
    Raises:
        KeyboardInterrupt: Ctrl-C was pressed while the browser was opened, without waiting.
    """
    check_port(port)  # before the page is built, which may take long
    player = Player(page(source, view), port)
    wait = not hasattr(sys, "ps1") if wait is None else wait
    try:
        print(f"playing at {player.url}" + (" (Ctrl-C ends it)" if wait else ""), flush=True)
        if show:
            player.open()
        if wait:
            player.wait()
    except KeyboardInterrupt:
        player.close()
        if not wait:
            raise
    return player
