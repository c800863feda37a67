"""Cloth as it is sent to a browser."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from tests.viewer.clips import frame, header

from pb4u.export.drawn_cloth import DrawnCloth
from pb4u.scene.trajectory import TrajectoryHeader
from pb4u.viewer.surface import GarmentsSurface


class Scene:
    """Keeps what is added to it."""

    def __init__(self) -> None:
        self.meshes: list[Any] = []
        self.lines: list[Any] = []

    def add_mesh_simple(self, name: str, vertices: np.ndarray, faces: np.ndarray, **look: Any) -> Any:
        self.meshes.append(SimpleNamespace(name=name, vertices=vertices, faces=faces, visible=True, **look))
        return self.meshes[-1]

    def add_line_segments(self, name: str, points: np.ndarray, colors: np.ndarray, thickness: float) -> Any:
        self.lines.append(SimpleNamespace(points=points, colors=colors, thickness=thickness))
        return self.lines[-1]


def test_each_garment_has_a_colour_and_only_its_own_vertices() -> None:
    scene: Any = Scene()
    # Vertices of the two garments by turns.
    vertex_garment = np.array([0, 1, 0, 1, 0, 1, 1])
    faces = np.array([[0, 2, 4], [1, 3, 5], [3, 5, 6]])
    points = np.arange(21, dtype=np.float32).reshape(7, 3)
    body = np.zeros((0, 3), dtype=np.int64)
    both = TrajectoryHeader(faces, points, np.zeros(7, bool), vertex_garment, body, np.zeros(0, bool), 30.0)
    surface = GarmentsSurface(scene, "garment", both)
    assert surface.show(points, None)
    assert surface.show(points + 1.0, None)
    assert len(scene.meshes) == 2
    assert scene.meshes[0].color != scene.meshes[1].color
    np.testing.assert_array_equal(
        np.concatenate([mesh.vertices[mesh.faces] for mesh in scene.meshes]),
        DrawnCloth(both).at(points + 1.0)[DrawnCloth(both).faces],
    )
    assert [len(mesh.vertices) for mesh in scene.meshes] == [3 + 3, 4 + 5]


def test_edges_are_those_of_the_simulated_triangles() -> None:
    scene: Any = Scene()
    GarmentsSurface(scene, "garment", header(), wireframe=True).show(frame(3).positions, None)
    (mesh,) = scene.meshes
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], frame(3).positions[header().faces])


def test_hems_lie_on_the_cloth_of_each_frame() -> None:
    scene: Any = Scene()
    surface = GarmentsSurface(scene, "garment", header())
    for t in (0, 5):
        surface.show(frame(t).positions, None)
        assert [lines.thickness for lines in scene.lines] == [0.0015, 0.005]
        for lines, depth in zip(scene.lines, (0.02, 0.0025), strict=True):
            ends = lines.points.reshape(-1, 3) - [0.01 * t, 0.0, 0.0]
            np.testing.assert_allclose(np.minimum(ends[:, 1] - 0.8, 1.3 - ends[:, 1]), depth, atol=5e-4)
            radius = np.linalg.norm(ends[:, [0, 2]], axis=1)
            assert 0.192 < radius.min() < radius.max() < 0.2015
    assert not GarmentsSurface(Scene(), "edges", header(), wireframe=True)._lines  # type: ignore[arg-type]
