from dataclasses import replace

import numpy as np
import pytest
from cloth_shapes import quad_tube

from pb4u.errors import InputError, InputWarning
from pb4u.geometry.obj_file import read_obj, write_obj

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def test_order_polygons_and_uv_seams_survive_a_round_trip(tmp_path):
    mesh = quad_tube()
    write_obj(tmp_path / "tube.obj", mesh)
    again = read_obj(tmp_path / "tube.obj")
    np.testing.assert_allclose(again.vertices, mesh.vertices, atol=1e-8)
    np.testing.assert_array_equal(np.stack(again.polygons), np.stack(mesh.polygons))
    np.testing.assert_allclose(again.uvs, mesh.uvs, atol=1e-8)
    np.testing.assert_array_equal(np.stack(again.polygon_uvs), np.stack(mesh.polygon_uvs))
    assert len(again.uvs) > len(again.vertices)


def test_every_way_of_writing_a_face(tmp_path):
    path = tmp_path / "faces.obj"
    path.write_text(
        "# comment\r\no cloth\r\n" + SQUARE.replace("\n", " 0.5 0.5 0.5\r\n") + "vn 0 0 1\r\n"
        "s off\r\nf 1 2 3\r\nf 1//1 2//1 3//1\r\nf -4 -3 -2 -1 # a quad\r\nf 1 2 \\\r\n 4\r\n",
        newline="",
    )
    mesh = read_obj(path)
    assert [p.tolist() for p in mesh.polygons] == [[0, 1, 2], [0, 1, 2], [0, 1, 2, 3], [0, 1, 3]]
    assert mesh.uvs is None
    np.testing.assert_array_equal(mesh.vertices[2], [1, 1, 0])


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbf" + SQUARE.encode() + b"f 1 2 3 4\n",
        (SQUARE + "f 1 2 3 4\n").replace("\n", "\r").encode(),
        b"# made in C:\\work\\\\\r\n" + (SQUARE + "f 1 2 \\\n3 4\n").replace("\n", "\r\n").encode(),
    ],
)
def test_no_line_is_lost_to_a_byte_order_mark_a_comment_or_the_ends_of_lines(tmp_path, content):
    path = tmp_path / "square.obj"
    path.write_bytes(content)
    mesh = read_obj(path)
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert [p.tolist() for p in mesh.polygons] == [[0, 1, 2, 3]]


def test_faces_without_uvs_leave_those_of_the_others(tmp_path):
    path = tmp_path / "partly.obj"
    path.write_text(SQUARE + "vt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3\nf 1 3 4\n")
    mesh = read_obj(path)
    assert [corners.tolist() for corners in mesh.polygon_uvs] == [[0, 1, 2], [3, 3, 3]]
    np.testing.assert_array_equal(mesh.uvs[3], [0, 0])


def test_uvs_that_are_no_numbers_leave_the_garment(tmp_path):
    path = tmp_path / "odd.obj"
    path.write_text(SQUARE + "vt 0 1\nvt nan nan\nvt 1 1\nf 1/1 2/2 3/3\n")
    with pytest.warns(InputWarning, match=r"1 texture coordinate.*NaN .*line 6"):
        mesh = read_obj(path)
    np.testing.assert_array_equal(mesh.uvs, [[0, 1], [0, 0], [1, 1]])


def test_materials_are_told_apart_by_names_in_any_code_and_of_any_sort(tmp_path):
    path = tmp_path / "two.obj"
    names = ["面料".encode("gbk"), "里料".encode("gbk")]
    (tmp_path / "two.mtl").write_bytes(b"newmtl\t%b\nKd 1 0 0\nnewmtl %b\nKd 0 0 1\n" % tuple(names))
    text = (SQUARE + "mtllib two.mtl\n").encode()
    path.write_bytes(text + b"usemtl %b\nf 1 2 3\nusemtl %b\nf 1 3 4\n" % tuple(names))
    mesh = read_obj(path)
    assert [mesh.appearances.listed[k].colour for k in mesh.appearances.of_face] == [(1, 0, 0), (0, 0, 1)]
    alike = tuple(replace(each, name="cloth") for each in mesh.appearances.listed)
    write_obj(tmp_path / "again.obj", replace(mesh, appearances=replace(mesh.appearances, listed=alike)))
    again = read_obj(tmp_path / "again.obj").appearances
    assert [again.listed[k].colour for k in again.of_face] == [(1, 0, 0), (0, 0, 1)]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (SQUARE, "no faces"),
        (SQUARE + "f 1 2 9\n", 'line 5: face "f 1 2 9" names a vertex out of range, the file has 4'),
        (SQUARE + "f 0 1 2\n", "out of range"),
        (SQUARE + "f -5 1 2\n", "out of range"),
        (SQUARE + "vt 0 0\nf 1/1 2/1 3/7\n", "texture coordinate out of range"),
        (SQUARE + f"f 1 2 {10**30}\n", "19 digits"),
        (SQUARE + "f 1 2\n", "line 5: a face needs 3 corners"),
        (SQUARE + "f 1 2 three\n", "line 5: the face index"),
        ("v 0 0\n" + SQUARE + "f 1 2 3\n", "line 1: a vertex needs 3 numbers"),
        (SQUARE + "v 1 x 2\nf 1 2 3\n", "line 5: a vertex needs 3 numbers"),
        (SQUARE + "v nan 0 0\nf 1 2 3\n", "first at line 5 (vertex 5)"),
        (SQUARE + "v 1e999 0 0\nf 1 2 3\n", "NaN or infinite"),
    ],
)
def test_damaged_files_are_refused_with_the_line(tmp_path, text, says):
    path = tmp_path / "bad.obj"
    path.write_text(text)
    with pytest.raises(InputError) as refusal:
        read_obj(path)
    assert says in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_nothing_is_left_behind_where_a_file_cannot_be_written(tmp_path):
    (tmp_path / "taken.obj").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        write_obj(tmp_path / "taken.obj", quad_tube())
    with pytest.raises(InputError, match="cannot be written"):
        write_obj(tmp_path / "nowhere" / "tube.obj", quad_tube())
    assert [p.name for p in tmp_path.iterdir()] == ["taken.obj"]
