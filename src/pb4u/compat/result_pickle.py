"""Results in the layout of the released research code (.pkl), written and read; its viewers open them."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np

from pb4u.errors import InputError
from pb4u.io.restricted_pickle import load_pickle
from pb4u.io.stored_numbers import Layout, read_members, require_places
from pb4u.progress import Progress
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader

FPS = 30.0
"""Frames per second of all results of the released code, whose files do not state it [1/s]."""
_LAYOUT: Layout = {
    "pred": ("f", ("frames", "vertices", 3)),
    "obstacle": ("f", ("frames", "body vertices", 3)),
    "cloth_faces": ("iu", ("faces", 3)),
    "obstacle_faces": ("iu", ("body faces", 3)),
}


def write_result(trajectory: Trajectory, path: Path, progress: Progress) -> None:
    """Write {pred, obstacle, cloth_faces, obstacle_faces, metrics}; the metrics are left empty.

    Args:
        trajectory: to write.
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
    """Trajectory in a result of the released code; no code in it is run.

    The files have no rest shape and no velocities: the first frame and differences of positions replace them.

    Args:
        path: the .pkl.

    Raises:
        InputError: the file is missing, no such result, or its parts do not fit each other.
    """
    if not path.is_file():
        raise InputError(f"There is no trajectory {path}.")

    def refuse(what: str) -> InputError:
        return InputError(f"{path} is not a result of the released code: {what}.")

    members, counts = read_members(load_pickle(path), _LAYOUT, refuse)
    require_places(members, {"cloth_faces": "vertices", "obstacle_faces": "body vertices"}, counts, refuse)
    if not counts["frames"] or not counts["vertices"]:
        raise refuse("it has no frames")
    positions, body = (members[name].astype(np.float32) for name in ("pred", "obstacle"))
    faces, body_faces = (members[name].astype(np.int64) for name in ("cloth_faces", "obstacle_faces"))
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
    frames = (Frame(*arrays) for arrays in zip(positions, velocities, body, strict=True))
    return Trajectory.collect(header, frames)


def open_trajectory(path: str | Path) -> Trajectory:
    """A trajectory from its .npz, or a result of the released code from its .pkl.

    Args:
        path: the file.

    Raises:
        InputError: it is neither, damaged, or its parts do not fit each other.
    """
    path = Path(path)
    return read_result(path) if path.suffix.lower() == ".pkl" else Trajectory.open(path)
