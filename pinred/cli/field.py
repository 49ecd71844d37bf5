"""`pinred field`: the connection of a robot over two joints, as a figure or as numbers."""

from __future__ import annotations

import argparse
from typing import Any

from ..common.errors import InputError
from .gait_sources import add_source, source_of
from .options import numbers_in
from .written import written

_SAMPLES = 200


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_source(sub)
    sub.add_argument("--joints", metavar="J1,J2", help="joints to vary, by name; the first two")
    sub.add_argument("--component", metavar="C", help="of the body twist: v1 … w3")
    sub.add_argument(
        "--part", metavar="P", default="curvature",
        help="curvature (default), exterior, bracket, connection",
    )  # fmt: skip
    sub.add_argument("--limits", metavar="LOW,HIGH", help="of both joints [rad | m]")
    sub.add_argument("--at", metavar="X1,X2,…", help="where the other joints stand [rad | m]")
    sub.add_argument(
        "--samples", metavar="N", type=int, default=_SAMPLES,
        help=f"along each joint, of an npz ({_SAMPLES})",
    )  # fmt: skip
    sub.add_argument("--out", metavar="FILE", required=True, help="a figure, or numbers as npz")


def run(options: argparse.Namespace) -> int:
    """Draw or write the field.  Returns 0."""
    import numpy as np

    from ..common.files import FIGURES, check_path, write_atomic

    path = check_path(options.out, (*FIGURES, ".npz"))
    source = source_of(options, gait=False)
    joints = None if options.joints is None else options.joints.split(",")
    limits = None
    if (given := numbers_in(options.limits, "limits")) is not None:
        if len(given) != 2 or not given[0] < given[1]:
            raise InputError(f"--limits takes LOW,HIGH, got {options.limits}")
        limits = [(given[0], given[1])] * 2
    at = numbers_in(options.at, "at")
    if path.suffix == ".npz":
        found = _numbers(source.connection, joints, limits, at, options.samples)
        write_atomic(path, lambda file: np.savez(file, **found))
    else:
        from ..views.plots.by_kind import plot
        from .plot import save

        made = plot(
            source.connection, "field", joints=joints, component=options.component,
            part=options.part, limits=limits, at=at, gait=source.gait,
        )  # fmt: skip
        save(made, path)
    print(written(path))
    return 0


def _numbers(
    connection: Any, joints: list[str] | None, limits: Any, at: Any, samples: int
) -> dict[str, Any]:
    """Return shapes, A and the curvature with its parts on a grid."""
    import numpy as np

    from ..common.arrays import vector
    from ..common.names import joint_index

    if samples < 2:
        raise InputError(f"--samples must be at least 2, got {samples}")
    if connection.m < 2:
        raise InputError(f"a field needs two joints; {connection} has {connection.m}")
    names = list(connection.joints)
    pair = [joint_index(name, names, "--joints") for name in joints or names[:2]]
    if len(set(pair)) != 2:
        raise InputError("--joints takes two different joints")
    stands = np.zeros(connection.m) if at is None else vector(at, connection.m, "--at", names)
    (low, high), _ = limits or [(-np.pi, np.pi)] * 2
    axis = np.linspace(low, high, samples)
    x = np.broadcast_to(stands, (samples, samples, connection.m)).copy()
    x[..., pair[0]], x[..., pair[1]] = np.meshgrid(axis, axis, indexing="ij")
    found = connection.grid(x)
    return {
        "x": x, "joints": np.array(names), "local": found.local, "curvature": found.curvature,
        "exterior": found.exterior, "bracket": found.bracket,
    }  # fmt: skip
