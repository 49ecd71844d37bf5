"""`pinred play`: show a motion in a browser, or write it as an HTML page or a film."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..common.errors import InputError
from .command_options import option_adder
from .motion_files import motion_in, show_motion


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..views.playback.viewers import VIEWER, VIEWERS

    text = "motion traj.npz, or scene file (.toml)"
    sub.add_argument("motion", metavar="MOTION", help=text)
    add = option_adder(sub)
    add("--robot R", "robot of a .npz file that names none")
    add("--ghost", "show full ABA too (scene files only)")
    add("--speed S", "initial playback speed", float, 1.0)
    add("--pair J1,J2", "two joints for the axes of the shape panel")
    add("--sphere JOINT", "draw the momentum sphere of a joint's body, or of 'base'")
    add("--meshes FOLDER", "folder with the meshes of a URDF; repeatable", action="append")
    add("--no-meshes", "draw bodies from their inertias instead of meshes")
    viewers = "; ".join(f"{name}: {text}" for name, text in VIEWERS.items())
    add("--viewer V", f"{viewers} (default: {VIEWER})", choices=[*VIEWERS])
    add("--port P", "port of the web server (default: a free one)", int)
    add("--no-open", "do not open the browser")
    add("--out FILE", "write FILE.html, .rrd (for rerun), .mp4, .gif or .png instead of playing")
    add("--fps F", "frames per second (default: 60; films 30)", float)


def run(arguments: argparse.Namespace) -> int:
    """Play or write the motion.  Returns 0."""
    from ..views.playback.view_options import View, default_fps
    from ..views.playback.viewers import PAGES

    _check(arguments)
    pair = None if arguments.pair is None else tuple(arguments.pair.split(","))
    out = None if arguments.out is None else Path(arguments.out)
    fps = default_fps(out) if arguments.fps is None else arguments.fps
    meshes = arguments.meshes or not arguments.no_meshes
    view = View(
        ghost=arguments.ghost, speed=arguments.speed, fps=fps, pair=pair,
        sphere=arguments.sphere, meshes=meshes,
    )  # fmt: skip
    if out is not None:
        from ..common.files import check_path
        from ..views.playback.film import SUFFIXES

        check_path(out, (*PAGES, *SUFFIXES))  # Check the path before a long simulation.
    else:
        from ..views.playback.server import check_port

        check_port(arguments.port)
    motion = motion_in(arguments.motion, arguments.robot)
    show_motion(
        motion, out, view, viewer=arguments.viewer, port=arguments.port, show=not arguments.no_open
    )
    return 0


def _check(arguments: argparse.Namespace) -> None:
    """Raise InputError for an unsupported kind of motion, or for an option without effect."""
    from ..views.playback.viewers import PAGES

    if Path(arguments.motion).suffix not in (".npz", ".toml"):
        raise InputError(f"play takes a .npz or a scene file (.toml), got '{arguments.motion}'")
    if arguments.out is not None and arguments.port is not None:
        raise InputError("--port applies to playback in a browser, not to --out")
    if arguments.out is not None and arguments.viewer is not None:
        raise InputError("--viewer applies to playback in a browser, not to --out")
    if arguments.meshes and arguments.no_meshes:
        raise InputError("--meshes and --no-meshes exclude each other; pass only one of them")
    page = arguments.out is None or Path(arguments.out).suffix in PAGES
    if arguments.fps is not None and page and Path(arguments.motion).suffix == ".npz":
        raise InputError(
            "--fps applies to films and scenes; a page shows a .npz file at its stored times "
            "(`pinred simulate --samples` stores more of them)"
        )
