"""The page on which joints are moved by hand: its numbers, scripts and options."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ...analysis.connections.connection import Connection
from ...common.arrays import Array
from ...common.files import check_path, write_atomic
from ...common.names import joint_index
from ...common.waiting import Wait
from ...system.loops.loop_assembly import rate_units
from ...system.system import System
from ..playback.drawn_bodies import Bodies, drawn_bodies
from ..playback.framing import frame
from ..playback.page import STAGE, Blob, assemble, plain_fields, resource, robot_head
from ..playback.playback import Momentum, Playback, conserved_momentum
from ..playback.shape_panel import motion_words
from .feel_graphs import feel_graphs, root_axes
from .felt_robot import FeltRobot, felt_robot
from .instructions import to_javascript

_SCRIPTS = ("lift.js", "closed_shapes.js", "loops.js", "plane.js", "feel.js")
_SPIN, _DRIFT = (
    0.6,
    0.3,
)  # angular [rad/s] or linear [m/s] velocity that the momentum causes at rest
_PERIOD = 4.0  # duration of one cycle of a loop [s]
_CROSSING = 2.0  # time in which a joint moves through its range [s]
_SAMPLES, _PAIR_SAMPLES = 60, 6  # random shapes for the size of the picture, and for the joint pair


@Wait("prepares the page of feel")
def feel_page(
    source: System | Connection,
    *,
    pair: Sequence[str] | None = None,
    meshes: bool | str | Path | Sequence[str | Path] = True,
) -> bytes:
    """Build the HTML page on which joints are moved and the base follows by the connection.

    Args:
        source: A system, whose mechanical connection is used, or a connection of a system.
        pair: Names of the joints on the axes of the shape plane. If None, the two whose curvature
            is largest.
        meshes: Options of the drawing, as in `View`.
    Returns:
        The page.
    Raises:
        InputError: There are no joints, a joint is unknown, or the connection has no system.
        SymmetryError: Gravity changes the momenta.
    """
    robot = felt_robot(source)
    connection, system, free = robot.connection, robot.system, robot.independent
    graphs = feel_graphs(connection, system)
    bodies, blob = drawn_bodies(system, meshes=meshes), Blob()
    head = {
        **_picture(robot, bodies),
        **robot_head(system, bodies, blob),
        "labels": [f"{name} [{unit}]" for name, unit in zip(robot.names, robot.units, strict=True)],
        "angles": [unit == "rad" for unit in robot.units],
        "low": robot.low[free].tolist(),
        "high": robot.high[free].tolist(),
        "start": robot.rest[free].tolist(),
        "size": connection.m,
        "loops": None if robot.chart is None else loop_numbers(robot),
        "pair": _pair(robot, pair),
        "components": motion_words(connection.group),
        "linear": connection.group.linear,
        "turns": connection.group.turns,
        "period": _PERIOD,
        "crossing": _CROSSING,
        "still": "zero momentum" if connection.is_mechanical else connection.form.what,
    }
    scripts = [
        *(to_javascript(name, function) for name, function in vars(graphs).items()),
        *map(resource, STAGE),
        *map(_resource, _SCRIPTS),
    ]
    return assemble(_resource("feel.html"), head, blob, scripts)


def save_feel(
    source: System | Connection,
    path: str | Path,
    *,
    pair: Sequence[str] | None = None,
    meshes: bool | str | Path | Sequence[str | Path] = True,
) -> int:
    """Write the page of `feel_page` to a .html file; if this fails, an existing file is kept.

    Args:
        source: A system or a connection.
        path: The file.
        pair: Names of the joints on the axes of the shape plane.
        meshes: Options of the drawing, as in `View`.
    Returns:
        Size of the file in bytes.
    """
    path = check_path(path, (".html",))
    content = feel_page(source, pair=pair, meshes=meshes)
    write_atomic(path, lambda file: file.write(content))
    return len(content)


def _pair(robot: FeltRobot, names: Sequence[str] | None) -> list[int]:
    """Return the indices of the independent joints on the axes of the shape plane."""
    if names is not None:
        return [joint_index(name, list(robot.names), "pair") for name in names]
    if robot.dim == 1:
        return [0, 0]
    group, strengths = robot.connection.group, np.zeros((robot.dim, robot.dim))
    first = group.linear % robot.connection.r  # rotations, if there are any
    for u in robot.random(_PAIR_SAMPLES):
        field = robot.moved.curvature(u)[first:]
        strengths += np.einsum("rab,rab->ab", field, field)
    pairs = [(a, b) for b in range(robot.dim) for a in range(b)]
    a, b = max(sorted(pairs), key=lambda pair: round(float(np.sqrt(strengths[pair])), 9))
    return [a, b]


def loop_numbers(robot: FeltRobot) -> dict[str, Any]:
    """Return the numbers by which the page closes the loops of a robot, see closed_shapes.js."""
    closure = robot.system.closure
    assert closure is not None
    assert robot.chart is not None
    dependent = robot.chart.dependent
    return {
        "independent": robot.independent.tolist(),
        "dependent": dependent.tolist(),
        "start": robot.rest.tolist(),
        "units": rate_units(robot.system, closure.length).tolist(),
        "low": robot.low[dependent].tolist(),
        "high": robot.high[dependent].tolist(),
        "names": [robot.system.space.names[k] for k in dependent],
    }


def _picture(robot: FeltRobot, bodies: Bodies) -> dict[str, Any]:
    """Return the framing, the placement of the root, and the momentum."""
    connection, system = robot.connection, robot.system
    model, data, group = system.sorted_model, system.sorted_model.createData(), system.group
    shapes = np.array([robot.shape(u) for u in robot.random(_SAMPLES)])
    q = np.array([system.sorted_q(group.identity(), x) for x in shapes])
    root, S = model.jointPlacements[1], root_axes(system)
    com, placements = np.empty((len(q), 3)), np.empty((len(q), model.njoints, 7))
    for k, configuration in enumerate(q):
        com[k] = pin.centerOfMass(model, data, configuration)
        placements[k] = [pin.SE3ToXYZQUAT(place) for place in data.oMi]
    # The centre of mass starts at the origin, so momenta about both are equal.
    along = S[:3, : group.linear]
    shift = -along @ along.T @ root.actInv(com[0])
    spatial = _momentum(robot) if connection.form.momentum else None
    rest = conserved_momentum(system, q[:1], np.zeros((1, model.nv)))
    twist = np.zeros(6) if spatial is None else S @ spatial
    vector = root.rotation @ (twist[3:] if group.turns else twist[:3])
    film = Playback(
        system=system, t=np.arange(len(q), dtype=float), x=shapes, xdot=shapes[:, : system.m] * 0.0,
        placements=placements - np.pad(com[:, None], ((0, 0), (0, 0), (0, 4))), com=0.0 * com,
        ellipsoid=np.zeros((len(q), 3, 3)), energy=np.zeros(len(q)), sphere=None, ghost=None,
        momentum=Momentum(np.tile(vector, (len(q), 1)), 0.0 * com, rest.words, rest.unit),
    )  # fmt: skip
    return {
        **plain_fields(frame(film, bodies)),
        "root": pin.SE3ToXYZQUAT(root).tolist(),
        "base": [*shift.tolist(), 0.0, 0.0, 0.0, 1.0],
        "momentum": {
            "spatial": None if spatial is None else twist.tolist(),
            "vector": vector.tolist(),
            "words": f"{np.linalg.norm(vector):.3g} {rest.unit}, {rest.words}",
            "pivoted": bool(group.turns) and not group.turns_about_com,
        },
    }


def _momentum(robot: FeltRobot) -> Array:
    """Return a spatial momentum, (r,), about the origin, for a pose with the CoM in the origin."""
    group, J = robot.connection.group, np.zeros(robot.connection.r)
    P = robot.connection.locked(robot.rest)
    if not group.turns:
        J[0] = _DRIFT * P[0, 0]
        return J
    about_com = np.linalg.inv(np.linalg.inv(P)[group.linear :, group.linear :])
    J[-1] = _SPIN * np.trace(about_com) / group.turns
    return J


def _resource(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")
