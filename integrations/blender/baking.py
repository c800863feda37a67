"""What of a Blender scene is simulated: garments at the first frame, bodies over all frames, as numpy arrays.

Blender is Z up, the simulation Y up: (x, y, z) becomes (x, z, -y), in metres by the scene's unit scale, so that a
figure that faces -Y in Blender faces +Z there.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np

from .environment import PlainError

MODIFIER = "pb4u"
"""Name of the Mesh Cache modifier that plays the result."""

LOOKS = {
    "SUBSURF", "MULTIRES", "SOLIDIFY", "BEVEL", "WIREFRAME", "TRIANGULATE", "DECIMATE", "REMESH", "SMOOTH",
    "CORRECTIVE_SMOOTH", "LAPLACIANSMOOTH", "NODES", "MASK",
}  # fmt: skip
"""Modifiers that follow the simulation: they shape what is seen, and carry the cloth nowhere."""
_NEUTRAL = {
    "EDGE_SPLIT", "WEIGHTED_NORMAL", "NORMAL_EDIT", "UV_PROJECT", "UV_WARP", "DATA_TRANSFER", "VERTEX_WEIGHT_EDIT",
    "VERTEX_WEIGHT_MIX", "VERTEX_WEIGHT_PROXIMITY", "PARTICLE_SYSTEM", "COLLISION", "DYNAMIC_PAINT",
}  # fmt: skip
"""Modifiers that may stand anywhere: they move no vertex."""

_SIMULATED_IN_BLENDER = ("CLOTH", "SOFT_BODY")
# Weight in a vertex group from which a vertex is pinned.
_PINNED = 0.5


@dataclass(frozen=True)
class BakedGarment:
    """A garment as it is at the first frame.

    Args:
        name: of its object.
        vertices: (vertices, 3) float64 [m], Y up.
        polygons: vertex indices of each face.
        pins: (n,) int64 pinned vertices, or None where no vertex group is chosen.
        base_vertices: vertices of its mesh before any modifier.
    """

    name: str
    vertices: np.ndarray
    polygons: list[np.ndarray]
    pins: np.ndarray | None
    base_vertices: int


@dataclass(frozen=True)
class BakedBody:
    """The bodies over the frames, as one mesh.

    Args:
        positions: (frames, vertices, 3) float32 [m], Y up.
        faces: (faces, 3) int64.
    """

    positions: np.ndarray
    faces: np.ndarray


def to_simulation(points: np.ndarray, metres: float) -> np.ndarray:
    """Blender's world coordinates (.., 3) as metres, Y up; `metres` is one unit of the scene [m]."""
    return points[..., [0, 2, 1]] * np.array([metres, metres, -metres])


def to_blender(points: np.ndarray, metres: float) -> np.ndarray:
    """What `to_simulation` made, back in Blender's world coordinates (.., 3)."""
    return points[..., [0, 2, 1]] * np.array([1.0, -1.0, 1.0]) / metres


def metres_per_unit(scene: bpy.types.Scene) -> float:
    """Length of one unit of the scene [m]."""
    return float(scene.unit_settings.scale_length)


def gravity(scene: bpy.types.Scene) -> list[float]:
    """Gravity of the scene [m/s^2], Y up; none where it is turned off."""
    if not scene.use_gravity:
        return [0.0, 0.0, 0.0]
    # Metres whatever the scene's unit: artists who model in centimetres leave it at 9.81.
    return to_simulation(np.array(scene.gravity), 1.0).tolist()


def wind(scene: bpy.types.Scene) -> dict[str, list[float] | int]:
    """Wind of the scene's wind fields together: its velocity [m/s], Y up, and a seed of gusts where one has noise.

    A field blows along its own Z, everywhere, and its strength is taken for metres a second; how it falls off with
    distance is not. Empty where no field blows.
    """
    blown, gusts = np.zeros(3), None
    for each in scene.objects:
        field = each.field
        if field is None or field.type != "WIND" or not field.strength or each.hide_render:
            continue
        blown += np.array(each.matrix_world.to_3x3().normalized().col[2]) * field.strength
        if field.noise:
            gusts = int(field.seed)
    if not blown.any():
        return {}
    return {"wind": to_simulation(blown, 1.0).tolist(), **({} if gusts is None else {"gusts": gusts})}


def frame_rate(scene: bpy.types.Scene) -> float:
    """Frames per second [1/s] of the scene."""
    return scene.render.fps / scene.render.fps_base


def frame_range(scene: bpy.types.Scene) -> range:
    """Frames that are simulated.

    Raises:
        PlainError: there is none.
    """
    settings = scene.pb4u
    start, end = scene.frame_start, scene.frame_end
    if settings.own_range:
        start, end = settings.frame_start, settings.frame_end
    if end < start:
        raise PlainError(f"The frame range {start} to {end} is empty; set an end that is not before the start.")
    return range(start, end + 1)


def garment_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Objects of the garments, inner first.

    Raises:
        PlainError: there is none, one is worn twice, or one cannot be simulated.
    """
    entries = [entry for entry in scene.pb4u.garments if entry.object is not None]
    found = [entry.object for entry in entries]
    if not found:
        raise PlainError("No garment is chosen: select its mesh and press + in the pb4u panel.")
    for number, each in enumerate(found):
        if each in found[:number]:
            raise PlainError(f"{each.name} is in the list of garments twice; remove one of them.")
        _require_mesh(each)
        _require_modifiers(each)
    return found


def body_objects(scene: bpy.types.Scene, garments: list[bpy.types.Object]) -> list[bpy.types.Object]:
    """Meshes of the body: the one chosen, or all that the chosen armature moves, garments left out.

    Raises:
        PlainError: none is chosen, or it has no mesh that can be used.
    """
    chosen = scene.pb4u.body
    if chosen is None:
        raise PlainError("There is no body: choose the mesh or the armature that wears the garments in the pb4u panel.")
    if chosen in garments:
        raise PlainError(f"{chosen.name} is both body and garment; choose another body, or take it off the list.")
    if chosen.type != "ARMATURE":
        _require_mesh(chosen)
        return [chosen]
    worn = [each for each in scene.objects if each not in garments and _is_moved_by(each, chosen)]
    moved = [each for each in worn if each.visible_get()]
    if not moved:
        hidden = " that is not hidden" if worn else ""
        raise PlainError(f"The armature {chosen.name} moves no mesh{hidden}; choose the mesh of the body instead.")
    for each in moved:
        _require_mesh(each)
    return moved


def _is_moved_by(mesh: bpy.types.Object, armature: bpy.types.Object) -> bool:
    moved = mesh.parent == armature or any(m.type == "ARMATURE" and m.object == armature for m in mesh.modifiers)
    return mesh.type == "MESH" and moved and bool(mesh.data.polygons)


def _require_mesh(each: bpy.types.Object) -> None:
    if each.type != "MESH":
        raise PlainError(f"{each.name} is no mesh; convert it with Object > Convert > Mesh.")
    if each.mode == "EDIT":
        each.update_from_editmode()
    if not each.data.polygons and not each.modifiers:
        raise PlainError(f"{each.name} has no faces, so there is nothing to simulate.")
    if not each.visible_get():
        raise PlainError(f"{each.name} is hidden, and Blender does not compute what is hidden; show it.")
    turn = np.array(each.matrix_world)[:3, :3]
    size = float(np.linalg.det(turn))
    if size < 0:
        raise PlainError(f"{each.name} is mirrored by a negative scale; apply it with Object > Apply > Scale.")
    if size == 0:
        raise PlainError(f"{each.name} is scaled to nothing; give it a scale other than 0.")


def cache_place(each: bpy.types.Object) -> int:
    """Index in the stack at which the result is played: where it is already, or before what only shapes the look."""
    names = [modifier.name for modifier in each.modifiers]
    if MODIFIER in names:
        return names.index(MODIFIER)
    return next((k for k, modifier in enumerate(each.modifiers) if modifier.type in LOOKS), len(names))


def _require_modifiers(each: bpy.types.Object) -> None:
    """Refuse modifiers that would move the cloth a second time."""
    place = cache_place(each)
    for k, modifier in enumerate(each.modifiers):
        if modifier.name == MODIFIER or not (modifier.show_viewport or modifier.show_render):
            continue
        if modifier.type in _SIMULATED_IN_BLENDER:
            raise PlainError(
                f"{each.name}: the modifier {modifier.name} simulates the cloth in Blender as well; remove it or turn "
                "it off."
            )
        if k > place and modifier.type not in LOOKS | _NEUTRAL:
            above = each.modifiers[place].name
            raise PlainError(
                f"{each.name}: the modifier {modifier.name} comes after the cloth and would move it a second time; "
                f"drag it above {above}, or turn it off."
            )


def shaping_modifiers(each: bpy.types.Object) -> list[str]:
    """Names of the modifiers after the cloth, which are not simulated."""
    place = cache_place(each)
    return [m.name for k, m in enumerate(each.modifiers) if k >= place and m.name != MODIFIER and m.show_viewport]


@contextmanager
def _up_to_the_cloth(objects: list[bpy.types.Object]) -> Iterator[None]:
    """The garments as they are before the simulation: without the modifiers from its place on."""
    hidden = [m for each in objects for m in each.modifiers[cache_place(each) :] if m.show_viewport]
    for modifier in hidden:
        modifier.show_viewport = False
    try:
        yield
    finally:
        for modifier in hidden:
            modifier.show_viewport = True


def bake_garments(context: bpy.types.Context, objects: list[bpy.types.Object], frame: int) -> list[BakedGarment]:
    """The garments at a frame, with all modifiers above the cloth.

    Args:
        context: whose scene it is.
        objects: of the garments.
        frame: of the scene.

    Raises:
        PlainError: one has no faces, or its vertex group is gone.
    """
    scene = context.scene
    groups = {entry.object: entry.pins for entry in scene.pb4u.garments}
    with _kept_frame(scene), _up_to_the_cloth(objects):
        scene.frame_set(frame)
        depsgraph = context.evaluated_depsgraph_get()
        return [_bake_garment(each, depsgraph, groups[each], metres_per_unit(scene)) for each in objects]


def _bake_garment(each: bpy.types.Object, depsgraph: bpy.types.Depsgraph, group: str, metres: float) -> BakedGarment:
    evaluated = each.evaluated_get(depsgraph)
    mesh = evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
    try:
        if not len(mesh.polygons):
            raise PlainError(f"{each.name} has no faces, so there is nothing to simulate.")
        corners = np.empty(len(mesh.loops), dtype=np.int32)
        mesh.loops.foreach_get("vertex_index", corners)
        sizes = np.empty(len(mesh.polygons), dtype=np.int32)
        mesh.polygons.foreach_get("loop_total", sizes)
        polygons = np.split(corners.astype(np.int64), np.cumsum(sizes)[:-1])
        pins = None
        if group:
            if group not in each.vertex_groups:
                raise PlainError(f"{each.name} has no vertex group {group}; choose its pins anew.")
            number = each.vertex_groups[group].index
            pins = np.array(
                [v.index for v in mesh.vertices if any(g.group == number and g.weight >= _PINNED for g in v.groups)],
                dtype=np.int64,
            )
            if not len(pins):
                raise PlainError(f"{each.name}: no vertex has a weight of {_PINNED:g} or more in the group {group}.")
        vertices = to_simulation(_world(mesh, evaluated), metres)
    finally:
        evaluated.to_mesh_clear()
    return BakedGarment(each.name, vertices, polygons, pins, len(each.data.vertices))


def bake_motion(
    context: bpy.types.Context, bodies: list[bpy.types.Object], garments: list[bpy.types.Object], frames: range
) -> tuple[BakedBody, np.ndarray]:
    """The bodies over the frames, and where the garments' objects stand meanwhile.

    Args:
        context: whose scene it is.
        bodies: meshes that are joined into one body.
        garments: objects of the garments.
        frames: of the scene.

    Returns:
        The body, and matrices (garments, frames, 4, 4) from each garment's own coordinates to the world.

    Raises:
        PlainError: a body changes its number of vertices.
    """
    scene, window = context.scene, context.window_manager
    metres = metres_per_unit(scene)
    rows: list[np.ndarray] = []
    counts: list[int] = []
    faces = np.zeros((0, 3), dtype=np.int64)
    matrices = np.empty((len(garments), len(frames), 4, 4))
    window.progress_begin(0, len(frames))
    with _kept_frame(scene):
        for t, frame in enumerate(frames):
            scene.frame_set(frame)
            depsgraph = context.evaluated_depsgraph_get()
            shown = [_evaluated_surface(each, depsgraph, with_faces=t == 0) for each in bodies]
            if t == 0:
                counts = [len(points) for points, _ in shown]
                starts = np.cumsum([0, *counts])
                faces = np.concatenate([own + start for (_, own), start in zip(shown, starts, strict=False)])
            for each, (points, _), count in zip(bodies, shown, counts, strict=True):
                if len(points) != count:
                    raise PlainError(
                        f"{each.name} has {count} vertices at frame {frames[0]} and {len(points)} at frame {frame}; "
                        "turn off the modifier that adds or removes them."
                    )
            rows.append(to_simulation(np.concatenate([points for points, _ in shown]), metres).astype(np.float32))
            for k, each in enumerate(garments):
                matrices[k, t] = np.array(each.evaluated_get(depsgraph).matrix_world)
            window.progress_update(t)
    window.progress_end()
    if not len(faces):
        raise PlainError(f"{bodies[0].name} has no faces, so cloth would fall through it.")
    return BakedBody(np.stack(rows), faces), matrices


def _evaluated_surface(
    each: bpy.types.Object, depsgraph: bpy.types.Depsgraph, with_faces: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (vertices, 3) in the world and triangles (faces, 3), of all modifiers, armatures and shape keys."""
    evaluated = each.evaluated_get(depsgraph)
    mesh = evaluated.to_mesh()
    try:
        faces = np.zeros((0, 3), dtype=np.int64)
        if with_faces:
            mesh.calc_loop_triangles()
            corners = np.empty(3 * len(mesh.loop_triangles), dtype=np.int32)
            mesh.loop_triangles.foreach_get("vertices", corners)
            faces = corners.reshape(-1, 3).astype(np.int64)
        return _world(mesh, evaluated), faces
    finally:
        evaluated.to_mesh_clear()


def _world(mesh: bpy.types.Mesh, evaluated: bpy.types.Object) -> np.ndarray:
    """Vertices (vertices, 3) float64 of an evaluated mesh in the world."""
    points = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", points)
    matrix = np.array(evaluated.matrix_world)
    return points.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


@contextmanager
def _kept_frame(scene: bpy.types.Scene) -> Iterator[None]:
    frame, part = scene.frame_current, scene.frame_subframe
    try:
        yield
    finally:
        scene.frame_set(frame, subframe=part)
