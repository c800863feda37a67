"""OBJ, one file a frame: `walk.obj` becomes walk_0000.obj, walk_0001.obj, ..."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pb4u.export.finite_frames import held_frames
from pb4u.export.progress import Progress
from pb4u.scene.trajectory import Trajectory

SIGNATURE = "# Written by pb4u"
"""First line of every OBJ file written here; a file with another first line is somebody's own."""


def frame_path(path: Path, frame: int) -> Path:
    """File of one frame of the sequence named `path`."""
    return path.with_name(f"{path.stem}_{frame:04d}{path.suffix}")


def write_obj_sequence(trajectory: Trajectory, path: Path, progress: Progress | None = None) -> None:
    """Write every frame of the garment, vertex order, polygons and UVs kept; metres, Y up."""
    topology = _topology(trajectory)
    held = set(held_frames(trajectory))
    for t, positions in enumerate(trajectory.positions):
        remark = "not finite, the last whole frame before it" if t in held else ""
        frame_path(path, t).write_text(_text(t, positions, topology, remark), encoding="ascii")
        if progress:
            progress(t + 1, trajectory.frame_count)


def write_obj(trajectory: Trajectory, path: Path, frame: int = 0) -> None:
    """Write one frame of the garment, vertex order, polygons and UVs kept; metres, Y up."""
    path.write_text(_text(frame, trajectory.positions[frame], _topology(trajectory)), encoding="ascii")


def _topology(trajectory: Trajectory) -> str:
    uvs, outlines = trajectory.header.uvs, trajectory.header.outlines
    if uvs is None or outlines.uv_corners is None:
        return "".join(f"f {' '.join(map(str, row))}\n" for row in outlines.each(outlines.corners + 1))
    uv_lines = "".join(f"vt {u:.6f} {v:.6f}\n" for u, v in uvs.tolist())
    rows = zip(outlines.each(outlines.corners + 1), outlines.each(outlines.uv_corners + 1), strict=True)
    return uv_lines + "".join(
        f"f {' '.join(f'{v}/{t}' for v, t in zip(row, uv_row, strict=True))}\n" for row, uv_row in rows
    )


def _text(frame: int, positions: np.ndarray, topology: str, remark: str = "") -> str:
    head = f"{SIGNATURE}: frame {frame}{f' ({remark})' if remark else ''}; metres, Y up\n"
    return head + "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in positions.tolist()) + topology
