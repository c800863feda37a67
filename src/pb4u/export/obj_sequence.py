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
    """Write every frame of the garment, vertex order and UVs kept; metres, Y up."""
    topology = _topology(trajectory)
    held = set(held_frames(trajectory))
    for t, positions in enumerate(trajectory.positions):
        remark = "not finite, the last whole frame before it" if t in held else ""
        frame_path(path, t).write_text(_text(t, positions, topology, remark), encoding="ascii")
        if progress:
            progress(t + 1, trajectory.frame_count)


def write_obj(trajectory: Trajectory, path: Path, frame: int = 0) -> None:
    """Write one frame of the garment, vertex order and UVs kept; metres, Y up."""
    path.write_text(_text(frame, trajectory.positions[frame], _topology(trajectory)), encoding="ascii")


def _topology(trajectory: Trajectory) -> str:
    header = trajectory.header
    if header.uvs is None or header.uv_faces is None:
        return "".join(f"f {a} {b} {c}\n" for a, b, c in (header.faces + 1).tolist())
    uv_lines = "".join(f"vt {u:.6f} {v:.6f}\n" for u, v in header.uvs.tolist())
    corners = np.stack([header.faces + 1, header.uv_faces + 1], axis=-1).reshape(-1, 6)
    return uv_lines + "".join(f"f {a}/{ua} {b}/{ub} {c}/{uc}\n" for a, ua, b, ub, c, uc in corners.tolist())


def _text(frame: int, positions: np.ndarray, topology: str, remark: str = "") -> str:
    head = f"{SIGNATURE}: frame {frame}{f' ({remark})' if remark else ''}; metres, Y up\n"
    return head + "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in positions.tolist()) + topology
