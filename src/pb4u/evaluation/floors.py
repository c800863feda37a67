"""The floor of the metric: what the solver reaches on the catalogue's test scenes, for ratios."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

from pb4u.errors import InputError

FLOORS_FILE = Path(__file__).with_name("floors.json")

ABOVE_GROUND = ("stretch", "bending", "collision", "friction", "inertia")
"""Terms of the ratio. Gravity is left out: a height has no zero, and sagging lowers it."""


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


def ratio_to_floor(energies: dict[str, float], scene: str, level: str = "base") -> float:
    """How many times the solver's mean energy without gravity a result has; `energies` are means [J]."""
    reached = floor(scene, level)["energies"]
    return sum(energies[term] for term in ABOVE_GROUND) / sum(reached[term] for term in ABOVE_GROUND)
