"""Every example ends in one sentence, not in a traceback, where a file or name that it is given cannot be used."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.mark.parametrize(
    ("name", "arguments", "says"),
    [
        ("00_simulate_and_save.py", ("--garment", "absent.obj"), "absent.obj"),
        ("02_recorded_motion.py", ("absent.npz",), 'no motion file "absent.npz"'),
        ("03_choose_a_resolution.py", ("--model", "absent.safetensors"), "no model file absent.safetensors"),
        ("04_change_the_material.py", ("--materials", "absent.json"), "absent.json"),
        ("05_compare_with_the_solver.py", ("--model", "absent.safetensors"), "no model file absent.safetensors"),
        ("07_scene_file.py", ("--garments", "tshirt", "tshirt"), "tshirt is worn twice"),
        ("06_into_blender.py", ("--trajectory", "absent.npz"), "no trajectory file absent.npz"),
    ],
)
def test_one_sentence_and_no_traceback(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str, arguments: tuple[str, ...], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    assert says in str(ended.value.code)
    assert "\n" not in str(ended.value.code)
    assert list(tmp_path.iterdir()) == []
