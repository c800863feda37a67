import numpy as np

from pb4u.geometry.triangle_mesh import face_areas
from pb4u.geometry.triangulation import triangulate


def test_polygons_keep_their_order_orientation_and_area():
    vertices = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [3, 0, 0], [3, 1, 0.0]])
    polygons = (np.array([1, 4, 5, 2]), np.array([0, 1, 2]), np.array([0, 2, 3]))
    corners, owner = triangulate(vertices, polygons)
    faces = np.concatenate(polygons)[corners]
    assert owner.tolist() == [0, 0, 1, 2]
    assert face_areas(vertices, faces).sum() == 3.0
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    assert (normals[:, 2] > 0).all()


def test_a_quad_is_cut_along_its_shorter_diagonal():
    kite = np.array([[0, 0, 0], [1, -0.2, 0], [2, 0, 0], [1, 0.2, 0.0]])
    corners, _ = triangulate(kite, [np.arange(4)])
    assert {frozenset(face) for face in corners.tolist()} == {frozenset({0, 1, 3}), frozenset({1, 2, 3})}


def test_a_concave_polygon_in_any_plane_is_covered_once():
    angle = np.linspace(0, 2 * np.pi, 11)[:-1]
    radius = np.where(np.arange(10) % 2, 0.4, 1.0)
    flat = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(10)], axis=1)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    star = flat @ turn.T + np.array([1.0, 2.0, 3.0])
    corners, owner = triangulate(star, [np.arange(10)])
    assert corners.shape == (8, 3)
    assert owner.tolist() == [0] * 8
    following = np.roll(flat, -1, axis=0)
    area = 0.5 * abs(np.sum(flat[:, 0] * following[:, 1] - flat[:, 1] * following[:, 0]))
    np.testing.assert_allclose(face_areas(star, corners).sum(), area)


def best_ears_first(flat):
    """Every ear looked at anew before each cut, in the order of `triangulate`."""

    def quality(left, k):
        a, b, c = (flat[left[i % len(left)]] for i in (k - 1, k, k + 1))
        sides = np.array([b - a, c - b, a - c])
        area = sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0]
        others = flat[[i for i in left if i not in (left[k - 1], left[k], left[(k + 1) % len(left)])]]
        offsets = others[:, None] - np.array([a, b, c])
        inside = (sides[:, 0] * offsets[..., 1] - sides[:, 1] * offsets[..., 0] > 0).all(axis=1).any()
        return -1.0 if area <= 0 or inside else area / np.linalg.norm(sides, axis=1).sum() ** 2

    left, ears = list(range(len(flat))), set()
    while len(left) > 3:
        k = max(range(len(left)), key=lambda k: quality(left, k))
        ears.add(frozenset((left[k - 1], left[k], left[(k + 1) % len(left)])))
        del left[k]
    return ears | {frozenset(left)}


def test_large_polygons_are_cut_as_by_looking_at_every_corner_each_time():
    draw = np.random.default_rng(0)
    for count in (6, 9, 14, 25, 40):
        angle, radius = np.sort(draw.uniform(0, 2 * np.pi, count)), draw.uniform(0.3, 1, count)
        flat = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        corners, _ = triangulate(np.column_stack([flat, np.zeros(count)]), [np.arange(count)])
        assert {frozenset(ear) for ear in corners.tolist()} == best_ears_first(flat)


def test_no_polygons_give_no_triangles():
    corners, owner = triangulate(np.zeros((3, 3)), [])
    assert corners.shape == (0, 3)
    assert owner.shape == (0,)


def test_a_quad_is_never_cut_outside_of_itself():
    dart = np.array([[0, 0, 0], [1, 1, 0], [2, 0, 0], [1, 3, 0.0]])
    midpoint = np.array([[0, 0, 0], [0.5, 0, 0], [1, 0, 0], [0.5, 3, 0.0]])
    for corners in (dart, midpoint):
        for turned in range(4):
            points = np.roll(corners, turned, axis=0)
            faces, _ = triangulate(points, [np.arange(4)])
            a, b, c = (points[faces[:, k]] for k in range(3))
            assert (np.abs(np.cross(b - a, c - a)[:, 2]) > 0.1).all()
            assert len(set(np.sign(np.cross(b - a, c - a)[:, 2]))) == 1
