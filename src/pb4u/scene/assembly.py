"""Makes a Scene from names and files: body, motion and garment loaded, fitted and placed."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.body_model import PosedBody, ShapedBody
from pb4u.body.library import load_body
from pb4u.errors import InputError, InputWarning
from pb4u.garment.diagnosis import require_worn
from pb4u.garment.dressing import AttachedPlacement, Placement, SkinnedPlacement
from pb4u.garment.garment import Garment
from pb4u.garment.garment_file import read_garment
from pb4u.garment.library import build_garment, garment_names
from pb4u.garment.material import Material, load_material
from pb4u.garment.pins import resolve_pins
from pb4u.motion.lead_in import lead_in as prepend_lead_in
from pb4u.motion.library import load_motion
from pb4u.scene.scene import DressedGarment, Scene

DEFAULT_FRAMES = 60
"""Frames written of a motion without end when none are asked for: two seconds at 30 frames per second."""

DEFAULT_MOTION = "walk"

DEFAULT_LEAD_IN = 30
"""Frames from the garment's rest pose into the motion (reference 1.9)."""


def make_scene(
    garment: str | Path | Garment = "tshirt",
    body: str | Path | ShapedBody | AnimatedBody = "woman",
    motion: str | Path | None = None,
    *,
    triangles: int | None = None,
    material: str | Path | Material = "default",
    pins: str | Path | None = None,
    body_shape: Mapping[str, float] | None = None,
    frames: int | None = None,
    lead_in: int = DEFAULT_LEAD_IN,
    keep_lead_in: bool = False,
    crop: tuple[int, int] | None = None,
    fps: float = 30.0,
    arms_away: float = 0.0,
    seed: int = 0,
) -> Scene:
    """A garment on a moving body, ready to simulate.

    Args:
        garment: built-in name, mesh file, or a Garment fitted to this body at rest.
        body: built-in name, model or sequence file, or a body already loaded.
        motion: built-in name or file; default "walk". A body that is a sequence of vertices brings its own.
        triangles: number of triangles to simulate; default the garment's own.
        material: built-in name, JSON file or Material.
        pins: name, boundary loop or file of vertices that follow the body; default the garment's own.
        body_shape: shape parameters of the body, see `pb4u assets`.
        frames: frames to write; default the whole recording, or 60 of a motion without end.
        lead_in: frames simulated before the first written one, from the rest pose into the motion.
        keep_lead_in: write those frames as well, before the `frames` asked for.
        crop: (first, stop) frames of a recording, counted at its own rate.
        fps: frames per second of the simulation.
        arms_away: degrees by which hanging arms are held away from the torso.
        seed: seed of procedural motion and of everything random.

    Raises InputError when anything cannot be used. Warns of a motion that the body does not perform, and of
    a garment from a file that is given without pins and that the shoulders do not hold up.
    """
    _check_counts(frames, lead_in, fps)
    _check_choices(seed, arms_away)
    figure = load_body(body, body_shape) if isinstance(body, str | Path) else body
    notes: list[str] = []
    collider: AnimatedBody
    if isinstance(figure, ShapedBody):
        motion_name = DEFAULT_MOTION if motion is None else str(motion)
        collider, frames = _animate(figure, motion_name, frames, lead_in, crop, fps, arms_away, seed, notes)
    else:
        _refuse_unused(figure, crop, arms_away)
        if motion is not None:
            _say(f"{figure.name} is a sequence of vertices that moves by itself; the motion {motion} is not used.")
        collider, frames = _use_sequence(figure, frames, lead_in, fps)
        motion_name = figure.name
    worn = _load_garment(
        garment,
        figure,
        triangles,
        load_material(material) if not isinstance(material, Material) else material,
        pins_given=pins is not None,
    )
    if pins is not None:
        worn = worn.with_pins(resolve_pins(str(pins), worn))
    placement: Placement = (
        SkinnedPlacement(worn, collider) if isinstance(collider, PosedBody) else AttachedPlacement(worn, collider)
    )
    if keep_lead_in and lead_in:
        notes.append(f"The first {lead_in} frames lead from the rest pose into the motion.")
        frames, lead_in = lead_in + frames, 0
    return Scene(
        garments=(DressedGarment(worn, placement),),
        colliders=(collider,),
        frames=frames,
        lead_in=lead_in,
        fps=fps,
        seed=seed,
        labels={"garment": worn.name, "body": collider.name, "motion": motion_name},
        notes=tuple(notes),
    )


def _check_counts(frames: int | None, lead_in: int, fps: float) -> None:
    if frames is not None and frames < 1:
        raise InputError(f"The number of frames must be 1 or more, not {frames}.")
    if lead_in < 0:
        raise InputError(f"The lead-in must be 0 frames or more, not {lead_in}.")
    if not 1.0 <= fps <= 1000.0:
        raise InputError(f"Frames per second must lie between 1 and 1000, not {fps:g}.")


def _check_choices(seed: int, arms_away: float) -> None:
    if seed < 0:
        raise InputError(f"The seed must be 0 or more, not {seed}.")
    if not 0.0 <= arms_away <= 90.0:
        raise InputError(f"Arms are held away by 0 to 90 degrees, not {arms_away:g}.")


def _refuse_unused(body: AnimatedBody, crop: tuple[int, int] | None, arms_away: float) -> None:
    """A sequence starts in the pose that garments are fitted to, so it is neither cut nor posed anew."""
    for given, flag in ((crop is not None, "crop"), (arms_away != 0.0, "arms-away")):
        if given:
            raise InputError(
                f"{body.name} is a sequence of vertices that moves by itself, so --{flag} cannot be applied; change "
                "the sequence where it comes from."
            )


def _animate(
    body: ShapedBody,
    motion: str,
    frames: int | None,
    lead_in: int,
    crop: tuple[int, int] | None,
    fps: float,
    arms_away: float,
    seed: int,
    notes: list[str],
) -> tuple[PosedBody, int]:
    clip = load_motion(motion, crop=crop, arms_away_degrees=arms_away, seed=seed)
    available = clip.available_frames(fps)
    if frames is None:
        frames = available or DEFAULT_FRAMES
    elif available is not None and frames > available:
        _say(f"{motion} ends after {available} frames at {fps:g} fps; {frames} were asked for, {available} are there.")
        frames = available
    poses = clip.poses(body, fps, frames)
    for note in clip.notes:
        notes.append(note)
        _say(note)
    return body.posed(prepend_lead_in(poses, body, lead_in)), frames


def _use_sequence(body: AnimatedBody, frames: int | None, lead_in: int, fps: float) -> tuple[AnimatedBody, int]:
    from pb4u.body.vertex_sequence import VertexSequence

    if not isinstance(body, VertexSequence):
        raise InputError("A moving body must be a shaped body or a vertex sequence.")
    # A body that never moves has no end: it stands for as long as is asked.
    standing = (frames or DEFAULT_FRAMES) - 1 if body.frame_count == 1 else 0
    held = body.resampled(fps).with_held_start(lead_in + standing)
    available = held.frame_count - lead_in
    if frames is not None and frames > available:
        _say(
            f"{body.name} ends after {available} frames at {fps:g} fps; {frames} were asked for, {available} are there."
        )
    return held, min(frames or available, available)


def _load_garment(
    garment: str | Path | Garment,
    body: ShapedBody | AnimatedBody,
    triangles: int | None,
    material: Material,
    pins_given: bool,
) -> Garment:
    if isinstance(garment, Garment):
        return garment
    if Path(garment).suffix:
        loaded = read_garment(Path(garment), material, triangles=triangles)
        require_worn(loaded, body, garment, pins_given=pins_given)
        return loaded
    if not isinstance(body, ShapedBody):
        near = ", ".join(garment_names())
        raise InputError(
            f"The built-in garments ({near}) are cut from a body with bones; {body.name} is a sequence of vertices: "
            "give the garment as a mesh file that fits its first frame."
        )
    options = {} if triangles is None else {"triangles": triangles}
    return build_garment(str(garment), body, **options).with_material(material)


def _say(sentence: str) -> None:
    warnings.warn(sentence, InputWarning, stacklevel=3)
