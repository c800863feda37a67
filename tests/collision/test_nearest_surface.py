"""Nearest points against brute force and closed forms; signs at edges and corners; borders."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from pb4u.collision.nearest_surface import TriangleSurface
from pb4u.errors import InputError
from pb4u.geometry.closest_point import closest_barycentric
from pb4u.geometry.principal_stretch import face_strains, principal_stretches, weighted_percentile


def box() -> trimesh.Trimesh:
    return trimesh.creation.box(extents=(2.0, 2.0, 2.0))


def posed(mesh: trimesh.Trimesh, region: np.ndarray | None = None):  # type: ignore[no-untyped-def]
    return TriangleSurface(np.asarray(mesh.faces), len(mesh.vertices), region).at(np.asarray(mesh.vertices))


def random_points(count: int, size: float = 1.5, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-size, size, (count, 3))


def test_signed_distance_of_a_box() -> None:
    points = random_points(400, 2.0)
    outside = np.linalg.norm(np.maximum(np.abs(points) - 1.0, 0.0), axis=1)
    inside = np.minimum(np.abs(points).max(axis=1) - 1.0, 0.0)
    found = posed(box()).nearest(points)
    np.testing.assert_allclose(found.signed_distance.numpy(), outside + inside, atol=1e-12)


def winding_numbers(points: torch.Tensor, a: torch.Tensor, b: torch.Tensor, c: torch.Tensor) -> torch.Tensor:
    """1 inside a closed surface, 0 outside: the solid angles of all its triangles (Van Oosterom and Strackee 1983)."""
    u, v, w = (corner[None] - points[:, None] for corner in (a, b, c))
    lu, lv, lw = (edge.norm(dim=-1) for edge in (u, v, w))
    volume = (u * torch.linalg.cross(v, w)).sum(-1)
    rest = lu * lv * lw + (u * v).sum(-1) * lw + (v * w).sum(-1) * lu + (w * u).sum(-1) * lv
    return torch.atan2(volume, rest).sum(1) / (2.0 * torch.pi)


def test_the_tree_the_candidates_and_brute_force_agree() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.7)
    mesh.vertices *= [1.0, 0.3, 1.6]
    surface = posed(mesh)
    points = torch.from_numpy(random_points(300))
    a, b, c = (torch.from_numpy(np.asarray(mesh.vertices)[mesh.faces[:, k]]) for k in range(3))
    spread = points[:, None].expand(-1, len(a), 3)
    barycentric = closest_barycentric(spread, a.expand_as(spread), b.expand_as(spread), c.expand_as(spread))
    closest = barycentric[..., :1] * a + barycentric[..., 1:2] * b + barycentric[..., 2:] * c
    expected = (spread - closest).norm(dim=-1).amin(dim=1)
    found = surface.nearest(points)
    torch.testing.assert_close(found.signed_distance.abs(), expected, rtol=0, atol=1e-12)
    torch.testing.assert_close((points - found.positions).norm(dim=1), expected, rtol=0, atol=1e-12)
    candidate = surface.batch.closest(points[None]).triangle
    torch.testing.assert_close((points - closest[torch.arange(300), candidate]).norm(dim=1), expected)
    np.testing.assert_array_equal((found.signed_distance < 0).numpy(), winding_numbers(points, a, b, c).numpy() > 0.5)


def test_sign_beyond_a_sharp_edge_and_corner() -> None:
    """Where a single face's normal would err: nearest to an edge or a corner of a thin wedge."""
    corners = [[0, 0, 0], [1, 0.05, 0], [1, -0.05, 0], [0.5, 0, 1]]
    wedge = trimesh.Trimesh(corners, [[0, 1, 3], [0, 3, 2], [1, 2, 3], [0, 2, 1]])
    wedge.fix_normals()
    points = np.array([[-0.1, 0.02, 0.0], [-0.1, -0.02, 0.1], [0.5, 0.0, 1.2], [0.7, 0.0, 0.1]])
    signs = np.sign(posed(wedge).nearest(points).signed_distance.numpy())
    np.testing.assert_array_equal(signs, [1, 1, 1, -1])


def test_normals_are_the_gradient_of_the_distance() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.8)
    surface, points = posed(mesh), random_points(60, 1.2, seed=3)
    found, h = surface.nearest(points), 1e-6
    slopes = [
        (surface.nearest(points + h * e).signed_distance - surface.nearest(points - h * e).signed_distance) / (2 * h)
        for e in np.eye(3)
    ]
    smooth = found.signed_distance > 0.01
    torch.testing.assert_close(torch.stack(slopes, 1)[smooth], found.normals[smooth], rtol=0, atol=1e-4)


def test_beyond_the_border_of_a_region_nothing_is_inside() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    region = np.asarray(mesh.vertices[:, 1] < 0.3)
    surface = posed(mesh, region)
    found = surface.nearest(np.array([[0.0, 0.9, 0.0], [0.0, 1.1, 0.0], [0.0, -0.9, 0.0]]))
    assert found.beyond_border.tolist() == [True, True, False]
    assert found.signed_distance[0] > 0
    assert found.signed_distance[2] < 0
    assert region[np.asarray(mesh.faces)[found.triangle.numpy()]].all(), "faces are numbered as in the whole surface"


def limb() -> tuple[trimesh.Trimesh, np.ndarray]:
    """A bar along X with 24 sides, radius 0.03 and ends at 0 and 0.3, and which of its vertices are not of the hand."""
    bar = trimesh.creation.cylinder(radius=0.03, height=0.3, sections=24)
    bar.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0.0, 1.0, 0.0]))
    bar.apply_translation([0.15, 0.0, 0.0])
    bar = bar.subdivide().subdivide().subdivide()
    return bar, np.asarray(bar.vertices)[:, 0] < 0.22


def test_what_came_into_a_limb_by_its_open_end_is_inside_once_that_is_capped() -> None:
    bar, arm = limb()
    faces, vertices = np.asarray(bar.faces), np.asarray(bar.vertices)
    cut = vertices[faces[arm[faces].all(axis=1)], 0].max()
    points = np.array([[cut - 0.004, 0.005, 0.0], [cut + 0.004, 0.005, 0.0], [0.1, 0.028, 0.0], [0.1, 0.04, 0.0]])
    is_open, capped = (TriangleSurface(faces, len(vertices), arm, capped=closed) for closed in (False, True))
    # The nearest way out of the open end is the side of the limb, half of a cloth that came in by each.
    assert float(is_open.at(vertices).nearest(points[:1]).normals[0, 0]) < 0.5
    found = capped.at(vertices).nearest(points)
    assert (found.signed_distance.numpy() < 0.0).tolist() == [True, False, True, False]
    assert not found.beyond_border.any()
    np.testing.assert_allclose(found.normals.numpy()[:2], [[1.0, 0.0, 0.0]] * 2, atol=0.2)
    # Its caps follow the given faces, and only its own faces are skin.
    assert (found.triangle.numpy() >= len(faces)).tolist() == [True, True, False, False]
    assert len(capped.region_faces) + len(capped.caps) == len(capped.faces)
    assert np.array_equal(capped.region_faces, is_open.faces)


def test_the_border_of_the_surface_itself_is_not_capped() -> None:
    bar, arm = limb()
    faces = np.asarray(bar.faces)
    still_open = faces[(np.asarray(bar.vertices)[faces][:, :, 0] > 0.05).all(axis=1)]
    whole = np.ones(len(arm), dtype=bool)
    assert not len(TriangleSurface(still_open, len(arm), whole, capped=True).caps)
    loops = TriangleSurface(still_open, len(arm), arm, capped=True).topology.boundary_loops
    assert len(loops) == 1
    assert np.asarray(bar.vertices)[loops[0], 0].max() < 0.1


@pytest.mark.parametrize("cut", [False, True])
def test_the_compiled_search_and_the_candidates_describe_the_same_points(cut: bool) -> None:
    """Faces, edges and corners, inside and outside, with and without a border; in a later pose than the tree's."""
    mesh = box().subdivide().subdivide()
    region = np.asarray(mesh.vertices[:, 1] < 0.3) if cut else None
    surface = TriangleSurface(np.asarray(mesh.faces), len(mesh.vertices), region)
    surface.at(np.asarray(mesh.vertices)).nearest(np.zeros((1, 3)))
    moved = surface.at(np.asarray(mesh.vertices) * [1.0, 0.4, 1.3] + 0.05 * np.sin(7.0 * np.asarray(mesh.vertices)))
    points = torch.from_numpy(random_points(500, 2.0, seed=5))
    kept = points[(moved.nearest(points).signed_distance.abs() > 1e-3)]
    found = moved.nearest(kept)
    near = moved.batch.closest(kept[None])
    positions, normals, distance, beyond = near.positions, near.normals, near.signed_distance, near.beyond_border
    zeros = (found.barycentric <= 1e-12).sum(1)
    assert {0, 1, 2} <= set(zeros.tolist())
    assert bool(beyond.any()) == cut
    assert bool((distance < 0).any())
    torch.testing.assert_close(found.positions, positions, rtol=0, atol=1e-9)
    torch.testing.assert_close(found.signed_distance, distance, rtol=0, atol=1e-12)
    torch.testing.assert_close(found.normals, normals, rtol=0, atol=1e-9)
    assert torch.equal(found.beyond_border, beyond)


def test_nearest_face_centre() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2)
    points = random_points(50)
    face, distance = posed(mesh).nearest_face_centre(points)
    gaps = np.linalg.norm(points[:, None] - mesh.triangles_center[None], axis=2)
    np.testing.assert_array_equal(face.numpy(), gaps.argmin(axis=1))
    np.testing.assert_allclose(distance.numpy(), gaps.min(axis=1))


def test_results_follow_the_dtype_of_the_points() -> None:
    found = posed(box()).nearest(torch.zeros(2, 3, dtype=torch.float32))
    assert found.positions.dtype == found.signed_distance.dtype == torch.float32


def test_a_degenerate_triangle_counts_as_its_edges() -> None:
    a, b, c = (torch.tensor([v], dtype=torch.float64) for v in ([0.0, 0, 0], [1.0, 0, 0], [0.5, 0, 0]))
    barycentric = closest_barycentric(torch.tensor([[0.25, 1.0, 0.0]], dtype=torch.float64), a, b, c)
    assert torch.isfinite(barycentric).all()
    assert float(barycentric[0, 1] + 0.5 * barycentric[0, 2]) == pytest.approx(0.25)


def test_refusals() -> None:
    mesh = box()
    with pytest.raises(InputError, match="not finite"):
        posed(mesh).nearest(np.array([[np.nan, 0.0, 0.0]]))
    with pytest.raises(InputError, match="contact region of the body is empty"):
        TriangleSurface(np.asarray(mesh.faces), len(mesh.vertices), np.zeros(len(mesh.vertices), dtype=bool))
    with pytest.raises(InputError, match="8 vertices"):
        TriangleSurface(np.asarray(mesh.faces), len(mesh.vertices)).at(np.zeros((7, 3)))


def test_principal_stretches_of_a_known_deformation() -> None:
    positions = torch.tensor([[0.0, 0, 0], [1.3, 0, 0], [0.4, 0.0, 0.7]], dtype=torch.float64)
    faces, inverse = torch.tensor([[0, 1, 2]]), torch.eye(2, dtype=torch.float64)[None]
    expected = np.linalg.svd([[1.3, 0.4], [0.0, 0.7]], compute_uv=False)
    np.testing.assert_allclose(principal_stretches(positions, faces, inverse)[0].numpy(), expected, rtol=1e-12)
    assert float(face_strains(positions, faces, inverse)) == pytest.approx(np.abs(expected - 1).max())


def test_weighted_percentile() -> None:
    values = torch.tensor([3.0, 1.0, 2.0])
    assert float(weighted_percentile(values, torch.tensor([1.0, 98.0, 1.0]), 95)) == 1.0
    assert float(weighted_percentile(values, torch.tensor([10.0, 80.0, 10.0]), 95)) == 3.0
    assert float(weighted_percentile(values, torch.tensor([10.0, 80.0, 10.0]), 90)) == 2.0
