"""Decisions on the paper's claims are those that docs/science/claims.md fixes."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from benchmarks.claim_tables import decided, decisions, read, table, whole, write

SCENES = [(f"g{g}", f"m{m}") for g, m in product(range(6), range(4))]


def rows(near: float, far: float, lost: bool) -> list[dict[str, Any]]:
    """Rollouts in which the rule is at `near` mm and K = 5 at `far`; without scaling all are `lost`."""
    arms = [("drawn", 0, near), ("trained at 5", 5, far)]
    made = [
        {
            "triangles": triangles, "garment": garment, "motion": motion, "arm": arm, "seed": seed, "scaling": scaling,
            "steps": steps, "lost": lost and scaling == "none", "strain": 0.2, "paper_total": 1.0,
            "millimetres": None if scaling == "none" and lost else distance * (1.0 + 0.01 * n + 0.02 * seed),
        }
        for n, (garment, motion) in enumerate(SCENES)
        for triangles, seed, scaling in product((2730, 4140), range(3), ("none", "per-vertex"))
        for arm, steps, distance in arms
    ]  # fmt: skip
    return made


@pytest.mark.parametrize(
    ("near", "far", "lost", "answers"),
    [
        (30.0, 60.0, True, ("holds", "holds")),
        (60.0, 30.0, False, ("undecided", "the opposite holds")),
        (30.0, 30.0, False, ("undecided", "undecided")),
    ],
)
def test_each_claim_is_answered_by_what_its_pairs_say(
    near: float, far: float, lost: bool, answers: tuple[str, str]
) -> None:
    said = decisions(rows(near, far, lost))
    for claim, answer in zip(("Claim 1,", "Claim 2,"), answers, strict=True):
        assert f": {answer}." in next(line for line in said if claim in line)
    assert sum("no pairs yet" in line for line in said) == 5


def test_one_scene_by_itself_decides_nothing_and_infinite_ranks_last() -> None:
    assert decided([-1.0] + [0.01 * (-1) ** n for n in range(23)], -1)[0] == "undecided"
    answer, mean, interval, _ = decided([math.inf] * 20 + [-0.3] * 4, -1)
    assert answer == "the opposite holds"
    assert math.isfinite(mean)
    assert interval[0] > 0.0


def test_a_line_of_a_table_counts_the_lost_and_ranks_them_last() -> None:
    line = next(line for line in table(rows(30.0, 60.0, True)).splitlines() if line.startswith("| drawn | none"))
    assert "144/144" in line
    assert "| - |" in line


def test_the_csv_file_has_what_ran_in_every_scene_and_reads_back(tmp_path: Path) -> None:
    made = [row | {"strain_max": 0.3, "edge_length": 0.03, "faces": 2688, "propagation_steps": None}
            for row in rows(30.0, 60.0, True)]  # fmt: skip
    begun = [made[0] | {"scaling": "mean"}, made[0] | {"triangles": 9600}]
    write(whole([*begun, *made]), tmp_path / "rollouts.csv")
    again = read(tmp_path / "rollouts.csv")
    assert len(again) == len(made)
    assert decisions(again) == decisions(made)
