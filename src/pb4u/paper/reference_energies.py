"""The floor of the metric: what the solver reaches on the catalogue's test scenes, for ratios."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

REFERENCE_FILE = Path(__file__).with_name("reference_energies.json")

REFERENCE_LEAD_IN = 30
"""Frames simulated before those that stored floors are means of, as `tools/floors.py` ran them."""


@lru_cache(maxsize=1)
def _references() -> dict[str, dict[str, Any]]:
    return json.loads(REFERENCE_FILE.read_text(encoding="utf-8"))


def stored_reference(scene: str, level: str, frames: int) -> dict[str, float] | None:
    """Mean energies [J] by term that the solver reached; None where none are stored.

    Args:
        scene: name in the catalogue.
        level: name of the resolution.
        frames: how many frames the mean is over.
    """
    record = _references().get(f"{scene}@{level}", {}).get(str(frames))
    return record["energies"] if record else None


def ratio(energies: Mapping[str, float], reached: Mapping[str, float]) -> float:
    """Ratio of summed mean energies to those of the reference, over the terms of the reference, without gravity.

    A height has no zero, and sagging lowers it.

    Args:
        energies: term -> mean over frames [J].
        reached: the same of the floor.
    """
    # Inertia last, as ever: a sum in another order differs in its last digit.
    terms = sorted((term for term in reached if term not in ("gravity", "total")), key="inertia".__eq__)
    return sum(energies[term] for term in terms) / sum(reached[term] for term in terms)
