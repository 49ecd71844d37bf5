"""Gaits and connections that commands take: from a gait file, or of a robot by name."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import InputError
from ..common.plain_names import quoted
from .options import add_parameters, numbers_in, parameters_in, refuse_of_robots

if TYPE_CHECKING:
    from ..planning.gait_files.load_gait import GaitFile


def add_source(sub: argparse.ArgumentParser) -> None:
    """Add where connection and gait come from."""
    sub.add_argument(
        "source", metavar="SOURCE", help="a gait file (.toml), or a robot (`pinred robots`, a file)"
    )
    sub.add_argument("--group", metavar="G", help="the symmetry of a robot")
    add_parameters(sub, "a number of a robot")
    sub.add_argument("--gait", metavar="FILE", help="recorded joint data (.csv, .npz), for a robot")
    sub.add_argument(
        "--circle", metavar="J1,J2,RADIUS",
        help="a circle of two joints about zero, for a robot [rad | m]",
    )  # fmt: skip


def source_of(options: argparse.Namespace, *, gait: bool) -> GaitFile:
    """Return connection and gait.  gait: whether a robot must come with one."""
    import numpy as np

    from ..analysis.connections.connection import Connection
    from ..analysis.gaits.gait import Gait
    from ..common.names import joint_index
    from ..planning.gait_files.load_gait import GaitFile, load_gait
    from ..system.load import load

    if Path(options.source).suffix == ".toml":
        refuse_of_robots(options, options.source, "group", "gait", "circle", "parameter")
        return load_gait(options.source)
    parameters = parameters_in(options.parameter)
    system = load(options.source, group=options.group, parameters=parameters)
    connection = Connection.mechanical(system)
    if (options.gait is None) == (options.circle is None) and (gait or options.gait is not None):
        raise InputError("a robot needs a gait: give --gait FILE or --circle J1,J2,RADIUS")
    none, path = np.zeros((1, system.m)), None
    if options.gait is not None:
        path = Gait.read(options.gait)
    elif options.circle is not None:
        words = options.circle.split(",")
        if len(words) != 3:
            raise InputError(f"--circle takes J1,J2,RADIUS, got {quoted(options.circle)}")
        (radius,) = numbers_in(words[2], "circle") or [0.0]
        cos, sin = none.copy(), none.copy()
        cos[0, joint_index(words[0], system.shape_names, "--circle")] = radius
        sin[0, joint_index(words[1], system.shape_names, "--circle")] = radius
        path = Gait.fourier(none[0], cos, sin)
    return GaitFile(system, connection, path, np.zeros(system.r))
