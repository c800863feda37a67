"""Connectivity derived from faces."""

from __future__ import annotations

import numpy as np

from pb4u.geometry.topology import Topology, faces_to_flip, joined_indices, offsets, ranges


def tube(around: int = 8, rows: int = 4) -> Topology:
    """An open tube: two border loops of `around` vertices."""
    faces = []
    for r in range(rows - 1):
        for k in range(around):
            a, b = r * around + k, r * around + (k + 1) % around
            c, d = a + around, b + around
            faces += [(a, b, d), (a, d, c)]
    return Topology(np.array(faces), around * rows)


def test_indices_of_joined_meshes_go_on_where_the_one_before_ends() -> None:
    starts = offsets([range(3), range(0), range(2)])
    assert starts == [0, 3, 3, 5]
    faces = [np.array([[0, 1, 2]]), np.zeros((0, 3), dtype=np.int64), np.array([[1, 0, 1]])]
    assert joined_indices(faces, starts).tolist() == [[0, 1, 2], [4, 3, 4]]


def test_ranges_come_one_after_the_other() -> None:
    assert ranges(np.array([4, 9, 0]), np.array([2, 0, 3])).tolist() == [4, 5, 0, 1, 2]


def test_euler_characteristic_of_a_tube_is_zero() -> None:
    mesh = tube()
    assert mesh.vertex_count - len(mesh.edges) + len(mesh.faces) == 0


def test_hinges_pair_every_inner_edge_with_its_two_opposite_vertices() -> None:
    mesh = tube()
    assert len(mesh.hinges) == (mesh.edge_face_counts == 2).sum()
    for (v0, v1, v2, v3), (f, g) in zip(mesh.hinges, mesh.hinge_faces, strict=True):
        assert set(mesh.faces[f]) == {v0, v1, v2}
        assert set(mesh.faces[g]) == {v0, v1, v3}
        corner = mesh.faces[f].tolist().index(v0)
        assert mesh.faces[f][(corner + 1) % 3] == v1


def test_border_loops_are_closed_and_follow_the_faces() -> None:
    mesh = tube(around=8, rows=4)
    assert [len(loop) for loop in mesh.boundary_loops] == [8, 8]
    directed = {tuple(edge) for edge in mesh.boundary_edges.tolist()}
    for loop in mesh.boundary_loops:
        assert {(a, b) for a, b in zip(loop, np.roll(loop, -1), strict=True)} <= directed


def test_faults_are_found() -> None:
    fin = Topology(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]), 6)
    assert fin.non_manifold_edges.tolist() == [[0, 1]]
    assert fin.isolated_vertices.tolist() == [5]
    assert not fin.is_consistently_oriented
    assert not fin.is_closed
    assert tube().is_consistently_oriented


def test_pieces_are_counted() -> None:
    two = Topology(np.array([[0, 1, 2], [3, 4, 5]]), 6)
    assert len(np.unique(two.piece_of_vertex)) == 2


def test_tetrahedron_is_closed_and_has_no_border() -> None:
    solid = Topology(np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]), 4)
    assert solid.is_closed
    assert solid.is_consistently_oriented
    assert solid.boundary_loops == ()


def strip(n, twisted):
    """A closed band of 2 n triangles."""
    a = np.arange(n) * 2
    b = (a + 2) % (2 * n)
    left, right = b.copy(), b + 1
    if twisted:
        left[-1], right[-1] = right[-1], left[-1]
    return np.concatenate([np.stack([a, a + 1, left], 1), np.stack([left, a + 1, right], 1)]).astype(np.int64)


def test_the_fewer_faces_of_each_piece_are_turned():
    one = strip(10, twisted=False)
    faces = np.concatenate([one, one + 20])
    turned = np.zeros(40, dtype=bool)
    turned[[3, 4, 17, 20, 31]] = True
    faces[turned] = faces[turned][:, ::-1]
    flip, orientable = faces_to_flip(Topology(faces, 40))
    assert orientable
    np.testing.assert_array_equal(flip, turned)


def test_a_mesh_that_agrees_is_left_alone():
    flip, orientable = faces_to_flip(Topology(strip(10, twisted=False), 20))
    assert orientable
    assert not flip.any()


def test_a_moebius_strip_has_one_side():
    flip, orientable = faces_to_flip(Topology(strip(10, twisted=True), 20))
    assert not orientable
    assert not flip.any()


def test_half_and_half_turns_one_half():
    faces = np.array([[0, 1, 2], [1, 2, 3]])
    flip, _ = faces_to_flip(Topology(faces, 4))
    assert flip.sum() == 1
    assert Topology(np.where(flip[:, None], faces[:, ::-1], faces), 4).is_consistently_oriented
