"""The floor of the metric: what the solver reaches on the catalogue's test scenes, for ratios."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from pb4u.errors import InputError

FLOORS_FILE = Path(__file__).with_name("floors.json")

ABOVE_GROUND = ("stretch", "bending", "collision", "friction", "inertia")
"""Terms of the ratio. Gravity is left out: a height has no zero, and sagging lowers it."""

FLOOR_LEAD_IN = 30
"""Frames simulated before those that stored floors are means of."""


@lru_cache(maxsize=1)
def _floors() -> dict[str, Any]:
    return json.loads(FLOORS_FILE.read_text(encoding="utf-8"))


def floor(scene: str, level: str = "base") -> dict[str, Any]:
    """Mean energies [J] and strain of the solver's own run of a test scene.

    Raises InputError where it was never computed; `tools/floors.py` does.
    """
    key = f"{scene}@{level}"
    if key not in _floors():
        raise InputError(f"The floor of {key} was never computed; run tools/floors.py --levels {level}.")
    return _floors()[key]


def stored_floor(scene: str, level: str, frames: int) -> dict[str, float] | None:
    """Mean energies [J] that are stored for a test scene of just so many frames; None where there are none."""
    found = _floors().get(f"{scene}@{level}")
    return found["energies"] if found and found["frames"] == frames else None


def ratio(energies: Mapping[str, float], reached: Mapping[str, float]) -> float:
    """Mean energy without gravity over that of the floor; both are means [J] by term."""
    return sum(energies[term] for term in ABOVE_GROUND) / sum(reached[term] for term in ABOVE_GROUND)


def ratio_to_floor(energies: dict[str, float], scene: str, level: str = "base") -> float:
    """How many times the solver's mean energy without gravity a result has; `energies` are means [J]."""
    return ratio(energies, floor(scene, level)["energies"])
