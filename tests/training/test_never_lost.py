"""A training killed at any instant goes on to the same numbers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from tests.training.ball_data import ball_data

from pb4u.training.packed_data import save_training_data

SETTINGS = (
    "network.width=8", "checkpoint_every=4", "log_every=2", "validate_every=12", "validation_frames=3",
    "statistics_windows=2", "curriculum.window_steps=((0,1),(0.4,2))",
)  # fmt: skip


def started(*arguments: object) -> subprocess.Popen[str]:
    main = "import sys; from pb4u.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", main, "train", *map(str, arguments), "--device", "cpu"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def ended(process: subprocess.Popen[str]) -> tuple[str, str]:
    out, err = process.communicate(timeout=400)
    assert process.returncode == 0, err
    return out, err


def wait_for(path: Path) -> None:
    until = time.monotonic() + 300
    while not path.exists():
        assert time.monotonic() < until, f"{path} did not appear"
        time.sleep(0.01)


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pack") / "pack.npz"
    save_training_data(ball_data((8,)), path)
    return path


@pytest.mark.slow
def test_a_killed_training_resumes_to_the_same_numbers(pack: Path, tmp_path: Path) -> None:
    common = ("--pack", pack, "--preset", "smoke", "--steps", 24, *(f"--set={s}" for s in SETTINGS))
    whole, killed = (started(*common, "--out", tmp_path / name) for name in ("whole", "killed"))
    wait_for(tmp_path / "killed" / "last.safetensors")
    killed.kill()
    killed.communicate()
    ended(started("--resume", tmp_path / "killed"))
    assert ended(whole)[0].startswith("Trained 24 steps.")

    for file in ("last.safetensors", "best.safetensors"):
        expected, found = (load_file(tmp_path / name / file) for name in ("whole", "killed"))
        assert found.keys() == expected.keys()
        assert all(torch.equal(value, found[key]) for key, value in expected.items()), file

    def losses(name: str) -> dict[int, float]:
        lines = (tmp_path / name / "metrics.jsonl").read_text().splitlines()
        return {line["step"]: line["total"] for line in map(json.loads, lines) if "total" in line}

    assert losses("killed") == losses("whole")
