"""Ends runs at random instants and looks at what is left: `python -m tests.kills --trials 50`.

Of `simulate`, `convert`, `train` and `evaluate` in turn, by SIGKILL, SIGTERM, SIGHUP and SIGINT in turn; some of them
on a small disk, also one that is nearly full instead of a signal (`--small FOLDER`, of a few MB, such as a tmpfs:
`unshare -rm sh -c 'mount -t tmpfs -o size=64m tmpfs FOLDER && python -m tests.kills --small FOLDER'`).
After each: inputs are as they were; what has an output's name is whole; nothing hidden stays, after a SIGKILL once the
same command has run again; and that command ends with the same numbers as one that nobody disturbed.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file
from tests.training.ball_data import ball_data

from pb4u.io.atomic_file import MARK
from pb4u.jobs.job import digest
from pb4u.scene.trajectory import Trajectory
from pb4u.training.packed_data import save_training_data

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
PB4U = (sys.executable, "-c", "from pb4u.cli.main import main; main()")
_SPARE = 3 * 2**18
"""Bytes left at most on a small disk that is nearly full: about what the runs write."""
_BEGUN = 0.2
"""Seconds in which Python itself has begun, which answers an interrupt in its own way."""


class Run(ABC):
    """A command with what it reads and writes.

    Args:
        name: of the run.
        inputs: files that it reads, by name in the folder of inputs.
        arguments: of the command; it runs in an empty folder, beside the folder of inputs.
    """

    def __init__(self, name: str, inputs: Sequence[str], *arguments: object) -> None:
        self.name, self.inputs = name, inputs
        self.arguments = [str(each) for each in arguments]

    def again(self, folder: Path) -> list[str]:
        """Arguments that go on where an ended run was."""
        return self.arguments

    @abstractmethod
    def numbers(self, folder: Path) -> Mapping[str, Any]:
        """What the run came to, by name; raises for a file that is not whole."""


class Files(Run):
    """A run that writes files, whole or not at all.

    Args:
        outputs: names of the files.
    """

    def __init__(self, name: str, inputs: Sequence[str], outputs: Sequence[str], *arguments: object) -> None:
        super().__init__(name, inputs, *arguments)
        self.outputs = outputs

    def numbers(self, folder: Path) -> Mapping[str, Any]:
        found: dict[str, Any] = {}
        for path in sorted(folder.iterdir()):
            if path.name.startswith("."):
                continue
            known = path.name in self.outputs or path.name.endswith(".interrupted.npz")
            assert known, f"{path.name} is left"
            if path.suffix == ".npz":
                trajectory = Trajectory.open(path)
                found[path.name] = (np.array(trajectory.positions).tobytes(), np.array(trajectory.velocities).tobytes())
            else:
                found[path.name] = path.stat().st_size if path.suffix == ".mp4" else path.read_bytes()
        return found


class Training(Run):
    """A training."""

    def again(self, folder: Path) -> list[str]:
        begun = (folder / "run" / "configuration.json").is_file() and (folder / "run" / "data.npz").is_file()
        return ["train", "--resume", "run", "--device", "cpu"] if begun else self.arguments

    def numbers(self, folder: Path) -> Mapping[str, Any]:
        run = folder / "run"
        found: dict[str, Any] = {}
        for name in ("last.safetensors", "best.safetensors", "final.safetensors"):
            if (run / name).is_file():
                found[name] = {key: value.tobytes() for key, value in load_file(run / name).items()}
        if (run / "metrics.jsonl").is_file():
            lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines() if line[-1:] == "}"]
            found["losses"] = {line["step"]: line["total"] for line in lines if "total" in line}
        return found


class Evaluation(Run):
    """An evaluation."""

    def numbers(self, folder: Path) -> Mapping[str, Any]:
        results = folder / "run" / "results.json"
        if not results.is_file():
            return {}
        rows = json.loads(results.read_text())["rollouts"]
        told = ("total", "stretch", "strain_p95", "penetration_percent")
        return {str(k): {name: row["result"]["metrics"][name] for name in told} for k, row in enumerate(rows)}


SKINNED = ("--triangles", 1000, "--model", "skinning", "--lead-in", 0)
TRAINED = (
    "network.width=8", "checkpoint_every=4", "log_every=2", "validate_every=12", "validation_frames=3",
    "statistics_windows=2",
)  # fmt: skip
RUNS = (
    Files("simulate", ["tube.obj"], ["a.npz", "a.pc2", "a.obj"], "simulate", *SKINNED, "--frames", 20,
          "--out", "a.npz", "--out", "a.pc2"),
    Files("convert to glb", ["t.npz"], ["c.glb"], "convert", "../inputs/t.npz", "c.glb"),
    Files("convert to usd", ["t.npz"], ["c.usdc"], "convert", "../inputs/t.npz", "c.usdc"),
    Files("convert to mp4", ["t.npz"], ["c.mp4"], "convert", "../inputs/t.npz", "c.mp4", "--range", "0:5"),
    Training("train", ["pack.npz"], "train", "--pack", "../inputs/pack.npz", "--preset", "smoke", "--steps", 16,
             "--out", "run", "--device", "cpu", *(f"--set={each}" for each in TRAINED)),
    Evaluation("evaluate", [], "evaluate", "--models", "skinning", "--garments", "tshirt", "--levels", 400,
               "--frames", 2, "--lead-in", 0, "--floors", "stored", "--motions", "walk,jump", "--out", "run"),
)  # fmt: skip


class Place:
    """A folder of inputs, and beside it one for each run.

    Args:
        path: where.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.inputs = path, path / "inputs"
        self.inputs.mkdir(parents=True)
        save_training_data(ball_data((8,)), self.inputs / "pack.npz")
        frames = ("--frames", 15, "--out", "t.npz")
        _finished([*PB4U, *map(str, ("simulate", *SKINNED, *frames))], self.inputs)
        self.before = digest(self.inputs)

    def emptied(self) -> Path:
        """An empty folder to run in."""
        shutil.rmtree(self.path / "work", ignore_errors=True)
        (self.path / "work").mkdir()
        return self.path / "work"


def _finished(command: list[str], folder: Path) -> tuple[float, str]:
    begun = time.monotonic()
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    return time.monotonic() - begun, ended.stderr


def _answer() -> None:
    """Let a run answer signals as from a terminal: what is begun in the background has some of them ignored."""
    for number in SIGNALS[1:]:
        signal.signal(number, signal.SIG_DFL)


def _ended_by(run: Run, folder: Path, number: signal.Signals, after: float) -> tuple[int, str]:
    """Exit code and last words of a run that gets a signal after so many seconds."""
    process = subprocess.Popen(
        [*PB4U, *run.arguments], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        preexec_fn=_answer,
    )  # fmt: skip
    time.sleep(after)
    process.send_signal(number)
    _, said = process.communicate()
    return process.returncode, said


def _without_room(run: Run, folder: Path, spare: int) -> tuple[int, str]:
    filler = folder.parent / "filler"
    free = shutil.disk_usage(folder).free
    filler.write_bytes(bytes(max(0, free - spare)))
    ended = subprocess.run([*PB4U, *run.arguments], cwd=folder, capture_output=True, text=True, check=False)
    filler.unlink()
    return ended.returncode, ended.stderr


def _hidden(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob(f".*{MARK}"))


def _trial(run: Run, way: signal.Signals | int, after: float, place: Place, sound: Mapping[str, Any]) -> str:
    """How a trial ended, in a word; raises AssertionError for what is wrong."""
    folder = place.emptied()
    by_signal = isinstance(way, signal.Signals)
    code, said = _ended_by(run, folder, signal.Signals(way), after) if by_signal else _without_room(run, folder, way)
    assert "Traceback" not in said, said
    assert digest(place.inputs) == place.before, "an input was changed"
    catchable = way != signal.SIGKILL
    word = "killed" if not catchable else {0: "done", 1: "refused"}.get(code, "interrupted")
    if by_signal:
        # A signal before Python has begun, or after the work, is answered by the system or not at all.
        allowed = {0, -way, 128 + way} | ({1} if run.name == "evaluate" else set())
        assert code in allowed, f"exit code {code}: {said}"
    if catchable and code >= 0:
        assert not _hidden(folder), f"left: {_hidden(folder)}"
    early = run.numbers(folder)
    if not isinstance(run, Training):
        assert all(early[name] == sound[name] for name in early if name in sound), "what there is, is something else"
    _finished([*PB4U, *run.again(folder)], folder)
    assert not _hidden(folder), f"left after the next run: {_hidden(folder)}"
    late = run.numbers(folder)
    assert all(late[name] == sound[name] for name in sound), "the run came to other numbers"
    return word


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--small", type=Path, help="folder on a disk of a few MB")
    asked = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"
    endings: Counter[str] = Counter()
    wrong = 0
    with tempfile.TemporaryDirectory() as there:
        os.environ["XDG_CACHE_HOME"] = f"{there}/cache"
        places = [Place(Path(there) / "large"), *([Place(asked.small / "small")] if asked.small else [])]
        sound, length = {}, {}
        for run in RUNS:
            folder = places[0].emptied()
            _finished([*PB4U, *run.arguments], folder)
            length[run.name], _ = _finished([*PB4U, *run.arguments], places[0].emptied())
            sound[run.name] = run.numbers(folder)
            print(f"{run.name}: {length[run.name]:.1f} s", flush=True)
        for number in range(asked.first, asked.first + asked.trials):
            rng = random.Random(number)
            run = RUNS[number % len(RUNS)]
            small = asked.small is not None and rng.random() < 0.3
            # Either a signal, or so many bytes that are left on the disk.
            way = rng.randrange(_SPARE) if small and rng.random() < 0.6 else SIGNALS[number % len(SIGNALS)]
            after = _BEGUN + rng.random() * length[run.name]
            ended_by = f"{way.name} after {after:.2f} s" if isinstance(way, signal.Signals) else f"{way:,} bytes left"
            told = f"{number}: {run.name}, {ended_by}"
            told += " on a small disk" if small else ""
            try:
                word = _trial(run, way, after, places[-1 if small else 0], sound[run.name])
            except AssertionError as error:
                wrong += 1
                word = f"WRONG: {error}"
            endings[word.partition(":")[0]] += 1
            print(f"{told}: {word}", flush=True)
    print(f"{asked.trials} trials: {dict(endings)}")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
