"""In Blender itself: what it shows after an import, against the trajectory.

Needs a Python with `bpy`: this one, or the one named by the environment variable PB4U_BLENDER_PYTHON.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.export.readers import Glb
from tests.export.test_bone_baking import skinned

from pb4u.export.registry import export
from pb4u.scene.trajectory import Trajectory

PYTHON = os.environ.get("PB4U_BLENDER_PYTHON", sys.executable)

_IMPORT = """
import sys
import bpy
import numpy as np

path, suffix, moments = sys.argv[1], sys.argv[2], [int(t) for t in sys.argv[5:]]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene, rate = bpy.context.scene, float(sys.argv[4])
scene.render.fps = round(rate)
scene.render.fps_base = round(rate) / rate
if suffix == ".glb":
    bpy.ops.import_scene.gltf(filepath=path)
elif suffix == ".abc":
    bpy.ops.wm.alembic_import(filepath=path, as_background_job=False)
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


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".pc2", ".mdd", ".usdc", ".usdz", ".glb", ".abc"])
def test_blender_shows_every_vertex_where_it_was(
    blender: str, trajectory: Trajectory, tmp_path: Path, suffix: str
) -> None:
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr", reason='the "usd" extra is not installed')
    path = export(trajectory, tmp_path / f"walk{suffix}")
    moments = [0, 6, 11]
    shown = shown_in(blender, path, moments)
    tolerance = 1e-3 if suffix == ".glb" else 1e-6
    vertices = trajectory.positions.shape[1]
    np.testing.assert_allclose(shown["garment"][:, :vertices], trajectory.positions[moments], atol=tolerance)
    if "body" in shown:
        np.testing.assert_allclose(shown["body"], trajectory.body_positions[moments], atol=tolerance)
    assert ("body" in shown) == (suffix not in (".pc2", ".mdd"))
    uvs, uv_faces = trajectory.header.uvs, trajectory.header.uv_faces
    assert uvs is not None
    assert uv_faces is not None
    if suffix == ".abc":
        # Which corner of a face comes first is Blender's own choice.
        by_corner = {(face, corner): uv for face, corner, uv in _corners(shown["corner"], shown["uv"])}
        for face, corner, uv in _corners(trajectory.faces.ravel(), uvs[uv_faces].reshape(-1, 2)):
            np.testing.assert_allclose(by_corner[face, corner], uv, atol=1e-6)
        return
    np.testing.assert_allclose(shown["uv"], uvs[uv_faces].reshape(-1, 2), atol=1e-5)
    if suffix != ".glb":
        np.testing.assert_array_equal(shown["corner"], trajectory.faces.ravel())


@pytest.mark.slow
@pytest.mark.parametrize("fps", [24.0, 29.97, 60.0])
def test_blender_shows_alembic_at_its_own_rate(
    blender: str, trajectory: Trajectory, tmp_path: Path, fps: float
) -> None:
    pytest.importorskip("alembic3d", reason='the "abc" extra is not installed')
    timed = replace(trajectory, header=replace(trajectory.header, fps=fps))
    shown = shown_in(blender, export(timed, tmp_path / "walk.abc"), list(range(12)), fps)
    np.testing.assert_allclose(shown["garment"], trajectory.positions, atol=1e-5)


@pytest.mark.slow
def test_blender_plays_baked_bones(blender: str, trajectory: Trajectory, tmp_path: Path) -> None:
    said: list[str] = []
    path = export(trajectory, tmp_path / "bones.glb", say=said.append, bones=16)
    shown = shown_in(blender, path, [0, 6, 11])["garment"][:, : trajectory.positions.shape[1]]
    expected = skinned(Glb(path), 0, 12)[[0, 6, 11], : trajectory.positions.shape[1]]
    np.testing.assert_allclose(shown, expected, atol=1e-5)


def shown_in(blender: str, path: Path, moments: list[int], fps: float = 25.0) -> dict[str, np.ndarray]:
    """What Blender shows of a file at some frames: (frames, vertices, 3) of each mesh; UVs and corners of the cloth."""
    command = [blender, "-c", _IMPORT, path, path.suffix, path.parent / "shown.npz", fps, *moments]
    ended = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    return dict(np.load(path.parent / "shown.npz"))


def _corners(vertices: np.ndarray, uvs: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
    """Triangle, vertex and UV of each corner."""
    return ((k // 3, int(vertex), uv) for k, (vertex, uv) in enumerate(zip(vertices, uvs, strict=True)))
