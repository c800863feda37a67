import numpy as np
import pytest
from trimesh.triangles import angles

from pb4u.collision.remeshing import _in_order_of_place, remesh
from pb4u.errors import InputError
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import edge_lengths, face_areas


def grid(columns: int, rows: int, width: float = 1.0, height: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.linspace(0, width, columns), np.linspace(0, height, rows), indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    i, j = np.meshgrid(np.arange(columns - 1), np.arange(rows - 1), indexing="ij")
    a = (i * rows + j).ravel()
    b, c, d = a + rows, a + rows + 1, a + 1
    return vertices, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def cylinder(around: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = grid(around + 1, rows, 2 * np.pi, 2.0)
    angle = vertices[:, 0]
    vertices = np.column_stack([np.cos(angle), np.sin(angle), vertices[:, 1]])
    faces = np.where(faces >= around * rows, faces - around * rows, faces)
    return vertices[: around * rows], faces


def variation(vertices: np.ndarray, faces: np.ndarray) -> float:
    lengths = edge_lengths(vertices, Topology(faces, len(vertices)).edges)
    return float(lengths.std() / lengths.mean())


@pytest.mark.parametrize("triangles", [400, 3000])
def test_an_uneven_tube_becomes_even_and_keeps_its_borders(triangles: int) -> None:
    vertices, faces = cylinder(60, 9)
    new, new_faces = remesh(vertices, faces, triangles)
    topology = Topology(new_faces, len(new))
    assert abs(len(new_faces) / triangles - 1) <= 0.05
    assert len(topology.boundary_loops) == 2
    assert topology.is_consistently_oriented
    assert not len(topology.non_manifold_edges)
    assert variation(new, new_faces) < 0.2 < variation(vertices, faces)
    assert np.degrees(angles(new[new_faces]).min()) > 20
    for loop in topology.boundary_loops:
        height = new[loop, 2]
        np.testing.assert_allclose(height, np.round(height / 2) * 2, atol=1e-12)
    radius = np.linalg.norm(new[:, :2], axis=1)
    assert radius.max() <= 1 + 1e-12
    assert radius.min() >= np.cos(np.pi / 60) - 1e-9


def test_outward_stays_outward() -> None:
    vertices, faces = cylinder(40, 12)
    new, new_faces = remesh(vertices, faces, 900)
    a, b, c = (new[new_faces[:, k]] for k in range(3))
    before = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    outward = np.sign((before * vertices[faces[:, 0]] * [1, 1, 0]).sum())
    assert ((np.cross(b - a, c - a) * (a + b + c) * [1, 1, 0]).sum(axis=1) * outward > 0).all()


def test_a_square_keeps_corners_and_area() -> None:
    vertices, faces = grid(12, 30)
    new, new_faces = remesh(vertices, faces, 700)
    for corner in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)):
        assert np.linalg.norm(new - corner, axis=1).min() < 1e-12
    assert face_areas(new, new_faces).sum() == pytest.approx(1.0, abs=1e-9)


def test_pieces_stay_apart_and_unused_vertices_go() -> None:
    one, faces_one = grid(8, 8)
    two, faces_two = cylinder(30, 10)
    vertices = np.concatenate([one, [[9.0, 9.0, 9.0]], two + [5.0, 0.0, 0.0]])
    faces = np.concatenate([faces_one, faces_two + len(one) + 1])
    new, new_faces = remesh(vertices, faces, 1500)
    assert Topology(new_faces, len(new)).piece_of_vertex.max() == 1
    assert len(np.unique(new_faces)) == len(new)


def test_the_same_call_gives_the_same_mesh() -> None:
    vertices, faces = cylinder(50, 10)
    first, second = remesh(vertices, faces, 600), remesh(vertices, faces, 600)
    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[1], second[1])


def test_a_closed_surface_stays_closed() -> None:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3)
    new, new_faces = remesh(np.array(ball.vertices), np.array(ball.faces), 500)
    topology = Topology(new_faces, len(new))
    assert topology.is_closed
    assert len(new) - len(topology.edges) + len(new_faces) == 2


def test_what_cannot_be_remeshed_is_refused() -> None:
    vertices, faces = grid(4, 4)
    fin = np.concatenate([faces, [[0, 5, 15]]])
    with pytest.raises(InputError, match="three or more faces"):
        remesh(vertices, np.concatenate([fin, [[5, 0, 3]]]), 100)
    turned = faces.copy()
    turned[4] = turned[4, ::-1]
    with pytest.raises(InputError, match="opposite ways"):
        remesh(vertices, turned, 100)
    bow = np.array([[0, 1, 2], [0, 3, 4]])
    with pytest.raises(InputError, match="touch only at that point"):
        remesh(np.random.default_rng(0).random((5, 3)), bow, 100)
    for count in (0, -5):
        with pytest.raises(InputError, match="ask for more"):
            remesh(vertices, faces, count)
    tube, tube_faces = cylinder(60, 9)
    with pytest.raises(InputError, match="triangles"):
        remesh(tube, tube_faces, 6)


def test_in_order_of_place_a_mesh_is_the_same_and_neighbours_are_next_to_each_other() -> None:
    vertices, faces = grid(40, 40)
    shuffled = np.random.default_rng(0).permutation(len(vertices))
    rank = np.argsort(shuffled)
    ordered, ordered_faces = _in_order_of_place(vertices[shuffled], rank[faces])
    corners, before = ordered[ordered_faces], vertices[faces]
    # Each triangle begins with its lowest vertex: compared as cycles.
    cycles = {tuple(np.roll(face, -k, axis=0).ravel()) for face in before for k in range(3)}
    assert len(corners) == len(before)
    assert all(tuple(face.ravel()) in cycles for face in corners)
    assert np.ptp(ordered_faces, axis=1).mean() < 0.2 * np.ptp(rank[faces], axis=1).mean()
    assert np.diff(ordered_faces[:, 0]).min() >= 0
