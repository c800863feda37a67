"""Attempts at jobs that take no time, and leave a line for each start and each end."""

from __future__ import annotations

import os
import signal
import time
from collections import Counter
from pathlib import Path

from pb4u.jobs.job import Failure
from pb4u.paper.rollout import ModelRecord, Rollout, RolloutJob, SceneRecord, Settings


def job(motion: str, log: Path | str = "log", model: str = "skinning", **scene: object) -> RolloutJob:
    """A job on a motion called so; `log` is carried in the place of the body."""
    fields = {"garment": "tshirt", "body": str(log), "seed": 2000, "triangles": 400, "frames": 3, **scene}
    return RolloutJob(SceneRecord(motion=motion, **fields), ModelRecord(model, model), Settings())


def attempt(asked: RolloutJob) -> Rollout | Failure:
    """Motions say what happens: "dies-once" and "dies" kill their worker, "refused" comes back as a sentence."""
    motion, log = asked.scene.motion, Path(asked.scene.body)
    begun_before = f"begin {motion}" in noted(log)
    note(log, f"begin {motion}")
    time.sleep(0.05)
    if motion == "dies" or (motion == "dies-once" and not begun_before):
        os.kill(os.getpid(), signal.SIGKILL)
    if motion == "refused":
        return Failure("It is refused.", "")
    note(log, f"end {motion}")
    return Rollout({"motion": motion, "worker": os.getpid()}, None)


def note(log: Path, line: str) -> None:
    with log.open("a") as stream:
        stream.write(line + "\n")


def noted(log: Path) -> Counter[str]:
    return Counter(log.read_text().splitlines()) if log.exists() else Counter()
