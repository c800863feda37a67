"""Attempts at jobs that take no time, and leave a line for each start and each end."""

from __future__ import annotations

import os
import signal
import time
from collections import Counter
from pathlib import Path

from pb4u.jobs.job import Failure, Made
from pb4u.measures.run_job import RunJob
from pb4u.run import Run, WornGarment


def job(motion: str, log: Path | str = "log", model: str = "skinning") -> RunJob:
    """A job on a motion called so; `log` is carried in the place of the body."""
    run = Run(
        (WornGarment("tshirt", triangles=400),), body=str(log), motion=motion, frames=3, model=model, device="cpu"
    )
    return RunJob(run, model, keep="stills")


def attempt(asked: RunJob) -> Made | Failure:
    """Motions say what happens: "dies-once" and "dies" kill their worker, "refused" comes back as a sentence.

    "meets-1" and "meets-2" each wait a minute at most for the other to begin.
    """
    motion, log = str(asked.run.motion), Path(str(asked.run.body))
    begun_before = f"begin {motion}" in noted(log)
    note(log, f"begin {motion}")
    time.sleep(0.05)
    if motion == "dies" or (motion == "dies-once" and not begun_before):
        os.kill(os.getpid(), signal.SIGKILL)
    met, until = {"begin meets-1", "begin meets-2"}, time.monotonic() + 60.0
    while motion.startswith("meets") and not noted(log).keys() >= met and time.monotonic() < until:
        time.sleep(0.05)
    if motion == "refused":
        return Failure("It is refused.", "")
    note(log, f"end {motion}")
    return Made({"motion": motion, "worker": os.getpid()})


def note(log: Path, line: str) -> None:
    with log.open("a") as stream:
        stream.write(line + "\n")


def noted(log: Path) -> Counter[str]:
    return Counter(log.read_text().splitlines()) if log.exists() else Counter()
