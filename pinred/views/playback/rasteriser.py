"""Pictures of triangles and lines, drawn without a graphics processor.

A picture is a grid of samples, SIDE × SIDE for each pixel.  A sample is one integer: the distance
in the upper bits and the colour in the lower 24, so that of two opaque samples the larger is the
nearer one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...integrators.stepping.compiling import compiled

Samples = NDArray[np.int64]
SIDE = 2  # number of samples of a pixel in each direction
UNLIT, FLAT, SMOOTH = range(3)  # brightness of a mesh: constant, by triangle, or by point
_DEPTH = float(1 << 38)  # depth of the near plane
# Directions to the lamps in the world frame, and their brightness.
_KEY, _FILL = (0.51, 0.51, 0.69), (-0.68, -0.68, 0.27)
_AMBIENT, _KEY_SHARE, _FILL_SHARE = 0.62, 0.50, 0.25
_LEAST = 1e-300  # avoids divisions of zero by zero


@compiled
def draw_triangle(
    samples: Samples,
    corners: Array,
    a: int,
    b: int,
    c: int,
    colour: Array,
    shade: float,
    over: bool,
) -> None:
    """Draw a triangle on the samples that it covers.

    Args:
        samples: The picture, (rows, columns).
        corners: Column, row, depth and brightness of points, (V, 4).
        a: Index of the first corner.
        b: Index of the second corner.
        c: Index of the third corner.
        colour: Red, green, blue [0 to 255] and opacity, (4,).
        shade: Brightness of the whole triangle; if negative, that of the corners.
        over: Whether it is drawn over nearer objects.
    """
    x0, y0, d0, s0 = corners[a, 0], corners[a, 1], corners[a, 2], corners[a, 3]
    x1, y1, d1, s1 = corners[b, 0], corners[b, 1], corners[b, 2], corners[b, 3]
    x2, y2, d2, s2 = corners[c, 0], corners[c, 1], corners[c, 2], corners[c, 3]
    if not (d0 > 0.0 and d1 > 0.0 and d2 > 0.0):  # reaches behind the near plane
        return
    u1, v1, u2, v2 = x1 - x0, y1 - y0, x2 - x0, y2 - y0
    area = u1 * v2 - u2 * v1
    first = max(0, math.ceil(min(y0, y1, y2) - 0.5))
    end = min(samples.shape[0], math.ceil(max(y0, y1, y2) - 0.5))
    if area == 0.0 or first >= end:
        return
    across = ((d1 - d0) * v2 - (d2 - d0) * v1) / area
    down = ((d2 - d0) * u1 - (d1 - d0) * u2) / area
    shade_across = shade_down = 0.0
    if shade < 0.0:
        shade_across = ((s1 - s0) * v2 - (s2 - s0) * v1) / area
        shade_down = ((s2 - s0) * u1 - (s1 - s0) * u2) / area
    start = s0 if shade < 0.0 else shade
    # Slopes are computed from the upper corner of an edge, so that triangles with a common edge
    # neither overlap nor leave a gap.
    slope0 = (x1 - x0) / (y1 - y0) if y1 != y0 else 0.0
    slope1 = (x2 - x1) / (y2 - y1) if y2 != y1 else 0.0
    slope2 = (x0 - x2) / (y0 - y2) if y0 != y2 else 0.0
    red, green, blue, opacity = colour[0], colour[1], colour[2], colour[3]
    solid = opacity >= 1.0 and not over
    for row in range(first, end):
        y = row + 0.5
        left, right = np.inf, -np.inf
        if min(y0, y1) <= y < max(y0, y1):
            x = x0 + (y - y0) * slope0 if y0 < y1 else x1 + (y - y1) * slope0
            left, right = min(left, x), max(right, x)
        if min(y1, y2) <= y < max(y1, y2):
            x = x1 + (y - y1) * slope1 if y1 < y2 else x2 + (y - y2) * slope1
            left, right = min(left, x), max(right, x)
        if min(y2, y0) <= y < max(y2, y0):
            x = x2 + (y - y2) * slope2 if y2 < y0 else x0 + (y - y0) * slope2
            left, right = min(left, x), max(right, x)
        if not left <= right:
            continue
        begin = max(0, math.ceil(left - 0.5))
        stop = min(samples.shape[1], math.ceil(right - 0.5))
        depth = d0 + across * (begin + 0.5 - x0) + down * (y - y0)
        bright = start + shade_across * (begin + 0.5 - x0) + shade_down * (y - y0)
        for column in range(begin, stop):
            old = samples[row, column]
            key = int(depth * _DEPTH)
            if over or key >= old >> 24:
                p = min(255.0, red * bright)
                q = min(255.0, green * bright)
                r = min(255.0, blue * bright)
                if not solid:
                    p = opacity * p + (1.0 - opacity) * (old >> 16 & 255)
                    q = opacity * q + (1.0 - opacity) * (old >> 8 & 255)
                    r = opacity * r + (1.0 - opacity) * (old & 255)
                    key = old >> 24
                mixed = int(p + 0.5) << 16 | int(q + 0.5) << 8 | int(r + 0.5)
                samples[row, column] = key << 24 | mixed
            depth += across
            bright += shade_across


@compiled
def _product(matrix: Array, row: int, x: float, y: float, z: float) -> float:
    """Return a row of a matrix times a vector."""
    product: float = matrix[row, 0] * x + matrix[row, 1] * y + matrix[row, 2] * z
    return product


@compiled
def _brightness(turn: Array, normals: Array, k: int, p: float, q: float, r: float) -> float:
    """Return the brightness of the side of a surface that faces the camera.

    Args:
        turn: Matrix from normals to those in the world, (3, 3).
        normals: Normals of surfaces, (N, 3).
        k: Index of the normal.
        p: First component of the vector from the camera to the surface.
        q: Second component.
        r: Third component.
    Returns:
        The brightness.
    """
    a, b, c = normals[k, 0], normals[k, 1], normals[k, 2]
    x, y, z = _product(turn, 0, a, b, c), _product(turn, 1, a, b, c), _product(turn, 2, a, b, c)
    length = math.sqrt(x * x + y * y + z * z)
    side = (-1.0 if x * p + y * q + z * r > 0.0 else 1.0) / max(length, _LEAST)
    key = side * (_KEY[0] * x + _KEY[1] * y + _KEY[2] * z)
    fill = side * (_FILL[0] * x + _FILL[1] * y + _FILL[2] * z)
    return _AMBIENT + _KEY_SHARE * max(0.0, key) + _FILL_SHARE * max(0.0, fill)


@compiled
def draw_mesh(
    samples: Samples,
    corners: Array,
    points: Array,
    normals: Array,
    faces: Samples,
    world: Array,
    turn: Array,
    view: Array,
    colour: Array,
    kind: int,
    over: bool,
) -> None:
    """Draw a mesh.

    Args:
        samples: The picture.
        corners: Memory for at least V points, (≥ V, 4).
        points: Points of the mesh, (V, 3) [m].
        normals: Unit normals of the points, or of the triangles of a flat mesh, (V | T, 3).
        faces: Indices of the corners of triangles, (T, 3).
        world: Matrix from the mesh to the world, (3, 4).
        turn: Matrix from the mesh's normals to those in the world, (3, 3).
        view: The camera: its right, down and forward axes in the world, its position, then focal
            length, column and row of its axis, and the near plane, (6, 3).
        colour: Red, green, blue [0 to 255] and opacity, (4,).
        kind: UNLIT, FLAT or SMOOTH.
        over: Whether it is drawn over nearer objects.
    """
    focal, middle, level, near = view[4, 0], view[4, 1], view[4, 2], view[5, 0]
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        p = _product(world, 0, x, y, z) + world[0, 3] - view[3, 0]
        q = _product(world, 1, x, y, z) + world[1, 3] - view[3, 1]
        r = _product(world, 2, x, y, z) + world[2, 3] - view[3, 2]
        away = _product(view, 2, p, q, r)
        inverse = 1.0 / away if away > near else -1.0
        corners[k, 0] = middle + focal * _product(view, 0, p, q, r) * inverse
        corners[k, 1] = level + focal * _product(view, 1, p, q, r) * inverse
        corners[k, 2] = near * inverse
        corners[k, 3] = 1.0
        if kind == SMOOTH:
            corners[k, 3] = _brightness(turn, normals, k, p, q, r)
    for k in range(len(faces)):
        a, b, c = faces[k, 0], faces[k, 1], faces[k, 2]
        shade = -1.0
        if kind == FLAT:
            x, y, z = points[a, 0], points[a, 1], points[a, 2]
            p = _product(world, 0, x, y, z) + world[0, 3] - view[3, 0]
            q = _product(world, 1, x, y, z) + world[1, 3] - view[3, 1]
            r = _product(world, 2, x, y, z) + world[2, 3] - view[3, 2]
            shade = _brightness(turn, normals, k, p, q, r)
        draw_triangle(samples, corners, a, b, c, colour, shade, over)


@compiled
def draw_segments(
    samples: Samples,
    corners: Array,
    ends: Array,
    opacities: Array,
    view: Array,
    colour: Array,
    width: float,
    over: bool,
) -> None:
    """Draw straight segments as rectangles that face the camera.

    Args:
        samples: The picture.
        corners: Memory for four points, (≥ 4, 4).
        ends: Both ends of each segment in the world, (N, 2, 3) [m].
        opacities: Opacity of each segment, (N,).
        view: The camera, see `draw_mesh`.
        colour: Red, green, blue [0 to 255] and memory for an opacity, (4,).
        width: Width of the segments in samples.
        over: Whether they are drawn over nearer objects.
    """
    focal, middle, level, near = view[4, 0], view[4, 1], view[4, 2], view[5, 0]
    for k in range(len(ends)):
        for end in range(2):
            p = ends[k, end, 0] - view[3, 0]
            q = ends[k, end, 1] - view[3, 1]
            r = ends[k, end, 2] - view[3, 2]
            away = _product(view, 2, p, q, r)
            inverse = 1.0 / away if away > near else -1.0
            corners[2 * end, 0] = middle + focal * _product(view, 0, p, q, r) * inverse
            corners[2 * end, 1] = level + focal * _product(view, 1, p, q, r) * inverse
            corners[2 * end, 2] = near * inverse
        along, down = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1]
        length = math.sqrt(along * along + down * down)
        if length == 0.0:
            continue
        along, down = 0.5 * width * along / length, 0.5 * width * down / length
        for end in range(2):
            a, b = 2 * end, 2 * end + 1
            corners[b, 0], corners[b, 1] = corners[a, 0] + down, corners[a, 1] - along
            corners[a, 0], corners[a, 1] = corners[a, 0] - down, corners[a, 1] + along
            corners[b, 2] = corners[a, 2]
        colour[3] = opacities[k]
        draw_triangle(samples, corners, 0, 1, 2, colour, 1.0, over)
        draw_triangle(samples, corners, 1, 2, 3, colour, 1.0, over)


@compiled
def draw_picture(samples: Samples, picture: Samples, row: int, column: int) -> None:
    """Draw a picture whose pixels are opacity, red, green and blue in 32 bits, over all else.

    Args:
        samples: The picture to draw on.
        picture: The picture, (rows, columns) of samples.
        row: First row.
        column: First column.
    """
    for i in range(max(0, -row), min(picture.shape[0], samples.shape[0] - row)):
        for j in range(max(0, -column), min(picture.shape[1], samples.shape[1] - column)):
            new, old = picture[i, j], samples[row + i, column + j]
            opacity = new >> 24
            value = old >> 24 << 24
            for shift in (16, 8, 0):
                mean = opacity * (new >> shift & 255) + (255 - opacity) * (old >> shift & 255)
                value |= (mean + 127) // 255 << shift
            samples[row + i, column + j] = value


@compiled
def average_samples(samples: Samples, pixels: Samples) -> None:
    """Store the mean colour of the samples of each pixel, (rows, columns)."""
    for i in range(pixels.shape[0]):
        for j in range(pixels.shape[1]):
            violet = green = 0
            for a in range(SIDE):
                for b in range(SIDE):
                    sample = samples[SIDE * i + a, SIDE * j + b]
                    violet += sample & 0xFF00FF  # red and blue do not meet in a sum of four
                    green += sample & 0x00FF00
            violet = (violet + 0x020002) >> 2 & 0xFF00FF
            pixels[i, j] = violet | ((green + 0x000200) >> 2 & 0x00FF00)
