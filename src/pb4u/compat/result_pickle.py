"""Results in the layout of the released research code (.pkl), written and read; its viewers open them."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.errors import InputError
from pb4u.io.restricted_pickle import load_pickle
from pb4u.io.stored_numbers import stored_numbers
from pb4u.progress import Progress
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader

FPS = 30.0
"""Frames per second of all results of the released code, whose files do not tell it [1/s]."""


def write_result(trajectory: Trajectory, path: Path, progress: Progress) -> None:
    """Write {pred, obstacle, cloth_faces, obstacle_faces, metrics}; the metrics are left empty.

    Args:
        trajectory: what is written.
        path: file to write.
        progress: called with (frames done, frames in all), before and after.
    """
    progress(0, trajectory.frame_count)
    content = {
        "pred": np.asarray(trajectory.positions, dtype=np.float32),
        "obstacle": np.asarray(trajectory.body_positions, dtype=np.float32),
        "metrics": {},
        "cloth_faces": np.asarray(trajectory.faces, dtype=np.int64),
        "obstacle_faces": np.asarray(trajectory.header.body_faces, dtype=np.int64),
    }
    # Named as before numpy 2, which the released viewers are older than; the first occurrence comes before any data.
    content_bytes = pickle.dumps(content, protocol=3)
    path.write_bytes(content_bytes.replace(b"cnumpy._core.multiarray\n", b"cnumpy.core.multiarray\n", 1))
    progress(trajectory.frame_count, trajectory.frame_count)


def read_result(path: Path) -> Trajectory:
    """Trajectory in a result of the released code; nothing in it is run.

    The files hold no rest shape and no velocities: the first frame stands for the one, differences for the other.

    Args:
        path: the .pkl.

    Raises:
        InputError: the file is missing, no such result, or its parts do not fit each other.
    """
    if not path.is_file():
        raise InputError(f"There is no trajectory {path}.")
    content = load_pickle(path)
    names = ("pred", "obstacle", "cloth_faces", "obstacle_faces")
    if not isinstance(content, Mapping) or (missing := [name for name in names if name not in content]):
        lacks = f"it lacks {', '.join(missing)}" if isinstance(content, Mapping) else "it is no dictionary"
        raise InputError(f"{path} is no result of the released code: {lacks}.")
    positions, body = (_frames(path, content, name) for name in names[:2])
    if len(positions) != len(body):
        raise InputError(f"{path} has {len(positions)} frames of cloth and {len(body)} of the body.")
    faces, body_faces = _faces(path, content, names[2], positions), _faces(path, content, names[3], body)
    count = positions.shape[1]
    header = TrajectoryHeader(
        faces=faces,
        rest_positions=positions[0],
        pinned=np.zeros(count, dtype=bool),
        vertex_garment=np.zeros(count, dtype=np.int32),
        body_faces=body_faces,
        body_contact=np.ones(body.shape[1], dtype=bool),
        fps=FPS,
        metadata={
            "garment": path.stem,
            "triangles": len(faces),
            "model": "released code",
            "notes": ["The rest shape is not in the file: the first frame stands for it."],
        },
    )
    velocities = FPS * np.diff(positions, axis=0, prepend=positions[:1])
    frames = (Frame(*each) for each in zip(positions, velocities, body, strict=True))
    return Trajectory.collect(header, frames)


def _frames(path: Path, content: Mapping[str, Any], name: str) -> np.ndarray:
    values = stored_numbers(content[name], path, name)
    if values.dtype.kind != "f" or values.ndim != 3 or values.shape[2] != 3 or not values.size:
        raise InputError(f'{path}: "{name}" has the shape {values.shape}, where (frames, vertices, 3) belongs.')
    return values.astype(np.float32)


def _faces(path: Path, content: Mapping[str, Any], name: str, positions: np.ndarray) -> np.ndarray:
    faces = stored_numbers(content[name], path, name)
    if faces.dtype.kind not in "iu" or faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(f'{path}: "{name}" has the shape {faces.shape}, where (faces, 3) whole numbers belong.')
    if len(faces) and not 0 <= faces.min() <= faces.max() < positions.shape[1]:
        raise InputError(f'{path}: "{name}" names vertices that are not there; there are {positions.shape[1]}.')
    return faces.astype(np.int64)


def open_trajectory(path: str | Path) -> Trajectory:
    """A trajectory from its .npz, or a result of the released code from its .pkl.

    Args:
        path: the file.

    Raises:
        InputError: it is neither, damaged, or its parts do not fit each other.
    """
    path = Path(path)
    return read_result(path) if path.suffix.lower() == ".pkl" else Trajectory.open(path)
