"""The garment alone, frame by frame: OBJ files, and PC2 and MDD point caches, each with the OBJ that it moves.

`walk.obj` becomes walk_0000.obj, walk_0001.obj, ...
`walk.pc2` comes with walk.obj: the garment at its first frame, vertices in the order of the cache, with its UVs.
In Blender import the OBJ, then add a Mesh Cache modifier with the cache file and leave its axes as they are: the
importer turns the object, not its vertices, so object and cache agree although both are Y up, in metres. The frame
rate of the scene has to be set to that of the trajectory: PC2 holds none, and Blender plays one sample a frame.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pb4u.errors import InputError
from pb4u.export.finite_frames import held_frames
from pb4u.export.panels import SewnPanels
from pb4u.export.pieces import part_of_polygon
from pb4u.export.shading import cloth_parts
from pb4u.geometry.obj_file import group_name
from pb4u.io.point_cache import MDD_HEADER, pc2_header
from pb4u.progress import Progress, no_progress
from pb4u.scene.trajectory import Trajectory

SIGNATURE = "# Written by pb4u"
"""First line of every OBJ file written here; a file with another first line is somebody's own."""


def frame_files(path: Path, frames: int) -> tuple[Path, ...]:
    """Files of an OBJ sequence.

    Args:
        path: name that the files are derived from.
        frames: number of frames.
    """
    return tuple(path.with_name(f"{path.stem}_{t:04d}{path.suffix}") for t in range(frames))


def later_frame_files(path: Path, frames: int) -> tuple[Path, ...]:
    """Files of an OBJ sequence that was written here before and had more frames.

    Args:
        path: name that the files are derived from.
        frames: number of frames of the sequence.
    """
    return tuple(file for file, number in _numbered(path) if number >= frames and _is_frame(file, number))


def check_frames(path: Path) -> None:
    """Refuse an OBJ sequence whose frames could overwrite meshes that pb4u did not write.

    Args:
        path: name that the files are derived from.

    Raises:
        InputError: such a mesh exists there.
    """
    for mesh, _ in _numbered(path):
        if not is_own(mesh):
            raise _not_ours(mesh, path)


def _numbered(path: Path) -> list[tuple[Path, int]]:
    """Files called as the frames of an OBJ sequence, and their numbers."""
    name = re.compile(re.escape(path.stem) + r"_(\d{4,})" + re.escape(path.suffix))
    matches = [(file, name.fullmatch(file.name)) for file in sorted(path.parent.iterdir())]
    return [(file, int(match.group(1))) for file, match in matches if match]


def is_own(mesh: Path) -> bool:
    """Whether this package wrote an OBJ file.

    Args:
        mesh: path of the OBJ.
    """
    if not mesh.is_file():
        return False
    with mesh.open("rb") as file:
        return file.read(len(SIGNATURE)) == SIGNATURE.encode()


def _is_frame(mesh: Path, number: int) -> bool:
    """Whether an OBJ file is this frame of a sequence; the mesh of a cache called walk_0006.pc2 says frame 0."""
    if not is_own(mesh):
        return False
    with mesh.open("rb") as file:
        head = re.match(rb": frame (\d+)\b", file.readline(200)[len(SIGNATURE) :])
    return head is not None and int(head.group(1)) == number


def write_obj_sequence(trajectory: Trajectory, path: Path, progress: Progress = no_progress) -> None:
    """Write every frame of the garment, vertex order, polygons and UVs kept; metres, Y up.

    A garment sewn of a pattern has a group for each panel, and its seams as lines of the group `seams`; one of several
    fabrics names the fabric of its faces (`usemtl`).

    Args:
        trajectory: to write, with finite frames only.
        path: name that the files are derived from, see `frame_files`.
        progress: called with the frames written.
    """
    topology = _topology(trajectory)
    repeated = set(held_frames(trajectory))
    files = frame_files(path, trajectory.frame_count)
    for t, (file, positions) in enumerate(zip(files, trajectory.positions, strict=True)):
        remark = "not finite, the last whole frame before it" if t in repeated else ""
        file.write_text(_text(t, positions, topology, remark), encoding="ascii")
        progress(t + 1, trajectory.frame_count)


def cache_files(path: Path, _frames: int) -> tuple[Path, ...]:
    """Paths of a point cache and of the OBJ that belongs to it."""
    return path, path.with_suffix(".obj")


def check_companion(path: Path) -> None:
    """Refuse a point cache whose OBJ would overwrite a mesh that pb4u did not write.

    Args:
        path: the cache.

    Raises:
        InputError: such a mesh exists beside it.
    """
    mesh = path.with_suffix(".obj")
    if mesh.exists() and not is_own(mesh):
        raise _not_ours(mesh, path)


def _not_ours(mesh: Path, path: Path) -> InputError:
    return InputError(f"{mesh} exists and is not from pb4u, and {path.name} needs that name: choose another name.")


def write_pc2(trajectory: Trajectory, path: Path, progress: Progress = no_progress) -> None:
    """Write PC2, little-endian: header (magic, version 1, points, first frame, sampling 1, samples), then the vertices.

    Args:
        trajectory: to write, with finite frames only.
        path: file to write; its OBJ goes beside it.
        progress: called with the frames written.
    """
    samples, points = trajectory.positions.shape[:2]
    _write(trajectory, path, pc2_header(points, samples), "<f4", progress)


def write_mdd(trajectory: Trajectory, path: Path, progress: Progress = no_progress) -> None:
    """Write MDD (LightWave), big-endian: samples, points, the time of each sample [s], then the vertices.

    Args:
        trajectory: to write, with finite frames only.
        path: file to write; its OBJ goes beside it.
        progress: called with the frames written.
    """
    samples, points = trajectory.positions.shape[:2]
    times = (np.arange(samples) / trajectory.fps).astype(">f4")
    header = MDD_HEADER.pack(samples, points) + times.tobytes()
    _write(trajectory, path, header, ">f4", progress)


def _write(trajectory: Trajectory, path: Path, header: bytes, dtype: str, progress: Progress) -> None:
    with path.open("wb") as file:
        file.write(header)
        for number, positions in enumerate(trajectory.positions, start=1):
            file.write(positions.astype(dtype).tobytes())
            progress(number, trajectory.frame_count)
    first = _text(0, trajectory.positions[0], _topology(trajectory))
    path.with_suffix(".obj").write_text(first, encoding="ascii")


def _topology(trajectory: Trajectory) -> str:
    header = trajectory.header
    uvs, outlines, panels = header.uvs, header.outlines, SewnPanels.of(header)
    rows = [[str(v) for v in row] for row in outlines.each(outlines.corners + 1)]
    lines = []
    if uvs is None or outlines.uv_corners is None:
        panels = None
    else:
        lines = [f"vt {u:.6f} {v:.6f}\n" for u, v in uvs.tolist()]
        pairs = zip(rows, outlines.each(outlines.uv_corners + 1), strict=True)
        rows = [[f"{v}/{t}" for v, t in zip(row, uv_row, strict=True)] for row, uv_row in pairs]
    names = [] if panels is None else [*map(group_name, panels.names), "cloth"]
    parts = cloth_parts(header)
    part = part_of_polygon(header, parts)
    for face, row in enumerate(rows):
        if panels is not None and (face == 0 or panels.of_face[face] != panels.of_face[face - 1]):
            lines.append(f"g {names[panels.of_face[face]]}\n")
        if len(parts) > 1 and (face == 0 or part[face] != part[face - 1]):
            lines.append(f"usemtl {group_name(parts[part[face]].name)}\n")
        lines.append(f"f {' '.join(row)}\n")
    if panels is not None:
        lines += ["g seams\n", *(f"l {a} {b}\n" for a, b in (panels.seams + 1).tolist())]
    return "".join(lines)


def _text(frame: int, positions: np.ndarray, topology: str, remark: str = "") -> str:
    head = f"{SIGNATURE}: frame {frame}{f' ({remark})' if remark else ''}; metres, Y up\n"
    return head + "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in positions.tolist()) + topology
