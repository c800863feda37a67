"""How much a file may make a reader take: sizes, counts and depths, checked before the memory is.

Every reader of the package asks here. A file may take `HEADROOM` more than its own size; what would take more is
refused, in a sentence that says so.
"""

from __future__ import annotations

import json
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import Any, NamedTuple

import numpy as np

from pb4u.errors import InputError

HEADROOM = 256 * 2**20
"""Bytes that reading a file may take over its size."""
MOST_TEXT = 8 * 2**20
"""Bytes of a text that is parsed at once (JSON, TOML, a header): an empty list of 3 bytes takes 64 in memory."""
MOST_NUMBERS_TEXT = 64 * 2**20
"""Bytes of a text of numbers that is read line by line: two characters make a number of 8 bytes."""
MOST_LINE = 4 * 2**20
"""Bytes of one line of a text that is read line by line; a word of two takes 60 in memory."""
_NUMBERS_AT_ONCE = 1 << 20
"""Characters of a text of numbers that are taken apart at once."""
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

_ARRAY_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_DIRECTORY_END = b"PK\x05\x06"
_DIRECTORY_END_64 = b"PK\x06\x06"
_UNREADABLE = (
    OSError, ValueError, EOFError, IndexError, KeyError, TypeError, NotImplementedError, RuntimeError, MemoryError,
    struct.error, zipfile.BadZipFile, zlib.error, TokenError,
)  # fmt: skip
"""What the readers of zipfile and numpy raise on damaged files."""


class DamagedArchiveError(InputError):
    """A file is no readable archive of plain arrays.

    Args:
        path: the file.
        reason: what its reader said.
    """

    def __init__(self, path: Path, reason: object) -> None:
        super().__init__(f"{path}: not a readable .npz of plain arrays ({reason}).")
        self.reason = str(reason)


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


def parse_numbers(text: str) -> np.ndarray:
    """The numbers (n,) float64 of a text, in any unit, some at a time: words take eight times the room.

    Args:
        text: numbers between blanks.

    Raises:
        ValueError: a word is none.
    """
    parts: list[np.ndarray] = []
    start = 0
    while start < len(text):
        stop = min(start + _NUMBERS_AT_ONCE, len(text))
        while stop < len(text) and not text[stop].isspace():
            stop += 1
        parts.append(np.array([float(word) for word in text[start:stop].split()]))
        start = stop
    return np.concatenate(parts) if parts else np.zeros(0)


class ArrayLayout(NamedTuple):
    """What the header of a stored array tells.

    Args:
        shape: number of entries along each axis.
        fortran: whether the first axis runs fastest.
        dtype: data type of the entries.
    """

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype

    @property
    def size(self) -> int:
        """Bytes of the entries."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_layout(stream: Any, name: str, most: int) -> ArrayLayout:
    """The header of an .npy array, of which nothing is read yet.

    Args:
        stream: binary stream at its beginning, then at the entries.
        name: name of the array, for the message.
        most: bytes that the file has for the entries.

    Raises:
        ValueError: the header is damaged, or tells of Python objects or of more entries than there are.
    """
    version = np.lib.format.read_magic(stream)
    if version not in _ARRAY_HEADERS:
        raise ValueError(f"member {name} has an array header of version {version[0]}.{version[1]}")
    layout = ArrayLayout(*_ARRAY_HEADERS[version](stream))
    if layout.dtype.hasobject:
        raise ValueError(f"member {name} holds Python objects")
    if min(layout.shape, default=0) < 0:
        raise ValueError(f"member {name} has the shape {layout.shape}")
    if layout.size > most:
        raise ValueError(f"member {name} is cut short")
    return layout


@contextmanager
def open_archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """A zip file whose directory is of bounded size; a member gives the bytes that the directory tells, or fewer.

    Args:
        path: the file.

    Raises:
        InputError: there is no such file, it is no zip file, or one with too many members or of a compression whose
            output has no bound.
    """
    try:
        _require_small_directory(path)
        archive = zipfile.ZipFile(path)
    except FileNotFoundError as error:
        raise InputError(f"There is no file {path}.") from error
    except InputError:
        raise
    except _UNREADABLE as error:
        raise DamagedArchiveError(path, error) from error
    with archive:
        plain = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        odd = next((member for member in archive.infolist() if member.compress_type not in plain), None)
        if odd is not None:
            raise InputError(f'{path}: its member "{odd.filename[:60]}" is compressed in a way that is not read.')
        yield archive


def _require_small_directory(path: Path) -> None:
    """Refuse too many members before zipfile makes an object of each."""
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(0, size - (1 << 16) - 128))
        tail = stream.read()
    end, end_64 = tail.rfind(_DIRECTORY_END), tail.rfind(_DIRECTORY_END_64)
    told = [struct.unpack_from("<H", tail, end + 10)[0]] if 0 <= end <= len(tail) - 22 else []
    # A directory entry has 46 bytes at least: its size bounds what zipfile makes of it, whatever number is told.
    told += [struct.unpack_from("<I", tail, end + 12)[0] // 46 // 8] if told else []
    if told and 0 <= end_64 <= len(tail) - 56:
        told = [
            struct.unpack_from("<Q", tail, end_64 + 32)[0],
            struct.unpack_from("<Q", tail, end_64 + 40)[0] // 46 // 8,
        ]
    if told and max(told) > MOST_MEMBERS:
        raise InputError(f"{path} is an archive of {max(told):,} members or more, and {MOST_MEMBERS:,} are the most.")


def member_names(path: Path) -> tuple[str, ...]:
    """Names of the arrays of an .npz, without reading them.

    Raises:
        InputError: it is no .npz that `open_archive` takes.
    """
    with open_archive(path) as archive:
        return tuple(name.removesuffix(".npy") for name in archive.namelist())


def told_names(names: Iterable[object]) -> str:
    """The first of many names, for a message."""
    ordered = sorted(str(name)[:40] for name in names)
    return ", ".join(ordered[:10]) + (f" and {len(ordered) - 10} more" if len(ordered) > 10 else "") or "(none)"


def told_error(error: BaseException) -> str:
    """What a library says of a file, cut to a sentence's length: some repeat the file."""
    text = str(error) or type(error).__name__
    return text if len(text) <= _MOST_TOLD else f"{text[:_MOST_TOLD]} .."


def read_arrays(path: Path, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
    """Arrays (...) of an .npz by name, in any unit; nothing is unpickled.

    Args:
        path: the file.
        names: those to be read, where it has them; None for all.

    Raises:
        InputError: it is no .npz of plain arrays, or would take more memory than it may.
    """
    allowance = Allowance(path) if path.is_file() else None
    arrays: dict[str, np.ndarray] = {}
    with open_archive(path) as archive:
        members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
        for name in members if names is None else names:
            if name in members and allowance is not None:
                arrays[name] = read_member(archive, members[name], allowance)
    return arrays


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, allowance: Allowance) -> np.ndarray:
    """One array (...) of an .npz.

    Args:
        archive: the .npz.
        member: the array's place in it.
        allowance: memory that its file may take.

    Raises:
        InputError: it is no plain array, or would take more memory than it may.
    """
    name = member.filename.removesuffix(".npy")
    try:
        with archive.open(member) as stream:
            layout = read_layout(stream, name[:60], member.file_size)
        allowance.take(layout.size, f'its member "{name[:60]}"')
        with archive.open(member) as stream:
            return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))
    except InputError:
        raise
    except _UNREADABLE as error:
        raise DamagedArchiveError(allowance.path, error) from error


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
