"""Triangle meshes of shapes, for viewers other than pinred's page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...common.arrays import Array
from ...system.urdf_shapes import Mesh
from .drawn_bodies import Solid

_AROUND = 32  # number of sides of a round shape
_RISE = 16  # number of steps from pole to pole
_CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])  # of a square, anticlockwise


def solid_mesh(solid: Solid, meshes: Sequence[Mesh]) -> Mesh:
    """Return the surface of a shape in the shape's own frame, with faces anticlockwise outside.

    Edges have separate vertices on each side, so that averaged normals keep them sharp.

    Args:
        solid: The shape.
        meshes: The meshes of the robot.
    Returns:
        The surface.
    """
    size = solid.size
    if solid.kind == "mesh":
        return meshes[int(size[0])]
    if solid.kind == "box":
        return _box(np.array(size))
    if solid.kind == "sphere":
        return _ball(np.full(3, size[0]))
    if solid.kind == "ellipsoid":
        return _ball(np.array(size))
    radius, half = size
    if solid.kind == "capsule":
        quarter = np.linspace(0.0, 0.5 * np.pi, _RISE // 2 + 1)
        angles = np.concatenate([-quarter[::-1], quarter])
        shift = np.repeat([-half, half], len(quarter))
        height = radius * np.sin(angles) + shift
        return _revolve([np.column_stack([radius * np.cos(angles), height])])
    base = np.array([[0.0, -half], [radius, -half]])
    if solid.kind == "cone":
        return _revolve([base, np.array([[radius, -half], [0.0, half]])])
    side, top = np.array([[radius, -half], [radius, half]]), np.array([[radius, half], [0.0, half]])
    return _revolve([base, side, top])


def vertex_normals(mesh: Mesh) -> Array:
    """Return unit normals of the vertices, means over the faces weighted by area, (V, 3)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.zeros_like(mesh.vertices)
    for k in range(3):
        np.add.at(normals, mesh.faces[:, k], np.cross(b - a, c - a))
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(lengths > 0.0, lengths, 1.0))


def face_normals(mesh: Mesh) -> Array:
    """Return unit normals of the triangles, (T, 3); zero for triangles without area."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(lengths > 0.0, lengths, 1.0))


def facets(mesh: Mesh) -> Mesh:
    """Return a mesh whose triangles share no vertices, so that each is drawn flat."""
    return Mesh(
        mesh.vertices[mesh.faces].reshape(-1, 3),
        np.arange(mesh.faces.size, dtype=np.uint32).reshape(-1, 3),
    )


def _ball(semi_axes: Array) -> Mesh:
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _RISE + 1)
    unit = _revolve([np.column_stack([np.cos(angles), np.sin(angles)])])
    return Mesh(unit.vertices * semi_axes, unit.faces)


def _box(half: Array) -> Mesh:
    """Return a box of six faces with four vertices each."""
    vertices: list[Array] = []
    faces: list[list[int]] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            corners = np.empty((4, 3))
            corners[:, axis] = sign
            corners[:, [(axis + 1) % 3, (axis + 2) % 3]] = _CORNERS[:: int(sign)]
            first = 4 * len(vertices)
            faces += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
            vertices.append(corners * half)
    return Mesh(np.concatenate(vertices), np.array(faces, dtype=np.uint32))


def _revolve(profiles: Sequence[Array]) -> Mesh:
    """Return the surface swept by curves of radius and height, from below to above, about z.

    Args:
        profiles: Points (radius, height) of each curve, (P, 2) [m].  Curves share no vertices.
    Returns:
        The surface.
    """
    angles = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    vertices, faces, first = [], [], 0
    for profile in profiles:
        rings = np.empty((len(profile), _AROUND, 3))
        rings[..., :2] = profile[:, None, :1] * circle
        rings[..., 2] = profile[:, 1:]
        vertices.append(rings.reshape(-1, 3))
        starts = first + _AROUND * np.arange(len(profile) - 1)[:, None]
        below = (starts + np.arange(_AROUND)).ravel()
        after = (starts + (np.arange(_AROUND) + 1) % _AROUND).ravel()
        faces.append(np.column_stack([below, after, after + _AROUND]))
        faces.append(np.column_stack([below, after + _AROUND, below + _AROUND]))
        first += rings[..., 0].size
    return Mesh(np.concatenate(vertices), np.concatenate(faces).astype(np.uint32))
