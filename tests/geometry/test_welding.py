import numpy as np

from pb4u.geometry.topology import Topology
from pb4u.geometry.welding import coincident_border_vertices


def test_vertices_on_top_of_each_other_find_the_lowest():
    # Two unit squares side by side, each with its own copy of the shared side.
    left = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    right = left + np.array([1.0, 0, 0])
    vertices = np.concatenate([left, right]) + np.array([0.0, 0.0, 5e-6])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    target = coincident_border_vertices(vertices, Topology(faces, 8))
    assert target.tolist() == [0, 1, 2, 3, 1, 5, 6, 2]


def test_ends_of_a_short_edge_are_not_joined():
    vertices = np.array([[0, 0, 0], [1e-5, 0, 0], [0, 1, 0.0]])
    topology = Topology(np.array([[0, 1, 2]]), 3)
    assert coincident_border_vertices(vertices, topology).tolist() == [0, 1, 2]


def test_a_closed_mesh_has_nothing_to_weld():
    vertices = np.zeros((4, 3))
    topology = Topology(np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]), 4)
    assert coincident_border_vertices(vertices, topology).tolist() == [0, 1, 2, 3]
