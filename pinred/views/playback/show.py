"""Show a motion: serve its page, in a browser on this machine."""

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
    """Serve the playback of a motion, print where, and return the Player.

    port: any free one if None.  show: open the user's browser.  wait: serve until Ctrl-C; if
    None, only where nobody types on, that is in a script.
    Errors as of `Player` and `page`.
    """
    check_port(port)  # before the page is made, which may take long
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
