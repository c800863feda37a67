from dataclasses import replace

import numpy as np
import pytest
from cloth_shapes import CLOTH, quad_tube, saved, triangle_tube, tube_garment, with_open_seam

from pb4u.body.library import load_body
from pb4u.collision.crossings import self_crossings
from pb4u.errors import InputWarning
from pb4u.garment.diagnosis import diagnose
from pb4u.garment.fit import AXES, RestBody
from pb4u.garment.garment_file import read_garment
from pb4u.garment.repair import CLEARANCE, push_out, repair
from pb4u.garment.source_surface import SourceSurface
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.triangle_mesh import edge_lengths


@pytest.fixture(scope="module")
def woman():
    return load_body("woman")


def test_a_sound_garment_is_returned_as_it_was(woman):
    mesh = quad_tube(low=0.6, high=1.0, radius=0.22)
    mended, said, _ = repair(mesh, woman)
    assert said == ()
    np.testing.assert_array_equal(mended.vertices, mesh.vertices)
    np.testing.assert_array_equal(np.stack(mended.polygons), np.stack(mesh.polygons))


def test_units_axes_and_origin_are_set_right_with_polygons_and_uvs_kept(woman):
    mesh = quad_tube(low=0.2, high=1.0, radius=0.22)
    standing = mesh.vertices + np.array([0.0, 0.0, 0.02])
    file = 100.0 * (standing - [0.0, woman.lift, 0.0]) @ AXES["Z up, facing -Y"]
    mended, said, _ = repair(replace(mesh, vertices=file), woman)
    assert said[0] == "Scaled by 0.01, from centimetres to metres."
    assert said[1] == "Turned from Z up, facing -Y to Y up, facing +Z."
    assert said[2].startswith("Moved by +81.8 cm in y")
    np.testing.assert_allclose(mended.vertices, standing, atol=0.005)  # the hips were pushed a little
    np.testing.assert_array_equal(np.stack(mended.polygons), np.stack(mesh.polygons))
    np.testing.assert_array_equal(np.stack(mended.polygon_uvs), np.stack(mesh.polygon_uvs))


def test_cloth_with_a_front_and_a_back_is_not_sewn_shut():
    mesh = triangle_tube()
    back = [polygon[::-1] + len(mesh.vertices) for polygon in mesh.polygons]
    both = PolygonMesh(np.concatenate([mesh.vertices, mesh.vertices]), (*mesh.polygons, *back))
    mended, said, left = repair(both)
    assert not any("Welded" in sentence for sentence in said)
    assert any("no opening" in sentence for sentence in left)
    assert len(mended.vertices) == len(both.vertices)


def test_faults_of_the_mesh_are_mended_without_a_body():
    mesh = triangle_tube()
    torn = with_open_seam(mesh)
    polygons = list(torn.polygons)
    polygons[11] = polygons[11][::-1]
    polygons += [polygons[7], np.array([9, 9, 10])]
    broken = PolygonMesh(np.concatenate([torn.vertices, [[0.0, 0.7, 0.4]]]), tuple(polygons))
    assert {"unwelded", "duplicate", "degenerate", "orientation"} <= set(diagnose(broken).codes)
    mended, said, _ = repair(broken)
    assert diagnose(mended).codes == ()
    assert len(mended.vertices) == len(mesh.vertices)
    assert len(mended.polygons) == 1600
    assert len(said) == 4
    np.testing.assert_array_equal(np.sort(mended.vertices, axis=0), np.sort(mesh.vertices, axis=0))


def test_faces_turned_over_are_counted_alike_by_who_finds_and_who_turns_them(tmp_path):
    mesh = quad_tube()
    turned = replace(mesh, polygons=tuple(p[::-1] if 80 <= k < 160 else p for k, p in enumerate(mesh.polygons)))
    turned = replace(turned, uvs=None, polygon_uvs=None)
    (found,) = (each.sentence for each in diagnose(turned).findings if each.code == "orientation")
    assert found.startswith("80 face(s) are flipped")
    assert repair(turned)[1] == ("Turned 80 face(s) over to agree with their neighbours.",)
    with pytest.warns(InputWarning, match="80 face.s. are flipped"):
        read_garment(saved(tmp_path, turned), CLOTH)


def test_a_seam_whose_weld_would_join_three_faces_stays_open():
    vertices = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    mesh = PolygonMesh(vertices, (np.array([0, 1, 3]), np.array([1, 0, 2]), np.array([4, 5, 6])))
    mended, said, left = repair(mesh)
    assert len(mended.vertices) == 7
    assert said == ()
    assert "left open" in left[0]


def test_a_garment_inside_out_is_turned(woman):
    mesh = quad_tube(low=0.6, high=1.0, radius=0.22)
    wrong = replace(
        mesh,
        polygons=tuple(p[::-1] for p in mesh.polygons),
        polygon_uvs=tuple(p[::-1] for p in mesh.polygon_uvs),
    )
    mended, said, _ = repair(wrong, woman)
    assert said == ("Turned the garment right side out.",)
    np.testing.assert_array_equal(np.stack(mended.polygons), np.stack(mesh.polygons))
    np.testing.assert_array_equal(np.stack(mended.polygon_uvs), np.stack(mesh.polygon_uvs))


def test_cloth_is_pushed_out_smoothly_and_no_farther_than_it_must(woman):
    garment = tube_garment(low=0.85, high=1.1, radius=0.165, around=80, rows=24)
    body = RestBody.of(woman)
    before = body.signed_distances(garment.vertices)
    assert (before < 0.0).any()
    moved = push_out(garment.vertices, garment.topology, body)
    after = body.signed_distances(moved)
    assert after.min() >= 0.9 * CLEARANCE
    distance = np.linalg.norm(moved - garment.vertices, axis=1)
    assert distance.max() < 1.5 * (CLEARANCE - before.min()) + 1e-3
    # Cloth well clear of the body stays.
    assert distance[before > 0.04].max() < 1e-3
    stretch = edge_lengths(moved, garment.topology.edges) / garment.edge_lengths
    assert stretch.max() < 1.6
    assert stretch.min() > 0.5


def test_a_garment_of_another_size_is_not_pushed(woman):
    garment = triangle_tube(low=1.0, high=1.2, radius=0.04)
    garment = replace(garment, vertices=garment.vertices + np.array([0.0, 0.0, 0.03]))
    mended, said, left = repair(garment, woman)
    assert said == ()
    assert "too small" in left[-1]
    np.testing.assert_array_equal(mended.vertices, garment.vertices)


def test_cloth_pushed_out_crosses_itself_no_more_than_before(woman):
    # A lining inside its skirt: pushed out of the hips it comes through the outer layer, which starts clear of them.
    inner = triangle_tube(low=0.8, high=1.1, radius=0.165, around=60, rows=20)
    outer = triangle_tube(low=0.8, high=1.1, radius=0.1665, around=60, rows=20)
    faces = tuple(polygon + len(inner.vertices) for polygon in outer.polygons)
    lined = PolygonMesh(np.concatenate([inner.vertices, outer.vertices]), inner.polygons + faces)

    def crossings(vertices: np.ndarray) -> int:
        return len(self_crossings(vertices, np.stack(lined.polygons), sharing=True))

    body = RestBody.of(woman)
    pushed = push_out(lined.vertices, SourceSurface.of(lined).topology, body)
    assert crossings(lined.vertices) == 0 < crossings(pushed)
    mended, changes, left = repair(lined, woman)
    assert crossings(mended.vertices) == 0
    inside = int((body.signed_distances(mended.vertices) < 0.0).sum())
    assert changes[-1].startswith("Untangled")
    assert left[-1] == f"{inside} vertices are still inside the body."
