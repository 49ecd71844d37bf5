"""Contents of a film for viewers with a scene tree: nodes that move, with meshes and lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, FrozenArrays
from ...system.mesh_files import Mesh
from .drawn_bodies import Bodies, Colour, Solid
from .framing import Framing
from .playback import Playback
from .solid_meshes import solid_mesh

ARROW_COLOUR, TRAIL_COLOUR = (0.84, 0.37, 0.0), (0.07, 0.07, 0.07)
_SPHERE_COLOUR = (0.67, 0.20, 0.47)
_GHOST_COLOUR = (0.0, 0.45, 0.70, 0.38)
_ARROW_LENGTH = 1.25  # length of the momentum arrow, in radii of the robot
_STILL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])  # identity placement


@dataclass(frozen=True)
class Part:
    """A mesh of a node.

    Attributes:
        mesh: The surface, in the frame of `placement`.
        flat: Whether each triangle has a constant brightness.
        placement: Position [m] and quaternion (real part last) in the node's frame, (7,).
        colour: Red, green, blue, opacity.
    """

    mesh: Mesh
    flat: bool
    placement: Array
    colour: Colour


@dataclass(frozen=True)
class Line:
    """A line of a node: points (N, 3) [m], and red, green and blue."""

    points: Array
    colour: tuple[float, float, float]


@dataclass(frozen=True)
class Node:
    """An object that moves as one.

    Attributes:
        path: Names from the root of the scene tree to the node.
        placements: Position [m] and quaternion (real part last) in the world frame, (F, 7).
        parts: Meshes.
        lines: Lines.
    """

    path: tuple[str, str]
    placements: Array
    parts: tuple[Part, ...] = ()
    lines: tuple[Line, ...] = ()


@dataclass(frozen=True)
class Arrow(FrozenArrays):
    """The momentum arrow: start and difference to the tip, (F, 3) [m]; arrays are read-only."""

    tail: Array
    vector: Array


def scene_nodes(film: Playback, bodies: Bodies, framing: Framing) -> list[Node]:
    """Return all objects of a film except the momentum arrow.

    Args:
        film: The motion.
        bodies: Shapes of the robot.
        framing: Framing of the film.
    Returns:
        The robot, its ghost, the trail of the centre of mass, and the momentum sphere.
    """
    nodes = list(_robot("robot", film, film.placements, bodies))
    if film.ghost is not None:
        placements = film.ghost.placements.copy()
        placements[..., :3] += framing.aside
        nodes += _robot("full simulation", film, placements, bodies, _GHOST_COLOUR)
    trail = Line(film.com, TRAIL_COLOUR)
    still = np.broadcast_to(_STILL, (len(film.t), 7))
    nodes.append(Node(("overlays", "trail"), still, lines=(trail,)))
    if film.sphere is not None:
        placements = film.placements[:, film.sphere.joint].copy()
        placements[:, :3] = film.momentum.tail
        radius = _ARROW_LENGTH * framing.radius
        ball = Solid(0, "sphere", (radius,), _STILL, (*_SPHERE_COLOUR, 0.12))
        path = Line(radius * film.sphere.path, _SPHERE_COLOUR)
        part = _part(ball, ())
        nodes.append(Node(("overlays", "momentum sphere"), placements, (part,), (path,)))
    return nodes


def momentum_arrow(film: Playback, framing: Framing) -> Arrow | None:
    """Return the momentum arrow, which is as long as in pinred's page; None without momentum."""
    largest = float(np.linalg.norm(film.momentum.vector, axis=1).max())
    if largest == 0.0:
        return None
    scale = _ARROW_LENGTH * framing.radius / largest
    return Arrow(film.momentum.tail, scale * film.momentum.vector)


def interpolate(t: Array, values: Array, time: float) -> Array:
    """Interpolate an array over frames, (F, …), linearly at a time within the film."""
    after = int(np.clip(np.searchsorted(t, time, side="right"), 1, len(t) - 1))
    share = float(np.clip((time - t[after - 1]) / (t[after] - t[after - 1]), 0.0, 1.0))
    if share in (0.0, 1.0):
        return np.array(values[after - 1 + int(share)])
    return np.asarray((1.0 - share) * values[after - 1] + share * values[after])


def interpolate_placements(t: Array, placements: Array, time: float) -> Array:
    """Interpolate placements (F, …, 7) at a time, with quaternions along the shortest arc.

    Args:
        t: Times of the frames, (F,) [s].
        placements: Positions [m] and quaternions.
        time: A time within the film [s].
    Returns:
        The placements, (…, 7).
    """
    after = int(np.clip(np.searchsorted(t, time, side="right"), 1, len(t) - 1))
    pair = placements[after - 1 : after + 1].copy()
    opposite = (pair[0, ..., 3:] * pair[1, ..., 3:]).sum(axis=-1) < 0.0
    pair[1, ..., 3:] *= np.where(opposite, -1.0, 1.0)[..., None]  # q and −q are the same rotation
    mean = interpolate(t[after - 1 : after + 1], pair, time)
    mean[..., 3:] /= np.linalg.norm(mean[..., 3:], axis=-1, keepdims=True)
    return mean


def _robot(
    name: str, film: Playback, placements: Array, bodies: Bodies, colour: Colour | None = None
) -> Iterator[Node]:
    """Yield a node of each joint with shapes.

    Args:
        name: First name of the nodes' paths.
        film: The motion.
        placements: Placements of the joints, (F, joints, 7).
        bodies: The shapes.
        colour: Colour of all shapes; their own if None.
    Yields:
        The nodes.
    """
    for joint, joint_name in enumerate(film.system.sorted_model.names):
        solids = [solid for solid in bodies.solids if solid.joint == joint]
        if solids:
            parts = tuple(_part(solid, bodies.meshes, colour) for solid in solids)
            yield Node((name, f"{joint} {joint_name}"), placements[:, joint], parts)


def _part(solid: Solid, meshes: Sequence[Mesh], colour: Colour | None = None) -> Part:
    mesh, flat = solid_mesh(solid, meshes), solid.kind == "mesh"
    return Part(mesh, flat, solid.placement, solid.colour if colour is None else colour)
