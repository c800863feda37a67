"""Arrays of numbers in files: read from lists or arrays, and checked against one layout."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.errors import InputError
from pb4u.io.reading_limits import names_text

Layout = Mapping[str, tuple[str, tuple[str | int | None, ...]]]
"""Member -> kinds of its numbers as numpy's letters, and its shape. Counts of one name agree over all members; None is
any length."""

_KINDS = {
    "f": "decimal numbers",
    "b": "yes or no",
    "iu": "whole numbers",
    "i": "whole numbers",
    "fiu": "numbers",
    "fiub": "numbers",
    "U": "text",
}


_RATE_ROUNDING = 2e-4
"""Share by which files round a frame rate: 0.033333 s a frame are 30.0003 a second. 29.97 is another rate than 30."""


def unrounded_rate(fps: float) -> float:
    """The whole number of frames per second from which a stored rate, or time of a frame, was rounded; else the rate
    itself.

    Args:
        fps: as stored [1/s].
    """
    return float(round(fps)) if abs(fps - round(fps)) <= _RATE_ROUNDING * fps else fps


def stored_numbers(value: object, where: str | Path, name: str) -> np.ndarray:
    """The real numbers (...) in a value that a file holds: an array, or lists of numbers.

    Args:
        value: whatever the file holds.
        where: the file, for the message.
        name: name of the value there.

    Raises:
        InputError: it holds something else.
    """
    values = _array(value)
    if values is None or values.dtype.kind not in "fiub":
        raise InputError(f'{where}: "{name}" is not an array of numbers.')
    return values


def _array(value: Any) -> Any:
    if hasattr(value, "tocsr"):  # a sparse matrix of scipy
        return value
    try:
        values = np.asarray(value)
        return values.astype(np.float64) if values.dtype.kind == "O" else values
    except (TypeError, ValueError, OverflowError):
        return None


def read_members(
    content: object, layout: Layout, refuse: Callable[[str], InputError], optional: Collection[str] = ()
) -> tuple[dict[str, Any], dict[str, int]]:
    """Arrays (...) of a dictionary that a file holds, in the units of the file.

    Args:
        content: whatever the file holds.
        layout: kinds and shapes that its members should have.
        refuse: gives the error for a sentence on what does not fit.
        optional: members that may be missing.

    Returns:
        The arrays by name, and every count by its name.

    Raises:
        InputError: whatever `refuse` gives, for the first member that is missing or does not fit.
    """
    if not isinstance(content, Mapping):
        raise refuse(f"it holds a {type(content).__name__}, not a dictionary")
    if missing := [name for name in layout if name not in content and name not in optional]:
        raise refuse(f"it has no {' and no '.join(missing)}; it holds {names_text(content)}")
    arrays = {name: _array(content[name]) for name in layout if name in content}
    if odd := [name for name, values in arrays.items() if values is None]:
        raise refuse(f'"{odd[0]}" is not an array of numbers')
    return arrays, require_layout(arrays, layout, refuse)


def require_layout(
    members: Mapping[str, np.ndarray], layout: Layout, refuse: Callable[[str], InputError]
) -> dict[str, int]:
    """Refuse arrays of a file whose kinds and shapes do not fit together.

    Args:
        members: arrays (...) by name, in the units of their file; absent ones are ignored.
        layout: kinds and shapes that they should have.
        refuse: gives the error for a sentence on what does not fit.

    Returns:
        Every count by its name.

    Raises:
        InputError: whatever `refuse` gives, for the first member that does not fit.
    """
    counts: dict[str, int] = {}
    for name, (kinds, shape) in layout.items():
        values = members.get(name)
        if values is None:
            continue
        if values.dtype.kind not in kinds:
            raise refuse(f"{name} holds {values.dtype}, not {_KINDS[kinds]}")
        fits = len(values.shape) == len(shape) and all(
            count is None or length == (counts.setdefault(count, length) if isinstance(count, str) else count)
            for length, count in zip(values.shape, shape, strict=True)
        )
        if not fits:
            expected = ", ".join(
                "any" if count is None else f"{count} = {counts[count]}" if count in counts else str(count)
                for count in shape
            )
            raise refuse(f"{name} has the shape {values.shape}, not ({expected})")
    return counts


def require_places(
    members: Mapping[str, np.ndarray],
    points_at: Mapping[str, str],
    counts: Mapping[str, int],
    refuse: Callable[[str], InputError],
) -> None:
    """Refuse indices in a file that are out of range.

    Args:
        members: arrays (...) by name, in the units of their file; absent ones are ignored.
        points_at: member of indices -> the count that they stay below.
        counts: as `require_layout` gives them.
        refuse: gives the error for a sentence on what does not fit.

    Raises:
        InputError: whatever `refuse` gives, for the first member that does not fit.
    """
    for name, count in points_at.items():
        values = members.get(name)
        if values is not None and values.size and (values.min() < 0 or values.max() >= counts.get(count, 0)):
            raise refuse(f"{name} has indices beyond its {counts.get(count, 0)} {count}")
