"""Triangle meshes of shapes and cameras, which the players of other packages share."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pinred.common.arrays import Array
from pinred.system.urdf_shapes import Mesh
from pinred.views.playback.drawn_bodies import Solid, facets, solid_mesh, vertex_normals
from pinred.views.playback.scene_nodes import interpolate_placements

SOLIDS = {  # {kind: (size, volume)}
    "box": ((0.1, 0.2, 0.3), 8.0 * 0.006),
    "sphere": ((0.5,), np.pi / 6.0),
    "ellipsoid": ((0.1, 0.2, 0.3), 4.0 / 3.0 * np.pi * 0.006),
    "cylinder": ((0.2, 0.5), np.pi * 0.04),
    "cone": ((0.3, 0.5), np.pi * 0.03),
    "capsule": ((0.2, 0.5), np.pi * 0.04 + 4.0 / 3.0 * np.pi * 0.008),
}


def mesh_of(kind: str) -> Mesh:
    """Return the mesh of a shape."""
    return solid_mesh(Solid(1, kind, SOLIDS[kind][0], np.eye(7)[6], (1.0, 1.0, 1.0, 1.0)), ())


def volume(mesh: Mesh) -> float:
    """Return the volume, which is negative for faces that are clockwise outside."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float((np.cross(a, b) * c).sum() / 6.0)


@pytest.mark.parametrize("kind", SOLIDS)
def test_meshes_have_the_volume_of_the_shape(kind: str) -> None:
    """Polyhedra inside of round shapes lose a few percent; each edge has two faces."""
    mesh, exact = mesh_of(kind), SOLIDS[kind][1]
    assert 0.97 * exact < volume(mesh) <= exact * (1.0 + 1e-12)
    assert volume(facets(mesh)) == pytest.approx(volume(mesh), rel=1e-12)
    limits = np.abs(mesh.vertices).max(axis=0)
    size = SOLIDS[kind][0]
    ends = {1: size * 3, 3: size}.get(len(size), (size[0], size[0], sum(size[kind != "capsule" :])))
    np.testing.assert_allclose(limits, ends, rtol=1e-12)
    _, corners = np.unique(np.round(mesh.vertices, 9), axis=0, return_inverse=True)
    faces = corners.reshape(-1)[mesh.faces]
    faces = faces[(np.diff(np.sort(faces, axis=1), axis=1) > 0).all(axis=1)]  # poles are points
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forth, counts = np.unique(edges, axis=0, return_counts=True)
    back = np.unique(edges[:, ::-1], axis=0)
    np.testing.assert_array_equal(forth, back)
    assert counts.max() == 1


def test_normals_of_an_ellipsoid_are_its_gradient() -> None:
    """Normals of edges are not averaged: those of a box are the axes."""
    mesh, semi = mesh_of("ellipsoid"), np.array(SOLIDS["ellipsoid"][0])
    exact = mesh.vertices / semi**2
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    cosines = (vertex_normals(mesh) * exact).sum(axis=1)
    assert (cosines > 0.95).all()  # poles have the normals of their faces
    assert np.median(cosines) > 0.995
    np.testing.assert_allclose(np.abs(vertex_normals(mesh_of("box"))).max(axis=1), 1.0, rtol=1e-12)


def test_placements_between_frames_are_on_the_shortest_arc() -> None:
    """Frames are exact; a quaternion of opposite sign is the same rotation."""
    rotations = [pin.exp3(np.array([0.0, 0.0, angle])) for angle in (0.3, 0.7)]
    frames: Array = np.array(
        [
            [*position, *pin.Quaternion(turn).coeffs()]
            for position, turn in zip(([0.0, 1, 2], [2.0, 1, 0]), rotations, strict=True)
        ]
    )
    frames[1, 3:] *= -1.0
    t = np.array([1.0, 2.0])
    np.testing.assert_allclose(interpolate_placements(t, frames, 1.0), frames[0], rtol=1e-15)
    np.testing.assert_allclose(interpolate_placements(t, frames, 2.0)[:3], frames[1, :3])
    middle = pin.XYZQUATToSE3(interpolate_placements(t, frames, 1.5))
    np.testing.assert_allclose(middle.translation, 1.0, rtol=1e-15)
    np.testing.assert_allclose(pin.log3(middle.rotation), [0.0, 0.0, 0.5], atol=1e-12)
