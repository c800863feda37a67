"""What the buttons do: choose, check, simulate, cancel, install."""

import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import bpy

from . import baking, scene_folder
from .environment import (
    PlainError,
    ask,
    installation,
    last_sentence,
    names,
    plain_environment,
    python_for_environment,
    requirements,
)
from .job import cache_folder, is_own, prepare, running_job, start
from .preferences import command, environment_folder, preferences

MARKS = "pb4u findings"
"""Vertex group that holds what the last check found."""

_IN_BLENDER = {
    "non-manifold": "delete the extra faces there",
    "degenerate": "Mesh > Clean Up > Degenerate Dissolve",
    "duplicate": "delete one of each",
    "isolated": "Mesh > Clean Up > Delete Loose",
    "unwelded": "Mesh > Merge > By Distance",
    "orientation": "Mesh > Normals > Recalculate Outside",
    "inside-out": "Mesh > Normals > Flip",
    "graded": "give it a number of triangles",
    "too-many": "give it a number of triangles",
    "units": "scale it, or set the unit scale of the scene",
    "axes": "turn it",
    "place": "move it onto the body at the first frame",
    "height": "move it onto the body at the first frame",
    "misplaced": "move it onto the body at the first frame",
    "penetration": "push them out with Sculpt or Shrinkwrap; simulation pushes out what is shallow",
    "unsupported": "choose a vertex group for its pins",
    "self-crossing": "mend it, or turn self-contact off",
}
"""What an artist does in Blender about a finding; for others the doctor's own words are good."""

_TOLD_ELSEWHERE = ("polygons",)


class SentenceOperator(bpy.types.Operator):
    """An operator whose refusals are sentences."""

    bl_options = {"REGISTER"}

    def execute(self, context):
        try:
            return self.act(context)
        except PlainError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}


class PB4U_OT_add_garment(SentenceOperator):
    """Add the selected meshes to the garments, the innermost first"""

    bl_idname = "pb4u.add_garment"
    bl_label = "Add Garments"
    bl_options = {"REGISTER", "UNDO"}

    def act(self, context):
        settings = context.scene.pb4u
        there = [entry.object for entry in settings.garments]
        chosen = [
            each
            for each in context.selected_objects
            if each.type == "MESH" and each not in there and each != settings.body
        ]
        if not chosen:
            raise PlainError("Select the meshes of the garments first; those in the list are left as they are.")
        for each in chosen:
            settings.garments.add().object = each
        settings.active_garment = len(settings.garments) - 1
        return {"FINISHED"}


class PB4U_OT_remove_garment(SentenceOperator):
    """Take the garment off the list"""

    bl_idname = "pb4u.remove_garment"
    bl_label = "Remove Garment"
    bl_options = {"REGISTER", "UNDO"}

    def act(self, context):
        settings = context.scene.pb4u
        settings.garments.remove(settings.active_garment)
        settings.active_garment = max(0, min(settings.active_garment, len(settings.garments) - 1))
        return {"FINISHED"}


class PB4U_OT_move_garment(SentenceOperator):
    """Wear the garment farther in or farther out"""

    bl_idname = "pb4u.move_garment"
    bl_label = "Move Garment"
    bl_options = {"REGISTER", "UNDO"}

    step: bpy.props.IntProperty(default=1)

    def act(self, context):
        settings = context.scene.pb4u
        to = settings.active_garment + self.step
        if 0 <= to < len(settings.garments):
            settings.garments.move(settings.active_garment, to)
            settings.active_garment = to
        return {"FINISHED"}


class PB4U_OT_check(SentenceOperator):
    """Ask pb4u what is wrong with the garments at the first frame, and mark the vertices concerned"""

    bl_idname = "pb4u.check"
    bl_label = "Check"
    bl_options = {"REGISTER", "UNDO"}

    def act(self, context):
        program = command(context)
        scene = context.scene
        settings = scene.pb4u
        frames = baking.frame_range(scene)
        objects = baking.garment_objects(scene)
        bodies = baking.body_objects(scene, objects)
        garments = baking.bake_garments(context, objects, frames[0])
        body, _ = baking.bake_motion(context, bodies, objects, frames[:1])
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            files = scene_folder.write_garments(folder, garments)
            worn_by = scene_folder.write_body(folder, body, baking.frame_rate(scene))
            report = folder / "report.json"
            worn = [argument for each in files for argument in ("--garment", str(each.mesh))]
            try:
                ask(program, "check", *worn, "--body", str(worn_by), "--json", str(report))
            except PlainError:
                # A garment that is refused ends with an error too, and its findings are there.
                if not report.is_file():
                    raise
            told = json.loads(report.read_text(encoding="utf-8"))
        settings.findings.clear()
        reports = told["garments"] if "garments" in told else [told["garment"]]
        for each, garment, found in zip(objects, garments, reports, strict=True):
            _keep_findings(settings, each, garment, found["findings"])
        for tangle in told.get("crossings", {}).get("as_worn", []):
            entry = settings.findings.add()
            entry.severity, entry.sentence = "refused", f"{tangle['sentence']}."
            entry.fix = "wear them in another order, or mend them there"
        refused = sum(entry.severity == "refused" for entry in settings.findings)
        count = len(settings.findings)
        settings.checked = (
            f"{count} finding{'s' if count != 1 else ''}, {refused} of which would be refused."
            if count
            else "Nothing to repair."
        )
        self.report({"WARNING"} if refused else {"INFO"}, settings.checked)
        return {"FINISHED"}


def _keep_findings(settings, each, garment, findings):
    """Put the findings of a garment on the list, and mark their vertices in its group."""
    marked = set()
    own_vertices = len(garment.vertices) == garment.base_vertices
    for finding in findings:
        if finding["code"] in _TOLD_ELSEWHERE or (finding["code"] == "unsupported" and garment.pins is not None):
            continue
        entry = settings.findings.add()
        entry.object, entry.severity, entry.sentence = each.name, finding["severity"], finding["sentence"]
        entry.fix = _IN_BLENDER.get(finding["code"], finding["fix"])
        if own_vertices:
            entry.vertices = json.dumps(finding["vertices"])
            marked |= set(finding["vertices"])
    if MARKS in each.vertex_groups:
        each.vertex_groups.remove(each.vertex_groups[MARKS])
    if marked:
        was_active = each.vertex_groups.active_index
        each.vertex_groups.new(name=MARKS).add(sorted(marked), 1.0, "REPLACE")
        each.vertex_groups.active_index = max(was_active, 0)


class PB4U_OT_select_finding(SentenceOperator):
    """Select the vertices of this finding in Edit Mode"""

    bl_idname = "pb4u.select_finding"
    bl_label = "Select Vertices"
    bl_options = {"REGISTER", "UNDO"}

    index: bpy.props.IntProperty()

    def act(self, context):
        entry = context.scene.pb4u.findings[self.index]
        each = bpy.data.objects.get(entry.object)
        vertices = json.loads(entry.vertices or "[]")
        if each is None or not vertices:
            raise PlainError("This finding names no vertices of a mesh that is here.")
        if context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        mesh = each.data
        if max(vertices) >= len(mesh.vertices):
            raise PlainError(f"{each.name} has changed since it was checked; check it again.")
        for other in context.selected_objects:
            other.select_set(False)
        each.select_set(True)
        context.view_layer.objects.active = each
        wanted = set(vertices)
        mesh.vertices.foreach_set("select", [k in wanted for k in range(len(mesh.vertices))])
        mesh.edges.foreach_set("select", [False] * len(mesh.edges))
        mesh.polygons.foreach_set("select", [False] * len(mesh.polygons))
        context.tool_settings.mesh_select_mode = (True, False, False)
        bpy.ops.object.mode_set(mode="EDIT")
        return {"FINISHED"}


class PB4U_OT_simulate(SentenceOperator):
    """Simulate the garments beside Blender; frames appear as they are computed"""

    bl_idname = "pb4u.simulate"
    bl_label = "Simulate"

    wait: bpy.props.BoolProperty(
        name="Wait",
        description="Return when the simulation has ended; for scripts",
        default=True,
        options={"SKIP_SAVE"},
    )

    def invoke(self, context, _event):
        self.wait = False
        return self.execute(context)

    def act(self, context):
        job = start(context)
        for note in job.prepared.notes:
            self.report({"INFO"}, note)
        if not self.wait:
            bpy.app.timers.register(job.tick, first_interval=0.1)
            return {"FINISHED"}
        while (seconds := job.tick()) is not None:
            time.sleep(seconds)
        if job.error:
            raise PlainError(context.scene.pb4u.status)
        self.report({"INFO"}, context.scene.pb4u.status)
        return {"FINISHED"}


class PB4U_OT_cancel(SentenceOperator):
    """End the simulation between two steps; the frames that are there stay"""

    bl_idname = "pb4u.cancel"
    bl_label = "Cancel"

    def act(self, _context):
        job = running_job()
        if job is None or job.process.exit_code is not None:
            raise PlainError("No simulation is running.")
        job.cancel()
        return {"FINISHED"}


class PB4U_OT_export(SentenceOperator):
    """Write the scene to a folder of its own, for `pb4u simulate scene.toml` on this or another machine"""

    bl_idname = "pb4u.export"
    bl_label = "Write Scene File"

    def act(self, context):
        prepared = prepare(context)
        self.report({"INFO"}, f"Written: {prepared.folder / scene_folder.SCENE}")
        return {"FINISHED"}


class PB4U_OT_remove_result(SentenceOperator):
    """Show the garments as they were made; the frames stay on the disk until unused runs are deleted"""

    bl_idname = "pb4u.remove_result"
    bl_label = "Remove Result"
    bl_options = {"REGISTER", "UNDO"}

    def act(self, context):
        for entry in context.scene.pb4u.garments:
            modifier = entry.object.modifiers.get(baking.MODIFIER) if entry.object else None
            if modifier is not None:
                entry.object.modifiers.remove(modifier)
        return {"FINISHED"}


class PB4U_OT_delete_unused(SentenceOperator):
    """Delete the runs of this file in the cache folder that none of its objects plays"""

    bl_idname = "pb4u.delete_unused"
    bl_label = "Delete Unused Runs"

    def invoke(self, context, event):
        return context.window_manager.invoke_confirm(self, event)

    def act(self, context):
        job = running_job()
        if job is not None and job.process.exit_code is None:
            raise PlainError("A simulation is running; cancel it first.")
        used = {
            Path(bpy.path.abspath(modifier.filepath)).resolve().parent
            for each in bpy.data.objects
            for modifier in each.modifiers
            if modifier.type == "MESH_CACHE"
        }
        folder, _ = cache_folder(context.scene.pb4u.folder)
        unused = [run for run in folder.glob("run_*") if is_own(run) and run.resolve() not in used]
        for run in unused:
            shutil.rmtree(run, ignore_errors=True)
        self.report({"INFO"}, f"{len(unused)} runs deleted.")
        return {"FINISHED"}


class PB4U_OT_find(SentenceOperator):
    """Find the pb4u command and ask it what it offers"""

    bl_idname = "pb4u.find"
    bl_label = "Find"

    def act(self, context):
        own = preferences(context)
        program = command(context)
        own.offered = json.dumps(names(program))
        own.status = f"{ask(program, '--version').strip()} at {program}"
        self.report({"INFO"}, own.status)
        return {"FINISHED"}


class PB4U_OT_install(SentenceOperator):
    """Make a Python environment of the add-on's own and install pb4u into it"""

    bl_idname = "pb4u.install"
    bl_label = "Install"

    def invoke(self, context, event):
        return context.window_manager.invoke_confirm(self, event)

    def act(self, context):
        own = preferences(context)
        if not own.source.strip():
            raise PlainError("Say what to install: a package name, a wheel, a folder or an address.")
        wanted = requirements(bpy.path.abspath(own.source.strip()))
        is_local = Path(wanted[-1]).exists()
        if not bpy.app.online_access and not is_local:
            raise PlainError(
                "Blender is set to stay offline; allow online access in Preferences > System, or install from a wheel."
            )
        environment_folder(create=True)
        python = python_for_environment()
        for told in installation(python, environment_folder(), wanted):
            print("pb4u:", " ".join(told))
            ended = subprocess.run(told, capture_output=True, text=True, env=plain_environment())
            if ended.returncode:
                raise PlainError(f"`{' '.join(told[1:])}` failed: {last_sentence(ended.stderr or ended.stdout)}")
        own.command = ""
        program = command(context)
        own.status = f"Installed: {ask(program, '--version').strip()} at {program}"
        self.report({"INFO"}, own.status)
        return {"FINISHED"}


CLASSES = (
    PB4U_OT_add_garment, PB4U_OT_remove_garment, PB4U_OT_move_garment, PB4U_OT_check, PB4U_OT_select_finding,
    PB4U_OT_simulate, PB4U_OT_cancel, PB4U_OT_export, PB4U_OT_remove_result, PB4U_OT_delete_unused, PB4U_OT_find,
    PB4U_OT_install,
)  # fmt: skip
