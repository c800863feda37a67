"""The run folder: nothing half-written, nothing foreign taken, moments rounded within reason."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
import torch

from pb4u.errors import InputError
from pb4u.training.request import TrainingRequest
from pb4u.training.run_folder import NotSavedError, RunFolder
from pb4u.training.session import train


def test_a_full_disk_leaves_the_last_checkpoint_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = RunFolder.create(tmp_path / "run", {"preset": "smoke"})
    folder.save_state({"a": torch.ones(3)}, {"step": 1})

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(NotSavedError, match="No space left on device"):
        folder.save_state({"a": torch.zeros(3)}, {"step": 2})
    found = folder.load_state()
    assert found is not None
    assert found[1] == {"step": 1}
    assert torch.equal(found[0]["a"], torch.ones(3))
    assert sorted(p.name for p in folder.path.iterdir()) == ["configuration.json", "last.safetensors"]


def test_folders_of_others_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a folder of a training"):
        RunFolder.open(tmp_path)
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(InputError, match="not an empty folder"):
        RunFolder.create(tmp_path, {})
    folder = RunFolder.create(tmp_path / "run", {})
    with pytest.raises(InputError, match="continue it with --resume"):
        RunFolder.create(tmp_path / "run", {})
    assert folder.load_state() is None
    (folder.path / "last.safetensors").write_bytes(b"not this")
    with pytest.raises(InputError, match="not a checkpoint of a training"):
        folder.load_state()
    (folder.path / "configuration.json").write_text('{"format_version": 99}')
    with pytest.raises(InputError, match="newer format"):
        folder.configuration()
    (folder.path / "configuration.json").write_text("{")
    with pytest.raises(InputError, match="not the configuration"):
        folder.configuration()


def test_metrics_forget_steps_that_will_be_taken_again(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", {})
    for step in (5, 10, 15):
        folder.append_metrics({"step": step})
    with open(folder.path / "metrics.jsonl", "ab") as out:
        out.write(b'[1]\n\xff\xfe\n{"step": 2')
    assert [line["step"] for line in folder.metrics()] == [5, 10, 15]
    folder.forget_metrics_after(10)
    assert (folder.path / "metrics.jsonl").read_text() == '{"step": 5}\n{"step": 10}\n'
    (folder.path / ".last.safetensors.123").write_bytes(b"half")
    folder.forget_leftovers()
    assert sorted(p.name for p in folder.path.iterdir()) == ["configuration.json", "metrics.jsonl"]


def test_one_process_at_a_time_trains_in_a_folder(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "run", {})
    with folder.held(), pytest.raises(InputError, match="Another process"):
        train(TrainingRequest(resume=folder.path))
    with folder.held():
        pass
