"""What each reader does with a file that asks for more than it may take."""

from __future__ import annotations

import io
import json
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pb4u.body.library import load_body
from pb4u.errors import InputError
from pb4u.garment.garment_file import read_garment
from pb4u.garment.library import build_garment
from pb4u.garment.material import MATERIALS, load_material
from pb4u.garment.pins import resolve_pins
from pb4u.geometry.obj_file import read_obj
from pb4u.io.array_archive import read_arrays
from pb4u.io.reading_limits import HEADROOM, parse_json
from pb4u.motion.library import load_motion
from pb4u.run import Run
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.checkpoint import load_checkpoint, weights_file
from pb4u.training.packed_data import load_training_data
from pb4u.training.run_folder import RunFolder

# What Python, the interpreter's parsers and the test itself take beside the reader.
SLACK = 48 * 2**20


def refused(path: Path, read: Callable[[], Any], traced: bool = True) -> str:
    """The sentence of a refusal; fails where the reader took more memory than the file may (`traced`: slowly)."""
    size = path.stat().st_size if path.is_file() else 0
    if traced:
        tracemalloc.start()
    try:
        with pytest.raises(InputError) as refusal:
            read()
        peak = tracemalloc.get_traced_memory()[1] if traced else 0
    finally:
        tracemalloc.stop()
    assert peak <= size + HEADROOM + SLACK, f"{peak / 2**20:.0f} MB"
    sentence = str(refusal.value)
    assert "\n" not in sentence
    assert len(sentence) < 1000
    return sentence


def npy_header(shape: tuple[int, ...], dtype: str = "<f8") -> bytes:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": dtype, "fortran_order": False, "shape": shape})
    return header.getvalue()


def bomb(path: Path, names: tuple[str, ...], megabytes: int = 400) -> Path:
    """An .npz whose first member unpacks to so much from a thousandth; the others are small."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in names:
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                if name != names[0]:
                    member.write(npy_header((1,)) + bytes(8))
                    continue
                member.write(npy_header((megabytes, 2**17)))
                block = bytes(2**20)
                for _ in range(megabytes):
                    member.write(block)
    return path


TRAJECTORY = ("positions", "velocities", "faces", "body_positions", "body_faces", "fps", "metadata")
ARCHIVES: dict[str, tuple[tuple[str, ...], Callable[[Path], Any]]] = {
    "SMPL body": (("v_template", "shapedirs", "posedirs", "J_regressor", "kintree_table", "weights", "f"), load_body),
    "baked body": (("format_version", "term_basis"), load_body),
    "moving body": (("positions", "faces", "fps"), load_body),
    "AMASS recording": (("poses", "trans", "mocap_framerate"), load_motion),
    "trajectory": (TRAJECTORY, Trajectory.open),
    "training pack": (("header",), load_training_data),
}


@pytest.mark.parametrize("kind", ARCHIVES)
def test_an_archive_that_unpacks_to_far_more_is_refused_before_it_is(kind: str, tmp_path: Path) -> None:
    names, read = ARCHIVES[kind]
    path = bomb(tmp_path / "bomb.npz", names)
    assert "400 MB" in (sentence := refused(path, lambda: read(path)))
    assert f"{HEADROOM // 2**20} MB" in sentence


def test_an_array_larger_than_its_member_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "told.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("poses.npy", npy_header((10**12, 72)))
    with pytest.raises(InputError, match="cut short"):
        read_arrays(path)
    assert read_arrays(path, ()) == {}


def test_an_array_of_less_than_nothing_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "told.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("poses.npy", npy_header((-1, 72)))
    with pytest.raises(InputError, match="not a readable"):
        read_arrays(path)


def test_a_refusal_lists_ten_members_at_most(tmp_path: Path) -> None:
    path = tmp_path / "many.npz"
    np.savez(path, **{f"member{k:03}": np.zeros(1) for k in range(300)})  # type: ignore[arg-type]
    for read in (load_body, load_motion):
        with pytest.raises(InputError) as refusal:
            read(path)
        assert str(refusal.value).count("member0") <= 12


def test_json_has_a_depth_and_digits() -> None:
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_json("[" * 100_000)
    assert parse_json(json.dumps("[" * 1000)) == "[" * 1000
    with pytest.raises(ValueError, match="5,000 digits"):
        parse_json("9" * 5000)
    assert parse_json("-" + "9" * 18) == -(10**18) + 1


@pytest.mark.parametrize("text", ["[" * 100_000, '{"density": ' + "9" * 5000 + "}"], ids=["open", "digits"])
def test_a_material_and_pins_are_read_within_the_limits(text: str, tmp_path: Path) -> None:
    path = tmp_path / "it.json"
    path.write_text(text)
    refused(path, lambda: load_material(path))
    garment = build_garment("tshirt", load_body("woman"), triangles=1000)
    refused(path, lambda: resolve_pins(path, garment))


def test_a_scene_file_nested_deep_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text("a = " + "[" * 100_000)
    refused(path, lambda: Run.open(path))


def with_header(path: Path, header: bytes) -> Path:
    path.write_bytes(struct.pack("<Q", len(header)) + header)
    return path


def changed_checkpoint(path: Path, change: Callable[[dict], None]) -> Path:
    """The shipped weights with another configuration in their header."""
    with weights_file("pb4u-small") as file:
        content = file.read_bytes()
    length = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + length])
    configuration = json.loads(header["__metadata__"]["configuration"])
    change(configuration)
    header["__metadata__"]["configuration"] = json.dumps(configuration)
    with_header(path, json.dumps(header).encode())
    path.write_bytes(path.read_bytes() + content[8 + length :])
    return path


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("width", -1), ("width", 0), ("width", "wide"), ("width", 10**6), ("width", 10**7), ("width", 1000),
        ("width", 64.5), ("width", True), ("width", None), ("width", [64]), ("width", 10**17), ("blocks", 10**8),
        ("blocks", -1), ("blocks", 1000), ("passes", 10**9), ("layout", 3), ("warm_start_shares", "all"),
    ],
)  # fmt: skip
def test_a_network_that_the_weights_are_not_of_is_never_built(field: str, value: object, tmp_path: Path) -> None:
    path = changed_checkpoint(tmp_path / "odd.safetensors", lambda record: record.update({field: value}))
    refused(path, lambda: load_checkpoint(path), traced=False)


def test_a_header_longer_than_its_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "long.safetensors"
    path.write_bytes(struct.pack("<Q", 2**40) + b"{}")
    refused(path, lambda: load_checkpoint(path))
    (tmp_path / "configuration.json").write_text('{"format_version": 1}')
    path.rename(tmp_path / "last.safetensors")
    refused(tmp_path / "last.safetensors", RunFolder.open(tmp_path).load_state)


@pytest.mark.parametrize("name", ["v 1e300 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "v 0 0 0\n" * 2000])
def test_an_obj_that_cannot_be_used_is_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.obj"
    path.write_text(name)
    refused(path, lambda: read_garment(path, MATERIALS["default"]), traced=False)


def test_lines_of_an_obj_may_be_continued(tmp_path: Path) -> None:
    text = b"v 0 0 0\nv 1 0 \\\n 0\r\nv 0 1 0\nf 1 2 3\nv 0 0 1\nf -1 \\\r\n -2 -3 # it\nf 1 2 4"
    path = tmp_path / "small.obj"
    path.write_bytes(text)
    whole = read_obj(path)
    assert [p.tolist() for p in whole.polygons] == [[0, 1, 2], [3, 2, 1], [0, 1, 3]]
    path.write_bytes(text + b"\nf 1 2 9")
    with pytest.raises(InputError, match=r'line 8: .*"f 1 2 9"'):
        read_obj(path)
