"""Triangles counted without parsing, against what the lines say."""

from __future__ import annotations

from pathlib import Path

import pytest

from pb4u.geometry.mesh_file import least_triangles


@pytest.mark.parametrize(
    ("text", "triangles"),
    [
        ("", 0),
        ("v 1 2 3\nvt 0 1\n", 0),
        ("f 1 2 3", 1),
        ("f 1 2 3\n", 1),
        ("f 1/1 2/2 3/3 4/4\r\nf 1//1 2//2 3//3\r\n", 3),
        ("f 1 2 3 4 5  \nf\t1 2\t3 4\n", 5),
        ("f 1 2 3 # a b c\n", 1),
        ("# f 1 2 3\nfoo 1 2 3\nf\n", 0),
    ],
)
def test_corners_of_face_lines_are_counted(tmp_path: Path, text: str, triangles: int) -> None:
    (tmp_path / "a.obj").write_text(text, newline="")
    assert least_triangles(tmp_path / "a.obj", 100) == triangles


def test_blocks_end_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\n" + "f 1 2 3 4\nf 1 2 3\n" * 20)
    for size in range(1, 24):
        monkeypatch.setattr("pb4u.geometry.mesh_file._BLOCK", size)
        assert least_triangles(tmp_path / "a.obj", 100) == 60


def test_more_than_enough_need_not_be_exact(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("f 1 2 3 4\n" * 20)
    assert least_triangles(tmp_path / "a.obj", 40) == 40
    assert 10 < least_triangles(tmp_path / "a.obj", 10) <= 40
