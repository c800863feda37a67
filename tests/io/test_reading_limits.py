"""What each reader does with a file that asks for more than it may take."""

from __future__ import annotations

import io
import json
import pickle
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
from pb4u.io.reading_limits import HEADROOM, MOST_DEPTH, MOST_MEMBERS, MOST_NUMBERS_TEXT, MOST_TEXT, parse_json
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


def test_a_compression_without_a_bound_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "packed.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("poses.npy", npy_header((0, 72)))
    with pytest.raises(InputError, match="compressed in a way that is not read"):
        read_arrays(path)


def test_an_archive_of_many_members_is_refused_without_listing_them(tmp_path: Path) -> None:
    path = tmp_path / "many.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for k in range(MOST_MEMBERS + 1):
            archive.writestr(f"member{k}.npy", b"")
    assert "10,001 members" in refused(path, lambda: load_body(path))


def test_a_refusal_lists_ten_members_at_most(tmp_path: Path) -> None:
    path = tmp_path / "many.npz"
    np.savez(path, **{f"member{k:03}": np.zeros(1) for k in range(300)})  # type: ignore[arg-type]
    for read in (load_body, load_motion):
        with pytest.raises(InputError) as refusal:
            read(path)
        assert str(refusal.value).count("member0") <= 12


def laughs(levels: int, leaf: object = 1.0) -> object:
    value: object = (leaf, leaf)
    for _ in range(levels):
        value = (value, value)
    return value


PICKLES: dict[str, Callable[[], object]] = {
    "tuples that double at each level": lambda: {"poses": laughs(60), "trans": laughs(60), "v_template": laughs(60)},
    "lists that double at each level": lambda: {"poses": lists(40), "trans": lists(40), "v_template": lists(40)},
    "a list in itself": lambda: {"poses": endless(), "trans": endless()},
    "an array in itself": lambda: {"poses": endless_array(), "trans": endless_array()},
    "very many objects": lambda: {"poses": [[] for _ in range(600_000)], "trans": []},
}


def lists(levels: int) -> list:
    value: list = [1.0, 1.0]
    for _ in range(levels):
        value = [value, value]
    return value


def endless() -> list:
    value: list = []
    value.append(value)
    return value


def endless_array() -> np.ndarray:
    value = np.empty(1, dtype=object)
    value[0] = value
    return value


@pytest.mark.parametrize("kind", PICKLES)
@pytest.mark.parametrize("read", [load_body, load_motion], ids=["body", "recording"])
def test_a_pickle_that_holds_too_much_is_refused_at_once(kind: str, read: Any, tmp_path: Path) -> None:
    path = tmp_path / "bomb.pkl"
    path.write_bytes(pickle.dumps(PICKLES[kind]()))
    refused(path, lambda: read(path))


def test_a_key_that_doubles_at_each_level_is_not_hashed(tmp_path: Path) -> None:
    # (1, 1), then that twice, 60 times over; as the key of a dictionary its hash would take 2^60 steps.
    levels = b"".join(b"h" + bytes([k]) + b"h" + bytes([k]) + b"\x86q" + bytes([k + 1]) for k in range(60))
    path = tmp_path / "bomb.pkl"
    path.write_bytes(b"\x80\x02}K\x01K\x01\x86q\x00" + levels + b"K\x01s.")
    assert "nested in each other" in refused(path, lambda: load_motion(path))


def test_arrays_made_again_and_again_of_one_text_are_refused(tmp_path: Path) -> None:
    megabytes = 4
    content = np.zeros(megabytes * 2**17)
    one = pickle.dumps(content, protocol=2)
    # The same bytes, remembered once and made into an array a hundred times.
    state = content.__reduce__()
    path = tmp_path / "bomb.pkl"
    path.write_bytes(pickle.dumps({"poses": [Again(state) for _ in range(100)], "trans": 1}, protocol=4))
    assert path.stat().st_size < 2 * len(one)
    assert "may take" in refused(path, lambda: load_motion(path))


@pytest.mark.parametrize(("protocol", "fits", "large"), [(2, 2**15, 2**17), (4, 2**16, 2**18)])
def test_a_pickle_in_large_pieces_is_refused_before_they_are_read(
    protocol: int, fits: int, large: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pb4u.io.reading_limits.HEADROOM", 2**20)
    monkeypatch.setattr("pb4u.io.pickle_limits.HEADROOM", 2**20)
    path = tmp_path / "large.pkl"
    content = {"poses": np.zeros(fits), "trans": 1}
    path.write_bytes(pickle.dumps(content, protocol=protocol))
    with pytest.raises(InputError) as refusal:
        load_motion(path)
    assert "in one piece" not in str(refusal.value)
    content["poses"] = np.zeros(large)
    path.write_bytes(pickle.dumps(content, protocol=protocol))
    tracemalloc.start()
    with pytest.raises(InputError, match="in one piece"):
        load_motion(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**19


class Again:
    """Pickles as an array of its own with the content of another."""

    def __init__(self, state: Any) -> None:
        self.state = state

    def __reduce__(self) -> Any:
        return self.state


def test_a_place_far_out_in_the_memory_of_a_pickle_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.pkl"
    path.write_bytes(b"\x80\x02}r\xff\xff\xff\x7f.")
    assert "2,147,483,647" in refused(path, lambda: load_motion(path))


def test_a_sparse_matrix_of_a_huge_shape_is_refused(tmp_path: Path) -> None:
    import scipy.sparse

    matrix = scipy.sparse.coo_matrix((np.ones(1), (np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64))))
    matrix._shape = (10**12, 10**12)
    path = tmp_path / "bomb.pkl"
    path.write_bytes(pickle.dumps({"J_regressor": matrix}))
    assert "sparse matrix" in refused(path, lambda: load_body(path))


def test_json_has_a_depth_a_size_and_digits(tmp_path: Path) -> None:
    deep = "[" * (MOST_DEPTH + 1) + "]" * (MOST_DEPTH + 1)
    with pytest.raises(InputError, match=f"more than {MOST_DEPTH} lists"):
        parse_json(deep, "it")
    assert parse_json(deep[1:-1], "it")
    assert parse_json(json.dumps("[" * 1000), "it") == "[" * 1000
    with pytest.raises(InputError, match="may have 8 MB"):
        parse_json(" " * (MOST_TEXT + 1), "it")
    with pytest.raises(InputError, match="5,000 digits"):
        parse_json("9" * 5000, "it")
    assert parse_json("-" + "9" * 18, "it") == -(10**18) + 1


@pytest.mark.parametrize(
    "text",
    ["[" * 100_000, '{"density": ' + "9" * 5000 + "}", '{"a": ' + "[" * 5000 + "]" * 5000 + "}", " " * (MOST_TEXT + 1)],
    ids=["open", "digits", "deep", "long"],
)  # fmt: skip
def test_a_material_and_pins_are_read_within_the_limits(text: str, tmp_path: Path) -> None:
    path = tmp_path / "it.json"
    path.write_text(text)
    refused(path, lambda: load_material(path))
    garment = build_garment("tshirt", load_body("woman"), triangles=1000)
    refused(path, lambda: resolve_pins(path, garment))


def test_a_scene_file_nested_deep_or_large_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    for text in ("a = " + "[" * 100_000, "#" + " " * MOST_TEXT):
        path.write_text(text)
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


def test_a_configuration_nested_deep_is_refused(tmp_path: Path) -> None:
    def nest(record: dict) -> None:
        for _ in range(400):
            record["layout"] = {"type": "FeatureLayout", "node": [record["layout"]]}

    path = changed_checkpoint(tmp_path / "deep.safetensors", nest)
    assert "nests more than" in refused(path, lambda: load_checkpoint(path))


@pytest.mark.parametrize("length", [2**40, MOST_TEXT + 10])
def test_a_header_longer_than_headers_are_is_refused(length: int, tmp_path: Path) -> None:
    path = tmp_path / "long.safetensors"
    path.write_bytes(struct.pack("<Q", length) + b"{}" + b" " * (MOST_TEXT + 10))
    refused(path, lambda: load_checkpoint(path))
    (tmp_path / "configuration.json").write_text('{"format_version": 1}')
    path.rename(tmp_path / "last.safetensors")
    refused(tmp_path / "last.safetensors", RunFolder.open(tmp_path).load_state)


@pytest.mark.parametrize(
    "text",
    [
        b"v 0 0 0\n" * 2_000,
        b"#" + b"\\\n" * 3_000_000,
        b"v 0 0 0 " * 3_000_000,
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * 4_500_000,
        b"v 1e300 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf " + b"1 " * 12_000_000,
    ],
    ids=["vertices", "continued", "one line", "faces", "far away", "one face"],
)
def test_an_obj_is_read_within_the_limits(text: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pb4u.geometry.obj_file._MOST_VERTICES", 1000)
    path = tmp_path / "large.obj"
    path.write_bytes(text)
    refused(path, lambda: read_garment(path, MATERIALS["default"]), traced=False)
    if b"1e300" not in text:
        refused(path, lambda: load_body(path), traced=False)


def test_lines_of_an_obj_may_end_anywhere_in_a_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = b"v 0 0 0\nv 1 0 \\\n 0\r\nv 0 1 0\nf 1 2 3\nv 0 0 1\nf -1 \\\r\n -2 -3 # it\nf 1 2 4"
    path = tmp_path / "small.obj"
    path.write_bytes(text)
    whole = read_obj(path)
    assert [p.tolist() for p in whole.polygons] == [[0, 1, 2], [3, 2, 1], [0, 1, 3]]
    for size in range(1, len(text) + 1):
        monkeypatch.setattr("pb4u.geometry.obj_file._BLOCK", size)
        again = read_obj(path)
        np.testing.assert_array_equal(again.vertices, whole.vertices)
        assert [p.tolist() for p in again.polygons] == [p.tolist() for p in whole.polygons]
    path.write_bytes(text + b"\nf 1 2 9")
    with pytest.raises(InputError, match='line 8: face "f 1 2 9" names a vertex out of range'):
        read_obj(path)


def gltf(path: Path, **entries: Any) -> Path:
    header = json.dumps({"asset": {"version": "2.0"}, **entries}).encode()
    header += b" " * (-len(header) % 4)
    path.write_bytes(struct.pack("<4sIIII", b"glTF", 2, 20 + len(header), len(header), 0x4E4F534A) + header)
    return path


def test_a_glb_of_arrays_without_data_is_refused(tmp_path: Path) -> None:
    accessor = {"componentType": 5126, "count": 10**9, "type": "VEC3"}
    mesh = {"primitives": [{"attributes": {"POSITION": 0}}]}
    path = gltf(tmp_path / "zeros.glb", accessors=[accessor], meshes=[mesh], nodes=[{"mesh": 0}])
    assert "may take" in refused(path, lambda: read_garment(path, MATERIALS["default"]))


def test_a_glb_of_one_mesh_in_many_places_is_refused(tmp_path: Path) -> None:
    accessor = {"componentType": 5126, "count": 300_000, "type": "VEC3"}
    mesh = {"primitives": [{"attributes": {"POSITION": 0}}]}
    path = gltf(tmp_path / "many.glb", accessors=[accessor], meshes=[mesh], nodes=[{"mesh": 0}] * 100)
    assert "10,000,000 triangles" in refused(path, lambda: read_garment(path, MATERIALS["default"]))


@pytest.mark.parametrize("suffix", [".ply", ".off", ".stl"])
def test_a_large_mesh_written_as_text_is_refused(suffix: str, tmp_path: Path) -> None:
    head = {
        ".ply": b"ply\nformat ascii 1.0\nelement vertex 9\nend_header\n", ".off": b"OFF\n9 9 9\n", ".stl": b"solid it\n"
    }[suffix]  # fmt: skip
    path = tmp_path / f"large{suffix}"
    path.write_bytes(head + b"0 0 0\n" * 3_000_000)
    assert "a mesh written as text may have" in refused(path, lambda: read_garment(path, MATERIALS["default"]))


def test_coincident_border_vertices_are_not_paired(tmp_path: Path) -> None:
    path = tmp_path / "point.obj"
    triangle = b"v 0 0 0\nv 0.00001 0 0\nv 0 0.00001 0\n"
    faces = b"".join(b"f %d %d %d\n" % (k, k + 1, k + 2) for k in range(1, 60_000, 3))
    path.write_bytes(triangle * 20_000 + faces + b"v 0 1 0\nv 1 1 0\nv 1 0 0\nf -1 -2 -3\n")
    assert "lie in the same places" in refused(path, lambda: read_garment(path, MATERIALS["default"]))


def test_recordings_of_text_are_read_within_the_limits(tmp_path: Path) -> None:
    head = "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n"
    cases = {
        "deep.bvh": head + "JOINT a\n{\nOFFSET 0 0 0\n" * 5000,
        "channels.bvh": head + "CHANNELS 1e18 Xposition",
        "numbers.bvh": head + "}\nMOTION\nFrames: 1\nFrame Time: 0.1\n" + "1 " * 20_000_000,
        "long.bvh": "x" * (MOST_NUMBERS_TEXT + 1),
    }
    for name, text in cases.items():
        path = tmp_path / name
        path.write_text(text)
        refused(path, lambda path=path: load_motion(path), traced=False)
        path.unlink()
