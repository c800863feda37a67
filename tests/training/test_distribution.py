"""Two processes with half a batch each learn what one learns from the whole."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
import torch
from tests.training.ball_data import TINY, ball_data

from pb4u.errors import InputError
from pb4u.training.budget import Budget
from pb4u.training.distribution import Workers, workers
from pb4u.training.journal import Reporter
from pb4u.training.trainer import Trainer

CONFIGURATION = replace(
    TINY,
    batch=2,
    curriculum=replace(TINY.curriculum, window_steps=((0.0, 1),)),
    statistics_windows=2,
    validate_every=1000,
    validation_clips=1,
    validation_frames=2,
)
STEPS = 4


class Totals(Reporter):
    def __init__(self) -> None:
        self.values: list[float] = []

    def progressed(self, step: int, progress: float, seconds: float, means: object) -> None:
        self.values.append(means["total"])  # type: ignore[index]


def losses(mine: Workers) -> tuple[list[float], torch.Tensor]:
    totals = Totals()
    trainer = Trainer(replace(CONFIGURATION, log_every=1), Budget(STEPS), ball_data(), mine, None, totals)
    trainer.run()
    return totals.values, torch.cat([p.detach().reshape(-1) for p in trainer.model.parameters()])


@pytest.mark.slow
def test_two_processes_have_the_losses_of_one(tmp_path: Path) -> None:
    with workers("cpu") as alone:  # first, so that the others need not compile its kernels at the same time
        expected, weights = losses(alone)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    root = Path(__file__).resolve().parents[2]
    path = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
    processes = []
    for rank in range(2):
        environment = {
            **os.environ, "RANK": str(rank), "WORLD_SIZE": "2", "LOCAL_RANK": str(rank), "OMP_NUM_THREADS": "1",
            "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "PYTHONPATH": path,
        }  # fmt: skip
        command = [sys.executable, __file__, str(tmp_path / f"{rank}.pt")]
        processes.append(subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True))
    for process in processes:
        _, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
    for rank in range(2):
        found = torch.load(tmp_path / f"{rank}.pt", weights_only=True)
        assert found["losses"] == pytest.approx(expected, rel=2e-3)
        assert found["losses"][0] == pytest.approx(expected[0], rel=1e-5)
        assert torch.allclose(found["weights"], weights, atol=2e-3)
    assert len(expected) == STEPS


def test_processes_wait_long_for_one_that_validates(monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, timedelta] = {}
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setattr("torch.distributed.init_process_group", lambda backend, **options: given.update(options))
    monkeypatch.setattr("torch.distributed.destroy_process_group", lambda: None)
    with workers("cpu"):
        assert given["timeout"] >= timedelta(hours=12)


def test_batches_that_cannot_be_shared_and_absent_devices_are_refused() -> None:
    with pytest.raises(InputError, match="2 processes"):
        Workers(0, 2, torch.device("cpu")).share(3)
    assert Workers(1, 2, torch.device("cpu")).share(4) == slice(2, 4)
    with pytest.raises(InputError, match="auto, cpu or cuda"), workers("tpu"):
        pass
    if not torch.cuda.is_available():
        with pytest.raises(InputError, match="no CUDA device"), workers("cuda"):
            pass


if __name__ == "__main__":
    with workers("cpu") as one_of_two:
        values, final = losses(one_of_two)
    torch.save({"losses": values, "weights": final}, sys.argv[1])
