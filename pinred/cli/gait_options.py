"""Options of the commands on gaits: the source of a gait and its connection."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import InputError
from ..common.plain_names import quoted
from .command_options import (
    add_options,
    add_parameters,
    numbers_in,
    option_adder,
    parameters_in,
    refuse_of_robots,
)

if TYPE_CHECKING:
    from ..planning.gait_files.load_gait import GaitFile


def add_source(sub: argparse.ArgumentParser) -> None:
    """Add the options that name a connection and a gait."""
    from ..scene.toml.keys import LOAD

    text = "gait file (.toml), or robot: a name (see `pinred robots`) or a file"
    sub.add_argument("source", metavar="SOURCE", help=text)
    add_options(sub, {"group": LOAD.keys["group"]})
    add_parameters(sub)
    add = option_adder(sub)
    add("--gait FILE", "recorded joint data (.csv, .npz) of a robot")
    add("--circle J1,J2,RADIUS", "gait of a robot: a circle of two joints about zero [rad | m]")


def source_of(arguments: argparse.Namespace, *, gait: bool) -> GaitFile:
    """Return the connection and gait named by the options of add_source.

    Args:
        arguments: Parsed arguments of the command.
        gait: Whether a robot needs a gait.
    Returns:
        The source.
    Raises:
        InputError: The options contradict each other, or a gait is missing.
    """
    import numpy as np

    from ..analysis.connections.connection import Connection
    from ..analysis.gaits.gait import Gait
    from ..common.names import joint_index
    from ..planning.gait_files.load_gait import GaitFile, load_gait
    from ..system.load import load

    if Path(arguments.source).suffix == ".toml":
        refuse_of_robots(arguments, arguments.source, "group", "gait", "circle", "parameter")
        return load_gait(arguments.source)
    parameters = parameters_in(arguments.parameter)
    system = load(arguments.source, group=arguments.group, parameters=parameters)
    connection = Connection.mechanical(system)
    file, circle = arguments.gait, arguments.circle
    if (file is None) == (circle is None) and (gait or file is not None):
        raise InputError("a robot needs a gait: give --gait FILE or --circle J1,J2,RADIUS")
    zero, path = np.zeros((1, system.m)), None
    if file is not None:
        path = Gait.read(file)
    elif circle is not None:
        words = circle.split(",")
        if len(words) != 3:
            raise InputError(f"--circle takes J1,J2,RADIUS, got {quoted(circle)}")
        (radius,) = numbers_in(words[2], "circle") or [0.0]
        cos, sin = zero.copy(), zero.copy()
        cos[0, joint_index(words[0], system.shape_names, "--circle")] = radius
        sin[0, joint_index(words[1], system.shape_names, "--circle")] = radius
        path = Gait.fourier(zero[0], cos, sin)
    return GaitFile(system, connection, path, np.zeros(system.r))
