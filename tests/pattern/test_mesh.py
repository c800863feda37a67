from __future__ import annotations

import numpy as np
import pytest
from tests.pattern.patterns import gathered, skirt, square

from pb4u.errors import InputError
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import face_areas
from pb4u.pattern.mesh import mesh_pattern
from pb4u.pattern.pattern import Panel, Pattern, Seam


def _areas(corners: np.ndarray) -> np.ndarray:
    flat = np.pad(corners.reshape(-1, 2), ((0, 0), (0, 1)))
    return face_areas(flat, np.arange(len(flat)).reshape(-1, 3))


@pytest.mark.parametrize("triangles", [100, 700, 4000])
def test_straight_panels_keep_their_areas_and_edges_at_every_count(triangles: int):
    pattern = skirt()
    mesh = mesh_pattern(pattern, triangles)
    assert len(mesh.faces) == pytest.approx(triangles, rel=0.1)
    areas = _areas(mesh.rest_uv)
    for number, panel in enumerate(pattern.panels):
        assert areas[mesh.face_panel == number].sum() == pytest.approx(abs(panel.area), rel=1e-9)
    lengths = np.array([pattern.seam_lengths(seam) for seam in pattern.seams])
    assert mesh.seam_lengths == pytest.approx(lengths, rel=1e-9)


@pytest.mark.parametrize("triangles", [60, 300, 2500])
def test_gathers_darts_and_curves_are_sewn_one_to_one(triangles: int):
    mesh = mesh_pattern(gathered(), triangles)
    topology = Topology(mesh.sewn_faces, mesh.vertex_count)
    assert not len(topology.non_manifold_edges)
    assert topology.is_consistently_oriented
    assert len(topology.boundary_loops) == 1
    for one, other in mesh.sides:
        assert (mesh.vertex[one] == mesh.vertex[other]).all()
    # Triangles are even: 1 is equilateral.
    corners = mesh.rest_uv
    sides = np.square(corners - np.roll(corners, 1, axis=1)).sum(axis=(1, 2))
    assert (4.0 * np.sqrt(3.0) * _areas(corners) / sides).min() > 0.2
    assert _areas(corners).min() > 0.0


def test_curves_are_followed_with_the_square_of_the_edge_length():
    exact = gathered().area
    coarse, fine = (abs(_areas(mesh_pattern(gathered(), count).rest_uv).sum() - exact) for count in (300, 4800))
    assert fine < coarse / 8.0


def test_chords_of_a_curve_end_on_it():
    pattern = gathered()
    mesh, panel = mesh_pattern(pattern, 300), pattern.panels[1]
    own = mesh.panel == 1
    shape = Topology(mesh.faces[mesh.face_panel == 1] - np.flatnonzero(own)[0], own.sum())
    border = mesh.points[own][shape.boundary_loops[0]]
    for edge in panel.curves:
        ends = panel.corners[[edge, (edge + 1) % panel.edge_count]]
        start, end = (int(np.hypot(*(border - corner).T).argmin()) for corner in ends)
        chords = np.roll(border, -start, axis=0)[: (end - start) % len(border) + 1]
        on_curve = panel.edge_points(edge, np.linspace(0.0, 1.0, len(chords)))
        assert len(chords) > 4
        assert chords == pytest.approx(on_curve, abs=1e-9)


def test_edges_sewn_the_other_way_round_meet_start_to_start():
    panels = [square("a"), square("b")]
    mesh = mesh_pattern(Pattern("twisted", panels, [Seam(("a", 1), ("b", 1), same_way=True)]), 100)
    one, other = mesh.sides[0]
    assert mesh.points[one] == pytest.approx(mesh.points[other])


def test_a_bag_sewn_along_adjacent_edges_has_no_edge_of_more_than_two_faces():
    panels = [square("a"), square("b")]
    seams = [Seam(("a", 0), ("b", 0), same_way=True), Seam(("a", 1), ("b", 1), same_way=True)]
    mesh = mesh_pattern(Pattern("bag", panels, seams), 40)
    assert not len(Topology(mesh.sewn_faces, mesh.vertex_count).non_manifold_edges)


def test_panels_lie_side_by_side_in_the_texture():
    mesh = mesh_pattern(skirt(), 300)
    assert mesh.uvs.min() >= 0.0
    assert mesh.uvs.max() <= 1.0
    # All triangles have one scale, and none lies on another.
    uv_areas = _areas(mesh.uvs[mesh.faces])
    assert uv_areas / _areas(mesh.rest_uv) == pytest.approx(uv_areas[0] / _areas(mesh.rest_uv)[0])
    boxes = [(mesh.uvs[mesh.panel == k].min(axis=0), mesh.uvs[mesh.panel == k].max(axis=0)) for k in range(4)]
    for k, (low, high) in enumerate(boxes):
        assert not any(((low < other[1]) & (other[0] < high)).all() for other in boxes[:k])


def test_too_few_triangles_are_refused():
    with pytest.raises(InputError, match=r"10 triangles .*4 panels of skirt"):
        mesh_pattern(skirt(), 10)


@pytest.mark.parametrize(
    ("corners", "touching"),
    [
        ([(0, 0), (0.2, 0), (0.2, 0.15), (0.2001, 0), (0.4, 0), (0.4, 0.4), (0, 0.4)], "1 and 2"),
        ([(0, 0), (0.4, 0), (0.4, 0.4), (0.2, 0), (0, 0.4)], "0 and 3"),
    ],
)
def test_a_slit_without_width_and_edges_that_touch_are_refused(corners: list, touching: str):
    with pytest.raises(InputError, match=f"Panel a: its edges {touching} touch"):
        mesh_pattern(Pattern("torn", [Panel("a", corners)], []), 300)
