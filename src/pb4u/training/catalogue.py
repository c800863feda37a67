"""Garments, motions and seeds of which training, validation and tests are made.

The paper trains and tests on the VTO data set, which is not free. Its four held-out motions are stood in for by free
CMU recordings of the same kinds: 07_02 and 01_01 are VTO's own, 127_04 stands for 104_54 and 29_25 for 55_27.
Recordings are not part of the package; every split also has built-in motions, with seeds of its own, so that each
works without.
"""

from __future__ import annotations

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
