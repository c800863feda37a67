"""The scenes that training, validation and tests are made of, by name.

The paper trains and tests on the VTO data set, which is not free. Its four held-out motions are stood in for by free
CMU recordings of the same kinds: 07_02 and 01_01 are VTO's own, 127_04 stands for 104_54 and 29_25 for 55_27.
Recordings are not part of the package; every split also has built-in motions, told apart by their seeds, so that each
works without.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pb4u.errors import InputError, unknown_name
from pb4u.run import Run, WornGarment
from pb4u.scene.assembly import build_scene
from pb4u.scene.scene import Scene

TRAINING_GARMENTS = ("tshirt", "tanktop", "longsleeve", "dress")
UNSEEN_GARMENTS = ("fitted_dress", "cardigan")

_TRAINING_TRIALS = """
02_01 02_02 02_03 02_04 02_05 02_06 05_01 05_02 05_03 05_04 05_07 05_20 07_05 08_02 08_04 09_01 09_05 09_12 14_07 14_14
14_20 14_24 16_01 16_03 16_05 16_09 16_11 16_13 16_17 16_19 16_21 16_35 16_37 16_47 16_55 17_03 29_01 29_03 35_01 35_17
49_02 49_04 49_09 49_12 49_18 49_19 91_01 91_47 127_03 127_05 127_09 127_11 127_25 135_07
"""

RECORDINGS: dict[str, tuple[str, ...]] = {
    "train": tuple(_TRAINING_TRIALS.split()),
    "validation": ("05_12", "16_58", "127_17", "135_09"),
    "test": ("07_02", "01_01", "127_04", "29_25"),
}
"""CMU trials of each split."""

MOTIONS: dict[str, tuple[str, ...]] = {
    "train": ("walk", "run", "jump", "arms", "twist", "squat", "turn", "dance"),
    "validation": ("walk", "dance"),
    "test": ("walk", "jump", "turn", "dance"),
}
"""Built-in motions of each split."""

SEEDS = {"train": range(100), "validation": range(1000, 1002), "test": range(2000, 2001)}
"""Seeds of the built-in motions of each split; no seed belongs to two."""


@dataclass(frozen=True)
class SceneName:
    """A catalogue entry, written split/garment/motion, or split/garment/motion-seed for a built-in motion.

    Args:
        split: train, validation or test.
        garment: built-in garment.
        motion: built-in motion or CMU trial.
        seed: seed of a built-in motion; None for a recording.
    """

    split: str
    garment: str
    motion: str
    seed: int | None

    def __str__(self) -> str:
        return f"{self.split}/{self.garment}/{self.motion}" + ("" if self.seed is None else f"-{self.seed}")

    @property
    def needs_recording(self) -> bool:
        """Whether the motion is a CMU recording instead of a built-in motion."""
        return self.seed is None


def scene_names(split: str | None = None, recordings: bool = True) -> tuple[SceneName, ...]:
    """Names of the scenes of the catalogue.

    Args:
        split: "train", "validation" or "test"; all of them by default.
        recordings: whether scenes that need recordings are listed too.

    Raises:
        InputError: an unknown split.
    """
    names = []
    for each in RECORDINGS if split is None else (split,):
        if each not in RECORDINGS:
            raise unknown_name("split", each, RECORDINGS)
        garments = TRAINING_GARMENTS + (UNSEEN_GARMENTS if each == "test" else ())
        for garment in garments:
            names += [SceneName(each, garment, motion, seed) for motion in MOTIONS[each] for seed in SEEDS[each]]
            if recordings:
                names += [SceneName(each, garment, trial, None) for trial in RECORDINGS[each]]
    return tuple(names)


def catalogue_scene(
    name: str | SceneName,
    triangles: int | None = None,
    frames: int | None = None,
    body: str = "woman",
    recordings: str | Path | None = None,
) -> Scene:
    """Scene of the catalogue called `name`, loaded.

    Args:
        name: entry as `scene_names` prints it, such as "test/dress/07_02" or "test/tshirt/walk-2000".
        triangles: resolution; the garment's base level by default.
        frames: frames to write; 60 of a built-in motion and the whole of a recording by default.
        body: built-in body.
        recordings: folder of CMU files, SUBJECT/TRIAL.amc beside SUBJECT/SUBJECT.asf.

    Raises:
        InputError: an unknown name, or a recording that is not in the folder.
    """
    entry = _find(name) if isinstance(name, str) else name
    worn = WornGarment(entry.garment, triangles=triangles)
    motion = _recording(entry, recordings) if entry.needs_recording else entry.motion
    return build_scene(Run((worn,), body=body, motion=motion, frames=frames, seed=entry.seed or 0))


def _recording(entry: SceneName, recordings: str | Path | None) -> Path:
    file = Path(recordings or ".") / entry.motion.split("_")[0] / f"{entry.motion}.amc"
    if recordings is None or not file.is_file():
        raise InputError(
            f"The scene {entry} needs the CMU trial {entry.motion} as {file}; give the folder of recordings, or take a "
            "scene on a built-in motion."
        )
    return file


def _find(name: str) -> SceneName:
    known = {str(entry): entry for entry in scene_names()}
    if name not in known:
        raise unknown_name("scene of the catalogue", name, known)
    return known[name]
