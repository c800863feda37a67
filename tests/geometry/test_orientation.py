import numpy as np

from pb4u.geometry.orientation import faces_to_flip
from pb4u.geometry.topology import Topology


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
