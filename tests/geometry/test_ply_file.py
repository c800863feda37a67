"""PLY and OFF files give polygons and UVs as their authors made them."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from pb4u.errors import InputError
from pb4u.geometry.mesh_file import PolygonMesh, read_mesh
from pb4u.geometry.triangle_mesh import face_areas
from pb4u.geometry.triangulation import triangulate

CORNERS = "0 0 0\n2 0 0\n2 2 0\n1 0.2 0\n0 2 0\n3 0 0\n3 2 0\n"
"""A pentagon with a dent, whose area is 2.2, and what lies beside it."""
HEADER = (
    "ply\nformat {} 1.0\ncomment TextureFile none.png\nelement vertex 7\nproperty float x\nproperty float y\n"
    "property float z\nelement face {}\nproperty list uchar int vertex_indices\n{}end_header\n"
)
UV_HEADER = "property list uchar float texcoord\nproperty uchar flags\n"


def read(path: Path) -> PolygonMesh:
    return read_mesh(path, lambda count: None)


def polygons(mesh: PolygonMesh) -> list[list[int]]:
    return [polygon.tolist() for polygon in mesh.polygons]


def test_polygons_keep_their_order_and_are_cut_within_themselves(tmp_path: Path) -> None:
    faces = [[0, 1, 2, 3, 4], [1, 5, 6], [1, 5, 6, 2]]
    rows = "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in faces)
    (tmp_path / "text.ply").write_text(HEADER.format("ascii", 3, "") + CORNERS + rows)
    packed = struct.pack(">21f", *map(float, CORNERS.split()))
    packed += b"".join(struct.pack(f">B{len(face)}i", len(face), *face) for face in faces)
    (tmp_path / "packed.ply").write_bytes(HEADER.format("binary_big_endian", 3, "").encode() + packed)
    (tmp_path / "text.off").write_text(
        "OFF # a shape\n7 3 0\n" + CORNERS + rows.replace("1 5 6 2", "1 5 6 2 0.5 0.5 1")
    )
    for path in tmp_path.iterdir():
        mesh = read(path)
        assert polygons(mesh) == faces
        corners, of = triangulate(mesh.vertices, mesh.polygons)
        areas = face_areas(mesh.vertices, np.concatenate(mesh.polygons)[corners])
        assert areas[of == 0].sum() == pytest.approx(2.2)


@pytest.mark.parametrize("packed", [False, True])
def test_uvs_of_corners_do_not_tear_the_cloth(
    tmp_path: Path, packed: bool, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture
) -> None:
    uvs = [[0, 0, 1, 0, 1, 1], [0.5, 0.5, 1, 1, 0, 1]]
    path = tmp_path / "worn.ply"
    if packed:
        content = struct.pack("<21f", *map(float, CORNERS.split()))
        for face, uv in zip([(0, 1, 2), (0, 2, 4)], uvs, strict=True):
            content += struct.pack("<B3iB6fB", 3, *face, 6, *uv, 0)
        path.write_bytes(HEADER.format("binary_little_endian", 2, UV_HEADER).encode() + content)
    else:
        rows = "3 0 1 2 6 0 0 1 0 1 1 0\n3 0 2 4 6 .5 .5 1 1 0 1 0\n"
        path.write_text(HEADER.format("ascii", 2, UV_HEADER) + CORNERS + rows)
    mesh = read(path)
    assert polygons(mesh) == [[0, 1, 2], [0, 2, 4]]
    assert mesh.uvs is not None
    assert mesh.polygon_uvs is not None
    np.testing.assert_allclose([mesh.uvs[corners].ravel() for corners in mesh.polygon_uvs], uvs)
    # The image of the header is not there, which is no matter for the cloth.
    assert not caplog.records
    assert "Traceback" not in capsys.readouterr().err


def test_uvs_of_vertices_are_kept(tmp_path: Path) -> None:
    header = HEADER.format("ascii", 1, "").replace(
        "property float z\n", "property float z\nproperty float s\nproperty float t\n"
    )
    (tmp_path / "a.ply").write_text(header + CORNERS.replace("\n", " 0.25 0.75\n") + "3 0 1 2\n")
    mesh = read(tmp_path / "a.ply")
    assert mesh.uvs is not None
    assert (mesh.uvs == [0.25, 0.75]).all()


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.ply", HEADER.format("ascii", 1, "") + CORNERS + "2 0 1\n", "face 0 has 2 corners"),
        ("a.ply", HEADER.format("ascii", 1, "") + CORNERS + "3 0 1 9\n", "out of range"),
        ("a.ply", HEADER.format("ascii", 1, "") + CORNERS + "3 0 1\n", "cannot be read as a mesh"),
        ("a.ply", HEADER.format("ascii", 1, "") + CORNERS + "-1 0 1\n", "cannot be read as a mesh"),
        ("a.ply", HEADER.format("ascii", 0, "") + CORNERS, "no faces"),
        ("a.ply", HEADER.format("ascii", 1, "") + "nan" + CORNERS[1:] + "3 0 1 2\n", "NaN or infinite"),
        ("a.ply", HEADER.format("binary_little_endian", 10**9, "") + CORNERS, "cannot be read as a mesh"),
        ("a.off", "OFF\n7 1 0\n" + CORNERS, "cut short"),
        ("a.off", "OFF\n7 1 0\n" + CORNERS + "4 0 1 2\n", "face 0 has 3 corners"),
        ("a.off", "OFF\n7 0 0\n" + CORNERS, "no faces"),
        ("a.off", "PLY\n7 1 0\n" + CORNERS, "not with OFF"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, name: str, content: str, says: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=says):
        read(tmp_path / name)
