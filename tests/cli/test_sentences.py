"""What the common refusals say, word by word; other tests look for the file, flag or number in a sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

FILES = {
    "cut.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    "scene.toml": "[scene]\nmotoin = 3\n",
}
SENTENCES = {
    "simulate --garment tshrt": "There is no garment 'tshrt'; did you mean tshirt or shirt or skirt?",
    "simulate --garment absent.obj": "There is no garment file absent.obj.",
    "simulate --garment cut.obj": 'cut.obj line 4: face "f 1 2 9" names a vertex out of range, the file has 3; '
    "export it again.",
    "simulate --body-shape tallness=1": 'The body "woman" has no shape parameter "tallness": its shape parameters are '
    "height (0 to 1), weight (0 to 1), muscle (0 to 1).",
    "simulate --motion wlak": "There is no motion 'wlak'; did you mean walk? There are walk, run, jump, arms, twist, "
    "squat, turn, dance.",
    "simulate --motion absent.bvh": 'There is no motion file "absent.bvh".',
    "simulate --material sillk": "There is no material 'sillk'; did you mean silk?",
    "simulate --material absent.json": "There is no material file absent.json.",
    "simulate --model pb4u-smal": "There is no model 'pb4u-smal'; did you mean pb4u-small or pb4u-light?",
    "simulate --model solver --refine 3": "--refine does nothing with --model solver; leave it out.",
    "simulate --frames 0": "--frames must be a whole number, 1 or more, not 0.",
    "simulate --fps 0": "--fps must be a number from 1 to 1,000, not 0.0.",
    "simulate --triangles 10": "A built-in garment has between 200 and 200000 triangles, not 10.",
    "simulate --out absent/a.npz": "The folder absent does not exist; make it first.",
    "simulate --out a.xyz": ".xyz is not a format that is written; give the file one of the suffixes .npz, .obj, "
    ".pc2, .mdd, .abc, .usdc, .usda, .usdz, .glb, .png, .jpg, .gif, .mp4, .pkl.",
    "simulate scene.toml": "scene.toml: [scene] has no entry 'motoin'; did you mean motion or raw_motion?",
    "simulate absent.toml": "There is no scene file absent.toml.",
    "batch absent.toml --out d": "There is no jobs file absent.toml.",
    "dress absent.toml --out a.npz": "There is no pattern absent.toml.",
    "view absent.npz": "There is no trajectory file absent.npz.",
    "convert absent.npz a.pc2": "There is no trajectory file absent.npz.",
    "check absent.obj": "There is no garment file absent.obj.",
    "assets write tshrt a.obj": "There is no built-in asset 'tshrt'; did you mean tshirt or shirt or twist?",
    "evaluate --out r --protocol resolutions": "There is no protocol 'resolutions'; did you mean resolution? There are "
    "resolution, unseen, depth, efficiency, ablation, controls, robustness.",
    "evaluate --out r --workers 0": "The number of workers must be 1 or more, not 0.",
    "train": "Give --out FOLDER for a new training, or --resume FOLDER to continue one.",
    "train --out r --preset smal": "There is no training preset 'smal'; did you mean small? There are paper, literal, "
    "literal_small, small, wide, comparison, smoke.",
    "train --out r --set batc=2": "There is no setting 'batc'; did you mean batch?",
    "convert-weights absent.pth a.safetensors": "There is no checkpoint absent.pth.",
}


@pytest.mark.parametrize("call", SENTENCES)
def test_a_common_refusal_is_one_sentence(
    pb4u: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, content in FILES.items():
        Path(name).write_text(content)
    ended = pb4u(*call.split())
    assert (ended.code, ended.err) == (1, f"pb4u: {SENTENCES[call]}\n")
    assert {file.name for file in tmp_path.iterdir()} == FILES.keys()
