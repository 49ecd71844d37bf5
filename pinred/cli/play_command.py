"""`pinred play`: show a motion or a robot in a browser, or write it as an HTML page or a film."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import InputError
from .command_options import option_adder
from .motion_files import check_robot, motion_in, show_motion

if TYPE_CHECKING:
    from ..views.motion_source import MotionSource


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..views.playback.viewers import VIEWER, VIEWERS

    text = "motion traj.npz, scene file (.toml), or a robot, which is shown at rest"
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
    is_motion = Path(arguments.motion).suffix in (".npz", ".toml")
    motion = (
        motion_in(arguments.motion, arguments.robot)
        if is_motion
        else _at_rest(arguments.motion, arguments.meshes)
    )
    show_motion(
        motion, out, view, viewer=arguments.viewer, port=arguments.port, show=not arguments.no_open
    )
    return 0


def _at_rest(robot: str, meshes: list[str] | None) -> MotionSource:
    """Return a motion in which a robot, given by name or file, stays in its neutral shape."""
    from ..simulation.simulate import simulate
    from ..system.load import load

    system = load(robot, gravity=(0.0, 0.0, 0.0), meshes=meshes or ())
    return simulate(
        system, xdot0=[0.0] * system.m, momentum=0, passive=False, duration=1.0, times=[0.0, 1.0]
    )


def _check(arguments: argparse.Namespace) -> None:
    """Raise InputError for an unsupported kind of motion, or for an option without effect."""
    from ..views.playback.viewers import PAGES

    check_robot(arguments.motion, arguments.robot)
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
