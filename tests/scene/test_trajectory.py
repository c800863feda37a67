"""The trajectory file: written in a stream, mapped back, refused when damaged."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pb4u.errors import InputError
from pb4u.scene.trajectory import FORMAT_VERSION, Frame, SourceTrack, Trajectory, TrajectoryHeader, TrajectoryWriter


def make_trajectory(frames: int = 5, vertices: int = 700, with_source: bool = False) -> Trajectory:
    rng = np.random.default_rng(7)
    faces = np.stack([np.arange(vertices - 2), np.arange(1, vertices - 1), np.arange(2, vertices)], axis=1)
    source = None
    if with_source:
        source = SourceTrack(
            np.array([[0, 1, 2]]), np.array([4, 5, 6]), np.eye(3), np.eye(3)[:, :2], np.array([[0, 1, 2]])
        )
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
    np.savez(path, format_version=np.array(FORMAT_VERSION + 1), positions=np.zeros((1, 3, 3)))
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
