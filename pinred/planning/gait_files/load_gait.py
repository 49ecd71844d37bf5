"""Gait files: reading and validation of gaits and objectives in TOML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.connections.fluid import Ellipse, Ellipsoid
from ...analysis.connections.viscous import Rod
from ...analysis.connections.wheels import Rolling, Wheel
from ...analysis.gaits.gait import Gait
from ...common.arrays import Array
from ...common.errors import InputError
from ...scene.toml.documents import read_document, robot_in
from ...scene.toml.file_place import naming
from ...scene.toml.parameter_tables import file_parameters, refuse_others, with_robot_parameters
from ...system.system import System
from .gait_keys import GAIT_FILE


@dataclass(frozen=True)
class GaitFile:
    """The contents of a gait file.

    Attributes:
        system: The system.
        connection: The connection.
        gait: The gait, or None.
        momentum: Initial body momentum, (r,).
        optimise: Options of `optimise_gait` in the file, by name.
        reorient: Options of `reorient` in the file, by name.
    """

    system: System
    connection: Connection
    gait: Gait | None
    momentum: Array
    optimise: Mapping[str, Any] = field(default_factory=dict)
    reorient: Mapping[str, Any] = field(default_factory=dict)

    @property
    def path(self) -> Gait:
        """The gait.  Raises InputError if the file has none."""
        if self.gait is None:
            raise InputError(
                f"no gait of '{self.system.name}' is given; add a [gait] table to the file"
            )
        return self.gait


def load_gait(path: str | Path) -> GaitFile:
    """Read robot, connection, gait and objectives from a TOML file (see docs/phases.md).

    Args:
        path: Name of the file.
    Returns:
        The contents.
    Raises:
        LoadError: The file, or a file that it names, cannot be read.
        InputError: A value is invalid; the message names file and key.
    """
    document, place = read_document(path, GAIT_FILE, "gait")
    folder = Path(path).parent
    given = file_parameters(document, place)
    system, others = with_robot_parameters(robot_in(document, folder, place), given, place)
    refuse_others(system, others)
    with naming(place / "connection"):
        connection = _connection(system, document.get("connection", {"kind": "mechanical"}))
    if "base" in document:
        with naming(place / "base"):
            connection = connection.seen_from(document["base"])
    gait = None
    if "gait" in document:
        with naming(place / "gait"):
            gait = _gait(document["gait"], connection, folder)
    momentum = np.zeros(connection.r)
    given = document.get("momentum", 0.0)
    if given != 0.0:
        values = [given] if isinstance(given, float) else given
        if len(values) != connection.r:
            names = ", ".join(connection.group.twist_names)
            (place / "momentum").fail(f"must have {connection.r} entries ({names}), or be 0")
        momentum[:] = values
    optimise = dict(document.get("optimise", {}))
    for name, word in (("cost", "none"), ("winding", "any")):
        if optimise.get(name) == word:
            optimise[name] = None
    turn = dict(document.get("reorient", {}))
    if turn and momentum.any():
        turn["momentum"] = momentum
    return GaitFile(system, connection, gait, momentum, optimise, turn)


def _connection(system: System, table: Mapping[str, Any]) -> Connection:
    kind = table["kind"]
    if kind == "viscous":
        return Connection.viscous(system, {k: Rod(**rod) for k, rod in table["drag"].items()})
    if kind == "fluid":
        bodies = {name: _body(body) for name, body in table["bodies"].items()}
        return Connection.fluid(system, table["density"], bodies)
    if kind == "kinematic":
        return Connection.kinematic(system, [_wheel(wheel) for wheel in table["wheels"]])
    return Connection.mechanical(system)


def _body(table: Mapping[str, Any]) -> Ellipsoid | Ellipse:
    options = dict(table)
    return Ellipsoid(**options) if options.pop("kind") == "ellipsoid" else Ellipse(**options)


def _wheel(table: Mapping[str, Any]) -> Wheel | Rolling:
    options = dict(table)
    return Wheel(**options) if options.pop("kind") == "wheel" else Rolling(**options)


def _gait(table: Mapping[str, Any], connection: Connection, folder: Path) -> Gait:
    options = dict(table)
    kind = options.pop("kind")
    if kind == "recorded":
        gait = Gait.read(folder / options.pop("file"), **options)
    elif kind == "strokes":
        gait = Gait.strokes(joints=connection.joints, **options)
    else:
        gait = getattr(Gait, kind)(**options)
    if gait.m != connection.m:
        raise InputError(
            f"the gait moves {gait.m} joints, but the robot has {connection.m}: "
            f"{', '.join(connection.joints)}"
        )
    return gait
