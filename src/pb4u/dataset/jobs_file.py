"""Jobs files: many runs described at once, as products and lists of the entries of scene files.

TOML holds `[fixed]` entries of every clip, lists in `[product]` of which every combination is a clip, and `[[clips]]`
one by one. Besides the entries of a scene file without their sections, `scene` names a scene file that the others
change.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from pb4u.errors import InputError
from pb4u.io.toml_file import read_tables
from pb4u.options import is_whole
from pb4u.run import ENTRIES, Run
from pb4u.scene_file import OF_BEFORE, require_entries, require_format

MOST_CLIPS = 100_000
"""Clips of one jobs file unless more are allowed: ten times the usual dataset, and what a slip of the pen exceeds."""
FORMAT_VERSION = 1
_SCENE = "scene"
_KNOWN = (_SCENE, *ENTRIES)
_TOLD = 4
"""Entries of a clip that a refusal names: enough to find its line."""


def read_jobs(path: Path, most: int = MOST_CLIPS) -> tuple[Run, ...]:
    """The runs of a jobs file, those of the product first, its last entry varying fastest.

    Args:
        path: the file, .toml; paths in it are relative to it.
        most: clips that it may describe.

    Raises:
        InputError: it is missing or not of its format, describes none or too many, or an entry is unknown or has a
            value that cannot be used.
    """
    if path.suffix.lower() == ".csv":
        raise InputError(
            f"{path}: CSV tables are no longer read; write each row as a [[clips]] section of a .toml file."
        )
    if path.suffix.lower() != ".toml":
        raise InputError(f"{path} is not a jobs file; its name must end in .toml.")
    if not path.is_file():
        raise InputError(f"There is no jobs file {path}.")
    tables = read_tables(path, "a jobs file")
    try:
        count, clips = _described_clips(tables)
        if not count:
            raise InputError("it describes no clip; give lists in [product], or [[clips]].")
        if count > most:
            raise InputError(
                f"it describes {count:,} clips; a data set has at most {most:,}; shorten a list, or raise --most-clips."
            )
        scenes: dict[Path, Run] = {}
        # Absolute, so that a worker finds the files from wherever it runs.
        folder = path.absolute().parent
        return tuple(_run(number, entries, folder, scenes) for number, entries in enumerate(clips, start=1))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _run(number: int, entries: Mapping[str, Any], folder: Path, scenes: dict[Path, Run]) -> Run:
    """The run of one clip; `scenes` holds the scene files that were read."""
    changed = {name: value for name, value in entries.items() if name != _SCENE}
    try:
        described = Run(**OF_BEFORE)
        if _SCENE in entries:
            if not isinstance(entries[_SCENE], str):
                raise InputError(f"scene must be the name of a scene file, not {entries[_SCENE]!r}.")
            file = folder / entries[_SCENE]
            if file not in scenes:
                scenes[file] = Run.open(file)
            described = scenes[file]
        return described.with_entries(changed, folder)
    except InputError as error:
        values = ", ".join(f"{name} = {value}" for name, value in list(entries.items())[:_TOLD])
        raise InputError(f"clip {number} ({values}): {error}") from None


def _described_clips(tables: dict[str, Any]) -> tuple[int, Iterator[dict[str, Any]]]:
    require_format(tables, ("fixed", "product", "clips"), FORMAT_VERSION)
    fixed = require_entries("[fixed]", tables.get("fixed", {}), _KNOWN)
    varied = require_entries("[product]", tables.get("product", {}), _KNOWN)
    lists = {name: _choices(name, value) for name, value in varied.items()}
    clip_tables = tables.get("clips", [])
    if not isinstance(clip_tables, list):
        raise InputError("each clip must be a section of its own, written [[clips]].")
    singles = [require_entries("[[clips]]", clip, _KNOWN) for clip in clip_tables]
    for name in lists:
        if name in fixed:
            raise InputError(f"{name} is in both [fixed] and [product]; keep it in one.")
    products = math.prod(len(values) for values in lists.values()) if lists else 0

    def clips() -> Iterator[dict[str, Any]]:
        if lists:
            for values in product(*lists.values()):
                yield {**fixed, **dict(zip(lists, values, strict=True))}
        for clip in singles:
            yield {**fixed, **clip}

    return products + len(singles), clips()


def _choices(name: str, value: Any) -> Sequence[Any]:
    """The values of an entry of the product; seeds may be a range."""
    if name == "seed" and isinstance(value, dict):
        if set(value) != {"first", "count"} or not all(is_whole(bound) for bound in value.values()):
            raise InputError(f"seeds must be a list, or {{ first = 0, count = 10 }} in whole numbers, not {value!r}.")
        return range(value["first"], value["first"] + value["count"])
    if not isinstance(value, list):
        raise InputError(f"{name} in [product] must be a list of values; a single one belongs in [fixed].")
    return value
