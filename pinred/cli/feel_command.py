"""`pinred feel`: move the joints of a robot in a browser; the base follows by the connection."""

from __future__ import annotations

import argparse

from .command_options import add_robot, option_adder, system_of


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub)
    add = option_adder(sub)
    add("--pair J1,J2", "two joints for the axes of the shape plane")
    add("--no-meshes", "draw bodies from their inertias instead of meshes")
    add("--port P", "port of the web server (default: a free one)", int)
    add("--no-open", "do not open the browser")
    add("--out FILE", "write the page FILE.html instead of opening it")


def run(arguments: argparse.Namespace) -> int:
    """Open or write the page.  Returns 0."""
    from ..common.errors import InputError
    from ..common.files import check_path
    from ..views.motions import feel, save_html
    from ..views.playback.server import check_port

    if arguments.out is not None and arguments.port is not None:
        raise InputError("--port applies to the page in a browser, not to --out")
    if arguments.out is not None:
        check_path(arguments.out, (".html",))  # Check the path before the robot is loaded.
    check_port(arguments.port)
    pair = None if arguments.pair is None else arguments.pair.split(",")
    system, meshes = system_of(arguments), not arguments.no_meshes
    if arguments.out is None:
        show = not arguments.no_open
        feel(system, pair=pair, meshes=meshes, port=arguments.port, show=show, wait=True)
    else:
        size = save_html(system, arguments.out, feel=True, pair=pair, meshes=meshes)
        print(f"written to {arguments.out} ({size / 1e6:.2f} MB)")
    return 0
