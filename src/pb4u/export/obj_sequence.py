"""OBJ, one file a frame: `walk.obj` becomes walk_0000.obj, walk_0001.obj, ..."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pb4u.scene.trajectory import Trajectory


def frame_path(path: Path, frame: int) -> Path:
    """File of one frame of the sequence named `path`."""
    return path.with_name(f"{path.stem}_{frame:04d}{path.suffix}")


def write_obj_sequence(trajectory: Trajectory, path: Path) -> None:
    """Write every frame, vertex order and UVs kept; metres, Y up."""
    header = trajectory.header
    if header.uvs is not None and header.uv_faces is not None:
        uv_lines = "".join(f"vt {u:.6f} {v:.6f}\n" for u, v in header.uvs)
        corners = np.stack([header.faces + 1, header.uv_faces + 1], axis=-1).reshape(-1, 6)
        face_lines = "".join(f"f {a}/{ua} {b}/{ub} {c}/{uc}\n" for a, ua, b, ub, c, uc in corners.tolist())
    else:
        uv_lines = ""
        face_lines = "".join(f"f {a} {b} {c}\n" for a, b, c in (header.faces + 1).tolist())
    for t, positions in enumerate(trajectory.positions):
        vertex_lines = "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in positions.tolist())
        target = frame_path(path, t)
        beside = target.with_name(f".{target.name}.part")
        beside.write_text(vertex_lines + uv_lines + face_lines, encoding="ascii")
        beside.replace(target)
