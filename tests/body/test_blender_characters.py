"""Characters as Blender shows them, and as it writes them, against the same as they are read here.

Needs a Python with `bpy`: this one, or the one named by the environment variable PB4U_BLENDER_PYTHON.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tests.body.characters import write_woman

from pb4u.body.character import Character, PosedCharacter
from pb4u.body.library import load_body

pytestmark = pytest.mark.slow
PYTHON = os.environ.get("PB4U_BLENDER_PYTHON", sys.executable)

_SHOW = """
import sys
import bpy
import numpy as np

path, exported, shown = sys.argv[1], sys.argv[2], sys.argv[3]
frames = [int(each) for each in sys.argv[4:]]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 30
bpy.ops.import_scene.gltf(filepath=path, merge_vertices=False)
bodies = [each for each in bpy.data.objects if each.type == "MESH" and each.name.startswith("Body")]
found = {}
for frame in frames:
    bpy.context.scene.frame_set(frame)
    graph = bpy.context.evaluated_depsgraph_get()
    for each in bodies:
        held = each.evaluated_get(graph)
        places = np.array([held.matrix_world @ v.co for v in held.data.vertices])
        found[f"{each.name.split(chr(46))[0]} {frame}"] = np.stack([places[:, 0], places[:, 2], -places[:, 1]], axis=1)
np.savez(shown, **found)
bpy.ops.export_scene.gltf(filepath=exported, export_animation_mode="ACTIONS", export_force_sampling=True,
    export_all_influences=True)
"""


@pytest.fixture(scope="module")
def blender() -> str:
    if subprocess.run([PYTHON, "-c", "import bpy"], capture_output=True).returncode:
        pytest.skip("bpy is absent; name a Python that has it in PB4U_BLENDER_PYTHON")
    return PYTHON


def in_file(body: Character, time: float) -> np.ndarray:
    """Vertices (vertices, 3) of a clip at a time from its first key [s], in the file's own space."""
    poses = body.rig.tree.posed(body.clip, np.array([time]))
    places = PosedCharacter(body, poses, 30.0).positions(0, 1)[0].double().numpy()
    world = body.rig.tree.world
    return (places - world[:3, 3]) @ np.linalg.inv(world[:3, :3]).T


def test_blender_shows_and_writes_the_same_vertices(tmp_path: Path, blender: str) -> None:
    path = write_woman(tmp_path / "woman.glb", unit=0.01, clips=("walk",), split=2)
    # The keys begin at half a second, which is frame 15.
    frames = [15, 20, 26]
    arguments = [tmp_path / "again.glb", tmp_path / "shown.npz", *frames]
    subprocess.run([blender, "-c", _SHOW, path, *map(str, arguments)], check=True, capture_output=True, timeout=300)
    shown = np.load(tmp_path / "shown.npz")
    body, again = load_body(path), load_body(tmp_path / "again.glb")
    assert isinstance(body, Character)
    assert isinstance(again, Character)
    for frame in frames:
        wanted = np.concatenate([shown[f"Body{k} {frame}"] for k in range(2)])
        # Blender leaves out vertices that no triangle has, and writes them in another order.
        for read in (body, again):
            ours = in_file(read, (frame - 15) / 30)[read.source_vertices]
            assert cKDTree(ours).query(wanted)[0].max() < 1e-5
            assert cKDTree(wanted).query(ours)[0].max() < 1e-5


def test_both_clips_of_a_file_by_blender_are_there(tmp_path: Path, blender: str) -> None:
    path = write_woman(tmp_path / "woman.glb")
    arguments = [tmp_path / "again.glb", tmp_path / "shown.npz", 15]
    subprocess.run([blender, "-c", _SHOW, path, *map(str, arguments)], check=True, capture_output=True, timeout=300)
    for name in ("walk", "arms"):
        body = load_body(tmp_path / "again.glb", clip=name)
        assert isinstance(body, Character)
        assert body.is_human
        assert body.clip is not None
        assert body.clip.name == name
        assert len(body.rig.morphs) == 1
        assert any("left out of the body: EyeIris, Hair" in note for note in body.notes)
        np.testing.assert_allclose(body.height, load_body("woman").height, atol=1e-4)
