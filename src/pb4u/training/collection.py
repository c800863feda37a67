"""Makes training data from the built-in bodies, garments and motions, and from a folder of recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.library import body_names, load_boned_body
from pb4u.errors import InputError, warn
from pb4u.garment.garment import Garment
from pb4u.garment.library import build_garment
from pb4u.garment.weight_cache import garment_weights
from pb4u.io.array_archive import member_names
from pb4u.motion.library import load_motion, motion_names
from pb4u.motion.motion import Motion
from pb4u.progress import Progress, no_progress
from pb4u.run import WornGarment
from pb4u.scene.loaded_garments import load_garment
from pb4u.training.catalogue import RECORDINGS, SEEDS
from pb4u.training.configuration import DataSelection
from pb4u.training.packed_data import Outfit, PosedClip, TrainingData, rounded_poses
from pb4u.training.variation import CAPE, before_refining, cape, uneven, varied_garment

_OTHER_RECORDINGS = (".pkl", ".npz", ".bvh")
"""Suffixes of recordings that are trained on beside those of the catalogue."""


def collect(
    selection: DataSelection, recordings: Path | None = None, seed: int = 0, progress: Progress = no_progress
) -> TrainingData:
    """Training data that `selection` describes; garments from files are worn by the first body, for which they must be
    made.

    Args:
        selection: garments, bodies and motions.
        recordings: folder of recordings: SUBJECT/TRIAL.amc of the catalogue's training and validation splits, and .pkl
            files of VTO, .npz of AMASS and .bvh of any name, every tenth of which is for validation; where none would
            be, the last of all is.
        seed: seed of body shapes and of the choice of clips.
        progress: called with (parts made, parts in all).

    Raises:
        InputError: an unknown name, a folder without any recording, or a recording that cannot be read.
    """
    rng = np.random.default_rng([seed, 17])
    bodies = _bodies(selection, rng)
    if all(_is_file(name) for name in selection.garments):
        bodies = bodies[:1]
    total = len(bodies) * (len(selection.garments) * len(selection.triangles) + 1)
    count = 0
    recorded = {} if recordings is None else _recorded(recordings)
    outfits, clips = [], []
    for index, body in enumerate(bodies):
        for which, name in enumerate(selection.garments):
            if index and _is_file(name):
                continue
            for triangles in selection.triangles:
                garment = _garment(selection, name, body, triangles, (seed, 19, index, which, triangles))
                outfits.append(Outfit(garment, garment_weights(garment, body), index))
                count += 1
                progress(count, total)
        clips += _built_in_clips(selection, body, index, rng)
        for split, motions in recorded.items():
            clips += [_clip(motion, motion.name, split, body, index, selection.fps) for motion in motions]
        count += 1
        progress(count, total)
    return TrainingData(tuple(bodies), tuple(outfits), tuple(clips))


def _bodies(selection: DataSelection, rng: np.random.Generator) -> list[ShapedBody]:
    """Bodies of as many shapes as are asked for, taken in turn; the first of each is its default."""
    unknown = sorted(set(selection.bodies) - set(body_names()))
    if unknown:
        raise InputError(f"Training takes built-in bodies only, {', '.join(body_names())}, not {unknown[0]!r}.")
    bodies = []
    for i in range(selection.shapes):
        name = selection.bodies[i % len(selection.bodies)]
        drawn: dict[str, float] = {}
        if i >= len(selection.bodies):
            low, high = selection.drawn_shapes
            drawn = {key: float(np.round(rng.uniform(low, high), 3)) for key in load_boned_body(name).shape}
        shaped = load_boned_body(name, drawn)
        bodies.append(shaped)
    return bodies


def _garment(selection: DataSelection, name: str, body: ShapedBody, triangles: int, seed: tuple[int, ...]) -> Garment:
    """A garment of the selection. Its random draws depend on its index alone, so a change of one leaves the others."""
    if _is_file(name):
        loaded = load_garment(WornGarment(name, triangles=triangles), body, "moulded")
        if loaded.rest_uv is not None:
            raise InputError(f"{name} is sewn of flat panels, which training does not take; give its mesh.")
        return loaded
    rng = np.random.default_rng(seed)
    varies, refined = rng.random() < selection.varied, rng.random() < selection.uneven
    count = before_refining(triangles) if refined else triangles
    if name == CAPE:
        garment = cape(body, count, rng)
    else:
        garment = varied_garment(name, body, count, rng) if varies else build_garment(name, body, count, "moulded")
    return uneven(garment, body, rng) if refined else garment


def _is_file(name: str) -> bool:
    return bool(Path(name).suffix)


def _built_in_clips(
    selection: DataSelection, body: ShapedBody, index: int, rng: np.random.Generator
) -> list[PosedClip]:
    unknown = sorted(set(selection.motions) - set(motion_names()))
    if unknown:
        raise InputError(f"There is no built-in motion {unknown[0]!r}; there are {', '.join(motion_names())}.")
    if not selection.motions:
        return []
    clips = []
    offset = int(rng.integers(len(selection.motions)))
    for split, count in (("train", selection.clips), ("validation", min(selection.clips, len(selection.motions)))):
        for i in range(count):
            name = selection.motions[(offset + i) % len(selection.motions)]
            seed = int(rng.choice(list(SEEDS[split])))
            start = int(rng.integers(0, 60)) if split == "train" else 0
            poses = load_motion(name, seed=seed).poses(body, selection.fps, selection.clip_frames, start)
            clips.append(PosedClip(f"{name}-{seed}", split, index, rounded_poses(poses)))
    return clips


def _recorded(folder: Path) -> dict[str, list[Motion]]:
    """Motions of the files below the `folder`, by split: that of the catalogue, and of others every tenth validates.

    Of two or more one does at least.
    """
    motions: dict[str, list[Motion]] = {}
    trials = {trial: split for split in ("train", "validation") for trial in RECORDINGS[split]}
    missing = dict(trials)
    files = [file for file in sorted(folder.rglob("*")) if file.suffix.lower() in _OTHER_RECORDINGS]
    others = [file for file in files if not _is_shape(file)]
    if len(others) < len(files):
        words = "files hold" if len(files) - len(others) > 1 else "file holds"
        warn(
            f"{len(files) - len(others)} {words} no poses, like the shape files of AMASS, and are not used in the "
            "training."
        )
    for trial, split in trials.items():
        file = folder / trial.split("_")[0] / f"{trial}.amc"
        if file.is_file():
            motions.setdefault(split, []).append(load_motion(file))
            del missing[trial]
    for place, file in enumerate(others, start=1):
        motions.setdefault("train" if place % 10 else "validation", []).append(load_motion(file))
    if "train" not in motions:
        first = next(iter(trials))
        raise InputError(
            f"The folder {folder} holds neither a {', '.join(_OTHER_RECORDINGS)} file nor a CMU recording, such as "
            f"{first.split('_')[0]}/{first}.amc."
        )
    if "validation" not in motions and len(motions["train"]) > 1:
        motions["validation"] = [motions["train"].pop()]
    if missing and not others:
        warn(f"{len(missing)} recordings of the catalogue are not in {folder}.")
    return motions


def _is_shape(file: Path) -> bool:
    return file.suffix.lower() == ".npz" and not {"poses", "body_pose"} & set(member_names(file))


def _clip(motion: Motion, name: str, split: str, body: ShapedBody, index: int, fps: float) -> PosedClip:
    frames = motion.available_frames(fps) or 1
    return PosedClip(name, split, index, rounded_poses(motion.poses(body, fps, frames)))
