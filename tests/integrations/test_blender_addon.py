"""The Blender add-on, installed from its zip into a headless Blender, where the same operators run as the buttons do.

Needs a Python with `bpy`: this one, or the one named by the environment variable PB4U_BLENDER_PYTHON. What Blender does
is in `artist_scene.py` and in the scripts here; they leave what they saw as files.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.export.readers import pc2_frames
from tools.pack_blender_addon import pack

import pb4u
from pb4u.body.library import load_body
from pb4u.run import Run

PYTHON = os.environ.get("PB4U_BLENDER_PYTHON", sys.executable)
ROOT = Path(__file__).resolve().parents[2]
COMMAND = f"#!{sys.executable}\nimport sys\nsys.path.insert(0, {str(ROOT / 'src')!r})\n" + (
    "from pb4u.cli.main import main\nmain()\n"
)


@pytest.fixture(scope="module")
def blender() -> str:
    if subprocess.run([PYTHON, "-c", "import bpy"], capture_output=True).returncode:
        pytest.skip("bpy is absent; name a Python that has it in PB4U_BLENDER_PYTHON")
    return PYTHON


@pytest.fixture(scope="module")
def figure() -> dict[str, np.ndarray]:
    body = load_body("woman")
    return {"vertices": np.asarray(body.vertices), "faces": np.asarray(body.faces)}


@pytest.fixture
def run(blender: str, figure: dict[str, np.ndarray], tmp_path: Path) -> Callable[[str], Any]:
    """Run a script in the artist's scene; what it puts into `seen` comes back."""
    pack(tmp_path).rename(tmp_path / "pb4u.zip")
    np.savez(tmp_path / "body.npz", **figure)
    (tmp_path / "pb4u").write_text(COMMAND)
    (tmp_path / "pb4u").chmod(0o755)

    def call(script: str) -> Any:
        head = "import json\nfrom artist_scene import *\nseen = {}\nrig, body, skirt = artist_scene(FOLDER)\n"
        # Blender 4.2 as a module crashes while it ends wherever a property has a function of Python's; so it just ends.
        tail = "\n(FOLDER / 'seen.json').write_text(json.dumps(seen))\nos._exit(0)\n"
        environment = os.environ | {
            "PYTHONPATH": str(Path(__file__).parent),
            "BLENDER_USER_RESOURCES": str(tmp_path / "user"),
        }
        lines = "settings = bpy.context.scene.pb4u\n" + script
        ended = subprocess.run(
            [blender, "-c", head + lines + tail, str(tmp_path)], capture_output=True, text=True, env=environment
        )
        assert ended.returncode == 0, ended.stderr + ended.stdout
        return json.loads((tmp_path / "seen.json").read_text())

    return call


def test_the_same_sources_give_the_same_zip(tmp_path: Path) -> None:
    (tmp_path / "again").mkdir()
    one, other = pack(tmp_path), pack(tmp_path / "again")
    assert one.read_bytes() == other.read_bytes()
    with zipfile.ZipFile(one) as archive:
        manifest = archive.read("blender_manifest.toml").decode()
        assert {"__init__.py", "LICENSE"} < set(archive.namelist())
    assert f'\nversion = "{pb4u.__version__}"\n' in manifest
    assert '\nblender_version_min = "4.2.0"\n' in manifest


@pytest.mark.slow
def test_an_artists_mesh_moves_as_the_command_line_says(run: Callable, tmp_path: Path) -> None:
    seen = run("""
scene = bpy.context.scene
scene.frame_end = 4
before = [(tuple(p.vertices), p.material_index) for p in skirt.data.polygons]
uvs = [tuple(corner.uv) for corner in skirt.data.uv_layers[0].data]
seen["found"] = list(bpy.ops.pb4u.find())
seen["checked"] = (list(bpy.ops.pb4u.check()), settings.checked)
scene.frame_set(3)
settings.model, settings.self_contact = "skinning", False
bpy.ops.pb4u.simulate()
seen["first"] = skirt.modifiers["pb4u"].filepath
settings.model, settings.self_contact = "solver", True
bpy.ops.pb4u.simulate()
seen["second"] = skirt.modifiers["pb4u"].filepath
seen["status"] = settings.status
seen["stack"] = [m.name for m in skirt.modifiers]
seen["frame"] = scene.frame_current
seen["same mesh"] = before == [(tuple(p.vertices), p.material_index) for p in skirt.data.polygons] and uvs == [
    tuple(corner.uv) for corner in skirt.data.uv_layers[0].data
]
np.savez(FOLDER / "shown.npz", skirt=[world(skirt, t) for t in range(1, 5)], body=[world(body, t) for t in range(1, 5)])
bpy.ops.pb4u.delete_unused()
seen["left"] = sorted(each.name for each in (FOLDER / "pb4u_cache").iterdir())
bpy.ops.pb4u.remove_result()
seen["removed"] = [m.name for m in skirt.modifiers]
""")
    assert seen["found"] == ["FINISHED"]
    assert seen["checked"] == [["FINISHED"], "Nothing to repair."]
    assert seen["status"] == "4 frames are there."
    assert seen["stack"] == ["pb4u", "Subdivision"]
    assert seen["frame"] == 4  # the newest, as asked for
    assert seen["same mesh"]
    assert seen["first"] == "//pb4u_cache/run_0001/Skirt.pc2"
    assert seen["second"] == "//pb4u_cache/run_0002/Skirt.pc2"
    assert (seen["left"], seen["removed"]) == (["run_0002"], ["Subdivision"])
    files = tmp_path / "pb4u_cache" / "run_0002"
    for arguments in (
        ("simulate", files / "scene.toml", "--out", tmp_path / "own.npz"),
        ("convert", tmp_path / "own.npz", tmp_path / "own.pc2", "--on", "source"),
    ):
        subprocess.run([tmp_path / "pb4u", *arguments], check=True, capture_output=True)
    shown = np.load(tmp_path / "shown.npz")
    own = pc2_frames(tmp_path / "own.pc2")
    np.testing.assert_allclose(shown["skirt"], own[..., [0, 2, 1]] * [1, -1, 1], atol=1e-6)
    baked = np.load(files / "body.npz")["vertices"]
    np.testing.assert_allclose(shown["body"], baked[..., [0, 2, 1]] * [1, -1, 1], atol=1e-6)
    assert np.ptp(own, axis=0).max() > 0.005
    waist = own[:, np.loadtxt(files / "Skirt_pins.txt", dtype=int)]
    assert len(waist[0]) == 28
    assert np.abs(waist[:, :, 1] - waist[0, :, 1]).max() < 0.03


@pytest.mark.slow
def test_a_run_is_cancelled_in_the_middle_and_keeps_its_frames(run: Callable, tmp_path: Path) -> None:
    seen = run("""
import time
settings.own_range, settings.frame_start, settings.frame_end = True, 1, 200
seen["started"] = (list(bpy.ops.pb4u.simulate(wait=False)), settings.running)
try:
    bpy.ops.pb4u.simulate(wait=False)
except RuntimeError as error:
    seen["again"] = str(error)
job = bpy.app.driver_namespace["pb4u_job"]
told, appeared, began = set(), [], time.time()
while job.tick() is not None and time.time() - began < 300:
    told.add(settings.status)
    appeared.append(job.frame_count)
    if job.frame_count >= 2 and not job.cancelled:
        seen["moved while it ran"] = float(abs(world(skirt, 2) - world(skirt, 1)).max())
        bpy.ops.pb4u.cancel()
    time.sleep(0.05)
seen["told"], seen["appeared"] = sorted(told), sorted(set(appeared))
seen["status"], seen["running"], seen["samples"] = settings.status, settings.running, job.frame_count
seen["exit"] = job.process.exit_code
try:
    bpy.ops.pb4u.cancel()
except RuntimeError as error:
    seen["nothing to cancel"] = str(error)
""")
    assert seen["started"] == [["FINISHED"], True]
    assert "A simulation is running; cancel it first." in seen["again"]
    assert seen["moved while it ran"] > 0
    assert 2 <= seen["samples"] < 200
    assert seen["status"] == f"Cancelled; {seen['samples']} of 200 frames are there."
    assert not seen["running"]
    assert any(sentence.startswith("Step ") for sentence in seen["told"])
    assert seen["exit"] == 128 + 15
    assert "No simulation is running." in seen["nothing to cancel"]
    folder = tmp_path / "pb4u_cache" / "run_0001"
    assert len(pc2_frames(folder / "Skirt.pc2")) == seen["samples"]
    assert (folder / "result.interrupted.npz").is_file()


@pytest.mark.slow
def test_an_outfit_of_a_mirrored_and_a_carried_garment(run: Callable, tmp_path: Path) -> None:
    seen = run("""
scene = bpy.context.scene
scene.frame_end = 4
settings.model, settings.self_contact = "skinning", False
# Half a tube, mirrored by a modifier, on an object that the rig carries.
angle = np.linspace(0, np.pi, 15)
points = [(0.215 * np.sin(a), 0.17 * np.cos(a) - 0.027, z) for z in np.linspace(0.75, 0.98, 8) for a in angle]
half = mesh_object("In ner", np.array(points), [(15 * r + k, 15 * r + 15 + k, 15 * r + 16 + k, 15 * r + k + 1)
                                                for r in range(7) for k in range(14)])
half.parent = rig
mirror = half.modifiers.new("Mirror", "MIRROR")
settings.garments.add().object = half
settings.active_garment = 1
bpy.ops.pb4u.move_garment(step=-1)
settings.garments[0].own_triangles, settings.garments[0].triangles = True, 600
settings.garments[0].material, settings.garments[1].material = "denim", "silk"
settings.garments[1].parts = "hem=denim, waist = rib"
bpy.ops.pb4u.simulate()
seen["status"] = settings.status
seen["order"] = [entry.object.name for entry in settings.garments]
seen["stack"] = [m.name for m in half.modifiers]
np.savez(FOLDER / "shown.npz", **{each.name: [world(each, t) for t in range(1, 5)] for each in (half, skirt)})
""")
    assert seen["status"] == "4 frames are there."
    assert seen["order"] == ["In ner", "Skirt"]
    assert seen["stack"] == ["Mirror", "pb4u"]
    files = tmp_path / "pb4u_cache" / "run_0001"
    worn = Run.open(files / "scene.toml").garments
    assert [(each.name, each.material, each.triangles) for each in worn] == [
        ("In_ner", "denim", 600),
        ("Skirt", {"body": "silk", "hem": "denim", "waist": "rib"}, None),
    ]
    command = (tmp_path / "pb4u", "simulate", files / "scene.toml", "--out", tmp_path / "own.npz")
    subprocess.run([*command, "--live", tmp_path / "own"], check=True, capture_output=True)
    shown = np.load(tmp_path / "shown.npz")
    for name in ("In ner", "Skirt"):
        own = pc2_frames(tmp_path / "own" / f"{name.replace(' ', '_')}.pc2")
        np.testing.assert_allclose(shown[name], own[..., [0, 2, 1]] * [1, -1, 1], atol=1e-6)


@pytest.mark.slow
def test_wind_gravity_and_pins_of_the_scene_are_simulated(run: Callable, tmp_path: Path) -> None:
    seen = run("""
scene = bpy.context.scene
scene.gravity = (0.0, 0.0, -1.62)
scene.frame_end = 4
bpy.ops.object.effector_add(type="WIND", rotation=(-np.pi / 2, 0.0, 0.0))
field = bpy.context.object.field
field.strength, field.noise, field.seed = 3.0, 1.0, 7
entry = settings.garments[0]
entry.springs, entry.pin_stiffness, entry.lets_go, entry.pins_until = True, 120.0, True, scene.frame_start + 2
bpy.ops.pb4u.simulate()
seen["status"] = settings.status
""")
    assert seen["status"] == "4 frames are there."
    written = Run.open(tmp_path / "pb4u_cache" / "run_0001" / "scene.toml")
    # A field that blows along +Y in Blender blows along -Z, to the back of the figure.
    np.testing.assert_allclose(written.environment.wind, [0.0, 0.0, -3.0], atol=1e-5)
    np.testing.assert_allclose(written.environment.gravity, [0.0, -1.62, 0.0], atol=1e-6)
    assert written.environment.gusts == 7
    assert (written.friction_law, written.time_integration, written.air) == ("auto", "auto", "auto")
    assert (written.garments[0].pin_stiffness, written.garments[0].pins_until) == (120.0, 2)


@pytest.mark.slow
def test_what_cannot_be_simulated_is_told_in_one_sentence(run: Callable, tmp_path: Path) -> None:
    seen = run("""
scene = bpy.context.scene

def told(what):
    for operator in (bpy.ops.pb4u.simulate, bpy.ops.pb4u.check):
        try:
            operator()
            seen.setdefault(what, []).append("nothing")
        except RuntimeError as error:
            seen.setdefault(what, []).append(str(error).removeprefix("Error: ").strip())

settings.body = None
told("no body")
settings.body = skirt
told("both")
settings.body = rig
skirt.scale[0] *= -1
bpy.context.view_layer.update()
told("mirrored")
skirt.scale[0] *= -1
rig.scale[1] = -1
bpy.context.view_layer.update()
told("body mirrored")
rig.scale[1] = 1
bpy.context.view_layer.update()
skirt.modifiers.new("Lattice", "LATTICE")
told("after")
skirt.modifiers.remove(skirt.modifiers["Lattice"])
skirt.modifiers.new("Cloth", "CLOTH")
told("cloth")
skirt.modifiers.remove(skirt.modifiers["Cloth"])
settings.own_range, settings.frame_start, settings.frame_end = True, 9, 8
told("empty range")
settings.frame_start, settings.frame_end = 1, 6
body.modifiers.new("Build", "BUILD").frame_duration = 5
told("changing body")
body.modifiers.remove(body.modifiers["Build"])
settings.garments[0].pins = "gone"
told("group")
settings.garments[0].pins = "Empty"
skirt.vertex_groups.new(name="Empty")
told("empty group")
settings.garments[0].pins = ""
skirt.hide_viewport = True
told("hidden")
skirt.hide_viewport = False
body.hide_viewport = True
told("no mesh")
body.hide_viewport = False
settings.garments.add().object = skirt
told("twice")
settings.garments.clear()
told("no garment")
settings.garments.add().object = skirt
own = bpy.context.preferences.addons["bl_ext.user_default.pb4u"].preferences
own.command = "/nowhere/pb4u"
told("command")
own.command = str(FOLDER / "pb4u")
settings.model = "solvr"
try:
    bpy.ops.pb4u.simulate()
except RuntimeError as error:
    seen["model"] = [str(error)]
""")
    for what, says in {
        "no body": "There is no body: choose the mesh or the armature",
        "both": "Skirt is both body and garment",
        "mirrored": "Skirt is mirrored by a negative scale; apply it with Object > Apply > Scale.",
        "body mirrored": "Body is mirrored by a negative scale",
        "after": "Skirt: the modifier Lattice comes after the cloth and would move it a second time; drag it above "
        "Subdivision, or turn it off.",
        "cloth": "Skirt: the modifier Cloth simulates the cloth in Blender as well",
        "group": "Skirt has no vertex group gone",
        "empty group": "no vertex has a weight of 0.5 or more in the group Empty",
        "empty range": "The frame range 9 to 8 is empty",
        "hidden": "Skirt is hidden",
        "no mesh": "The armature Rig moves no mesh that is not hidden",
        "twice": "Skirt is in the list of garments twice",
        "no garment": "No garment is chosen",
        "command": "There is no pb4u command at /nowhere/pb4u",
        "model": "'solvr'; did you mean solver",
    }.items():
        for sentence in seen[what]:
            assert says in sentence, (what, sentence)
            assert "\n" not in sentence.strip()
    changing = seen["changing body"][0]
    assert "turn off the modifier that adds or removes them." in changing
    # A refused scene leaves no folder behind; the last one is refused by pb4u itself.
    assert sorted(each.name for each in (tmp_path / "pb4u_cache").iterdir()) == ["run_0001"]


@pytest.mark.slow
def test_unused_runs_of_other_files_are_kept(run: Callable) -> None:
    seen = run("""
def simulate():
    settings = bpy.context.scene.pb4u
    settings.model, settings.self_contact = "skinning", False
    bpy.context.scene.frame_end = 1
    bpy.ops.pb4u.simulate()

def left(folder):
    bpy.ops.pb4u.delete_unused()
    return sorted(each.name for each in folder.iterdir())

simulate()
bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "other.blend"))
bpy.ops.pb4u.remove_result()
simulate()
simulate()
seen["other"] = left(FOLDER / "pb4u_cache")
bpy.ops.wm.open_mainfile(filepath=str(FOLDER / "artist.blend"))
seen["reopened"] = left(FOLDER / "pb4u_cache")
bpy.ops.wm.read_homefile(use_empty=True)
with np.load(FOLDER / "body.npz") as arrays:
    rig, body = rigged_body(arrays)
settings = bpy.context.scene.pb4u
settings.body = rig
settings.garments.add().object = quad_skirt()
settings.garments[0].pins = "waistband"
simulate()
simulate()
seen["not saved"] = left(Path(bpy.app.tempdir) / "pb4u")
""")
    # The file was saved before its run, so once it is opened again nothing of it plays that.
    assert seen == {"other": ["run_0001", "run_0003"], "reopened": ["run_0003"], "not saved": ["run_0002"]}


@pytest.mark.slow
def test_the_script_of_the_page_runs(run: Callable) -> None:
    (script,) = re.findall(r"^```py\n(.*?)^```", (ROOT / "docs" / "blender.md").read_text(), re.MULTILINE | re.DOTALL)
    before = "settings.garments.clear()\nbpy.context.scene.frame_end = 1\n"
    before += 'settings.model, settings.self_contact = "skinning", False\n'
    seen = run(f'{before}{script}seen["status"] = settings.status')
    assert seen["status"] == "1 frame is there."


@pytest.mark.slow
def test_findings_are_marked_and_selected(run: Callable) -> None:
    seen = run("""
import bmesh
# A seam of the skirt is cut open, and one face is turned over.
edit = bmesh.new()
edit.from_mesh(skirt.data)
edit.edges.ensure_lookup_table()
edit.faces.ensure_lookup_table()
upright = [e for e in edit.edges if {v.index % 28 for v in e.verts} == {3}]
edit.faces[200].normal_flip()
bmesh.ops.split_edges(edit, edges=upright)
edit.to_mesh(skirt.data)
edit.free()
seen["checked"] = (list(bpy.ops.pb4u.check()), settings.checked)
seen["findings"] = [(f.object, f.severity, f.sentence, f.fix, json.loads(f.vertices)) for f in settings.findings]
group = skirt.vertex_groups["pb4u findings"].index
seen["marked"] = [v.index for v in skirt.data.vertices if any(g.group == group for g in v.groups)]
seen["drawn"] = draw_panels()
turned = [k for k, f in enumerate(settings.findings) if "turned over" in f.sentence][0]
bpy.ops.pb4u.select_finding(index=turned)
seen["mode"] = bpy.context.mode
bpy.ops.object.mode_set(mode="OBJECT")
seen["selected"] = [v.index for v in skirt.data.vertices if v.select]
seen["face"] = sorted(skirt.data.polygons[200].vertices)
""")
    assert seen["checked"][0] == ["FINISHED"]
    assert {"pb4u.check", "pb4u.simulate", "pb4u.select_finding", "pb4u.add_garment"} <= set(seen["drawn"])
    by_fix = {fix: (each, sentence, vertices) for each, _, sentence, fix, vertices in seen["findings"]}
    each, sentence, vertices = by_fix["Mesh > Merge > By Distance"]
    assert each == "Skirt"
    assert "15 border vertices coincide with others" in sentence
    assert len(vertices) == 15
    assert by_fix["Mesh > Normals > Recalculate Outside"][2] == seen["face"] == seen["selected"]
    assert seen["marked"] == sorted({index for *_, found in seen["findings"] for index in found})
    assert seen["mode"] == "EDIT_MESH"


@pytest.mark.slow
def test_pb4u_is_installed_into_an_environment_of_its_own(run: Callable, tmp_path: Path) -> None:
    wheel = tmp_path / "my wheels" / "pb4u-9.9-py3-none-any.whl"
    wheel.parent.mkdir()
    told = "def main():\n    import json, sys\n    print('pb4u 9.9' if '--version' in sys.argv else json.dumps({}))\n"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("pb4u.py", told)
        archive.writestr("pb4u-9.9.dist-info/METADATA", "Metadata-Version: 2.1\nName: pb4u\nVersion: 9.9\n")
        archive.writestr("pb4u-9.9.dist-info/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr("pb4u-9.9.dist-info/entry_points.txt", "[console_scripts]\npb4u = pb4u:main\n")
        archive.writestr("pb4u-9.9.dist-info/RECORD", "")
    seen = run(f"""
own = bpy.context.preferences.addons["bl_ext.user_default.pb4u"].preferences
own.source = "no-such-package-of-anyone"
try:
    bpy.ops.pb4u.install()
except RuntimeError as error:
    seen["offline"] = str(error)
own.source = {str(wheel)!r}
seen["installed"] = list(bpy.ops.pb4u.install())
own.source = {f"--no-index '{wheel}'"!r}
seen["with options"] = list(bpy.ops.pb4u.install())
seen["status"] = own.status
own.source = {str(tmp_path / "artist.blend")!r}
try:
    bpy.ops.pb4u.install()
except RuntimeError as error:
    seen["failed"] = str(error)
""")
    assert "Blender is set to stay offline" in seen["offline"]
    assert seen["installed"] == seen["with options"] == ["FINISHED"]
    assert seen["status"].startswith("Installed: pb4u 9.9 at ")
    assert str(tmp_path / "user") in seen["status"]
    assert "failed:" in seen["failed"]
