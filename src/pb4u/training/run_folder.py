"""The folder of a training: configuration, data, metrics and checkpoints. Killed at any instant, it can go on.

* configuration.json: what is trained, on what, for how long
* data.npz: the training data, so that it goes on with the same
* metrics.jsonl: a line every so many steps, and one for each validation and incident
* last.safetensors: everything a training needs to go on
* best.safetensors: the averaged weights that did best in validation, as `--model` takes them
* final.safetensors: the averaged weights of the end
* curve.png: the run at a glance
"""

from __future__ import annotations

import contextlib
import json
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from pb4u.errors import InputError, on_disk
from pb4u.io.atomic_file import locked, replace_file
from pb4u.io.reading_limits import error_text, parse_json, read_json

FORMAT_VERSION = 1
CONFIGURATION, DATA, METRICS = "configuration.json", "data.npz", "metrics.jsonl"
LAST, BEST, FINAL, CURVE = "last.safetensors", "best.safetensors", "final.safetensors", "curve.png"


class NotSavedError(InputError):
    """A file of a training could not be written; the previous version is still complete."""


@dataclass(frozen=True)
class RunFolder:
    """The files of one training.

    Args:
        path: the folder.
    """

    path: Path

    @staticmethod
    def require_free(path: Path | str) -> None:
        """Refuse a path at which there is anything but an empty folder: raises InputError.

        Args:
            path: path for a new folder.
        """
        folder = RunFolder(Path(path))
        if (folder.path / CONFIGURATION).is_file():
            raise InputError(
                f"{path} already holds a training; continue it with --resume {path}, or give another folder."
            )
        if folder.path.exists() and (not folder.path.is_dir() or any(folder.path.iterdir())):
            raise InputError(f"{path} exists and is not an empty folder; give another one for the training.")

    @staticmethod
    def create(path: Path | str, configuration: dict[str, Any]) -> RunFolder:
        """Make a new folder with its configuration.

        Args:
            path: path of the folder.
            configuration: plain JSON data.

        Raises:
            InputError: it has other content, or cannot be created.
        """
        RunFolder.require_free(path)
        folder = RunFolder(Path(path))
        with on_disk(f"Cannot make the folder {path}"):
            folder.path.mkdir(parents=True, exist_ok=True)
        folder.configure(configuration)
        return folder

    def remove(self) -> None:
        """Delete the configuration and the folder that `create` made."""
        with contextlib.suppress(OSError):
            (self.path / CONFIGURATION).unlink()
            self.path.rmdir()

    def held(self) -> AbstractContextManager:
        """Lock the folder against other trainings.

        Raises:
            InputError: another process is training in the folder.
        """
        with on_disk(f"Cannot use the folder {self.path}"):
            return locked(
                self.path,
                f"Another process is training in {self.path}; wait for it, or end it, before going on with --resume.",
            )

    @staticmethod
    def open(path: Path | str) -> RunFolder:
        """Open an existing folder.

        Args:
            path: of the folder.

        Raises:
            InputError: it is not a folder of a training.
        """
        folder = RunFolder(Path(path))
        if not (folder.path / CONFIGURATION).is_file():
            raise InputError(f"{path} is not a folder of a training: it has no {CONFIGURATION}.")
        return folder

    def configure(self, configuration: dict[str, Any]) -> None:
        """Write the configuration, plain JSON data.

        Args:
            configuration: plain JSON data.
        """
        record = {"format_version": FORMAT_VERSION, **configuration}
        self._replace(CONFIGURATION, (json.dumps(record, indent=2) + "\n").encode())

    def configuration(self) -> dict[str, Any]:
        """Configuration that `configure` wrote.

        Raises:
            InputError: it cannot be read.
        """
        path = self.path / CONFIGURATION
        try:
            record = read_json(path)
            version = int(record["format_version"])
        except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
            raise InputError(f"{path} is not the configuration of a training: {error_text(error)}.") from error
        if version > FORMAT_VERSION:
            raise InputError(f"{path} is of a newer format; upgrade pb4u.")
        return dict(record)

    @property
    def data(self) -> Path:
        """Path of the training data."""
        return self.path / DATA

    @property
    def best(self) -> Path:
        """Path of the best weights in validation."""
        return self.path / BEST

    @property
    def final(self) -> Path:
        """Path of the weights of the end."""
        return self.path / FINAL

    def save_state(self, tensors: dict[str, Tensor], counters: dict[str, Any]) -> None:
        """Replace the last checkpoint in one move.

        Args:
            tensors: (...) each as in the model, by name, in the units that `Learner.state` gives them.
            counters: progress, as `Counters.to_json` gives it.

        Raises:
            NotSavedError: it cannot be written.
        """
        content = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
        self._replace(LAST, save(content, {"pb4u_training": str(FORMAT_VERSION), "counters": json.dumps(counters)}))

    def load_state(self) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """Tensors (...) by name and counters of the last checkpoint, in their unit; None where there is none yet.

        Raises:
            InputError: a file that is not a checkpoint.
        """
        path = self.path / LAST
        if not path.is_file():
            return None
        try:
            with safe_open(path, framework="pt") as file:
                metadata = file.metadata() or {}
                counters = parse_json(metadata["counters"])
                return {key: file.get_tensor(key) for key in file.keys()}, counters  # noqa: SIM118
        except (SafetensorError, OSError, KeyError, ValueError) as error:
            raise InputError(f"{path} is not a checkpoint of a training ({error_text(error)}).") from error

    def append_metrics(self, record: dict[str, Any]) -> None:
        """Add a line to the metrics.

        Args:
            record: plain JSON data of one line.

        Raises:
            NotSavedError: it cannot be written.
        """
        file = self.path / METRICS
        with on_disk(f"Cannot write {file}", NotSavedError), open(file, "a", encoding="utf-8") as out:
            out.write(json.dumps(record) + "\n")

    def metrics(self) -> list[dict[str, Any]]:
        """Lines of the metrics, without incomplete ones."""
        lines = []
        with contextlib.suppress(FileNotFoundError), (self.path / METRICS).open("rb") as stream:
            for line in stream:
                # One that a kill cut in two is not JSON, or no text.
                with contextlib.suppress(ValueError):
                    record = parse_json(line)
                    if isinstance(record, dict):
                        lines.append(record)
        return lines

    def forget_metrics_after(self, step: int) -> None:
        """Delete the lines of the metrics after a `step`, since later steps will be repeated.

        Args:
            step: last step whose lines are kept.
        """
        lines = [line for line in self.metrics() if line.get("step", 0) <= step]
        self._replace(METRICS, "".join(json.dumps(line) + "\n" for line in lines).encode())

    def forget_leftovers(self) -> None:
        """Delete files that a killed process had begun to write."""
        for name in (CONFIGURATION, DATA, METRICS, LAST, BEST, FINAL):
            for leftover in self.path.glob(f".{name}.*"):
                leftover.unlink(missing_ok=True)

    def _replace(self, name: str, content: bytes) -> None:
        """Write a file beside and move it into place: it is always the old one or the new one."""
        path = self.path / name
        with on_disk(f"Cannot write {path}", NotSavedError):
            replace_file(path, content)
