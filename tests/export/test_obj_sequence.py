"""OBJ sequences that share a folder: each keeps its own frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pb4u.errors import InputError
from pb4u.export.registry import check_target, export
from pb4u.scene.trajectory import Trajectory


def names(folder: Path, pattern: str) -> list[str]:
    return sorted(file.name for file in folder.glob(pattern))


def cut(trajectory: Trajectory, frames: int) -> Trajectory:
    arrays = {name: getattr(trajectory, name)[:frames] for name in ("positions", "velocities", "body_positions")}
    return replace(trajectory, **arrays)


@pytest.mark.parametrize("other", ["run", "walk_0005", "walk_fast", "awalk"])
def test_a_shorter_sequence_keeps_the_frames_of_another_name(
    trajectory: Trajectory, tmp_path: Path, other: str
) -> None:
    for name in (other, "walk"):
        export(trajectory, tmp_path / f"{name}.obj")
    export(cut(trajectory, 2), tmp_path / "walk.obj")
    assert len(names(tmp_path, f"{other}_????.obj")) == trajectory.frame_count
    assert names(tmp_path, "walk_????.obj") == ["walk_0000.obj", "walk_0001.obj"]


def test_a_sequence_keeps_the_mesh_of_a_cache_whose_name_ends_as_a_frame_s(
    trajectory: Trajectory, tmp_path: Path
) -> None:
    export(trajectory, tmp_path / "walk_0006.pc2")
    export(cut(trajectory, 2), tmp_path / "walk.obj")
    assert names(tmp_path, "*.obj") == ["walk_0000.obj", "walk_0001.obj", "walk_0006.obj"]


def test_meshes_of_others_that_are_called_as_frames_are_kept(trajectory: Trajectory, tmp_path: Path) -> None:
    own = tmp_path / "walk_0001.obj"
    own.write_text("# Blender\n")
    with pytest.raises(InputError, match=r"walk_0001\.obj"):
        check_target(tmp_path / "walk.obj")
    check_target(tmp_path / "run.obj")
    own.unlink()
    for _ in range(2):
        export(trajectory, tmp_path / "walk.obj")
