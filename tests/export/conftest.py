"""A small garment with a UV seam on a moving body, as a trajectory and as a file."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pb4u.cli.main import main
from pb4u.scene.author_mesh import SourceTrack
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader

AROUND, UP, FRAMES = 14, 6, 12


def tube_faces(columns: int) -> np.ndarray:
    """Triangles of a tube of AROUND x UP points whose rows have `columns` points; AROUND of them make it closed."""
    i, j = (a.ravel() for a in np.meshgrid(np.arange(UP - 1), np.arange(AROUND), indexing="ij"))
    a, b = i * columns + j, i * columns + (j + 1) % columns
    return np.concatenate([np.column_stack([a, a + columns, b]), np.column_stack([b, a + columns, b + columns])])


def tube_at(t: int, radius: float = 0.2) -> np.ndarray:
    angle, height = np.meshgrid(2 * np.pi * np.arange(AROUND) / AROUND, np.linspace(0.6, 1.2, UP))
    wave = radius * (1 + 0.1 * np.sin(3 * angle + 0.7 * t + 5 * height))
    points = np.stack([wave * np.cos(angle), height + 0.02 * np.sin(t), wave * np.sin(angle) + 0.05 * t], axis=-1)
    return points.reshape(-1, 3).astype(np.float32)


@pytest.fixture
def trajectory() -> Trajectory:
    u, v = np.meshgrid(np.linspace(0, 1, AROUND + 1), np.linspace(0.1, 0.9, UP))
    faces = tube_faces(AROUND)
    rng = np.random.default_rng(3)
    source = SourceTrack(
        faces=np.array([[4, 2, 0], [1, 3, 4]]),
        triangle=rng.integers(0, len(faces), 5),
        barycentric=rng.dirichlet(np.ones(3), 5),
        uvs=rng.random((6, 2)),
        uv_faces=np.array([[5, 4, 3], [0, 1, 2]]),
    )
    header = TrajectoryHeader(
        faces=faces,
        rest_positions=tube_at(0),
        pinned=np.zeros(AROUND * UP, dtype=bool),
        vertex_garment=np.zeros(AROUND * UP, dtype=np.int32),
        body_faces=faces[: len(faces) // 2 + 8],
        body_contact=np.ones(AROUND * UP, dtype=bool),
        fps=25.0,
        uvs=np.column_stack([u.ravel(), v.ravel()]),
        uv_faces=tube_faces(AROUND + 1),
        source=source,
    )
    return Trajectory.collect(
        header, (Frame(tube_at(t), np.zeros((AROUND * UP, 3)), tube_at(t, radius=0.15)) for t in range(FRAMES))
    )


@pytest.fixture
def saved(trajectory: Trajectory, tmp_path: Path) -> Path:
    return trajectory.save(tmp_path / "run.npz")


@pytest.fixture
def broken(trajectory: Trajectory) -> Trajectory:
    """The same with NaN or infinity in frames 0, 5 and 6."""
    positions = trajectory.positions.copy()
    positions[0, 3] = np.nan
    positions[5, 7, 1] = np.inf
    positions[6] = np.nan
    return replace(trajectory, positions=positions)


@pytest.fixture
def convert(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    def call(*arguments: object) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["pb4u", "convert", *map(str, arguments)])
        try:
            main()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        return code, capsys.readouterr().err

    return call
