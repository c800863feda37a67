"""Bodies that SAM 3D Body finds in pictures, one file a frame or all in one: vertices of MHR's own topology.

Layout: `process_one_image` of facebookresearch/sam-3d-body gives `pred_vertices` [m] and `pred_cam_t` in the axes of
the camera (Y down, Z away), here saved by `numpy.savez` as the samples of facebookresearch/MHR are. The faces are the
estimator's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pb4u.body.animated_body import FLOOR_PERCENTILE
from pb4u.body.sequence_files import by_number, surface_of, warn_of_gaps
from pb4u.body.vertex_sequence import DEFAULT_FPS, VertexSequence, require_usable
from pb4u.errors import InputError, warn
from pb4u.io.array_archive import member_names, read_arrays
from pb4u.io.reading_limits import refusing

VERTICES = "pred_vertices"
_PLACE, _FACES, _RATE = "pred_cam_t", ("faces", "mhr_faces"), "fps"
_UPRIGHT = np.array([1.0, -1.0, -1.0], dtype=np.float32)
_MESHES = (".ply", ".obj")


def is_sam3d_folder(folder: Path) -> bool:
    """Whether a folder holds .npz files, the first of which has such vertices.

    Args:
        folder: any folder.
    """
    first = next(iter(sorted(folder.glob("*.npz"))), None)
    return first is not None and VERTICES in member_names(first)


def read_sam3d_body(path: Path) -> VertexSequence:
    """The body of all frames, Y up, on the ground.

    Args:
        path: an .npz with `pred_vertices` (vertices, 3) or (frames, vertices, 3), or a folder of one a frame. The faces
            are in a member `faces`, or in a file beside it: `faces.npy`, or a .ply or .obj of one frame. A member `fps`
            gives the frames per second; 30 without it.

    Raises:
        InputError: a part is missing, frames have different vertices, the rate is invalid, or there are no faces.
    """
    files = sorted(path.glob("*.npz"), key=by_number) if path.is_dir() else [path]
    warn_of_gaps(path, files)
    frames: list[np.ndarray] = []
    faces: np.ndarray | None = None
    fps = DEFAULT_FPS
    for file in files:
        arrays = read_arrays(file, (VERTICES, _PLACE, _RATE, *_FACES))
        if VERTICES not in arrays or arrays[VERTICES].dtype.kind != "f" or arrays[VERTICES].shape[-1:] != (3,):
            raise InputError(f'{file} has no "{VERTICES}" (vertices, 3) as SAM 3D Body writes them.')
        vertices = arrays[VERTICES].astype(np.float32)
        vertices = vertices.reshape(-1, *vertices.shape[-2:])
        place = arrays.get(_PLACE, np.zeros(3)).astype(np.float32)
        if frames and vertices.shape[1] != frames[0].shape[1]:
            raise InputError(f"{file} has {vertices.shape[1]} vertices and {files[0].name} {frames[0].shape[1]}.")
        with refusing(file, f'has a "{_PLACE}" that does not fit its frames'):
            frames.append((vertices + place.reshape(-1, 1, 3)) * _UPRIGHT)
        faces = next((arrays[name] for name in _FACES if name in arrays), faces)
        with refusing(file, f'has an "{_RATE}" that is not a number'):
            fps = float(arrays[_RATE].item()) if _RATE in arrays else fps
    vertices = np.concatenate(frames)
    faces = _faces_beside(path, vertices.shape[1]) if faces is None else faces
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise InputError(f"{path}: its faces have the shape {faces.shape}; they must be whole numbers (faces, 3).")
    vertices, faces = require_usable(path, vertices, faces.astype(np.int64))
    floor = float(np.percentile(vertices[..., 1].min(axis=1), FLOOR_PERCENTILE))
    middle = vertices[0].mean(axis=0)
    vertices -= np.array([middle[0], floor, middle[2]], dtype=np.float32)
    warn(
        f"{path.name}: the ground is assumed to be level for the camera, {-floor:.2f} m below it; if the camera "
        "looked down, turn the body upright first.",
    )
    sequence = VertexSequence(path.stem, vertices, faces, fps)
    sequence.from_video = True
    return sequence


def _faces_beside(path: Path, count: int) -> np.ndarray:
    folder = path if path.is_dir() else path.parent
    if (folder / "faces.npy").is_file():
        return np.asarray(np.load(folder / "faces.npy", allow_pickle=False))
    for mesh in sorted(entry for entry in folder.iterdir() if entry.suffix.lower() in _MESHES):
        vertices, faces = surface_of(mesh)
        if len(vertices) == count:
            return faces
    raise InputError(
        f"{path} has no faces: put those of the estimator beside it, numpy.save('faces.npy', estimator.faces), or the "
        ".ply "
        "that the notebook writes of a frame."
    )
