"""Options of the commands on gaits: the source of a gait and connection, and joint limits."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import InputError
from ..common.plain_names import quoted
from .command_options import (
    add_parameters,
    by_joint_in,
    numbers_in,
    option_adder,
    parameters_in,
    refuse_of_robots,
)

if TYPE_CHECKING:
    from ..planning.gait_files.load_gait import GaitFile

_LIMIT_FORMAT = "R, R1,R2,… or J1=R1,…"


def add_source(sub: argparse.ArgumentParser) -> None:
    """Add the options that name a connection and a gait."""
    text = "gait file (.toml), or robot: a name (see `pinred robots`) or a file"
    sub.add_argument("source", metavar="SOURCE", help=text)
    add = option_adder(sub)
    add("--group G", "symmetry group of a robot")
    add_parameters(sub)
    add("--gait FILE", "recorded joint data (.csv, .npz) of a robot")
    add("--circle J1,J2,RADIUS", "gait of a robot: a circle of two joints about zero [rad | m]")


def source_of(arguments: argparse.Namespace, *, gait: bool) -> GaitFile:
    """Return the connection and gait that the options of add_source name.

    `gait` states whether a robot needs a gait.  Raises InputError.
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


def add_limits(sub: argparse.ArgumentParser) -> None:
    """Add the limits of joint positions, rates and torques."""
    add = option_adder(sub)
    text = "keep joints in [-R, R] [rad | m] (default: limits of the robot's file)"
    add(f"--limits {_LIMIT_FORMAT}", text)
    add(f"--speeds {_LIMIT_FORMAT}", "largest joint rates [rad/s | m/s] (default: none)")
    add(f"--torques {_LIMIT_FORMAT}", "largest joint torques [N·m | N] (default: none)")


def limits_in(
    arguments: argparse.Namespace,
) -> dict[str, float | list[float] | dict[str, float]]:
    """Return the stated limits, by their names in Python.  Raises InputError."""
    limits: dict[str, float | list[float] | dict[str, float]] = {}
    for name in ("limits", "speeds", "torques"):
        text = getattr(arguments, name)
        if text is None:
            continue
        values = by_joint_in(text, name)
        if not values:
            raise InputError(f"--{name} takes {_LIMIT_FORMAT}, got nothing")
        limits[name] = values[0] if isinstance(values, list) and len(values) == 1 else values
    return limits
