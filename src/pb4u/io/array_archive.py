"""Zip files of plain arrays (.npz): read within the limits of `reading_limits`; nothing is unpickled."""

from __future__ import annotations

import math
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
from pb4u.io.reading_limits import MOST_MEMBERS, Allowance

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
