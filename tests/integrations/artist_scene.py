"""Run by a Python that has `bpy`: installs the packed add-on and builds the scene of an artist, for the tests beside.

    PYTHON_WITH_BPY -c "..." FOLDER

FOLDER holds pb4u.zip, the `pb4u` command, and body.npz: `vertices` (n, 3) [m] and `faces` of a standing figure, Y up.
"""

import os
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np

WAIST, KNEE = 1.01, 0.55


def install(folder):
    """The add-on, enabled from its zip as Blender's own dialog does it; the name of its module."""
    bpy.ops.extensions.package_install_files(
        filepath=str(folder / "pb4u.zip"), repo="user_default", enable_on_install=True
    )
    module = "bl_ext.user_default.pb4u"
    if module not in bpy.context.preferences.addons:
        bpy.ops.preferences.addon_enable(module=module)
    bpy.context.preferences.addons[module].preferences.command = str(folder / "pb4u")
    return module


def z_up(points):
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)


def mesh_object(name, vertices, faces):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], [list(map(int, face)) for face in faces])
    made = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def rigged_body(arrays):
    """A figure that bends at the waist by a bone, turns by the rig itself, and breathes by a shape key."""
    points = z_up(arrays["vertices"])
    body = mesh_object("Body", points, arrays["faces"])
    rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for name, low, high in (("hips", 0.8, 1.05), ("spine", 1.05, 1.5)):
        bone = rig.data.edit_bones.new(name)
        bone.head, bone.tail = (0, 0, low), (0, 0, high)
    rig.data.edit_bones["spine"].parent = rig.data.edit_bones["hips"]
    bpy.ops.object.mode_set(mode="OBJECT")
    upper = np.clip((points[:, 2] - 1.05) / 0.2, 0.0, 1.0)
    for name, weights in (("hips", 1 - upper), ("spine", upper)):
        group = body.vertex_groups.new(name=name)
        for k, weight in enumerate(weights.tolist()):
            group.add([k], weight, "REPLACE")
    body.shape_key_add(name="Basis")
    breath = body.shape_key_add(name="breath")
    outward = points * [1.04, 1.04, 1.0] - points
    chest = np.exp(-(((points[:, 2] - 0.95) / 0.15) ** 2))[:, None]
    breath.data.foreach_set("co", (points + chest * outward).astype(np.float32).ravel())
    body.parent = rig
    body.modifiers.new("Armature", "ARMATURE").object = rig
    spine = rig.pose.bones["spine"]
    spine.rotation_mode = "XYZ"
    for frame, bend, breathing, turn in ((1, 0.0, 0.0, 0.0), (15, 0.35, 1.0, 0.6), (30, -0.1, 0.0, -0.4)):
        spine.rotation_euler = (bend, 0, 0)
        spine.keyframe_insert("rotation_euler", frame=frame)
        breath.value = breathing
        breath.keyframe_insert("value", frame=frame)
        rig.rotation_euler = (0, 0, turn)
        rig.keyframe_insert("rotation_euler", frame=frame)
    return rig, body


def quad_skirt(around=28, rows=14):
    """A flared skirt of quads with UVs, pinned at its waist; its object is moved, turned and scaled."""
    angle = np.arange(around) * 2 * np.pi / around
    vertices = []
    for row in range(rows + 1):
        down = row / rows
        width, depth = 0.175 + 0.13 * down + 0.04 * np.sqrt(down), 0.12 + 0.17 * down + 0.04 * np.sqrt(down)
        height = WAIST + (KNEE - WAIST) * down
        vertices += [(width * np.sin(a), -0.027 - depth * np.cos(a), height) for a in angle]
    vertices = np.array(vertices)
    faces = [
        (
            row * around + k,
            (row + 1) * around + k,
            (row + 1) * around + (k + 1) % around,
            row * around + (k + 1) % around,
        )
        for row in range(rows)
        for k in range(around)
    ]
    place = np.array([0.3, -0.2, 0.4])
    made = mesh_object("Skirt", (vertices - place)[:, [1, 0, 2]] * [-2.0, 2.0, 2.0], faces)
    # (x, y) of the mesh are (-2 y, 2 x) of the world: a quarter turn back, at half the size.
    made.location, made.rotation_euler, made.scale = place, (0, 0, -np.pi / 2), (0.5, 0.5, 0.5)
    layer = made.data.uv_layers.new(name="UVMap")
    for polygon in made.data.polygons:
        row, k = divmod(polygon.index, around)
        for loop, (u, v) in zip(
            polygon.loop_indices, ((k, row), (k, row + 1), (k + 1, row + 1), (k + 1, row)), strict=True
        ):
            layer.data[loop].uv = (u / around, 1 - v / rows)
    waist = made.vertex_groups.new(name="waistband")
    waist.add(list(range(around)), 1.0, "REPLACE")
    waist.add(list(range(around, 2 * around)), 0.2, "REPLACE")
    made.modifiers.new("Subdivision", "SUBSURF")
    return made


def artist_scene(folder):
    """The scene, with the skirt on the add-on's list; the rig, the body and the skirt."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end, scene.render.fps = 1, 30, 30
    with np.load(folder / "body.npz") as arrays:
        rig, body = rigged_body(arrays)
    skirt = quad_skirt()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "artist.blend"))
    install(folder)
    settings = scene.pb4u
    settings.body, settings.model, settings.lead_in = rig, "solver", 2
    for each in bpy.context.selected_objects:
        each.select_set(False)
    skirt.select_set(True)
    bpy.ops.pb4u.add_garment()
    settings.garments[0].pins = "waistband"
    bpy.context.view_layer.update()
    return rig, body, skirt


def world(each, frame=None):
    """Vertices (vertices, 3) of an object in the world, up to the modifier that plays the simulation, at a frame."""
    for modifier in each.modifiers:
        modifier.show_viewport = modifier.type in ("MESH_CACHE", "ARMATURE", "MIRROR")
    if frame is not None:
        bpy.context.scene.frame_set(frame)
    evaluated = each.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    matrix = np.array(evaluated.matrix_world)
    result = points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    evaluated.to_mesh_clear()
    return result


class Layout:
    """Takes what a panel draws without a screen, and refuses properties and operators that are not there."""

    def __init__(self, drawn):
        self.drawn = drawn

    def prop(self, data, name, **_):
        assert name in data.bl_rna.properties, name

    def prop_search(self, data, name, source, names, **_):
        assert name in data.bl_rna.properties, name
        assert names in source.bl_rna.properties, names

    def operator(self, name, **_):
        module, _, function = name.partition(".")
        getattr(getattr(bpy.ops, module), function).get_rna_type()
        self.drawn.append(name)
        return self

    def template_list(self, _kind, _name, data, entries, _active_data, active, rows):
        assert {entries, active} <= set(data.bl_rna.properties.keys())

    def label(self, text, **_):
        assert text

    def progress(self, factor, text):
        assert 0.0 <= factor <= 1.0

    def row(self, **_):
        return self

    column = box = row


def draw_panels():
    """Draw every panel of the add-on; the operators that they offer."""
    module = sys.modules["bl_ext.user_default.pb4u.panels"]
    drawn = []
    # Without a screen the interface has no scale.
    screen = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0))
    context = SimpleNamespace(scene=bpy.context.scene, preferences=screen, region=SimpleNamespace(width=320))
    for panel in module.CLASSES[1:]:
        panel.draw(SimpleNamespace(layout=Layout(drawn)), context)
    own = bpy.context.preferences.addons["bl_ext.user_default.pb4u"].preferences
    sys.modules["bl_ext.user_default.pb4u.preferences"].Preferences.draw(
        SimpleNamespace(layout=Layout(drawn), source=own.source, status="x", bl_rna=own.bl_rna), context
    )
    return drawn


FOLDER = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(os.curdir)
