from __future__ import annotations

from pathlib import Path

from pb4u.io.toml_file import read_tables


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_bytes(b"\xef\xbb\xbfframes = 2\n")
    assert read_tables(tmp_path / "scene.toml", "a scene file") == {"frames": 2}
