"""Makes a Scene of a run: body, motion and garments loaded, fitted and placed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from pb4u.body.animated_body import AnimatedBody
from pb4u.body.body_model import PosedBody, ShapedBody
from pb4u.environment import USUAL
from pb4u.errors import InputError, InputNote, noted, refuse_unknown, warn
from pb4u.garment.corrected_placement import CorrectedPlacement
from pb4u.garment.dressing import AttachedPlacement, Placement, PrescribedPlacement, SkinnedPlacement
from pb4u.garment.fit import RestBody
from pb4u.garment.garment import Garment, PinSprings
from pb4u.garment.layering import layered
from pb4u.motion.motion import Motion
from pb4u.options import NONE
from pb4u.run import Run, WornGarment, entries
from pb4u.scene.loaded_garments import load_garments
from pb4u.scene.moving_body import perform
from pb4u.scene.scene import DressedGarment, Scene

_SUNKEN = 0.05
"""Depth [m] under the ground from which on a body does not stand on it; feet of a body that does sink in less."""

_STIFF = 200.0
"""Modulus [N/m] of both threads from which on cloth is told of: all that is woven."""

_OF_A_BAND = 0.1
"""Share of a garment's cloth up to which that of a band is too narrow for folds of its own."""

_EDGE_OF_A_FOLD = 1.5
"""Edge length over the bending length of cloth from which on a good part of its folds is lost.

Curvature of a walking T-shirt of silk with edges of 2.5, 1.6 and 1.2 bending lengths: 23, 30 and 37 /m; of poplin with
1.6 and 0.8: 23 and 31 /m. With soft threads and the same bending silk has 23, 32 and 37 /m.
"""

_FIRM = 2e4
"""Stiffness [N/m] of the springs of pins that let go and are not said to give way: under a coat they do by half a
millimetre."""

GarmentChoice: TypeAlias = str | Path | Garment | WornGarment


def make_scene(
    garment: GarmentChoice | Sequence[GarmentChoice] = WornGarment.garment,
    body: str | Path | ShapedBody | AnimatedBody | None = Run.body,
    motion: str | Path | Motion | None = None,
    **options: Any,
) -> Scene:
    """Garments on a moving body, ready to simulate.

    Names, paths and loaded objects are all accepted.

    Args:
        garment: built-in name, mesh file, Garment fitted to this body at rest, or WornGarment; of several, a list,
            inner first.
        body: built-in name, model or sequence file, or a body already loaded; None for no body.
        motion: built-in name, file or Motion; default "walk". A body that is a sequence of vertices has its own motion.
        options: fields of `Run` on the scene by name, such as body_shape, frames, lead_in, crop, fps, arms_away, seed,
            environment; and triangles, material and pins of the garments, one for all or a list with one each, used
            where a WornGarment does not set them.

    Raises:
        InputError: an input cannot be used, or an option conflicts with a loaded object.

    Warns:
        InputWarning: the body does not perform the motion or does not stand on the ground, nothing holds up a garment
            from a file without pins, or skin may show through a garment that is coarse for the body.
    """
    names = ("material", "pins", "triangles", "environment", *entries("scene"))
    refuse_unknown("option of a scene", options, names)
    choices: Sequence[Any] = garment if isinstance(garment, list | tuple) else [garment]
    specs = tuple(choice if isinstance(choice, WornGarment) else WornGarment(choice) for choice in choices)
    open_ = {name: options.pop(name) for name in ("material", "pins", "triangles") if options.get(name) is not None}
    options = {name: value for name, value in options.items() if value is not None}
    run = Run(specs, body=body, motion=motion, **options)
    filled = run.with_entries(open_)
    garments = [
        replace(after, **{name: getattr(spec, name) for name in open_ if getattr(spec, name) is not None})
        for spec, after in zip(specs, filled.garments, strict=True)
    ]
    return build_scene(replace(run, garments=tuple(garments)))


def build_scene(run: Run, written_fps: float | None = None) -> Scene:
    """Scene of a run, with all inputs loaded.

    Args:
        run: names, paths or loaded objects of the scene; its other options are ignored.
        written_fps: frames per second [1/s] that the result is written at; the run's by default.

    Raises:
        InputError: an input cannot be used, or an option conflicts with a loaded object.

    Warns:
        InputWarning: as `make_scene` does.
    """
    with noted() as notes:
        scene = _built(run, written_fps)
    return replace(scene, notes=tuple(dict.fromkeys((*notes, *scene.notes))))


def _built(run: Run, written_fps: float | None) -> Scene:
    """The scene of a run; not all that is warned of is among its notes."""
    body, performed = perform(run)
    collider, notes, led = performed.body, performed.notes, run.led_frames if run.keep_lead_in else 0
    frames, lead_in = led + performed.frames, run.led_frames - led
    garments, specified = load_garments(run.garments, body, run.as_recorded, run.rest_shape)
    garments = [
        _on_springs(item, spec, frames, lead_in, run.fps) for item, spec in zip(garments, specified, strict=True)
    ]
    places: Sequence[np.ndarray | None] = (None,) * len(garments)
    if body is not None and len(garments) > 1:
        places = layered(garments, RestBody.of(body))
    dressed = [
        DressedGarment(item, _placement(item, collider, layer)) for item, layer in zip(garments, places, strict=True)
    ]
    if led:
        written = round(led * (written_fps or run.fps) / run.fps)
        notes = (*notes, f"The first {written} frames lead from the rest pose into the motion.")
    ground, more = _ground(run, collider, lead_in + frames)
    if collider is None:
        _require_above(ground, garments)
    notes = (*notes, *more, *_lost_folds(garments))
    sources = [str(spec.garment) if isinstance(spec.garment, str | Path) else None for spec in specified]
    return Scene(
        garments=tuple(dressed),
        colliders=() if collider is None else (collider,),
        frames=frames,
        lead_in=lead_in,
        kept_lead_in=led,
        fps=run.fps,
        environment=replace(run.environment, ground=ground),
        seed=run.seed,
        labels={
            "garment": "+".join(item.garment.name for item in dressed),
            "sources": sources,
            "body": NONE if collider is None else collider.name,
            "body_shape": dict(body.shape) if isinstance(body, ShapedBody) else {},
            "motion": performed.motion,
            "rest_shape": run.rest_shape,
        },
        notes=notes,
    )


def _on_springs(garment: Garment, spec: WornGarment, frames: int, lead_in: int, fps: float) -> Garment:
    """The garment with its pins on springs where they are to give way, or to let go."""
    if spec.pin_stiffness is None and spec.pins_until is None:
        return garment
    if not garment.pinned.any():
        raise InputError(f"Nothing pins {garment.name}, so it has no pins to soften or release; give --pins too.")
    if spec.pins_until is not None and spec.pins_until >= frames:
        raise InputError(
            f"The pins of {garment.name} cannot be released at frame {spec.pins_until}: the last frame is {frames - 1}."
        )
    until = math.inf if spec.pins_until is None else (lead_in + spec.pins_until) / fps
    return replace(garment, springs=PinSprings(spec.pin_stiffness or _FIRM, until))


def _require_above(ground: float | None, garments: Sequence[Garment]) -> None:
    """Refuse garments under the `ground`, which would throw them up."""
    for garment in garments:
        if ground is not None and (lowest := float(garment.vertices[:, 1].min())) < ground:
            raise InputError(
                f"{garment.name} reaches {ground - lowest:.2f} m below the ground; raise it, or give --ground "
                f"{lowest:.2f} or --ground {NONE}."
            )


def _ground(run: Run, collider: AnimatedBody | None, frames: int) -> tuple[float | None, tuple[str, ...]]:
    """Height [m] of the ground of all `frames`, and what is to be told of it."""
    usual = run.environment.ground
    if run.as_recorded and usual == USUAL.ground:
        # A recording that is played as it is stands at whatever height it has.
        return None, ()
    if collider is None or isinstance(collider, PosedBody):
        # What has bones was put on the ground when its motion was made.
        return usual, ()
    lowest = min(float(collider.positions(frame, frame + 1)[..., 1].min()) for frame in range(frames))
    if usual is None or lowest > usual - _SUNKEN:
        return usual, ()
    note = f"{collider.name} reaches {usual - lowest:.2f} m below height {usual:g}, so the ground is put there."
    warn(note)
    return lowest, (note,)


def _lost_folds(garments: Sequence[Garment]) -> tuple[str, ...]:
    """What is to be told of woven garments whose folds are finer than their mesh."""
    notes = []
    for garment in garments:
        areas = garment.face_areas @ garment.layers
        made_of = [
            cloth
            for cloth, area in zip(garment.materials or (garment.material,), areas, strict=True)
            if area > _OF_A_BAND * areas.sum()
        ]
        folds = [cloth.bending_length for cloth in made_of if min(cloth.membrane[:2]) >= _STIFF and cloth.bending > 0]
        edge, longest = garment.mean_edge_length, _EDGE_OF_A_FOLD * min(folds, default=math.inf)
        if edge <= longest:
            continue
        # With a twentieth to spare: by so much a mesh misses the number that is asked for.
        enough = math.ceil(1.05 * len(garment.faces) * (edge / longest) ** 2 / 100) * 100
        notes.append(
            f"{garment.name}: edges of {1e3 * edge:.0f} mm are too long for the folds of this cloth; --triangles "
            f"{enough} gives edges of {1e3 * longest:.0f} mm, which show most of them."
        )
        warn(notes[-1], InputNote)
    return tuple(notes)


def _placement(garment: Garment, collider: AnimatedBody | None, places: np.ndarray | None) -> Placement:
    """The garment on the moving body, at `places` (vertices, 3) [m] where it lies over others; else where it is."""
    if collider is None:
        return PrescribedPlacement(garment.vertices[None])
    if not isinstance(collider, PosedBody):
        return AttachedPlacement(garment, collider, places)
    if places is None and garment.is_skinned_for(collider.body):
        return CorrectedPlacement(garment, collider)
    return SkinnedPlacement(garment, collider, worn=places)
