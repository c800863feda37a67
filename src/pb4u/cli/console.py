"""What every verb shares: the progress bar, JSON output and the flag values that are more than a word."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import typer

from pb4u.atomic_file import replace_file
from pb4u.errors import InputError
from pb4u.export.registry import formats_help, written_files

Progress = Callable[[int, int], None]

SHAPE_EXAMPLES = "such as height=0.7,weight=0.4, or beta0=1.5,beta1=-0.5 of an SMPL-family file"
FORMATS = formats_help()


@contextmanager
def progress_bar(label: str) -> Iterator[Progress]:
    """A bar with the time left, on standard error; silent where that is not a terminal."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(label, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def write_json(payload: Mapping[str, Any], target: str) -> None:
    """Write `payload` to a file, or to standard output for "-". Non-finite numbers become null."""
    text = json.dumps(_finite(payload), indent=2)
    if target == "-":
        print(text)
        return
    check_json_target(target)
    replace_file(Path(target), (text + "\n").encode())


def wrote(targets: Iterable[Path], frames: int) -> str:
    """One line on the files that the export of `frames` frames to `targets` left; long sequences by their ends."""
    told: list[str] = []
    for target in targets:
        files = [str(file) for file in written_files(target, frames)]
        told += [f"{files[0]} to {files[-1]}"] if len(files) > 2 else files
    return f"Wrote {', '.join(dict.fromkeys(told))}"


def check_json_target(target: str | None) -> None:
    """Raises InputError when the file of --json cannot be written; called before any work is done."""
    if target and target != "-":
        check_writable(Path(target), "--json")


def check_writable(path: Path, flag: str) -> None:
    """Raises InputError when the file that `flag` names cannot be written; called before any work is done."""
    if not path.parent.is_dir():
        raise InputError(f"The folder {path.parent} for {flag} does not exist; make it first.")
    if path.is_dir():
        raise InputError(f"{path} for {flag} is a folder; give the name of a file.")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"The folder {path.parent} for {flag} cannot be written to.")


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else None
    if isinstance(value, Mapping):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return value


class BodyShape(dict[str, float]):
    """Shape parameters of a body by name."""

    @classmethod
    def parse(cls, text: str) -> BodyShape:
        """From `height=0.7,weight=0.4`. Raises BadParameter on anything else."""
        shape = cls()
        for entry in text.split(","):
            if not entry.strip():
                continue
            key, equals, value = entry.partition("=")
            try:
                shape[key.strip()] = float(value)
            except ValueError:
                equals = ""
            if not equals:
                raise typer.BadParameter(f"it takes KEY=VALUE pairs such as height=0.7,weight=0.4; {entry!r} is none.")
        return shape


class FrameRange(NamedTuple):
    """Frames first..stop-1."""

    first: int
    stop: int

    @classmethod
    def parse(cls, text: str) -> FrameRange:
        """From `A:B`, B exclusive. Raises BadParameter on anything else."""
        first, colon, stop = text.partition(":")
        if colon and first.strip().isdecimal() and stop.strip().isdecimal() and int(first) < int(stop):
            return cls(int(first), int(stop))
        raise typer.BadParameter(f"a range is A:B, frame A to frame B-1 with 0 <= A < B, such as 30:120; not {text!r}.")
