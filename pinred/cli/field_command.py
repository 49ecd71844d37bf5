"""`pinred field`: draw or write the connection of a robot as a function of two joints."""

from __future__ import annotations

import argparse
from typing import Any

from ..common.errors import InputError
from .command_options import add_source, option_adder, source_of
from .option_values import numbers_in
from .output_files import describe_file, save_figure

_SAMPLES = 200  # default number of grid points along each joint


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_source(sub)
    add = option_adder(sub)
    add("--joints J1,J2", "names of the joints to vary (default: the first two)")
    add("--component C", "component of the body twist: v1 … w3, x, y, z or turn")
    add("--part P", "quantity: curvature, exterior, bracket or connection", str, "curvature")
    add("--limits LOW,HIGH", "range of both joints [rad | m]")
    add("--at X1,X2,…", "shape of the other joints [rad | m]")
    add("--samples N", "number of grid points along each joint in a .npz file", int, _SAMPLES)
    add("--out FILE", "figure file, or .npz file of numbers", required=True)


def run(arguments: argparse.Namespace) -> int:
    """Draw or write the field.  Returns 0."""
    import numpy as np

    from ..common.files import FIGURES, check_path, write_atomic

    path = check_path(arguments.out, (*FIGURES, ".npz"))
    source = source_of(arguments, gait=False)
    joints = None if arguments.joints is None else arguments.joints.split(",")
    limits = None
    if (ends := numbers_in(arguments.limits, "limits")) is not None:
        if len(ends) != 2 or not ends[0] < ends[1]:
            raise InputError(f"--limits takes LOW,HIGH, got {arguments.limits}")
        limits = [(ends[0], ends[1])] * 2
    at = numbers_in(arguments.at, "at")
    if path.suffix == ".npz":
        arrays = _compute_grid(source.connection, joints, limits, at, arguments.samples)
        write_atomic(path, lambda file: np.savez(file, **arrays))
    else:
        from ..views.plots.by_kind import plot

        figure = plot(
            source.connection, "field", joints=joints, component=arguments.component,
            part=arguments.part, limits=limits, at=at, gait=source.gait,
        )  # fmt: skip
        save_figure(figure, path)
    print(describe_file(path))
    return 0


def _compute_grid(
    connection: Any, joints: list[str] | None, limits: Any, at: Any, samples: int
) -> dict[str, Any]:
    """Compute A and the curvature with its two terms on a grid of shapes.

    Args:
        connection: Connection to evaluate.
        joints: Names of the two joints on the axes; by default the first two.
        limits: (low, high) of each axis.
        at: Values of the other joints.
        samples: Number of samples along each axis.
    Returns:
        Arrays by name, with leading axes (samples, samples).
    Raises:
        InputError: An option is invalid.
    """
    import numpy as np

    from ..analysis.connections.connection_source import rest_of
    from ..common.arrays import vector
    from ..views.plots.motion_labels import labels_of_connection

    if samples < 2:
        raise InputError(f"--samples must be at least 2, got {samples}")
    connection = connection.in_chart()
    names = list(connection.joints)
    pair = labels_of_connection(connection).pair(joints, "a field")
    fixed = rest_of(connection) if at is None else vector(at, connection.m, "--at", names)
    (low, high), _ = limits or [(-np.pi, np.pi)] * 2
    axis = np.linspace(low, high, samples)
    x = np.broadcast_to(fixed, (samples, samples, connection.m)).copy()
    x[..., pair[0]], x[..., pair[1]] = np.meshgrid(axis, axis, indexing="ij")
    grid = connection.grid(x)
    return {
        "x": x, "joints": np.array(names), "local": grid.local, "curvature": grid.curvature,
        "exterior": grid.exterior, "bracket": grid.bracket,
    }  # fmt: skip
