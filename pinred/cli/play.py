"""`pinred play`: a motion in a browser, as an HTML file, or as a film."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..common.errors import InputError
from .motion_files import motion_in


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("motion", metavar="MOTION", help="traj.npz, or a scene file (.toml)")
    sub.add_argument("--robot", metavar="R", help="the robot of an npz that does not name its own")
    sub.add_argument("--ghost", action="store_true", help="beside it, full ABA (scenes only)")
    sub.add_argument("--speed", metavar="S", type=float, default=1.0, help="speed at first (1)")
    sub.add_argument("--pair", metavar="J1,J2", help="joints on the axes of the shape panel")
    sub.add_argument(
        "--meshes", metavar="FOLDER", action="append", help="where to look for the meshes of a URDF"
    )
    sub.add_argument("--no-meshes", action="store_true", help="draw bodies from their inertias")
    sub.add_argument("--port", metavar="P", type=int, help="where to serve; any free port")
    sub.add_argument("--no-open", action="store_true", help="do not open the browser")
    sub.add_argument("--out", metavar="FILE", help="write FILE.html, .mp4, .gif or .png instead")
    sub.add_argument("--fps", metavar="F", type=float, help="frames a second (60; films 30)")


def run(options: argparse.Namespace) -> int:
    """Run the command.  Returns 0."""
    from ..views.playback.view import FILM_FPS, FPS, View

    _check(options)
    pair = None if options.pair is None else tuple(options.pair.split(","))
    out = None if options.out is None else Path(options.out)
    fps = options.fps
    if fps is None:
        fps = FPS if out is None or out.suffix == ".html" else FILM_FPS
    meshes = options.meshes or not options.no_meshes
    view = View(ghost=options.ghost, speed=options.speed, fps=fps, pair=pair, meshes=meshes)
    if out is not None:
        from ..common.files import check_path
        from ..views.playback.film import SUFFIXES

        check_path(out, (".html", *SUFFIXES))  # before a long simulation
    else:
        from ..views.playback.server import check_port

        check_port(options.port)
    motion = motion_in(options.motion, options.robot)
    if out is None:
        from ..views.playback.show import play

        play(motion, view, port=options.port, show=not options.no_open, wait=True)
    elif out.suffix == ".html":
        from ..views.playback.page import save_html

        print(f"written to {out} ({save_html(motion, out, view) / 1e6:.2f} MB)")
    else:
        from ..common.progress import ProgressBar
        from ..views.playback.film import save_film

        with ProgressBar("film   ") as bar:
            count = save_film(motion, out, view, progress=bar)
        print(f"{count} frames written to {out}")
    return 0


def _check(options: argparse.Namespace) -> None:
    """Raise InputError for a motion of another kind, or an option that would change nothing."""
    if Path(options.motion).suffix not in (".npz", ".toml"):
        raise InputError(f"play takes a .npz or a scene file (.toml), got '{options.motion}'")
    if options.out is not None and options.port is not None:
        raise InputError("--port is for playing in a browser, not with --out")
    if options.meshes and options.no_meshes:
        raise InputError("--meshes says where to find what --no-meshes leaves out; give one")
    page = options.out is None or Path(options.out).suffix == ".html"
    if options.fps is not None and page and Path(options.motion).suffix == ".npz":
        raise InputError(
            "--fps is for films and for scenes; a page shows a .npz at the times that it holds "
            "(`pinred simulate --samples` makes more of them)"
        )
