"""How much a file may make a reader take: sizes, counts and depths, checked before the memory is.

Every reader of the package asks here. A file may take `HEADROOM` more than its own size; what would take more is
refused, in a sentence that says so.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pb4u.errors import InputError

HEADROOM = 256 * 2**20
"""Bytes that reading a file may take over its size."""
MOST_TEXT = 8 * 2**20
"""Bytes of a text that is parsed at once (JSON, TOML, a header): an empty list of 3 bytes takes 64 in memory."""
MOST_NUMBERS_TEXT = 64 * 2**20
"""Bytes of a text of numbers that is read line by line: two characters make a number of 8 bytes."""
MOST_LINE = 4 * 2**20
"""Bytes of one line of a text that is read line by line; a word of two takes 60 in memory."""
MOST_DEPTH = 64
"""Lists and objects of a JSON text that lie within each other."""
MOST_DIGITS = 18
"""Digits of a whole number in JSON; those of a 64-bit number."""
MOST_JOINTS = 1000
"""Joints of a recorded skeleton; the largest known has some 170."""
MOST_MEMBERS = 10_000
"""Members of an archive; its directory takes some 600 bytes for each."""

_MOST_TOLD = 200
"""Characters of what a library says of a file that are passed on."""


class Allowance:
    """Memory that reading one file may take: its size and `HEADROOM`.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.whole = self.left = path.stat().st_size + HEADROOM

    def take(self, size: int, what: str) -> None:
        """Count memory before it is taken.

        Args:
            size: bytes.
            what: what takes them, such as "its member poses".

        Raises:
            InputError: the file has taken what it may.
        """
        if size > self.left:
            raise InputError(
                f"{self.path}: {what} would take {megabytes(size + self.whole - self.left)}, and a file of "
                f"{megabytes(self.whole - HEADROOM)} may take {megabytes(self.whole)} (its size and "
                f"{megabytes(HEADROOM)}); save it uncompressed, or in smaller parts."
            )
        self.left -= size


def megabytes(size: int) -> str:
    """Bytes in megabytes, for a message."""
    return f"{size / 2**20:,.0f} MB" if size >= 2**20 else f"{size:,} bytes"


def require_size(path: Path, most: int, kind: str) -> None:
    """Refuse a file that is larger than its kind may be.

    Args:
        path: the file.
        most: bytes that it may have.
        kind: what it is, such as "a JSON file".

    Raises:
        InputError: it is larger.
        OSError: it cannot be looked at.
    """
    if (size := path.stat().st_size) > most:
        raise InputError(f"{path} has {megabytes(size)}, and {kind} may have {megabytes(most)}.")


def read_text(path: Path, kind: str, most: int = MOST_TEXT, encoding: str = "utf-8", errors: str = "strict") -> str:
    """The text of a file.

    Args:
        path: the file.
        kind: what it is, such as "a JSON file".
        most: bytes that it may have.
        encoding: of the text.
        errors: as `bytes.decode` takes them.

    Raises:
        InputError: it is larger.
        OSError: it cannot be read.
        UnicodeDecodeError: it is not of that encoding.
    """
    require_size(path, most, kind)
    return path.read_text(encoding=encoding, errors=errors)


def parse_json(text: str | bytes, where: str | Path, most: int = MOST_TEXT) -> Any:
    """The data of a JSON text of bounded size, depth and digits.

    Args:
        text: the JSON.
        where: what holds it, for the message.
        most: characters that it may have.

    Raises:
        InputError: it is too large, nests too deep or holds a number of too many digits.
        ValueError: it is no JSON.
    """
    if isinstance(text, bytes):
        text = text.decode("utf-8")
    if len(text) > most:
        raise InputError(f"{where}: its JSON has {megabytes(len(text))}, and may have {megabytes(most)}.")
    depth = 0
    for match in re.finditer(r'"(?:[^"\\]|\\.)*"|[\[{]|[\]}]', text):
        depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(match.group(), 0)
        if depth > MOST_DEPTH:
            raise InputError(f"{where}: its JSON nests more than {MOST_DEPTH} lists and objects in each other.")

    def whole(digits: str) -> int:
        if len(digits.lstrip("-")) > MOST_DIGITS:
            raise InputError(f"{where}: it holds a whole number of {len(digits):,} digits; {MOST_DIGITS} are the most.")
        return int(digits)

    return json.loads(text, parse_int=whole)


def read_json(path: Path, most: int = MOST_TEXT) -> Any:
    """The data of a JSON file.

    Args:
        path: the file.
        most: bytes that it may have.

    Raises:
        InputError: it is too large, nests too deep or holds a number of too many digits.
        OSError: it cannot be read.
        ValueError: it is no JSON.
    """
    return parse_json(read_text(path, "a JSON file", most), path, most)


def read_lines(path: Path, kind: str) -> Iterator[str]:
    """The lines of a text of numbers, one at a time; bytes that are no text stand as they are in latin-1.

    Args:
        path: the file.
        kind: what it is, such as "a recording".

    Raises:
        InputError: the file or one of its lines is too long.
        OSError: it cannot be read.
    """
    require_size(path, MOST_NUMBERS_TEXT, kind)
    with path.open("rb") as stream:
        number = 0
        while line := stream.readline(MOST_LINE + 1):
            number += 1
            if len(line) > MOST_LINE:
                raise InputError(f"{path}: line {number} has over {megabytes(MOST_LINE)}, which no line of {kind} has.")
            yield from line.decode("latin-1").splitlines() or [""]


def told_names(names: Iterable[object]) -> str:
    """The first of many names, for a message."""
    ordered = sorted(str(name)[:40] for name in names)
    return ", ".join(ordered[:10]) + (f" and {len(ordered) - 10} more" if len(ordered) > 10 else "") or "(none)"


def told_error(error: BaseException) -> str:
    """What a library says of a file, cut to a sentence's length: some repeat the file."""
    text = str(error) or type(error).__name__
    return text if len(text) <= _MOST_TOLD else f"{text[:_MOST_TOLD]} .."


def require_small_header(path: Path) -> None:
    """Refuse a safetensors file whose header is too large or too deep to be parsed.

    Raises:
        InputError: it is.
        OSError: the file cannot be read.
        ValueError: the header is no JSON.
    """
    with path.open("rb") as stream:
        length = int.from_bytes(stream.read(8), "little")
        if length > path.stat().st_size:
            raise ValueError("it is cut short, or of another kind")
        if length > MOST_TEXT:
            raise InputError(f"{path}: its header has {megabytes(length)}, and may have {megabytes(MOST_TEXT)}.")
        parse_json(stream.read(length), path)
