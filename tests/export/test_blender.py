"""In Blender itself: what it shows after an import, against the trajectory.

Needs a Python with `bpy`: this one, or the one named by the environment variable PB4U_BLENDER_PYTHON.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pb4u.export.registry import export
from pb4u.scene.trajectory import Trajectory

PYTHON = os.environ.get("PB4U_BLENDER_PYTHON", sys.executable)

_IMPORT = """
import sys
import bpy
import numpy as np

path, suffix, moments = sys.argv[1], sys.argv[2], [int(t) for t in sys.argv[4:]]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 25
if suffix == ".glb":
    bpy.ops.import_scene.gltf(filepath=path)
elif suffix.startswith(".usd"):
    bpy.ops.wm.usd_import(filepath=path)
else:
    bpy.ops.wm.obj_import(filepath=path.replace(suffix, ".obj"))
    cached = bpy.context.selected_objects[0]
    cached.name = "garment"
    cache = cached.modifiers.new("cache", "MESH_CACHE")
    cache.cache_format = suffix[1:].upper()
    cache.filepath = path
    cache.frame_start = 0
shown = {}
for thing in bpy.data.objects:
    if thing.type != "MESH":
        continue
    frames = []
    for t in moments:
        bpy.context.scene.frame_set(t)
        evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
        mesh = evaluated.to_mesh()
        points = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", points)
        turn = np.array(evaluated.matrix_world)
        world = points.reshape(-1, 3) @ turn[:3, :3].T + turn[:3, 3]
        frames.append(world[:, [0, 2, 1]] * [1, 1, -1])
    shown[thing.name.lower()] = np.array(frames)
    if thing.name.lower() == "garment":
        layer = thing.data.uv_layers[0].data
        shown["uv"] = np.array([[*corner.uv] for corner in layer])
        shown["corner"] = np.array([loop.vertex_index for loop in thing.data.loops])
np.savez(sys.argv[3], **shown)
"""


@pytest.fixture(scope="module")
def blender() -> str:
    if subprocess.run([PYTHON, "-c", "import bpy"], capture_output=True).returncode:
        pytest.skip("bpy is absent; name a Python that has it in PB4U_BLENDER_PYTHON")
    return PYTHON


@pytest.mark.parametrize("suffix", [".pc2", ".mdd", ".usdc", ".usdz", ".glb"])
def test_blender_shows_every_vertex_where_it_was(
    blender: str, trajectory: Trajectory, tmp_path: Path, suffix: str
) -> None:
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr", reason='the "usd" extra is not installed')
    path = export(trajectory, tmp_path / f"walk{suffix}")
    moments = [0, 6, 11]
    command = [blender, "-c", _IMPORT, path, suffix, tmp_path / "shown.npz", *moments]
    ended = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    shown = np.load(tmp_path / "shown.npz")
    tolerance = 1e-3 if suffix == ".glb" else 1e-6
    vertices = trajectory.positions.shape[1]
    np.testing.assert_allclose(shown["garment"][:, :vertices], trajectory.positions[moments], atol=tolerance)
    if "body" in shown:
        np.testing.assert_allclose(shown["body"], trajectory.body_positions[moments], atol=tolerance)
    assert ("body" in shown) == (suffix not in (".pc2", ".mdd"))
    uvs, uv_faces = trajectory.header.uvs, trajectory.header.uv_faces
    assert uvs is not None
    assert uv_faces is not None
    np.testing.assert_allclose(shown["uv"], uvs[uv_faces].reshape(-1, 2), atol=1e-5)
    if suffix != ".glb":
        np.testing.assert_array_equal(shown["corner"], trajectory.faces.ravel())
