import numpy as np

from pb4u.garment.source_surface import SourceSurface
from pb4u.geometry.mesh_file import PolygonMesh


def weld_target(vertices, faces):
    return SourceSurface.of(PolygonMesh(vertices, tuple(np.array(faces)))).weld_target


def test_vertices_on_top_of_each_other_find_the_lowest():
    # Two unit squares side by side, each with its own copy of the shared side.
    left = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    right = left + np.array([1.0, 0, 0])
    vertices = np.concatenate([left, right]) + np.array([0.0, 0.0, 5e-6])
    assert weld_target(vertices, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]).tolist() == [0, 1, 2, 3, 1, 5, 6, 2]


def test_ends_of_a_short_edge_are_not_joined():
    vertices = np.array([[0, 0, 0], [1e-5, 0, 0], [0, 1, 0.0]])
    assert weld_target(vertices, [[0, 1, 2]]).tolist() == [0, 1, 2]


def test_a_closed_mesh_has_nothing_to_weld():
    vertices = 1e-5 * np.eye(4, 3)
    assert weld_target(vertices, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]).tolist() == [0, 1, 2, 3]
