"""Cloth as it is sent to a browser."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from pb4u.viewer.surface import GarmentsSurface


class Scene:
    """Keeps what is added to it."""

    def __init__(self) -> None:
        self.meshes: list[Any] = []

    def add_mesh_simple(self, name: str, vertices: np.ndarray, faces: np.ndarray, **look: Any) -> Any:
        self.meshes.append(SimpleNamespace(name=name, vertices=vertices, faces=faces, visible=True, **look))
        return self.meshes[-1]


def test_each_garment_has_a_colour_and_only_its_own_vertices() -> None:
    scene: Any = Scene()
    # Vertices of the two garments by turns.
    vertex_garment = np.array([0, 1, 0, 1, 0, 1, 1])
    faces = np.array([[0, 2, 4], [1, 3, 5], [3, 5, 6]])
    points = np.arange(21, dtype=np.float32).reshape(7, 3)
    surface = GarmentsSurface(scene, "garment", faces, vertex_garment)
    assert surface.show(points, None)
    assert surface.show(points + 1.0, None)
    assert len(scene.meshes) == 2
    assert scene.meshes[0].color != scene.meshes[1].color
    drawn = np.concatenate([mesh.vertices[mesh.faces] for mesh in scene.meshes])
    np.testing.assert_array_equal(drawn, (points + 1.0)[faces])
    assert [len(mesh.vertices) for mesh in scene.meshes] == [3, 4]
