import time
import warnings

import numpy as np
import pytest
from cloth_shapes import CLOTH, quad_tube, saved, triangle_tube, tube_arrays, with_open_seam

from pb4u.errors import InputError, InputWarning
from pb4u.garment.garment_file import read_garment
from pb4u.geometry.mesh_file import PolygonMesh


def on_source(source, positions, faces):
    """Source vertices where the simulated `positions` put them."""
    return np.einsum("sk,skd->sd", source.barycentric, positions[faces[source.triangle]])


def with_faces(mesh, extra):
    return PolygonMesh(mesh.vertices, (*mesh.polygons, *(np.array(face) for face in extra)))


def test_without_a_count_the_simulated_mesh_is_the_authors(tmp_path):
    mesh = triangle_tube()
    path = saved(tmp_path, mesh)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        garment = read_garment(path, CLOTH)
    np.testing.assert_allclose(garment.vertices, mesh.vertices, atol=1e-8)
    np.testing.assert_array_equal(garment.faces, np.stack(mesh.polygons))
    moved = garment.vertices + np.random.default_rng(0).normal(size=garment.vertices.shape)
    np.testing.assert_array_equal(on_source(garment.source, moved, garment.faces), moved)


def test_quads_are_cut_to_simulate_and_kept_in_the_source(tmp_path):
    mesh = quad_tube()
    with pytest.warns(InputWarning, match=r"800 .*`pb4u convert --on source`"):
        garment = read_garment(saved(tmp_path, mesh), CLOTH)
    assert garment.triangle_count == 1600
    assert all(len(p) == 4 for p in garment.source.source.polygons)
    # Each corner still has the UV of its own side of the seam.
    u = garment.uvs[garment.uv_faces][..., 0]
    assert np.ptp(u, axis=1).max() < 0.05


def test_remeshing_keeps_borders_and_carries_motion_back(tmp_path):
    mesh = quad_tube()
    with pytest.warns(InputWarning):
        garment = read_garment(saved(tmp_path, mesh), CLOTH, triangles=3000)
    assert abs(garment.triangle_count - 3000) <= 150
    assert len(garment.topology.boundary_loops) == 2
    assert len(garment.source.source.vertices) == len(mesh.vertices)
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    moved_source = on_source(garment.source, garment.vertices @ turn.T + np.array([0.1, 0.2, 0.3]), garment.faces)
    np.testing.assert_allclose(moved_source, mesh.vertices @ turn.T + np.array([0.1, 0.2, 0.3]), atol=2e-3)


def test_oddities_are_warned_of_and_left_out(tmp_path):
    mesh = triangle_tube()
    other, quads = tube_arrays(radius=0.4)
    polygons = (*mesh.polygons, mesh.polygons[7][[1, 2, 0]], np.array([3, 3, 4]), *(quads + len(mesh.vertices)))
    odd = PolygonMesh(np.concatenate([mesh.vertices, other, [[0.0, 0.7, 0.3]]]), polygons)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        garment = read_garment(saved(tmp_path, odd), CLOTH)
    said = " ".join(str(w.message) for w in caught)
    assert all(w.category is InputWarning for w in caught)
    for part in (
        "1 face(s) exist twice",
        "1 triangle(s) have no area",
        "1 vertices belong to no face",
        "2 pieces",
        "quads",
    ):
        assert part in said
    assert garment.triangle_count == 1600 + 1600
    assert len(garment.vertices) == len(odd.vertices) - 1
    # The isolated vertex rides on the cloth beside it.
    assert np.isfinite(garment.source.barycentric).all()
    moved_source = on_source(garment.source, garment.vertices + np.array([1.0, 0, 0]), garment.faces)
    assert np.linalg.norm(moved_source[-1] - [1.0, 0.7, 0.3]) < 0.06


def test_open_seams_and_turned_faces_are_said(tmp_path):
    mesh = triangle_tube()
    with pytest.warns(InputWarning, match="21 border vertices"):
        read_garment(saved(tmp_path, with_open_seam(mesh)), CLOTH)
    faces = np.stack(mesh.polygons)
    faces[5] = faces[5][::-1]
    with pytest.warns(InputWarning, match="1 face.s. are flipped"):
        garment = read_garment(saved(tmp_path, PolygonMesh(mesh.vertices, tuple(faces))), CLOTH)
    assert garment.topology.is_consistently_oriented


@pytest.mark.parametrize(("scale", "unit"), [(100.0, "centimetres"), (1000.0, "millimetres"), (0.01, "too small")])
def test_other_units_are_refused_and_the_fix_is_named(tmp_path, scale, unit):
    mesh = triangle_tube()
    path = saved(tmp_path, PolygonMesh(scale * mesh.vertices, mesh.polygons))
    with pytest.raises(InputError, match=rf"{unit}.*check {path} --fix"):
        read_garment(path, CLOTH)


def test_edges_of_three_faces_are_refused(tmp_path):
    mesh = triangle_tube()
    with pytest.raises(InputError, match=r"1 edge.*500-501"):
        read_garment(saved(tmp_path, with_faces(mesh, [[500, 501, 0]])), CLOTH)


@pytest.mark.parametrize(
    ("face", "count", "triangles", "says"),
    [
        (b"f 1 2 3\n", 5_000_000, 10_000, "5,000,000 triangles or more.*decimate it"),
        (b"f 1 2 3\n", 1_500_000, None, "1,500,000 triangles.*ask for fewer with `--triangles N`"),
    ],
)
def test_too_many_triangles_are_refused_before_they_are_parsed(tmp_path, monkeypatch, face, count, triangles, says):
    path = tmp_path / "huge.obj"
    path.write_bytes(b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n" + face * count)
    monkeypatch.setattr("pb4u.geometry.obj_file.read_obj", lambda _: pytest.fail("the file was parsed"))
    started = time.process_time()
    with pytest.raises(InputError, match=says):
        read_garment(path, CLOTH, triangles=triangles)
    assert time.process_time() - started < 4.0


def test_a_hundred_thousand_faces_load_in_seconds(tmp_path):
    mesh = triangle_tube(around=250, rows=200)
    path = saved(tmp_path, mesh)
    started = time.process_time()
    assert read_garment(path, CLOTH).triangle_count == 100_000
    assert time.process_time() - started < 6.0  # about 1.5 s


@pytest.mark.parametrize("suffix", ["ply", "stl", "glb"])
def test_other_formats_give_the_same_surface(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh")
    mesh = triangle_tube()
    path = tmp_path / f"tube.{suffix}"
    trimesh.Trimesh(mesh.vertices, np.stack(mesh.polygons), process=False).export(path)
    garment = read_garment(path, CLOTH)
    assert garment.triangle_count == len(mesh.polygons)
    assert len(garment.topology.boundary_loops) == 2
    if suffix != "stl":  # which has no vertex order of its own
        np.testing.assert_allclose(garment.vertices, mesh.vertices, atol=1e-6)


def test_what_is_no_garment_file(tmp_path):
    with pytest.raises(InputError, match="There is no garment file"):
        read_garment(tmp_path / "absent.obj", CLOTH)
    (tmp_path / "cloth.fbx").write_bytes(b"")
    with pytest.raises(InputError, match=r"\.obj.*Blender"):
        read_garment(tmp_path / "cloth.fbx", CLOTH)
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat ascii 1.0\nelement face 7\n")
    with pytest.raises(InputError, match=r"broken.ply"):
        read_garment(tmp_path / "broken.ply", CLOTH)
    (tmp_path / "noise.glb").write_bytes(bytes(range(200)))
    with pytest.raises(InputError, match=r"noise.glb"):
        read_garment(tmp_path / "noise.glb", CLOTH)
    with pytest.raises(InputError, match="must be 1 or more, not -5"):
        read_garment(saved(tmp_path, triangle_tube()), CLOTH, triangles=-5)
