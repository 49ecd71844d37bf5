"""Framing: where the camera looks from, how large things are, where the grid lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ...lie.rotations import rotation
from .drawn_bodies import extents
from .playback import Playback
from .solids import Bodies

ARROW = 1.3  # length of the momentum arrow with a margin, in radii of the robot
_LOOKS = 200  # frames from which the size is taken
_BESIDE = 1.8  # how far beside the robot its ghost stands, in radii
_ELEVATION, _PLANAR_ELEVATION = 18.0, 50.0  # degrees
_DEEP = 5.0  # how far above a floor one still sees it, in radii
_FAR = 10.0  # how far the grid goes on around what is followed, in radii


@dataclass(frozen=True)
class Framing:
    """The framing of a film; vectors are (3,) in the world frame, lengths in m.

    radius: of the ball about the centre of mass that the robot stays in.  reach: of what is
    drawn around it, but for a ghost.  middle: of the path of the centre of mass.  span: of
    what is drawn around that, all along.  follow: whether the robot goes so far that the
    camera should go along.  eye: unit vector to the camera.  aside: from the robot to its
    ghost.  cell, cells: side of the grid's squares, how many in a row; they go along with the
    camera.  wide: how many times as large they are if it stands still and sees all of the way.
    grid, normal: the middle of the grid when `middle` is followed, and the unit vector across
    it: a floor, or a wall for what falls.
    """

    radius: float
    reach: float
    middle: Array
    span: float
    follow: bool
    eye: Array
    aside: Array
    cell: float
    cells: int
    wide: float
    grid: Array
    normal: Array

    def __post_init__(self) -> None:
        freeze(self)


def frame(film: Playback, bodies: Bodies) -> Framing:
    """Return the framing of a film: all of the robot in sight, its momentum seen from the side."""
    radius = _radius(film, bodies)
    low, high = film.com.min(axis=0), film.com.max(axis=0)
    middle = 0.5 * (low + high)
    path = float(np.linalg.norm(film.com - middle, axis=1).max())
    eye = _eye(film)
    right = np.cross([0.0, 0.0, 1.0], eye)
    aside = np.zeros(3) if film.ghost is None else _BESIDE * radius * right / np.linalg.norm(right)
    reach = 1.05 * radius
    if film.momentum.vector.any():
        arm = film.momentum.tail - film.com
        reach = ARROW * radius + float(np.linalg.norm(arm, axis=1).max())
    cell = _nice(0.5 * radius)
    sideways = float(max((high - low)[:2]))
    falls = high[2] - low[2] > max(2.0 * radius, min(sideways, _DEEP * radius))
    normal, grid = np.array([0.0, 0.0, 1.0]), middle.copy()
    if falls:
        normal = np.append(eye[:2], 0.0) / np.linalg.norm(eye[:2])
        grid -= 1.5 * radius * normal
    else:
        grid[2] = low[2] - 1.1 * radius
    away = film.com - middle
    along = np.linalg.norm(away - np.outer(away @ normal, normal), axis=1)
    cells = 2 * int(np.ceil(_FAR * radius / cell))
    wide = (float(along.max()) + 6.0 * radius) / (0.5 * cells * cell)
    return Framing(
        radius=radius,
        reach=reach,
        middle=middle,
        span=reach + path,
        follow=path > radius,
        eye=eye,
        aside=aside,
        cell=cell,
        cells=cells,
        wide=_nice(max(1.0, wide)),
        grid=grid,
        normal=normal,
    )


def _radius(film: Playback, bodies: Bodies) -> float:
    some = np.unique(np.linspace(0, len(film.t) - 1, _LOOKS).astype(int))
    com, most = film.com[some], 0.0
    for joint, centre, radius in extents(bodies):
        if joint:
            at = film.placements[some, joint]
            points = at[:, :3] + np.einsum("fij,j->fi", rotation(at[:, 3:]), centre)
            most = max(most, float(np.linalg.norm(points - com, axis=1).max()) + radius)
    return most


def _eye(film: Playback) -> Array:
    """Return the direction, among some around the vertical, most across the momentum."""
    group = film.system.group
    planar = group.plane and group.linear == 2
    elevation = np.radians(_PLANAR_ELEVATION if planar else _ELEVATION)
    turn = np.arange(0.0, 181.0, 15.0)
    azimuth = np.radians(-60.0 + np.column_stack([-turn, turn]).ravel())
    eyes = np.column_stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.full(len(azimuth), np.sin(elevation)),
        ]
    )
    along = np.abs(eyes @ film.momentum.vector.T).max(axis=1)
    return np.asarray(eyes[int(np.argmin(np.round(along / max(along.max(), 1e-300), 6)))])


def _nice(length: float) -> float:
    """Return the least of 1, 2, 5 times a power of ten that is at least `length`."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= length))
