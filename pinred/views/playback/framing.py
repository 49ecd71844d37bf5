"""Framing of a film: direction of the camera, size of the robot, position of the grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, FrozenArrays
from ...lie.rotations import rotation
from .drawn_bodies import Bodies, extents
from .playback import Playback

ARROW = 1.3  # length of the momentum arrow with a margin, in radii of the robot
_SAMPLES = 200  # number of frames that determine the robot's radius
_BESIDE = 1.8  # distance between the robot and its ghost, in radii of the robot
# Distance of the gravity arrow to the left of the centre of mass, in radii of the robot. The arrow
# is half a radius long (player.js), so that it is within `reach` in any direction.
_LEFT = 0.8
_ELEVATION, _PLANAR_ELEVATION = 18.0, 50.0  # elevation of the camera [deg]
_DEEP = 5.0  # largest fall for which the grid is drawn as a floor, in radii of the robot
_FAR = 10.0  # half of the side length of the grid, in radii of the robot


@dataclass(frozen=True)
class Framing(FrozenArrays):
    """Framing of a film; vectors are (3,) in the world frame, lengths are in m.

    Attributes:
        radius: Radius of a ball about the centre of mass that contains the robot at all times.
        reach: Radius of such a ball that also contains the momentum arrow, but not the ghost.
        middle: Middle of the path of the centre of mass.
        span: Radius of a ball about `middle` that contains everything at all times.
        follow: Whether the camera should follow the robot.
        eye: Unit vector to the camera.
        aside: Offset from the robot to its ghost.
        gravity: Acceleration of gravity [m/s²].
        gravity_at: Offset from the centre of mass to the middle of the gravity arrow.
        cell: Side of the grid's squares.
        cells: Number of squares in a row of the grid, which follows the camera.
        wide: Factor on the size of the squares if the camera does not move and shows the whole
            path.
        grid: Centre of the grid if the camera looks at `middle`.
        normal: Unit normal of the grid: a floor, or a wall behind falling robots.
    """

    radius: float
    reach: float
    middle: Array
    span: float
    follow: bool
    eye: Array
    aside: Array
    gravity: Array
    gravity_at: Array
    cell: float
    cells: int
    wide: float
    grid: Array
    normal: Array


@dataclass(frozen=True)
class Camera(FrozenArrays):
    """A camera whose picture has z upwards; arrays are read-only.

    Attributes:
        position: Position, (3,) [m], relative to the centre of mass if the camera follows it.
        target: Point in the middle of the picture, (3,) [m], with the same origin.
        distance: Distance of both [m].
        reach: Radius of a ball about the target that contains everything at all times [m].
    """

    position: Array
    target: Array
    distance: float
    reach: float


def camera(framing: Framing, fov: float, *, follow: bool, aspect: float = 1.0) -> Camera:
    """Place a perspective camera that sees everything at all times.

    Args:
        framing: The framing of the film.
        fov: Vertical field of view [rad].
        follow: Whether the camera follows the centre of mass.
        aspect: Width of the picture divided by its height.
    Returns:
        The camera.
    """
    half = np.arctan(np.tan(0.5 * fov) * min(aspect, 1.0))
    target = 0.5 * framing.aside + (0.0 if follow else framing.middle)
    reach = framing.reach if follow else framing.span
    reach += 0.5 * float(np.linalg.norm(framing.aside))
    distance = float(1.02 * reach / np.sin(half))
    return Camera(target + distance * framing.eye, target, distance, reach)


def frame(film: Playback, bodies: Bodies) -> Framing:
    """Compute a framing that shows the whole robot, with its momentum arrow in side view."""
    radius = _radius(film, bodies)
    low, high = film.com.min(axis=0), film.com.max(axis=0)
    middle = 0.5 * (low + high)
    path = float(np.linalg.norm(film.com - middle, axis=1).max())
    eye = _eye(film)
    right = np.cross([0.0, 0.0, 1.0], eye)
    right /= np.linalg.norm(right)
    aside = np.zeros(3) if film.ghost is None else _BESIDE * radius * right
    reach = 1.05 * radius
    if film.momentum.vector.any():
        arm = film.momentum.tail - film.com
        reach = ARROW * radius + float(np.linalg.norm(arm, axis=1).max())
    cell = _round_up(0.5 * radius)
    sideways = float(max((high - low)[:2]))
    falls = high[2] - low[2] > max(2.0 * radius, min(sideways, _DEEP * radius))
    normal, grid = np.array([0.0, 0.0, 1.0]), middle.copy()
    if falls:
        normal = np.append(eye[:2], 0.0) / np.linalg.norm(eye[:2])
        grid -= 1.5 * radius * normal
    else:
        grid[2] = low[2] - 1.1 * radius
    offsets = film.com - middle
    distances = np.linalg.norm(offsets - np.outer(offsets @ normal, normal), axis=1)
    cells = 2 * int(np.ceil(_FAR * radius / cell))
    wide = (float(distances.max()) + 6.0 * radius) / (0.5 * cells * cell)
    return Framing(
        radius=radius,
        reach=reach,
        middle=middle,
        span=reach + path,
        follow=path > radius,
        eye=eye,
        aside=aside,
        gravity=film.system.gravity,
        gravity_at=-_LEFT * radius * right,
        cell=cell,
        cells=cells,
        wide=_round_up(max(1.0, wide)),
        grid=grid,
        normal=normal,
    )


def _radius(film: Playback, bodies: Bodies) -> float:
    frames = np.unique(np.linspace(0, len(film.t) - 1, _SAMPLES).astype(int))
    com, most = film.com[frames], 0.0
    for joint, centre, radius in extents(bodies):
        if joint:
            pose = film.placements[frames, joint]
            points = pose[:, :3] + np.einsum("fij,j->fi", rotation(pose[:, 3:]), centre)
            most = max(most, float(np.linalg.norm(points - com, axis=1).max()) + radius)
    return most


def _eye(film: Playback) -> Array:
    """Return the camera direction that is most nearly perpendicular to the momentum arrow."""
    group = film.system.group
    planar = group.plane and group.linear == 2
    elevation = np.radians(_PLANAR_ELEVATION if planar else _ELEVATION)
    steps = np.arange(0.0, 181.0, 15.0)
    azimuth = np.radians(-60.0 + np.column_stack([-steps, steps]).ravel())
    eyes = np.column_stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.full(len(azimuth), np.sin(elevation)),
        ]
    )
    overlap = np.abs(eyes @ film.momentum.vector.T).max(axis=1)
    return np.asarray(eyes[int(np.argmin(np.round(overlap / max(overlap.max(), 1e-300), 6)))])


def _round_up(length: float) -> float:
    """Round a length up to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= length))
