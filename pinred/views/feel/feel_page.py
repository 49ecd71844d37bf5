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
from ...common.errors import InputError
from ...common.files import check_path, write_atomic
from ...common.names import joint_index
from ...system.system import System
from ..playback.drawn_bodies import Bodies, drawn_bodies
from ..playback.framing import frame
from ..playback.page import STAGE, Blob, assemble, plain_fields, resource, robot_head
from ..playback.playback import Momentum, Playback, conserved_momentum
from ..playback.shape_panel import motion_words
from .feel_graphs import FeelGraphs, feel_graphs, root_axes
from .instructions import to_javascript

_SCRIPTS = ("lift.js", "loops.js", "plane.js", "feel.js")
_SPIN, _DRIFT = (
    0.6,
    0.3,
)  # angular [rad/s] or linear [m/s] velocity that the momentum causes at rest
_PERIOD = 4.0  # duration of one cycle of a loop [s]
_CROSSING = 2.0  # time in which a joint moves through its range [s]
_SAMPLES, _PAIR_SAMPLES = 60, 6  # random shapes for the size of the picture, and for the joint pair
_FARTHEST = np.pi  # largest range of a joint without narrower limits [rad | m]


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
    connection, system = _connection_of(source)
    graphs = feel_graphs(connection, system)
    bodies, blob = drawn_bodies(system, meshes=meshes), Blob()
    low, high = _limits(connection, system)
    head = {
        **_picture(connection, system, bodies, low, high),
        **robot_head(system, bodies, blob),
        "labels": [
            f"{name} [{unit}]" for name, unit in zip(connection.joints, system.units, strict=True)
        ],
        "angles": [unit == "rad" for unit in system.units],
        "low": low.tolist(),
        "high": high.tolist(),
        "start": np.clip(np.zeros(connection.m), low, high).tolist(),
        "pair": _pair(connection, graphs, pair, low, high),
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


def _connection_of(source: System | Connection) -> tuple[Connection, System]:
    """Return the connection in the chart, and its system."""
    connection = source if isinstance(source, Connection) else Connection.mechanical(source)
    if connection.system is None:
        raise InputError("feel: expected a System, or a Connection of a System as loaded")
    if not connection.m:
        raise InputError(f"feel: '{connection.system.name}' has no joints to move")
    connection.refuse_gravity()
    return connection.in_chart(), connection.system


def _limits(connection: Connection, system: System) -> tuple[Array, Array]:
    """Return the limits of the sliders, (m,) [rad | m]."""
    model, space = system.model, system.space
    low, high = np.full(system.m, -_FARTHEST), np.full(system.m, _FARTHEST)
    for joint in space.joints:
        number = model.joints[model.getJointId(joint.name)]
        if joint.kind.m == 1 and number.nq == 1:
            least, most = (
                float(limit[number.idx_q])
                for limit in (model.lowerPositionLimit, model.upperPositionLimit)
            )
            centre = 0.0 if connection.chart is None else float(connection.chart.centre[joint.x][0])
            if least < most:
                low[joint.v] = max(least - centre, -_FARTHEST)
                high[joint.v] = min(most - centre, _FARTHEST)
    wrong = ~(low < high)
    low[wrong], high[wrong] = -_FARTHEST, _FARTHEST
    return low, high


def _shapes(connection: Connection, w: Array) -> Array:
    return w if connection.chart is None else connection.chart.shapes(w)


def _random(connection: Connection, low: Array, high: Array, count: int) -> Array:
    """Return random coordinates within the limits, (count, m), of which the first is rest."""
    w = np.random.default_rng(0).uniform(low, high, (count, connection.m))
    w[0] = np.clip(0.0, low, high)
    return w


def _pair(
    connection: Connection, graphs: FeelGraphs, names: Sequence[str] | None, low: Array, high: Array
) -> list[int]:
    """Return the indices of the joints on the axes of the shape plane."""
    if names is not None:
        return [joint_index(name, list(connection.joints), "pair") for name in names]
    if connection.m == 1:
        return [0, 0]
    unit = np.eye(connection.m)
    shapes = _random(connection, low, high, _PAIR_SAMPLES)
    first = connection.group.linear % connection.r  # rotations, if there are any

    def strength(pair: tuple[int, int]) -> float:
        columns = (
            np.array(graphs.curvature(np.concatenate([w, unit[pair[0]], unit[pair[1]]])))
            for w in shapes
        )
        return round(float(np.linalg.norm([column[first:] for column in columns])), 9)

    pairs = [(a, b) for b in range(connection.m) for a in range(b)]
    a, b = max(sorted(pairs), key=strength)
    return [a, b]


def _picture(
    connection: Connection, system: System, bodies: Bodies, low: Array, high: Array
) -> dict[str, Any]:
    """Return the framing, the placement of the root, and the momentum."""
    model, data, group = system.model, system.model.createData(), system.group
    shapes = _shapes(connection, _random(connection, low, high, _SAMPLES))
    q = np.array([system.model_q(group.identity(), x) for x in shapes])
    root, S = model.jointPlacements[1], root_axes(system)
    com, placements = np.empty((len(q), 3)), np.empty((len(q), model.njoints, 7))
    for k, configuration in enumerate(q):
        com[k] = pin.centerOfMass(model, data, configuration)
        placements[k] = [pin.SE3ToXYZQUAT(place) for place in data.oMi]
    # The centre of mass starts at the origin, so momenta about both are equal.
    along = S[:3, : group.linear]
    shift = -along @ along.T @ root.actInv(com[0])
    spatial = _momentum(connection) if connection.form.momentum else None
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


def _momentum(connection: Connection) -> Array:
    """Return a spatial momentum, (r,), about the origin, for a pose with the CoM in the origin."""
    group, J = connection.group, np.zeros(connection.r)
    P = connection.locked(np.zeros(connection.m))
    if not group.turns:
        J[0] = _DRIFT * P[0, 0]
        return J
    about_com = np.linalg.inv(np.linalg.inv(P)[group.linear :, group.linear :])
    J[-1] = _SPIN * np.trace(about_com) / group.turns
    return J


def _resource(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")
