"""Makes a Scene of its specification: body, motion and garments loaded, fitted and placed."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import TypeAlias

import numpy as np

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.body_model import PosedBody, ShapedBody
from pb4u.body.library import load_body
from pb4u.body.smpl import read_contact
from pb4u.body.vertex_sequence import VertexSequence
from pb4u.errors import InputError, InputWarning
from pb4u.garment.corrected_placement import CorrectedPlacement
from pb4u.garment.diagnosis import require_fine, require_worn
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.garment.dressing import AttachedPlacement, Placement, SkinnedPlacement
from pb4u.garment.fit import RestBody, find_holder
from pb4u.garment.garment import Garment, SourceMap
from pb4u.garment.garment_dictionary import read_dictionary_garment
from pb4u.garment.garment_file import nearest_places, read_garment
from pb4u.garment.layering import layered, worn_order
from pb4u.garment.library import SEWN, build_garment, garment_names
from pb4u.garment.material import Material, load_material
from pb4u.garment.pins import resolve_pins
from pb4u.garment.repair import push_out
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.remeshing import remesh
from pb4u.motion.as_recorded import RecordingAsItIs
from pb4u.motion.lead_in import lead_in as prepend_lead_in
from pb4u.motion.library import load_motion
from pb4u.motion.motion import Motion
from pb4u.scene.scene import DressedGarment, Scene
from pb4u.scene.specification import GarmentSpecification, SceneSpecification

DEFAULT_FRAMES = 60
"""Frames written of a motion without end when none are asked for: two seconds at 30 frames per second."""

DEFAULT_MOTION = "walk"
DEFAULT_MATERIAL = "default"

GarmentChoice: TypeAlias = str | Path | Garment | GarmentSpecification
MaterialChoice: TypeAlias = str | Path | Material | None
PinChoice: TypeAlias = str | Path | Sequence[int] | None


def make_scene(
    garment: GarmentChoice | Sequence[GarmentChoice] = GarmentSpecification.garment,
    body: str | Path | ShapedBody | AnimatedBody = SceneSpecification.body,
    motion: str | Path | Motion | None = None,
    *,
    triangles: int | Sequence[int | None] | None = None,
    material: MaterialChoice | Sequence[MaterialChoice] = None,
    pins: PinChoice | Sequence[PinChoice] = None,
    body_shape: Mapping[str, float] | None = None,
    frames: int | None = None,
    lead_in: int = SceneSpecification.lead_in,
    keep_lead_in: bool = SceneSpecification.keep_lead_in,
    crop: tuple[int, int] | None = None,
    fps: float = SceneSpecification.fps,
    arms_away: float | None = SceneSpecification.arms_away,
    seed: int = SceneSpecification.seed,
) -> Scene:
    """Garments on a moving body, ready to simulate.

    Names, paths and loaded objects are taken alike. `triangles`, `material` and `pins` are one for all garments, or a
    list with one for each; they hold where a GarmentSpecification leaves them open.

    Args:
        garment: built-in name, mesh file, Garment fitted to this body at rest, or GarmentSpecification; of several, a
            list, inner first.
        body: built-in name, model or sequence file, or a body already loaded.
        motion: built-in name, file or Motion; default "walk". A body that is a sequence of vertices brings its own.
        triangles: number of triangles to simulate; default the garment's own.
        material: built-in name, JSON file or Material; default that of a loaded Garment, else "default".
        pins: name, boundary loop, file or indices of vertices that follow the body; default the garment's own.
        body_shape: shape parameters of the body, see `pb4u assets`.
        frames: frames to write; default the whole recording, or 60 of a motion without end.
        lead_in: frames simulated before the first written one, from the rest pose into the motion.
        keep_lead_in: write those frames as well, before the `frames` asked for.
        crop: (first, stop) frames of a recording, counted at its own rate.
        fps: frames per second of the simulation [1/s].
        arms_away: degrees by which hanging arms are held away from the torso; default: arms of a recording by as much
            as they would go into the body.
        seed: seed of procedural motion and of everything random.

    Raises:
        InputError: anything cannot be used, or what is given with a loaded object conflicts with it.

    Warns:
        InputWarning: the body does not perform the motion, nothing holds a garment up that comes from a file and is
            given without pins, or skin may show through a garment that is coarse for the body.
    """
    specification = SceneSpecification(
        garments=_specified(garment, triangles, material, pins),
        body=body,
        body_shape=body_shape or {},
        motion=motion,
        frames=frames,
        lead_in=lead_in,
        keep_lead_in=keep_lead_in,
        crop=crop,
        fps=fps,
        arms_away=arms_away,
        seed=seed,
    )
    return assemble(specification)


def assemble(specification: SceneSpecification) -> Scene:
    """Scene of a specification, everything in it loaded.

    Args:
        specification: names, paths or loaded objects that the scene is made of.

    Raises:
        InputError: anything cannot be used, or what is given with a loaded object conflicts with it.

    Warns:
        InputWarning: as `make_scene` does.
    """
    recording = _recording(specification) if specification.as_recorded else None
    body = _load_body(specification, recording)
    if isinstance(body, ShapedBody):
        performance = _perform(body, specification) if recording is None else _replay(body, recording, specification)
    else:
        performance = _play(body, specification)
    collider, frames, lead_in, notes = performance.body, performance.frames, specification.lead_in, performance.notes
    garments, specified = _load_garments(specification.garments, body)
    places = layered(garments, RestBody.of(body)) if len(garments) > 1 else (None,)
    dressed = [
        DressedGarment(each, _placement(each, collider, worn)) for each, worn in zip(garments, places, strict=True)
    ]
    if specification.keep_lead_in and lead_in:
        notes = (*notes, f"The first {lead_in} frames lead from the rest pose into the motion.")
        frames, lead_in = lead_in + frames, 0
    sources = [str(each.garment) if isinstance(each.garment, str | Path) else None for each in specified]
    return Scene(
        garments=tuple(dressed),
        colliders=(collider,),
        frames=frames,
        lead_in=lead_in,
        fps=specification.fps,
        # A recording that is played as it is stands at whatever height it has.
        ground_height=Scene.ground_height if recording is None else None,
        seed=specification.seed,
        labels={
            "garment": "+".join(each.garment.name for each in dressed),
            "sources": sources,
            "body": collider.name,
            "body_shape": dict(body.shape) if isinstance(body, ShapedBody) else {},
            "motion": performance.motion,
        },
        notes=notes,
    )


def _load_garments(
    specified: Sequence[GarmentSpecification], body: ShapedBody | VertexSequence
) -> tuple[list[Garment], list[GarmentSpecification]]:
    """The garments, pinned, and their specifications in the order they are worn, inner first."""
    garments = []
    for each in specified:
        garment = _load_garment(each, body)
        require_fine(garment, body)
        garments.append(garment if each.pins is None else garment.with_pins(resolve_pins(each.pins, garment)))
    order = worn_order(garments, [each.tucked for each in specified])
    return [garments[k] for k in order], [specified[k] for k in order]


def _specified(
    garment: GarmentChoice | Sequence[GarmentChoice],
    triangles: int | Sequence[int | None] | None,
    material: MaterialChoice | Sequence[MaterialChoice],
    pins: PinChoice | Sequence[PinChoice],
) -> tuple[GarmentSpecification, ...]:
    worn = garment if isinstance(garment, list | tuple) else [garment]
    # Whole numbers in a list are the indices of one choice of pins.
    chosen_pins = [pins] * len(worn) if isinstance(pins, list | tuple) and _all_whole(pins) else pins
    columns = [
        _one_each(name, value, len(worn))
        for name, value in (("triangles", triangles), ("material", material), ("pins", chosen_pins))
    ]
    specified = []
    for each, count, cloth, pinned in zip(worn, *columns, strict=True):
        given = each if isinstance(each, GarmentSpecification) else GarmentSpecification(each)
        specified.append(
            replace(
                given,
                triangles=count if given.triangles is None else given.triangles,
                material=cloth if given.material is None else given.material,
                pins=pinned if given.pins is None else given.pins,
            )
        )
    return tuple(specified)


def _all_whole(values: Sequence[object]) -> bool:
    return all(isinstance(value, int | np.integer) for value in values)


def _one_each(what: str, value: object, count: int) -> Sequence:
    if not isinstance(value, list | tuple):
        return [value] * count
    if len(value) != count:
        raise InputError(f"The list for {what} has {len(value)} entries for {count} garments; give one each.")
    return value


@dataclass(frozen=True, eq=False)
class _Performance:
    """A body in motion.

    Args:
        body: the moving body, lead-in included.
        frames: frames that are there to write.
        motion: name of what it performs.
        notes: plain sentences on what was changed or ignored.
    """

    body: AnimatedBody
    frames: int
    motion: str
    notes: tuple[str, ...] = ()


def _placement(garment: Garment, collider: AnimatedBody, worn: np.ndarray | None) -> Placement:
    """The garment on the moving body, at `worn` (vertices, 3) [m] where it lies over others."""
    if not isinstance(collider, PosedBody):
        return AttachedPlacement(garment, collider, worn)
    if worn is None and CorrectedPlacement.fits(garment.skinning, collider):
        return CorrectedPlacement(garment, collider)
    return SkinnedPlacement(garment, collider, worn=worn)


def _recording(specification: SceneSpecification) -> RecordingAsItIs:
    motion = specification.motion
    if not isinstance(motion, str | Path) or not Path(motion).suffix:
        raise InputError("To play a recording as recorded, give its file as the motion: a .pkl or .npz of SMPL.")
    return RecordingAsItIs(Path(motion), specification.crop, specification.arms_away)


def _load_body(
    specification: SceneSpecification, recording: RecordingAsItIs | None = None
) -> ShapedBody | VertexSequence:
    body = _shaped_body(specification, {} if recording is None else recording.shape)
    if specification.omitted is None:
        return body
    return body.with_contact(read_contact(Path(specification.omitted), len(body.contact)))


def _shaped_body(specification: SceneSpecification, shape: Mapping[str, float]) -> ShapedBody | VertexSequence:
    """The body with the `shape` that its recording says, and over it what is asked for."""
    body = specification.body
    if shape and not (isinstance(body, str | Path) and Path(body).suffix):
        raise InputError(
            f"A recording is played as recorded on an SMPL body, given as a model file; {body} has another skeleton."
        )
    if isinstance(body, str | Path):
        return load_body(body, {**shape, **specification.body_shape})
    if not isinstance(body, ShapedBody | VertexSequence):
        raise InputError("A moving body must be a shaped body or a vertex sequence.")
    if specification.body_shape:
        raise InputError(f"{body.name} is a body already loaded, with its shape; give body_shape to load_body instead.")
    return body


def _perform(body: ShapedBody, specification: SceneSpecification) -> _Performance:
    """A body with bones performs a motion."""
    clip, name = _load_motion(specification)
    frames, fps = specification.frames, specification.fps
    available = clip.available_frames(fps)
    if frames is None:
        frames = available or DEFAULT_FRAMES
    elif available is not None and frames > available:
        _say_shorter(name, available, frames, fps)
        frames = available
    poses, told = clip.perform(body, fps, frames)
    notes = (*clip.notes, *told)
    for note in notes:
        _say(note)
    return _Performance(body.posed(prepend_lead_in(poses, body, specification.lead_in)), frames, name, notes)


def _replay(body: ShapedBody, recording: RecordingAsItIs, specification: SceneSpecification) -> _Performance:
    """A body with bones plays its recording, nothing changed."""
    frames, lead_in = specification.frames, specification.lead_in
    available = recording.available_frames(specification.fps) or 0
    if frames is not None and frames > available:
        _say_shorter(recording.name, available, frames, specification.fps)
    poses = recording.led_in(body, specification.fps, lead_in)
    return _Performance(body.posed(poses), min(frames or available, available), str(specification.motion))


def _load_motion(specification: SceneSpecification) -> tuple[Motion, str]:
    motion = DEFAULT_MOTION if specification.motion is None else specification.motion
    crop, arms_away = specification.crop, specification.arms_away
    if isinstance(motion, str | Path):
        return load_motion(motion, crop, seed=specification.seed, arms_away_degrees=arms_away), str(motion)
    if not isinstance(motion, Motion):
        raise InputError(f"The motion must be a name, a path or a Motion, not {motion!r}.")
    for given, option in ((crop is not None, "crop"), (arms_away is not None, "arms_away")):
        if given:
            raise InputError(
                f"{motion.name} is a motion already loaded, so {option} cannot be applied; give it to load_motion."
            )
    return motion, motion.name


def _play(body: VertexSequence, specification: SceneSpecification) -> _Performance:
    """A sequence moves by itself; it starts in the pose that garments are fitted to: neither cut nor posed anew."""
    motion, frames, fps = specification.motion, specification.frames, specification.fps
    for given, flag in ((specification.crop is not None, "crop"), (specification.arms_away is not None, "arms-away")):
        if given:
            raise InputError(
                f"{body.name} is a sequence of vertices that moves by itself, so --{flag} cannot be applied; change "
                "the sequence where it comes from."
            )
    if motion is not None:
        ignored = motion if isinstance(motion, str | Path) else motion.name
        _say(f"{body.name} is a sequence of vertices that moves by itself; the motion {ignored} is not used.")
    # A body that never moves has no end: it stands for as long as is asked.
    standing = (frames or DEFAULT_FRAMES) - 1 if body.frame_count == 1 else 0
    held = body.resampled(fps).with_held_start(specification.lead_in + standing)
    available = held.frame_count - specification.lead_in
    if frames is not None and frames > available:
        _say_shorter(body.name, available, frames, fps)
    return _Performance(held, min(frames or available, available), body.name)


def _load_garment(specification: GarmentSpecification, body: ShapedBody | VertexSequence) -> Garment:
    """The garment in its material, without the pins of the specification."""
    garment, triangles = specification.garment, specification.triangles
    if isinstance(garment, Garment):
        cloth = garment.material if specification.material is None else _load_material(specification.material)
        return _remeshed(garment, triangles).with_material(cloth)
    if not isinstance(garment, str | Path):
        raise InputError(f"The garment must be a name, a path or a Garment, not {garment!r}.")
    cloth = _load_material(specification.material or DEFAULT_MATERIAL)
    entry = DictionaryEntry.parse(garment)
    if entry is not None:
        return _worn(_remeshed(read_dictionary_garment(entry, cloth), triangles), body)
    if loader := SEWN.get(Path(garment).suffix.lower()):
        loaded = resolve_name(loader)(Path(garment), body, cloth, triangles)
        return _held(loaded, body) if specification.pins is None else loaded
    if Path(garment).suffix:
        loaded = read_garment(Path(garment), cloth, triangles=triangles)
        if triangles is not None:
            loaded = _outside_as_made(loaded, RestBody.of(body))
        if specification.pins is None:
            loaded = _held(loaded, body)
        require_worn(loaded, body, garment, pins_given=specification.pins is not None)
        return loaded
    if not isinstance(body, ShapedBody):
        near = ", ".join(garment_names())
        raise InputError(
            f"The built-in garments ({near}) are cut from a body with bones; {body.name} is a sequence of vertices: "
            "give the garment as a mesh file that fits its first frame."
        )
    options = {} if triangles is None else {"triangles": triangles}
    return build_garment(str(garment), body, **options).with_material(cloth)


def _worn(garment: Garment, body: ShapedBody | VertexSequence) -> Garment:
    """A garment of a dictionary, which stands where SMPL's own origin is, at the height of the body that wears it."""
    if isinstance(body, ShapedBody):
        garment = replace(garment, vertices=garment.vertices + np.array([0.0, body.lift, 0.0]))
        if garment.skinning is not None and garment.skinning.bone_count == body.skeleton.bone_count:
            return garment  # its file says how this body wears it
    require_worn(garment, body, garment.name, pins_given=bool(garment.pinned.any()))
    return garment


def _outside_as_made(garment: Garment, body: RestBody) -> Garment:
    """A remeshed garment out of the body, where its author's mesh is: the chords of a coarser one dip into the skin."""
    source = garment.source
    if source is None or not body.is_closed or (body.signed_distances(source.source.vertices) < 0.0).any():
        return garment
    if (body.signed_distances(garment.vertices) >= 0.0).all():
        return garment
    return replace(garment, vertices=push_out(garment.vertices, garment.topology, body))


def _held(garment: Garment, body: ShapedBody | VertexSequence) -> Garment:
    """The garment, pinned by what was found to hold it."""
    holder = find_holder(garment.vertices, garment.faces, RestBody.of(body))
    if holder is None:
        return garment
    _say(
        f"{garment.name}: its {holder.name}, {int(holder.vertices.sum())} vertices, was found and holds it; --pins "
        "none lets it go."
    )
    return garment.with_pins(holder.vertices)


def _load_material(material: str | Path | Material) -> Material:
    if isinstance(material, Material):
        return material
    if not isinstance(material, str | Path):
        raise InputError(f"The material must be a name, a path or a Material, not {material!r}.")
    return load_material(material)


def _remeshed(garment: Garment, triangles: int | None) -> Garment:
    """A loaded garment with about `triangles` triangles; exports and pins follow the mesh it had."""
    if triangles is None or triangles == garment.triangle_count:
        return garment
    vertices, faces = remesh(garment.vertices, garment.faces, triangles)
    uv_faces = None if garment.uv_faces is None else tuple(garment.uv_faces)
    simulated = PolygonMesh(garment.vertices, tuple(garment.faces), garment.uvs, uv_faces)
    places = nearest_places(simulated.vertices, vertices, faces)
    own = garment.skinning
    if own is not None:
        triangle, barycentric = nearest_places(vertices, garment.vertices, garment.faces)
        own = own.at(garment.faces[triangle], barycentric)
    remeshed = replace(
        garment, vertices=vertices, faces=faces, pinned=np.zeros(len(vertices), dtype=bool), uvs=None, uv_faces=None,
        source=SourceMap(simulated, *places), coarse_edges=(), skinning=own,
    )  # fmt: skip
    if garment.pinned.any():
        remeshed = remeshed.with_pins(resolve_pins(np.flatnonzero(garment.pinned), remeshed))
    if garment.source is None:
        return remeshed
    author = garment.source.source
    return replace(remeshed, source=SourceMap(author, *nearest_places(author.vertices, vertices, faces)))


def _say_shorter(name: str, available: int, asked: int, fps: float) -> None:
    _say(f"{name} ends after {available} frames at {fps:g} fps; {asked} were asked for, {available} are there.")


def _say(sentence: str) -> None:
    warnings.warn(sentence, InputWarning, stacklevel=3)
