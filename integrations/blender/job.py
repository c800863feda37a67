"""A simulation that runs beside Blender: its files, its process, and its frames as they are computed."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from . import baking, scene_folder
from .environment import PlainError, Process, last_sentence, warnings_in
from .point_cache import GrowingCache, read_new
from .preferences import command
from .properties import entry_values, run_values

_KEY = "pb4u_job"
# Seconds between two looks at the process: well under the time of a step at the sizes that artists use.
_INTERVAL = 0.25


@dataclass
class GarmentResult:
    """Frames of a garment that came back.

    Args:
        object_name: of the artist's object.
        live: cache that the simulation writes, on the same vertices, in metres and Y up.
        matrices: (frames, 4, 4) from the object's own coordinates to the world.
        cache: what Blender plays, in the object's own coordinates.
    """

    object_name: str
    live: Path
    matrices: np.ndarray
    cache: GrowingCache

    def take(self, metres: float) -> int:
        """Write the frames that are new; how many they are. `metres` is one unit of the scene [m]."""
        done = self.cache.samples
        new = read_new(self.live, done, self.cache.points)[: len(self.matrices) - done]
        if len(new):
            world = baking.to_blender(new.astype(np.float64), metres)
            turn, place = self.matrices[done : done + len(new), :3, :3], self.matrices[done : done + len(new), :3, 3]
            self.cache.append(np.linalg.solve(turn, (world - place[:, None]).transpose(0, 2, 1)).transpose(0, 2, 1))
        return len(new)


@dataclass(frozen=True)
class PreparedRun:
    """Everything that a run reads, written to its folder.

    Args:
        folder: of the run.
        scene_name: of the Blender scene.
        frames: of the scene.
        metres: one unit of the scene [m].
        results: of each garment, inner first.
        notes: plain sentences on what the artist should know.
    """

    folder: Path
    scene_name: str
    frames: range
    metres: float
    results: list[GarmentResult]
    notes: list[str]


def prepare(context: bpy.types.Context) -> PreparedRun:
    """Bake the scene and write its files.

    Args:
        context: whose scene is simulated.

    Raises:
        PlainError: something of it cannot be simulated.
    """
    scene = context.scene
    settings = scene.pb4u
    frames = baking.frame_range(scene)
    objects = baking.garment_objects(scene)
    bodies = baking.body_objects(scene, objects)
    run = run_values(settings)
    parent, notes = cache_folder(settings.folder)
    notes += [
        f"{each.name}: what comes after the cloth is seen and not simulated: {', '.join(after)}."
        for each in objects
        if (after := baking.shaping_modifiers(each))
    ]
    garments = baking.bake_garments(context, objects, frames[0])
    body, matrices = baking.bake_motion(context, bodies, objects, frames)
    try:
        folder = scene_folder.new_run_folder(parent)
        _sign(folder)
        files = scene_folder.write_garments(folder, garments)
        scene_folder.write_body(folder, body, baking.frame_rate(scene))
        entries = {entry.object: entry for entry in settings.garments if entry.object is not None}
        scene_folder.write_scene(
            folder,
            {
                "body": f"./{scene_folder.BODY}",
                "frames": len(frames),
                "fps": baking.frame_rate(scene),
                "lead_in": settings.lead_in,
            },
            [entry_values(entries[each], written, frames[0]) for each, written in zip(objects, files, strict=True)],
            run,
            {"gravity": baking.gravity(scene), **baking.wind(scene)},
        )
        results = [
            GarmentResult(
                each.name,
                folder / scene_folder.LIVE / f"{written.mesh.stem}.pc2",
                matrices[k],
                GrowingCache(folder / f"{written.mesh.stem}.pc2", len(garments[k].vertices)),
            )
            for k, (each, written) in enumerate(zip(objects, files, strict=True))
        ]
    except OSError as error:
        raise PlainError(f"The folder {parent} cannot be written to: {error.strerror or error}.") from None
    return PreparedRun(folder, scene.name, frames, baking.metres_per_unit(scene), results, notes)


def cache_folder(chosen: str) -> tuple[Path, list[str]]:
    """The folder that runs are in, and what the artist should know of it.

    Args:
        chosen: in the panel.
    """
    if chosen.startswith("//") and not bpy.data.filepath:
        folder = Path(bpy.app.tempdir) / "pb4u"
        return folder, [f"The file is not saved yet, so its frames go to {folder}, which Blender deletes when it ends."]
    return Path(bpy.path.abspath(chosen)), []


def is_own(run: Path) -> bool:
    """Whether the file that is open made a run.

    Args:
        run: folder of the run.
    """
    named = run / scene_folder.MADE_BY
    return named.is_file() and (run / named.read_text(encoding="utf-8")).resolve() == _maker()


def _sign(run: Path) -> None:
    maker = str(_maker())
    with contextlib.suppress(ValueError):  # on Windows, another drive
        maker = os.path.relpath(maker, run.resolve())
    (run / scene_folder.MADE_BY).write_text(maker, encoding="utf-8")


def _maker() -> Path:
    """The .blend; of a file that is not saved, the folder that this Blender alone has."""
    return Path(bpy.data.filepath or bpy.app.tempdir).resolve()


class SimulationJob:
    """A run under way.

    Args:
        prepared: its files.
        program: the pb4u command.

    Raises:
        PlainError: the command cannot be run.
    """

    def __init__(self, prepared: PreparedRun, program: Path) -> None:
        self.prepared = prepared
        self.cancelled = False
        self.error = ""
        folder = prepared.folder
        arguments = ["simulate", scene_folder.SCENE, "--out", scene_folder.RESULT, "--live", scene_folder.LIVE]
        self.process = Process([str(program), *arguments], folder / scene_folder.LOG)
        self._tell(0.0, "Loading pb4u", running=True)

    @property
    def frame_count(self) -> int:
        """Frames that every garment has."""
        return min(result.cache.samples for result in self.prepared.results)

    def cancel(self) -> None:
        """End between two steps; the frames that are there stay."""
        self.cancelled = True
        self.process.interrupt()

    def tick(self) -> float | None:
        """Take the frames that are new. Seconds until the next look, or None at the end."""
        # Asked before the frames are read: what was written until the end is read after it.
        code = self.process.exit_code
        try:
            self._take_frames()
        except (OSError, ValueError) as error:
            self.error = f"The frames cannot be read: {error}"
            self.process.interrupt()
        if code is None:
            self._tell_progress()
            return _INTERVAL
        self._end(code)
        return None

    def _take_frames(self) -> None:
        before = self.frame_count
        for result in self.prepared.results:
            played = bpy.data.objects.get(result.object_name)
            first = result.cache.samples == 0
            if not result.take(self.prepared.metres) or played is None:
                continue
            if first:
                play(played, result.cache.path, self.prepared.frames[0])
            played.update_tag()
        scene = bpy.data.scenes.get(self.prepared.scene_name)
        if self.frame_count > before and scene is not None and scene.pb4u.follow:
            scene.frame_set(self.prepared.frames[self.frame_count - 1])

    def _tell_progress(self) -> None:
        told = _last_line(self.prepared.folder / scene_folder.LIVE / "progress.jsonl")
        if told is None:
            return
        done, of = told["step"], told["steps"]
        frames = len(self.prepared.frames)
        what = f"frame {self.frame_count} of {frames}" if self.frame_count else "settling the cloth"
        self._tell(done / of, f"Step {done} of {of}, {what}", running=True)

    def _end(self, code: int) -> None:
        frames, of = self.frame_count, len(self.prepared.frames)
        said = self.process.said()
        if self.cancelled:
            sentence = f"Cancelled; {frames} of {of} frames are there."
        elif self.error or code:
            self.error = self.error or last_sentence(said) or f"pb4u ended with {code}."
            sentence = self.error + (f" {frames} of {of} frames are there." if frames else "")
        else:
            sentence = f"{frames} frame{'s are' if frames != 1 else ' is'} there."
        # Of quads the command says how to write them whole; here they always are.
        self.prepared.notes.extend(note for note in warnings_in(said) if "--on source" not in note)
        shutil.rmtree(self.prepared.folder / scene_folder.LIVE, ignore_errors=True)
        self._tell(1.0 if not code else 0.0, sentence, running=False)

    def _tell(self, progress: float, sentence: str, running: bool) -> None:
        scene = bpy.data.scenes.get(self.prepared.scene_name)
        if scene is not None:
            scene.pb4u.progress, scene.pb4u.status, scene.pb4u.running = progress, sentence, running
            scene.pb4u.notes = "\n".join(self.prepared.notes)
        redraw()


def _last_line(path: Path) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    lines = path.read_text(encoding="ascii").rsplit("\n", 2)
    # What follows the last line break is a line that is being written.
    return json.loads(lines[-2]) if len(lines) > 1 else None


def play(played: bpy.types.Object, cache: Path, first_frame: int) -> None:
    """Play a cache on an object, in the place in its stack where the cloth is.

    Args:
        played: object whose vertices it moves.
        cache: PC2 in the object's own coordinates.
        first_frame: frame of the scene that its first sample belongs to.
    """
    modifier = played.modifiers.get(baking.MODIFIER)
    if modifier is None or modifier.type != "MESH_CACHE":
        place = baking.cache_place(played)
        modifier = played.modifiers.new(baking.MODIFIER, "MESH_CACHE")
        played.modifiers.move(len(played.modifiers) - 1, place)
        modifier = played.modifiers[place]
    modifier.cache_format = "PC2"
    modifier.filepath = _blend_path(cache)
    modifier.frame_start = first_frame
    modifier.show_viewport = modifier.show_render = True


def _blend_path(path: Path) -> str:
    """A path that is still true when the .blend is moved with its cache."""
    if bpy.data.filepath:
        with contextlib.suppress(ValueError):  # on Windows, another drive
            return bpy.path.relpath(str(path))
    return str(path)


def redraw() -> None:
    """Draw the views and their panels anew."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def running_job() -> SimulationJob | None:
    """The run under way, or the last one."""
    return bpy.app.driver_namespace.get(_KEY)


def start(context: bpy.types.Context) -> SimulationJob:
    """Prepare and start a run.

    Raises:
        PlainError: one runs already, pb4u is not there, or the scene cannot be simulated.
    """
    before = running_job()
    if before is not None and before.process.exit_code is None:
        raise PlainError("A simulation is running; cancel it first.")
    program = command(context)
    job = SimulationJob(prepare(context), program)
    bpy.app.driver_namespace[_KEY] = job
    return job


def end_running(*_: object) -> None:
    """End the run under way, as when another file is opened or the add-on is turned off."""
    job = bpy.app.driver_namespace.pop(_KEY, None)
    if job is not None:
        job.process.kill()
