"""From the files of the released code to what it computed, by the command line alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

RUNS = [
    ("pb4u", "garments_dict.pkl:dress", "release"),
    ("pb4u", "garments_dict_skirt.pkl:skirt", "release"),
    ("hood", "garments_dict.pkl:dress@73", "hood"),
    ("hood", "garments_dict_skirt.pkl:skirt@388", "hood"),
    ("hood_cvpr", "garments_dict.pkl:dress@125", "mgn"),
    ("hood_cvpr", "garments_dict_skirt.pkl:skirt@122", "mgn"),
    ("fine15", "garments_dict.pkl:dress", "mgn"),
    ("fine15", "garments_dict_skirt.pkl:skirt", "mgn"),
]


def arguments(compat: Path, garment: str) -> list[object]:
    files = compat / "files"
    return [
        "simulate", "--garment", f"{files}/{garment}", "--body", files / "SMPL_FEMALE.pkl",
        "--omitted", files / "smpl_aux.pkl", "--motion", files / "recording.pkl", "--as-recorded", "--arms-away", 20,
        "--lead-in", 0, "--refine", 0, "--contact", "off", "--self-contact", "off",
    ]  # fmt: skip


@pytest.mark.parametrize(("name", "garment", "start"), RUNS)
def test_the_released_rollout_is_met(
    compat: Path, pb4u: Callable[..., Any], tmp_path: Path, name: str, garment: str, start: str
) -> None:
    scene = f"{name}_{garment.partition(':')[2].partition('@')[0]}"
    golden = np.load(compat / f"golden/{scene}.npz")
    model = compat / f"checkpoints/{name}.pth"
    ended = pb4u(*arguments(compat, garment), "--model", model, "--start", start, "--out", tmp_path / "run.npz")
    assert ended.code == 0, ended.err
    with np.load(tmp_path / "run.npz") as run:
        positions, metadata = run["positions"], str(run["metadata"])
    assert "unknown: ask the author" in metadata
    assert len(positions) == 8
    for step in range(4):
        expected = golden[f"case0/step{step}/pred_pos"]
        assert np.abs(positions[step + 2] - expected).max() < 3e-6, step
