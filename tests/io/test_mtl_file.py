"""The images and MTL files that a mesh names are those that its reader reads, and those that are kept as its own."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from pb4u.geometry.obj_file import read_obj
from pb4u.io.companions import with_companions

CORNERS = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
FACE = b"usemtl a\nf 1/1 2/2 3/3\n"


@pytest.mark.parametrize(
    ("named", "image"),
    [
        (b"image.png", "image.png"),
        (b"-s 1 1 1 my image.png", "my image.png"),
        (b"-clamp on my  image.png \r", "my  image.png"),
        (rb"C:\foo\bar.png", "bar.png"),
        (rb"-mm 0 1 C:\my work\bar foo.png", "bar foo.png"),
        (rb"textures\bar.png", "textures/bar.png"),
        ("Rückseite.png".encode("latin-1"), "Rückseite.png"),
        ("Rückseite.png".encode(), "Rückseite.png"),
    ],
)
def test_the_image_that_is_read_is_kept(tmp_path: Path, named: bytes, image: str) -> None:
    (tmp_path / image).parent.mkdir(exist_ok=True)
    Image.new("RGB", (2, 2), (9, 8, 7)).save(tmp_path / image)
    Image.new("RGB", (2, 2)).save(tmp_path / "other.png")
    (tmp_path / "worn.mtl").write_bytes(b"newmtl a\n\tmap_Kd " + named + b"\n")
    obj = tmp_path / "worn.obj"
    obj.write_bytes(CORNERS + b"mtllib worn.mtl\n" + FACE)
    looks = read_obj(obj).appearances
    assert looks is not None
    assert [each.image for each in looks.listed] == [(tmp_path / image).read_bytes()]
    assert with_companions(obj) == [obj, tmp_path / "worn.mtl", tmp_path / image]


@pytest.mark.parametrize(
    ("line", "library"),
    [
        (b"mtllib the cloth.mtl", "the cloth.mtl"),
        (b"  mtllib\tcloth.mtl \r", "cloth.mtl"),
        (b"mtllib \\\r\n cloth.mtl", "cloth.mtl"),
        (rb"mtllib C:\work\cloth.mtl", "cloth.mtl"),
        ("mtllib Stück.mtl".encode("latin-1"), "Stück.mtl"),
        (b"mtllib cloth.mtl\nmtllib cloth.mtl\nmtllib " + b"x" * 300 + b"\nmtllib  ", "cloth.mtl"),
        (rb"mtllib .\cloth.mtl", "cloth.mtl"),
        (b'mtllib "the cloth.mtl"', "the cloth.mtl"),
        (b"mtllib other.mtl cloth.mtl", "cloth.mtl"),
        (b"# mtllib cloth.mtl", None),
        (b"mtllib none.mtl", None),
    ],
)
def test_the_library_that_is_read_is_kept(tmp_path: Path, line: bytes, library: str | None) -> None:
    (tmp_path / (library or "cloth.mtl")).write_bytes(b"\xef\xbb\xbfnewmtl a\nKd 1 0 0\nmap_Kd -clamp on\nmap_Kd\n")
    obj = tmp_path / "worn.obj"
    obj.write_bytes(CORNERS + line + b"\n" + FACE)
    if library is None:
        assert read_obj(obj).appearances is None
    else:
        with pytest.warns(match="the image .*is missing"):
            assert read_obj(obj).appearances is not None
    assert with_companions(obj) == [obj, *([] if library is None else [tmp_path / library])]


def test_several_libraries_of_one_line_are_read_and_missing_ones_are_told_of(tmp_path: Path) -> None:
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1 0 0\n")
    (tmp_path / "b.mtl").write_text("newmtl b\nKd 0.5\nnewmtl c\nKd spectral x.rfl\n")
    obj = tmp_path / "worn.obj"
    faces = b"usemtl b\nf 1 2 3\nusemtl c\nf 1 2 3\n"
    obj.write_bytes(CORNERS + b"mtllib a.mtl b.mtl\nmtllib none at all.mtl\n" + FACE + faces)
    with pytest.warns() as told:
        looks = read_obj(obj).appearances
    assert [str(each.message) for each in told] == [
        "b.mtl: the colour Kd spectral x.rfl is not three numbers; it is ignored.",
        "worn.obj: the MTL file none at all.mtl is missing; put it beside the file to see its colours.",
    ]
    assert looks is not None
    assert [each.colour for each in looks.listed] == [(1, 0, 0), (0.5, 0.5, 0.5), (0.8, 0.8, 0.8)]
