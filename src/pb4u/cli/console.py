"""What every verb shares: the progress bar, JSON output and small parsers of flag values."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pb4u.atomic_file import replace_file
from pb4u.errors import InputError

Progress = Callable[[int, int], None]


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


def check_json_target(target: str | None) -> None:
    """Raises InputError when the folder of a --json file does not exist; called before any work is done."""
    if target and target != "-" and not Path(target).parent.is_dir():
        raise InputError(f"The folder {Path(target).parent} for --json does not exist; make it first.")


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else None
    if isinstance(value, Mapping):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return value


def parse_shape(text: str | None) -> dict[str, float]:
    """`height=0.7,weight=0.4` as a mapping. Raises InputError on anything else."""
    shape: dict[str, float] = {}
    for entry in (text or "").split(","):
        if not entry.strip():
            continue
        key, equals, value = entry.partition("=")
        try:
            shape[key.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--body-shape takes KEY=VALUE pairs such as height=0.7,weight=0.4; {entry!r} is none.")
    return shape


def parse_crop(text: str | None) -> tuple[int, int] | None:
    """`A:B` as whole frame numbers, B exclusive. Raises InputError on anything else."""
    if text is None:
        return None
    first, colon, last = text.partition(":")
    if colon and first.strip().isdecimal() and last.strip().isdecimal() and int(first) < int(last):
        return int(first), int(last)
    raise InputError(f"A range is A:B, frame A to frame B-1 with 0 <= A < B, such as 30:120; {text!r} is none.")
