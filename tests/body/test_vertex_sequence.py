import struct
import warnings
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pb4u.body.library import load_body
from pb4u.body.sequence_files import load_vertex_sequence, write_vertex_sequence
from pb4u.body.vertex_sequence import VertexSequence, body_from_arrays
from pb4u.errors import InputError, InputWarning


@pytest.fixture
def box() -> tuple[np.ndarray, np.ndarray]:
    """Positions (4, 8, 3) of a box that slides along X by 0.1 m per frame, and its faces."""
    mesh = trimesh.creation.box(extents=(0.5, 1.7, 0.3))
    places = np.array([[[0.1 * frame, 0.85, 0.0]] for frame in range(4)])
    return (mesh.vertices + places).astype(np.float32), np.asarray(mesh.faces, dtype=np.int64)


def write_obj(path: Path, vertices: np.ndarray, polygons: list[list[int]]) -> None:
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    lines += ["f " + " ".join(f"{v + 1}/1/1" for v in polygon) for polygon in polygons]
    path.write_text("# made by a test\n" + "\n".join(lines) + "\n")


def write_pc2(path: Path, positions: np.ndarray) -> None:
    header = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, positions.shape[1], 0.0, 1.0, len(positions))
    path.write_bytes(header + positions.astype("<f4").tobytes())


def write_mdd(path: Path, positions: np.ndarray, fps: float) -> None:
    header = struct.pack(">ii", *positions.shape[:2]) + (np.arange(len(positions)) / fps).astype(">f4").tobytes()
    path.write_bytes(header + positions.astype(">f4").tobytes())


@pytest.fixture(autouse=True)
def no_unexpected_warnings() -> object:
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        yield


def test_npz_round_trip(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    write_vertex_sequence(tmp_path / "box.npz", box[0], box[1], 24.0)
    body = load_vertex_sequence(tmp_path / "box.npz")
    np.testing.assert_array_equal(body.positions(1, 3), box[0][1:3])
    np.testing.assert_array_equal(body.faces, box[1])
    assert (body.fps, body.frame_count, body.is_closed) == (24.0, 4, True)
    assert body.contact.all()
    np.testing.assert_allclose(body.rest_vertices, box[0][0])
    assert [p.name for p in tmp_path.iterdir()] == ["box.npz"]


def test_the_body_of_a_trajectory_is_a_vertex_sequence(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    contact = np.arange(8) > 2
    np.savez(
        tmp_path / "run.npz", positions=np.zeros((4, 5, 3), dtype=np.float32), faces=np.zeros((1, 3), dtype=np.int64),
        body_positions=box[0], body_faces=box[1], body_contact=contact, fps=30.0,
    )  # fmt: skip
    body = load_body(tmp_path / "run.npz")
    assert isinstance(body, VertexSequence)
    np.testing.assert_array_equal(body.positions(0, 4), box[0])
    np.testing.assert_array_equal(body.contact, contact)


def test_the_body_of_a_trajectory_in_half_precision_is_where_it_was(
    tmp_path: Path, box: tuple[np.ndarray, np.ndarray]
) -> None:
    origins = np.outer(np.arange(4), [0.0, 0.5, 1.0]).astype(np.float32)
    np.savez(
        tmp_path / "half.npz", body_positions=(box[0] - origins[:, None]).astype(np.float16),
        body_position_origins=origins, body_faces=box[1], fps=30.0,
    )  # fmt: skip
    np.testing.assert_allclose(load_vertex_sequence(tmp_path / "half.npz").positions(0, 4), box[0], atol=2e-3)


def test_a_point_cache_at_a_common_rate_has_all_of_its_frames(
    tmp_path: Path, box: tuple[np.ndarray, np.ndarray]
) -> None:
    write_obj(tmp_path / "box.obj", box[0][0], box[1].tolist())
    for count in (36, 148):
        write_mdd(tmp_path / "box.mdd", np.repeat(box[0][:1], count, axis=0), 30.0)
        body = load_vertex_sequence(tmp_path / "box.mdd")
        assert (body.fps, body.resampled(60.0).frame_count) == (30.0, 2 * count - 1)


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_folder_is_read_in_natural_order(suffix: str, tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    # Ten would come before eight in the order of text.
    for number, vertices in zip((8, 9, 10, 11), box[0], strict=True):
        path = tmp_path / f"frame{number}.{suffix}"
        if suffix == "obj":
            write_obj(path, vertices, box[1].tolist())
        else:
            trimesh.Trimesh(vertices, box[1], process=False).export(path)
    body = load_body(tmp_path)
    assert isinstance(body, VertexSequence)
    np.testing.assert_allclose(body.positions(0, 4), box[0], atol=1e-6)
    np.testing.assert_array_equal(body.faces, box[1])
    assert body.fps == 30.0


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (("w_01", "w_02", "w_05", "w_06"), "2 in all and the first after w_02.obj"),
        (("4", "8", "12", "20"), "1 in all and the first after 12.obj"),
        (("w_2", "w_4", "w_6", "w_8"), ""),
        (("a", "b", "c", "d"), ""),
        (("a1_1", "a1_2", "a9_1", "a9_2"), ""),
        (("a1", "a2", "a9", "b"), ""),
    ],
)
def test_frames_missing_from_a_folder_are_told(
    names: tuple[str, ...], told: str, tmp_path: Path, box: tuple[np.ndarray, np.ndarray]
) -> None:
    for name, vertices in zip(names, box[0], strict=True):
        write_obj(tmp_path / f"{name}.obj", vertices, box[1].tolist())
    with pytest.warns(InputWarning, match=told) if told else nullcontext():
        load_body(tmp_path)


def test_quads_become_triangles_and_negative_indices_count_back(tmp_path: Path) -> None:
    corners = np.array([[x, y, z] for x in (0, 0.5) for y in (0, 1.7) for z in (0, 0.3)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    write_obj(tmp_path / "a.obj", corners, quads)
    text = (tmp_path / "a.obj").read_text().splitlines()
    text[9] = "f -8 -7 -5 -6"
    (tmp_path / "a.obj").write_text("\n".join(text))
    body = load_vertex_sequence(tmp_path / "a.obj")
    assert body.faces.shape == (12, 3)
    assert body.is_closed
    assert body.topology.is_consistently_oriented


@pytest.mark.parametrize("kind", ["pc2", "mdd"])
@pytest.mark.parametrize("asked", ["obj", "cache"])
def test_obj_with_a_point_cache(kind: str, asked: str, tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    write_obj(tmp_path / "box.obj", box[0][0], box[1].tolist())
    cache = tmp_path / f"box.{kind}"
    write_pc2(cache, box[0]) if kind == "pc2" else write_mdd(cache, box[0], 25.0)
    body = load_body(tmp_path / "box.obj" if asked == "obj" else cache)
    assert isinstance(body, VertexSequence)
    np.testing.assert_array_equal(body.positions(0, 4), box[0])
    assert body.fps == pytest.approx(25.0 if kind == "mdd" else 30.0)
    assert body.positions(0, 1).numpy().dtype == np.float32


@pytest.mark.parametrize("kind", ["pc2", "mdd"])
@pytest.mark.parametrize("kept", [6, 20, -1])
def test_a_cut_point_cache_is_refused(kind: str, kept: int, tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    write_obj(tmp_path / "box.obj", box[0][0], box[1].tolist())
    cache = tmp_path / f"box.{kind}"
    write_pc2(cache, box[0]) if kind == "pc2" else write_mdd(cache, box[0], 25.0)
    cache.write_bytes(cache.read_bytes()[:kept])
    with pytest.raises(InputError, match=rf"box\.{kind}"):
        load_vertex_sequence(cache)


def test_a_point_cache_whose_times_are_cut_is_refused(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    write_obj(tmp_path / "box.obj", box[0][0], box[1].tolist())
    write_mdd(tmp_path / "box.mdd", box[0], 25.0)
    content = (tmp_path / "box.mdd").read_bytes()
    # Of more frames than there are bytes, in the middle of a time.
    (tmp_path / "box.mdd").write_bytes(struct.pack(">ii", 5000, 8) + content[8:-1])
    with pytest.raises(InputError, match="cut short"):
        load_vertex_sequence(tmp_path / "box.mdd")


def test_a_point_cache_of_another_mesh_or_without_one_is_refused(
    tmp_path: Path, box: tuple[np.ndarray, np.ndarray]
) -> None:
    write_pc2(tmp_path / "box.pc2", box[0][:, :7])
    with pytest.raises(InputError, match=r"box\.obj"):
        load_vertex_sequence(tmp_path / "box.pc2")
    write_obj(tmp_path / "box.obj", box[0][0], box[1].tolist())
    with pytest.raises(InputError, match="7 points"):
        load_vertex_sequence(tmp_path / "box.pc2")


def test_resampling_interpolates_linearly_and_a_held_start_waits(box: tuple[np.ndarray, np.ndarray]) -> None:
    body = VertexSequence("box", box[0], box[1], stored_fps=30.0)
    finer = body.resampled(60.0)
    assert finer.frame_count == 7
    np.testing.assert_allclose(finer.positions(1, 2)[0], 0.5 * (box[0][0] + box[0][1]), atol=1e-6)
    np.testing.assert_array_equal(finer.positions(6, 7)[0], box[0][3])
    held = body.with_held_start(5)
    assert held.frame_count == 9
    np.testing.assert_array_equal(held.positions(3, 7), box[0][[0, 0, 0, 1]])
    coarser = body.resampled(20.0)
    assert coarser.frame_count == 3
    np.testing.assert_allclose(coarser.positions(1, 2)[0], 0.5 * (box[0][1] + box[0][2]), atol=1e-6)
    # 30 frames at 30 fps are 1 second at any rate, however the division rounds.
    long = VertexSequence("box", np.repeat(box[0], 8, axis=0)[:31], box[1], 30.0)
    assert [long.resampled(fps).frame_count for fps in (10.0, 24.0, 29.97, 120.0)] == [11, 25, 30, 121]
    with pytest.raises(InputError, match="positive"):
        body.resampled(0.0)


def test_a_folder_with_differing_topology_is_refused(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    write_obj(tmp_path / "f1.obj", box[0][0], box[1].tolist())
    write_obj(tmp_path / "f2.obj", box[0][1], box[1][::-1].tolist())
    with pytest.raises(InputError, match=r"f2\.obj has other faces"):
        load_vertex_sequence(tmp_path)
    write_obj(tmp_path / "f2.obj", box[0][1][:7], [[0, 1, 2]])
    with pytest.raises(InputError, match=r"f2\.obj has 7 vertices"):
        load_vertex_sequence(tmp_path)


def test_an_empty_folder_and_mixed_kinds_are_refused(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    with pytest.raises(InputError, match=r"no \.obj or \.ply"):
        load_vertex_sequence(tmp_path)
    write_obj(tmp_path / "f1.obj", box[0][0], box[1].tolist())
    (tmp_path / "f2.ply").write_text("ply")
    with pytest.raises(InputError, match="both"):
        load_vertex_sequence(tmp_path)
    (tmp_path / "f1.obj").unlink()
    with pytest.raises(InputError, match=r"f2\.ply"):
        load_vertex_sequence(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"positions": None}, '"vertices"'),
        ({"faces": None}, '"faces"'),
        ({"positions": np.zeros((4, 8))}, "has the shape"),
        ({"positions": np.zeros((0, 8, 3))}, "no frames"),
        ({"positions": np.zeros((4, 8, 3), dtype=np.int64)}, "holds int64, not decimal numbers"),
        ({"faces": np.zeros((12, 4), dtype=np.int64)}, "has the shape"),
        ({"faces": np.full((12, 3), 8)}, "out of range"),
        ({"faces": np.zeros((0, 3), dtype=np.int64)}, "no faces"),
        ({"fps": 0.0}, "positive"),
        ({"fps": np.array(["fast"])}, "fps holds <U4, not numbers"),
        ({"contact": np.ones(5, dtype=bool)}, "contact has the shape"),
        ({"scale": 1e5}, "no person in any known unit; say which with --body-units"),
        ({"scale": 13.5}, "a person in inches or in decimetres; say which with --body-units"),
    ],
)
def test_bad_npz_is_refused(
    change: dict[str, object], message: str, tmp_path: Path, box: tuple[np.ndarray, np.ndarray]
) -> None:
    members: dict[str, object] = {"positions": box[0], "faces": box[1], "fps": 30.0, **change}
    scale = members.pop("scale", None)
    if scale is not None:
        members["positions"] = box[0] * scale
    np.savez(tmp_path / "body.npz", **{key: value for key, value in members.items() if value is not None})
    with pytest.raises(InputError, match=message):
        load_vertex_sequence(tmp_path / "body.npz")


def test_vertices_that_are_not_finite_are_refused_with_their_place(
    tmp_path: Path, box: tuple[np.ndarray, np.ndarray]
) -> None:
    positions = box[0].copy()
    positions[2, 5, 1] = np.nan
    write_vertex_sequence(tmp_path / "body.npz", positions, box[1], 30.0)
    with pytest.raises(InputError, match="vertex 5 of frame 2"):
        load_vertex_sequence(tmp_path / "body.npz")


def test_an_npz_that_hides_objects_is_refused(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    np.savez(tmp_path / "body.npz", positions=np.array([box[0], "x"], dtype=object), faces=box[1])
    with pytest.raises(InputError, match="plain arrays"):
        load_vertex_sequence(tmp_path / "body.npz")


def test_an_open_body_is_warned_of(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    write_vertex_sequence(tmp_path / "body.npz", box[0], box[1][:-1], 30.0)
    with pytest.warns(InputWarning, match="penetration") as told:
        body = load_vertex_sequence(tmp_path / "body.npz")
    assert not body.is_closed
    assert told[0].filename == __file__


def test_z_up_and_inside_out_are_warned_of(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    write_vertex_sequence(tmp_path / "lying.npz", box[0][..., [2, 0, 1]] * [1.0, 0.5, 1.0], box[1], 30.0)
    with pytest.warns(InputWarning, match="Z seems to be up"):
        load_vertex_sequence(tmp_path / "lying.npz")
    write_vertex_sequence(tmp_path / "inverted.npz", box[0], box[1][:, ::-1], 30.0)
    with pytest.warns(InputWarning, match="inside out"):
        body = load_vertex_sequence(tmp_path / "inverted.npz")
    corners = body.rest_vertices[body.faces]
    assert np.einsum("fc,fc->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0


def test_a_body_that_leaps_is_warned_of(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    still = np.repeat(box[0][:1], 6, axis=0)
    still[4:] += [1.0, 0.0, 0.0]
    write_vertex_sequence(tmp_path / "leap.npz", still, box[1], 30.0)
    with pytest.warns(InputWarning, match=r"1 time.*1\.0 m from frame 3 to 4"):
        load_vertex_sequence(tmp_path / "leap.npz")


def test_a_huge_body_is_refused_before_it_is_parsed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, box: tuple[np.ndarray, np.ndarray]
) -> None:
    path = tmp_path / "scan.obj"
    path.write_bytes(b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * 1_000_001)
    monkeypatch.setattr("pb4u.geometry.obj_file.read_obj", lambda _: pytest.fail("the file was parsed"))
    for asked in (path, tmp_path):
        with pytest.raises(InputError, match=r"scan\.obj .*1,000,001"):
            load_vertex_sequence(asked)
    np.savez(tmp_path / "scan.npz", positions=box[0], faces=np.tile(box[1], (100_000, 1)), fps=30.0)
    with pytest.raises(InputError, match=r"scan\.npz .*1,200,000"):
        load_vertex_sequence(tmp_path / "scan.npz")


def test_flipped_bytes_are_refused_or_read(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    write_vertex_sequence(tmp_path / "body.npz", box[0], box[1], 30.0)
    data = np.frombuffer((tmp_path / "body.npz").read_bytes(), dtype=np.uint8)
    rng, refused = np.random.default_rng(1), 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(200):
            damaged = data.copy()
            damaged[rng.integers(0, len(data), 3)] = rng.integers(0, 256, 3)
            (tmp_path / "damaged.npz").write_bytes(damaged.tobytes())
            try:
                load_vertex_sequence(tmp_path / "damaged.npz")
            except InputError:
                refused += 1
    assert refused > 50


@pytest.mark.parametrize("line", ["v 1 2", "v a b c", "f 1 2", "f 1 2 x", "f 0 1 2", "f 1 2 99", f"f 1 2 {10**30}"])
def test_a_broken_obj_is_refused(line: str, tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    path = tmp_path / "body.obj"
    write_obj(path, box[0][0], box[1].tolist())
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(InputError, match=r"body\.obj"):
        load_vertex_sequence(path)


def test_centimetres_are_told_by_the_size_of_a_person(tmp_path):
    box = trimesh.creation.box((0.5, 1.7, 0.3))
    write_vertex_sequence(tmp_path / "mhr.npz", 100.0 * np.stack([box.vertices] * 2), box.faces, 30.0)
    with pytest.warns(InputWarning, match=r"170.*centimetres"):
        sequence = load_vertex_sequence(tmp_path / "mhr.npz")
    assert np.ptp(sequence.positions(0, 1).numpy(), axis=1).max() == pytest.approx(1.7)


def test_the_unit_that_is_given_is_taken(tmp_path):
    box = trimesh.creation.box((0.5, 1.7, 0.3))
    write_vertex_sequence(tmp_path / "giant.npz", 5.0 * np.stack([box.vertices] * 2), box.faces, 30.0)
    with pytest.warns(InputWarning, match=r"measures 8.5, so it is read in decimetres, 0.85 m; --body-units"):
        load_body(tmp_path / "giant.npz")
    giant = load_body(tmp_path / "giant.npz", units="metres")
    assert np.ptp(giant.positions(0, 1).numpy(), axis=1).max() == pytest.approx(8.5)
    with pytest.raises(InputError, match="no unit of length 'yards'"):
        load_body(tmp_path / "giant.npz", units="yards")
    with pytest.raises(InputError, match="woman is in metres; leave out --body-units"):
        load_body("woman", units="feet")
    with pytest.raises(
        InputError, match="measures 85 in its own unit, a person in centimetres or in inches; say which"
    ):
        body_from_arrays(50.0 * box.vertices, box.faces)
    metres = body_from_arrays(67.0 * box.vertices, box.faces, units="decimetres")
    assert metres.rest_vertices[:, 1].max() == pytest.approx(5.695)


def test_a_cache_of_another_kind_beside_a_mesh_is_told(tmp_path):
    box = trimesh.creation.box((0.5, 1.7, 0.3))
    write_obj(tmp_path / "scan.obj", box.vertices, box.faces.tolist())
    for name in ("scan.pc16", "scan.mtl", "other.abc"):
        (tmp_path / name).write_bytes(b"x")
    with pytest.warns(InputWarning, match=r"scan\.obj: scan\.pc16 beside it is not read, so the mesh does not move"):
        assert load_vertex_sequence(tmp_path / "scan.obj").frame_count == 1


def test_a_cache_of_several_samples_a_frame_and_times_in_frames_are_told(
    tmp_path: Path, box: tuple[np.ndarray, np.ndarray]
) -> None:
    positions, faces = box
    for name in ("max", "houdini"):
        write_obj(tmp_path / f"{name}.obj", positions[0], faces.tolist())
    header = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, positions.shape[1], 0.0, 0.5, len(positions))
    (tmp_path / "max.pc2").write_bytes(header + positions.astype("<f4").tobytes())
    with pytest.warns(InputWarning, match=r"max\.pc2: its sample rate is 0\.5, .* one sample a frame"):
        load_vertex_sequence(tmp_path / "max.pc2")
    write_mdd(tmp_path / "houdini.mdd", positions, 1.0)
    with pytest.warns(InputWarning, match=r"houdini\.mdd: its samples are a second apart"):
        assert load_vertex_sequence(tmp_path / "houdini.mdd").stored_fps == 30.0
