"""The benchmark that sets rivals side by side: what it runs, what it leaves out, what it says of a busy machine."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from benchmarks.side_by_side import BUSY, RIVALS, absent, page, summed_up

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "side_by_side.py"

FIGURES = {
    "frames": [4, 30], "wall_ms": 20.0, "processor_ms": 10.0, "others": 0.0, "triangles": 1200, "peak_mb": 300.0,
    "energy_mj": 1.0, "stretch_mj": 0.5, "bending_mj": 0.25, "strain_p95": 0.1, "strain_max": 0.2,
    "inside_percent": 0.0, "deepest_mm": 0.0, "self_intersections": 0.0, "body_intersections": 0.0, "diverged": False,
}  # fmt: skip


def found(**changes: Any) -> dict[str, Any]:
    asked = {"garment": "tshirt", "body": "woman", "motion": "walk", "frames": 4, "lead_in": 30, "repeats": 1}
    rows = {"network": FIGURES | changes}
    return {"machine": {"cores": 2}, "asked": asked, "left_out": {"Blender cloth": "why"}, "figures": {1200: rows}}


def test_a_run_measures_its_rival_in_a_process_of_its_own(tmp_path: Path) -> None:
    out, figures = tmp_path / "page.md", tmp_path / "figures.json"
    options = ("--triangles", "300", "--frames", "2", "--repeats", "1", "--rivals", "skinning", "blender")
    nowhere = ("--blender-python", sys.executable + "_that_is_not_there")
    subprocess.run([sys.executable, SCRIPT, *options, *nowhere, "--out", out, "--json", figures], check=True)
    told = json.loads(figures.read_text())
    row = told["figures"]["300"]["skinning"]
    assert row["strain_p95"] > 0.05, "the body's motion alone stretches a T-shirt"
    assert row["wall_ms"] > 0
    assert list(told["left_out"]) == ["Blender cloth"]
    assert "| bare skinning |" in out.read_text()
    assert "Left out: Blender cloth (no Python with bpy" in out.read_text()


@pytest.mark.parametrize(("others", "said"), [(0.0, False), (None, False), (BUSY + 0.3, True)])
def test_times_taken_beside_other_work_are_called_so(others: float | None, said: bool) -> None:
    assert ("Others used up to 40 %" in page(found(others=others))) is said


def test_sizes_kept_from_a_shorter_run_say_their_frames() -> None:
    told = found()
    told["figures"][38000] = {"network": FIGURES | {"frames": [2, 10], "triangles": 38000}}
    assert page(told).count("frames after 30 of lead-in") == 1
    assert "2 frames after 10 of lead-in." in page(told).split("## 38,000 triangles")[1]


def test_times_are_medians_over_rounds_and_the_most_disturbed_round_is_told() -> None:
    rounds = [
        FIGURES,
        {"wall_ms": 90.0, "processor_ms": 12.0, "peak_mb": 310.0, "others": 0.4},
        {"wall_ms": 22.0, "processor_ms": 11.0, "peak_mb": 320.0, "others": None},
    ]
    row = summed_up(rounds)
    assert (row["wall_ms"], row["processor_ms"], row["peak_mb"], row["others"]) == (22.0, 11.0, 310.0, 0.4)
    assert row["stretch_mj"] == FIGURES["stretch_mj"]


def test_a_rival_whose_package_is_absent_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.side_by_side.find_spec", lambda name: None)
    assert [rival for rival in RIVALS if RIVALS[rival].needs and absent(rival, sys.executable)] == ["newton"]
