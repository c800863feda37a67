"""Blender's cloth on one scene, run by a Python that has the `bpy` package: reads and writes .npz files.

    PYTHON_WITH_BPY benchmarks/blender_cloth.py SCENE.npz RESULT.npz

`benchmarks/side_by_side.py` writes the scene and reads the result. Blender's stiffnesses are not those of a material in
SI units: it keeps those of its own default, cotton, at the garment's mass, with its default quality of 5 steps a frame
and collisions, with the body and with itself, at 3 mm.
"""

from __future__ import annotations

import resource
import struct
import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np

COLLISION_DISTANCE = 3e-3
QUALITY = 5


def mesh_object(name: str, vertices: np.ndarray, faces: np.ndarray) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    made = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def write_point_cache(path: Path, positions: np.ndarray) -> None:
    """PC2, a sample for each frame from 1 on."""
    frames, points = positions.shape[:2]
    header = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, points, 1.0, 1.0, frames)
    path.write_bytes(header + positions.astype("<f4").tobytes())


def simulate(arrays: dict[str, np.ndarray], cache: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (frames, vertices, 3) [m], and the wall and processor time [s] of each frame."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    frames = len(arrays["body_positions"])
    scene.frame_start, scene.frame_end = 1, frames
    scene.render.fps = round(float(arrays["fps"]))
    scene.gravity = arrays["gravity"].tolist()

    body = mesh_object("body", arrays["body_positions"][0], arrays["body_faces"])
    write_point_cache(cache, arrays["body_positions"])
    moved = body.modifiers.new("moved", "MESH_CACHE")
    moved.cache_format, moved.filepath, moved.frame_start = "PC2", str(cache), 1.0
    body.modifiers.new("collision", "COLLISION")
    body.collision.thickness_outer = COLLISION_DISTANCE

    cloth = mesh_object("cloth", arrays["start"], arrays["faces"])
    simulated = cloth.modifiers.new("cloth", "CLOTH")
    simulated.settings.quality = QUALITY
    simulated.settings.mass = float(arrays["mass"]) / len(arrays["start"])
    contact = simulated.collision_settings
    contact.use_collision, contact.distance_min = True, COLLISION_DISTANCE
    contact.use_self_collision, contact.self_distance_min = True, COLLISION_DISTANCE
    simulated.point_cache.frame_start, simulated.point_cache.frame_end = 1, frames

    positions = np.empty((frames, len(arrays["start"]), 3), dtype=np.float32)
    wall, processor = np.empty(frames), np.empty(frames)
    for frame in range(frames):
        began, spent = time.perf_counter(), time.process_time()
        scene.frame_set(frame + 1)
        result = cloth.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        wall[frame], processor[frame] = time.perf_counter() - began, time.process_time() - spent
        result.vertices.foreach_get("co", positions[frame].reshape(-1))
    return positions, wall, processor


def main() -> None:
    source, target = (Path(argument) for argument in sys.argv[1:3])
    with np.load(source) as file:
        arrays = {name: file[name] for name in file.files}
    with tempfile.TemporaryDirectory() as folder:
        positions, wall, processor = simulate(arrays, Path(folder) / "body.pc2")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    np.savez(target, positions=positions, wall=wall, processor=processor, peak_kib=peak, version=bpy.app.version_string)


if __name__ == "__main__":
    main()
