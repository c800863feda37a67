"""Makes a Scene of a run: body, motion and garments loaded, fitted and placed."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.body_model import PosedBody, ShapedBody
from pb4u.body.character import Character, PosedCharacter
from pb4u.body.library import load_body
from pb4u.body.smpl import read_contact
from pb4u.body.vertex_sequence import VertexSequence
from pb4u.collision.remeshing import remesh
from pb4u.errors import InputError, InputWarning, unknown_name
from pb4u.garment.corrected_placement import CorrectedPlacement
from pb4u.garment.diagnosis import require_fine, require_near, require_worn
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.garment.dressing import AttachedPlacement, Placement, SkinnedPlacement
from pb4u.garment.fit import RestBody
from pb4u.garment.garment import Garment, SourceMap
from pb4u.garment.garment_file import nearest_places, read_garment
from pb4u.garment.layering import layered, worn_order
from pb4u.garment.library import SEWN, build_garment, garment_names
from pb4u.garment.limbs_inside import with_limbs_inside
from pb4u.garment.material import Material, load_material
from pb4u.garment.pins import resolve_pins
from pb4u.garment.repair import push_out
from pb4u.garment.support import Support, find_support
from pb4u.garment.tacks import tacked
from pb4u.geometry.appearance import read_image
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.motion.character_lead_in import character_lead_in
from pb4u.motion.lead_in import lead_in as prepend_lead_in
from pb4u.motion.library import load_motion
from pb4u.motion.motion import Motion
from pb4u.motion.steadying import CUTOFF
from pb4u.run import Run, WornGarment, entries
from pb4u.scene.scene import DressedGarment, Scene

if TYPE_CHECKING:
    from pb4u.compat.recording_as_released import RecordingAsItIs

DEFAULT_FRAMES = 60
"""Frames written of a motion without end by default: two seconds at 30 frames per second."""

DEFAULT_MOTION = "walk"
DEFAULT_MATERIAL = "default"

GarmentChoice: TypeAlias = str | Path | Garment | WornGarment


def make_scene(
    garment: GarmentChoice | Sequence[GarmentChoice] = WornGarment.garment,
    body: str | Path | ShapedBody | AnimatedBody = Run.body,
    motion: str | Path | Motion | None = None,
    **options: Any,
) -> Scene:
    """Garments on a moving body, ready to simulate.

    Names, paths and loaded objects are taken alike.

    Args:
        garment: built-in name, mesh file, Garment fitted to this body at rest, or WornGarment; of several, a list,
            inner first.
        body: built-in name, model or sequence file, or a body already loaded.
        motion: built-in name, file or Motion; default "walk". A body that is a sequence of vertices brings its own.
        options: fields of `Run` on the scene by name, such as body_shape, frames, lead_in, crop, fps, arms_away, seed;
            and triangles, material and pins of the garments, one for all or a list with one each, which hold where a
            WornGarment leaves them open.

    Raises:
        InputError: anything cannot be used, or what is given with a loaded object conflicts with it.

    Warns:
        InputWarning: the body does not perform the motion, nothing holds a garment up that comes from a file and is
            given without pins, or skin may show through a garment that is coarse for the body.
    """
    known = ("material", "pins", "triangles", *entries("scene"))
    for option in options:
        if option not in known:
            raise unknown_name("option of a scene", option, known)
    named: Sequence[Any] = garment if isinstance(garment, list | tuple) else [garment]
    worn = tuple(each if isinstance(each, WornGarment) else WornGarment(each) for each in named)
    open_ = {name: options.pop(name) for name in ("material", "pins", "triangles") if options.get(name) is not None}
    options = {name: value for name, value in options.items() if value is not None}
    run = Run(worn, body=body, motion=motion, **options)
    filled = run.with_entries(open_)
    kept = [
        replace(after, **{name: getattr(given, name) for name in open_ if getattr(given, name) is not None})
        for given, after in zip(worn, filled.garments, strict=True)
    ]
    return build_scene(replace(run, garments=tuple(kept)))


def build_scene(run: Run) -> Scene:
    """Scene of a run, everything in it loaded.

    Args:
        run: names, paths or loaded objects that the scene is made of; its options are not looked at.

    Raises:
        InputError: anything cannot be used, or what is given with a loaded object conflicts with it.

    Warns:
        InputWarning: as `make_scene` does.
    """
    recording = _recording(run) if run.as_recorded else None
    body = _load_body(run, recording)
    if isinstance(body, ShapedBody):
        performance = _perform(body, run) if recording is None else _replay(body, recording, run)
    else:
        performance = _play(body, run)
    collider, frames, lead_in, notes = performance.body, performance.frames, run.lead_in, performance.notes
    garments, specified = _load_garments(run.garments, body, run.as_recorded)
    places = layered(garments, RestBody.of(body)) if len(garments) > 1 else (None,)
    dressed = [
        DressedGarment(each, _placement(each, collider, worn)) for each, worn in zip(garments, places, strict=True)
    ]
    if run.keep_lead_in and lead_in:
        notes = (*notes, f"The first {lead_in} frames lead from the rest pose into the motion.")
        frames, lead_in = lead_in + frames, 0
    sources = [str(each.garment) if isinstance(each.garment, str | Path) else None for each in specified]
    return Scene(
        garments=tuple(dressed),
        colliders=(collider,),
        frames=frames,
        lead_in=lead_in,
        fps=run.fps,
        # A recording that is played as it is stands at whatever height it has.
        ground_height=Scene.ground_height if recording is None else None,
        seed=run.seed,
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
    specified: Sequence[WornGarment], body: ShapedBody | VertexSequence, as_recorded: bool
) -> tuple[list[Garment], list[WornGarment]]:
    """The garments, pinned, and how each was specified, in the order they are worn, inner first."""
    garments = []
    for each in specified:
        garment = load_garment(each, body)
        if each.texture is not None:
            garment = garment.with_texture(read_image(Path(each.texture)))
        # A recording is replayed as its authors did, on the meshes that they did it with.
        require_fine(garment, body, accepted=as_recorded or _is_own_count(each, garment))
        garments.append(garment if each.pins is None else garment.with_pins(resolve_pins(each.pins, garment)))
    order = worn_order(garments, [each.tucked for each in specified])
    return [garments[k] for k in order], [specified[k] for k in order]


def _is_own_count(worn: WornGarment, garment: Garment) -> bool:
    """Whether the user wants just as many triangles as the garment was made with."""
    is_built_in = str(worn.garment) in garment_names()
    return worn.triangles == garment.triangle_count and garment.is_authors_mesh and not is_built_in


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


def _recording(run: Run) -> RecordingAsItIs:
    motion = run.motion
    if not isinstance(motion, str | Path) or not Path(motion).suffix:
        raise InputError("To play a recording as recorded, give its file as the motion: a .pkl or .npz of SMPL.")
    kind: type[RecordingAsItIs] = resolve_name("pb4u.compat.recording_as_released:RecordingAsItIs")
    return kind(Path(motion), run.crop, run.arms_away)


def _load_body(run: Run, recording: RecordingAsItIs | None = None) -> ShapedBody | VertexSequence:
    body = _shaped_body(run, {} if recording is None else recording.shape)
    if run.omitted is None:
        return body
    return body.with_contact(read_contact(Path(run.omitted), len(body.contact)))


def _shaped_body(run: Run, shape: Mapping[str, float]) -> ShapedBody | VertexSequence:
    """The body with the `shape` that its recording says, and over it that of the run."""
    body = run.body
    if shape and not (isinstance(body, str | Path) and Path(body).suffix):
        raise InputError(
            f"A recording is played as recorded on an SMPL body, given as a model file; {body} has another skeleton."
        )
    if isinstance(body, str | Path):
        parts = None if run.body_parts is None else [part.strip() for part in run.body_parts.split(",")]
        return load_body(body, {**shape, **run.body_shape}, clip=run.clip, parts=parts)
    if not isinstance(body, ShapedBody | VertexSequence):
        raise InputError("A moving body must be a shaped body or a vertex sequence.")
    if run.body_shape:
        raise InputError(f"{body.name} is a body already loaded, with its shape; give body_shape to load_body instead.")
    return body


def _perform(body: ShapedBody, run: Run) -> _Performance:
    """A body with bones performs a motion; a character its own clip, where no motion is given."""
    if isinstance(body, Character):
        for note in body.notes:
            _say(note)
        if run.motion is None and (body.clip is not None or not body.is_human):
            return _perform_clip(body, run)
        if not body.is_human:
            raise InputError(
                f"{body.name} performs its own clips alone: its bones are not a human's; leave out --motion."
            )
    if isinstance(body, Character) and run.clip is not None:
        raise InputError(f"{body.name} performs either its clip {run.clip} or --motion; leave one out.")
    clip, name = _load_motion(run)
    frames = _frames(run, name, clip.available_frames(run.fps))
    poses, more = clip.perform(body, run.fps, frames)
    notes = (*clip.notes, *more)
    for note in notes:
        _say(note)
    return _Performance(body.posed(prepend_lead_in(poses, body, run.lead_in)), frames, name, notes)


def _perform_clip(body: Character, run: Run) -> _Performance:
    """A character performs its own clip; one that has none stands."""
    _refuse_changes(run, f"{body.name} performs its own clip", "change the clip in its file")
    name = "stand" if body.clip is None else body.clip.name
    if run.clip is None and len(body.clip_names) > 1:
        _say(f"{body.name} performs {name}, the first of its clips {', '.join(body.clip_names[:10])}; --clip chooses.")
    available = run.frames or DEFAULT_FRAMES if body.clip is None else body.available_frames(run.fps)
    poses = character_lead_in(body, body.clip_poses(run.fps, available), run.fps, run.lead_in)
    return _Performance(PosedCharacter(body, poses, run.fps), _frames(run, name, available), name, body.notes)


def _replay(body: ShapedBody, recording: RecordingAsItIs, run: Run) -> _Performance:
    """A body with bones plays its recording, nothing changed."""
    poses = recording.led_in(body, run.fps, run.lead_in)
    frames = _frames(run, recording.name, recording.available_frames(run.fps))
    return _Performance(body.posed(poses), frames, str(run.motion))


def _load_motion(run: Run) -> tuple[Motion, str]:
    motion = DEFAULT_MOTION if run.motion is None else run.motion
    if isinstance(motion, str | Path):
        away, seed = run.arms_away, run.seed
        clip = load_motion(
            motion, run.crop, seed=seed, arms_away_degrees=away, raw=run.raw_motion, recorded_fps=run.recorded_fps
        )
        return clip, str(motion)
    if not isinstance(motion, Motion):
        raise InputError(f"The motion must be a name, a path or a Motion, not {motion!r}.")
    _refuse_changes(run, f"{motion.name} is a motion already loaded", "give it to load_motion")
    return motion, motion.name


def _play(body: VertexSequence, run: Run) -> _Performance:
    """A sequence moves by itself; it starts in the pose that garments are fitted to: neither cut nor posed."""
    motion, by_itself = run.motion, f"{body.name} is a sequence of vertices that moves by itself"
    _refuse_changes(run, by_itself, "change the sequence where it comes from")
    if motion is not None:
        ignored = motion if isinstance(motion, str | Path) else motion.name
        _say(f"{by_itself}; the motion {ignored} is not used.")
    if body.from_video and not run.raw_motion:
        _say(
            f"{body.name}: from a video, so what is faster than {CUTOFF:g} Hz is smoothed out; --raw-motion leaves it."
        )
        body = body.smoothed(CUTOFF)
    # A body that never moves has no end: it stands for as long as wanted.
    standing = (run.frames or DEFAULT_FRAMES) - 1 if body.frame_count == 1 else 0
    held = body.resampled(run.fps).with_held_start(run.lead_in + standing)
    return _Performance(held, _frames(run, body.name, held.frame_count - run.lead_in), body.name)


def _refuse_changes(run: Run, why: str, mend: str) -> None:
    """Refuse options that change a motion where none is loaded from a file."""
    for option in ("crop", "arms_away"):
        if getattr(run, option) is not None:
            raise InputError(f"{why}, so --{option.replace('_', '-')} cannot be applied; {mend}.")


def _frames(run: Run, name: str, available: int | None) -> int:
    """Frames to write; warns where there are fewer than wanted."""
    if run.frames is None:
        return available or DEFAULT_FRAMES
    if available is not None and run.frames > available:
        there = f"{run.frames} are wanted, {available} are there"
        _say(f"{name} ends after {available} frames at {run.fps:g} fps; {there}.")
        return available
    return run.frames


def load_garment(worn: WornGarment, body: ShapedBody | VertexSequence) -> Garment:
    """The garment in its material, without the pins of the worn.

    Args:
        worn: which garment, in what material and at how many triangles.
        body: who wears it.

    Raises:
        InputError: it cannot be read, or does not fit.
    """
    garment, triangles = worn.garment, worn.triangles
    if isinstance(garment, Garment):
        require_near(garment, body)
        cloth = garment.material if worn.material is None else _load_material(worn.material)
        own = tacked(_remeshed(garment, triangles), worn.tacks).with_material(cloth)
        return own if garment.skinning is not None else with_limbs_inside(own, body)
    if not isinstance(garment, str | Path):
        raise InputError(f"The garment must be a name, a path or a Garment, not {garment!r}.")
    cloth = _load_material(worn.material or DEFAULT_MATERIAL)
    entry = DictionaryEntry.parse(garment)
    if entry is not None:
        read = resolve_name("pb4u.compat.garment_dictionary:read_dictionary_garment")
        return _worn(tacked(_remeshed(read(entry, cloth), triangles), worn.tacks), body)
    if loader := SEWN.get(Path(garment).suffix.lower()):
        loaded = tacked(resolve_name(loader)(Path(garment), body, cloth, triangles), worn.tacks)
        return _held(loaded, body)[0] if worn.pins is None else loaded
    if Path(garment).suffix:
        loaded = read_garment(Path(garment), cloth, triangles=triangles)
        if triangles is not None:
            loaded = _outside_as_made(loaded, RestBody.of(body))
        loaded = tacked(loaded, worn.tacks)
        support = None
        if worn.pins is None:
            loaded, support = _held(loaded, body)
        require_worn(loaded, body, garment, None if loaded.pinned.any() else support)
        return with_limbs_inside(loaded, body)
    if not isinstance(body, ShapedBody):
        near = ", ".join(garment_names())
        raise InputError(
            f"The built-in garments ({near}) are cut from a body with bones; {body.name} is a sequence of vertices: "
            "give the garment as a mesh file that fits its first frame."
        )
    options = {} if triangles is None else {"triangles": triangles}
    return tacked(build_garment(str(garment), body, **options), worn.tacks).with_material(cloth)


def _worn(garment: Garment, body: ShapedBody | VertexSequence) -> Garment:
    """A garment of a dictionary, which stands where SMPL's own origin is, at the height of the body that wears it."""
    if isinstance(body, ShapedBody):
        garment = replace(garment, vertices=garment.vertices + np.array([0.0, body.lift, 0.0]))
        if garment.skinning is not None and garment.skinning.bone_count == body.skeleton.bone_count:
            return garment  # its file says how this body wears it
    places, faces = garment.vertices, garment.faces
    support = None if garment.pinned.any() else find_support(places, faces, RestBody.of(body))
    require_worn(garment, body, garment.name, support)
    return garment


def _outside_as_made(garment: Garment, body: RestBody) -> Garment:
    """A remeshed garment out of the body, where its author's mesh is: the chords of a coarser one dip into the skin."""
    source = garment.source
    if source is None or not body.is_closed or (body.signed_distances(source.source.vertices) < 0.0).any():
        return garment
    if (body.signed_distances(garment.vertices) >= 0.0).all():
        return garment
    return replace(garment, vertices=push_out(garment.vertices, garment.topology, body))


def _held(garment: Garment, body: ShapedBody | VertexSequence) -> tuple[Garment, Support]:
    """The garment, pinned by what was found to hold it, and that."""
    support = find_support(garment.vertices, garment.faces, RestBody.of(body))
    if support.held is None:
        return garment, support
    _say(
        f"{garment.name}: its {support.name}, {int(support.held.sum())} vertices, was found and holds it; --pins "
        "none lets it go."
    )
    return garment.with_pins(support.held), support


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
    if garment.rest_uv is not None:
        raise InputError(
            f"{garment.name} is sewn of flat panels, and is not remeshed as it hangs; dress its pattern with "
            f"{triangles} triangles."
        )
    vertices, faces = remesh(garment.vertices, garment.faces, triangles)
    uv_faces = None if garment.uv_faces is None else tuple(garment.uv_faces)
    simulated = PolygonMesh(garment.vertices, tuple(garment.faces), garment.uvs, uv_faces, garment.appearances)
    places = nearest_places(simulated.vertices, vertices, faces)
    own = garment.skinning
    if own is not None:
        triangle, barycentric = nearest_places(vertices, garment.vertices, garment.faces)
        own = own.at(garment.faces[triangle], barycentric)
    remeshed = replace(
        garment, vertices=vertices, faces=faces, pinned=np.zeros(len(vertices), dtype=bool), uvs=None, uv_faces=None,
        appearances=None, source=SourceMap(simulated, *places), coarse_edges=(), skinning=own,
    )  # fmt: skip
    if garment.pinned.any():
        remeshed = remeshed.with_pins(resolve_pins(np.flatnonzero(garment.pinned), remeshed))
    if garment.source is None:
        return remeshed
    author = garment.source.source
    return replace(remeshed, source=SourceMap(author, *nearest_places(author.vertices, vertices, faces)))


def _say(sentence: str) -> None:
    warnings.warn(sentence, InputWarning, stacklevel=3)
