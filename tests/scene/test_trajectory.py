"""The trajectory file: written in a stream, mapped back, refused when damaged."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pb4u.errors import InputError
from pb4u.scene.author_mesh import Polygons, SourceTrack
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader
from pb4u.scene.trajectory_file import FORMAT_VERSION, HALF_VERSION, TrajectoryWriter


def make_trajectory(frames: int = 5, vertices: int = 700, with_source: bool = False) -> Trajectory:
    rng = np.random.default_rng(7)
    faces = np.stack([np.arange(vertices - 2), np.arange(1, vertices - 1), np.arange(2, vertices)], axis=1)
    source = None
    if with_source:
        source = SourceTrack(
            np.array([[0, 1, 2]]), np.array([4, 5, 6]), np.eye(3), np.eye(3)[:, :2], np.array([[0, 1, 2]]),
            Polygons(np.array([3, 4]), np.array([0, 1, 2, 2, 1, 0, 1]), np.array([0, 1, 2, 1, 1, 0, 2])),
        )  # fmt: skip
    header = TrajectoryHeader(
        faces=faces,
        rest_positions=rng.random((vertices, 3)),
        pinned=np.zeros(vertices, dtype=bool),
        vertex_garment=np.zeros(vertices, dtype=np.int32),
        body_faces=np.array([[0, 1, 2]]),
        body_contact=np.ones(3, dtype=bool),
        fps=30.0,
        metadata={"garment": "sheet", "note": "naïve"},
        uvs=rng.random((vertices, 2)),
        uv_faces=faces,
        source=source,
    )
    rows = (Frame(rng.random((vertices, 3)), rng.random((vertices, 3)), rng.random((3, 3))) for _ in range(frames))
    return Trajectory.collect(header, rows)


def test_round_trip_keeps_every_member(tmp_path: Path) -> None:
    written = make_trajectory(with_source=True)
    written.save(tmp_path / "a.npz")
    read = Trajectory.open(tmp_path / "a.npz")
    for name in ("positions", "velocities", "body_positions"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    for name in (
        "faces",
        "rest_positions",
        "pinned",
        "vertex_garment",
        "body_faces",
        "body_contact",
        "uvs",
        "uv_faces",
    ):
        np.testing.assert_allclose(getattr(read.header, name), getattr(written.header, name), atol=1e-7)
    assert read.metadata == written.metadata
    assert read.header.source is not None
    np.testing.assert_array_equal(read.header.source.barycentric, np.eye(3))
    polygons, expected = read.header.source.polygons, written.header.source.polygons
    for name in ("sizes", "corners", "uv_corners"):
        np.testing.assert_array_equal(getattr(polygons, name), getattr(expected, name))
    assert read.header.polygons is None


def test_a_file_without_polygons_is_still_read(tmp_path: Path) -> None:
    """As versions before polygons wrote them."""
    with np.load(make_trajectory(with_source=True).save(tmp_path / "new.npz")) as archive:
        np.savez(tmp_path / "old.npz", **{k: v for k, v in archive.items() if "polygon" not in k})
    source = Trajectory.open(tmp_path / "old.npz").header.source
    assert source is not None
    assert source.polygons is None
    np.testing.assert_array_equal(source.faces, [[0, 1, 2]])


NAN_REST = np.full((700, 3), np.nan, dtype=np.float32)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"positions": np.zeros(9, dtype=np.float32)}, "positions has the shape"),
        ({"positions": np.zeros((5, 700, 2), dtype=np.float32)}, "positions has the shape"),
        ({"positions": np.zeros((0, 700, 3), dtype=np.float32)}, "shape"),
        ({"velocities": np.zeros((4, 700, 3), dtype=np.float32)}, "velocities has the shape"),
        ({"positions": np.zeros((5, 700, 3), dtype=np.int64)}, "not decimal numbers"),
        ({"faces": np.full((698, 3), 700)}, "faces has indices beyond its 700 vertices"),
        ({"faces": np.full((698, 3), -1)}, "faces has indices beyond"),
        ({"faces": np.array([[0.0, 1.0, 2.0]])}, "not whole numbers"),
        ({"faces": np.zeros((0, 3), dtype=np.int64), "uv_faces": np.zeros((0, 3), dtype=np.int64)}, "it has no faces"),
        ({"body_faces": np.array([[0, 1, 3]])}, "body_faces has indices beyond its 3 body vertices"),
        ({"body_contact": np.array(True)}, "body_contact has the shape"),
        ({"uv_faces": np.full((698, 3), 700)}, "uv_faces has indices beyond"),
        ({"uvs": None}, "only some of"),
        ({"source_triangle": np.array([0, 0, 698])}, "source_triangle has indices beyond its 698 faces"),
        ({"source_faces": np.array([[0, 1, 3]])}, "source_faces has indices beyond"),
        ({"source_barycentric": np.full((3, 3), np.inf)}, "source_barycentric is not finite"),
        ({"source_polygon_sizes": np.array([3, 5])}, "do not agree"),
        ({"source_polygon_corners": np.array([0, 1, 2, 2, 1, 0, 3])}, "source_polygon_corners has indices beyond"),
        ({"rest_positions": NAN_REST}, "rest_positions is not finite"),
        ({"fps": np.array(np.nan)}, "fps is not finite"),
        ({"fps": np.array(0.0)}, "0 frames per second"),
        ({"fps": np.array([30.0, 25.0])}, "fps has the shape"),
        ({"metadata": np.array("{")}, "not JSON"),
        ({"metadata": np.array("[]")}, "not a JSON object"),
        ({"metadata": np.array('{"heading": "north"}')}, "heading"),
        ({"metadata": np.array('{"held_frames": [0.5]}')}, "held_frames"),
        ({"material_layers": np.ones((698, 2))}, "material_layers and the materials in its metadata do not agree"),
        ({"material_layers": np.ones((697, 2))}, "material_layers has the shape"),
        ({"trims": np.zeros((698, 2))}, "elastic in its trims is not positive"),
        ({"trims": np.full((698, 2), np.nan)}, "trims is not finite"),
        ({"format_version": np.array([1, 2])}, "format version is not a whole number"),
    ],
)
def test_what_does_not_fit_together_is_refused_on_opening(
    tmp_path: Path, changed: dict[str, np.ndarray | None], says: str
) -> None:
    with np.load(make_trajectory(with_source=True).save(tmp_path / "a.npz")) as archive:
        members = {**archive, **changed}
    np.savez(tmp_path / "b.npz", **{name: values for name, values in members.items() if values is not None})
    with pytest.raises(InputError) as refused:
        Trajectory.open(tmp_path / "b.npz")
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_flipped_bytes_are_refused_or_read_but_never_end_in_another_error(tmp_path: Path) -> None:
    data = make_trajectory(2, 20, with_source=True).save(tmp_path / "a.npz").read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(300):
        damaged = np.frombuffer(data, dtype=np.uint8).copy()
        damaged[rng.integers(0, len(data), 3)] = rng.integers(0, 256, 3)
        (tmp_path / "b.npz").write_bytes(damaged.tobytes())
        try:
            Trajectory.open(tmp_path / "b.npz")
        except InputError:
            refused += 1
    assert refused > 100


def test_file_follows_the_contract_and_needs_no_pickle(tmp_path: Path) -> None:
    make_trajectory().save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert archive["positions"].dtype == np.float32
        assert archive["faces"].dtype == np.int64
        assert archive["vertex_garment"].dtype == np.int32
        assert archive["fps"].dtype == np.float64
        assert archive["metadata"].ndim == 0
        assert json.loads(str(archive["metadata"]))["garment"] == "sheet"
        assert int(archive["format_version"]) == FORMAT_VERSION


def test_frames_are_mapped_not_read(tmp_path: Path) -> None:
    make_trajectory().save(tmp_path / "a.npz")
    assert isinstance(Trajectory.open(tmp_path / "a.npz").positions, np.memmap)


def test_failure_leaves_nothing_behind_and_keeps_the_older_file(tmp_path: Path) -> None:
    trajectory = make_trajectory()
    trajectory.save(tmp_path / "a.npz")
    before = (tmp_path / "a.npz").read_bytes()
    with (
        pytest.raises(RuntimeError, match="in the middle"),
        TrajectoryWriter(tmp_path / "a.npz", trajectory.header) as writer,
    ):
        writer.append(next(iter(trajectory.frames)))
        raise RuntimeError("in the middle")
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]
    assert (tmp_path / "a.npz").read_bytes() == before


@pytest.mark.parametrize("keep", [0.3, 0.9])
def test_cut_file_is_refused_in_one_sentence(tmp_path: Path, keep: float) -> None:
    path = make_trajectory().save(tmp_path / "a.npz")
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * keep)])
    with pytest.raises(InputError, match="cut short"):
        Trajectory.open(path)


def test_newer_format_and_missing_members_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, format_version=np.array(HALF_VERSION + 1), positions=np.zeros((1, 3, 3)))
    with pytest.raises(InputError, match="update pb4u"):
        Trajectory.open(path)
    np.savez(path, positions=np.zeros((1, 3, 3)))
    with pytest.raises(InputError, match="lacks"):
        Trajectory.open(path)
    with pytest.raises(InputError, match="no trajectory file"):
        Trajectory.open(tmp_path / "absent.npz")


def test_folder_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        make_trajectory().save(tmp_path / "absent" / "a.npz")
