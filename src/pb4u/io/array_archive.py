"""Zip files of plain arrays (.npz), read without pickle and within a bound on what they unpack to."""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from pb4u.errors import InputError
from pb4u.io.reading_limits import require_room

_UNREADABLE = (
    OSError, ValueError, EOFError, IndexError, KeyError, TypeError, RuntimeError, MemoryError, struct.error,
    zipfile.BadZipFile, zlib.error, TokenError,
)  # fmt: skip
"""What the readers of zipfile and numpy raise on damaged files."""


def read_arrays(path: Path, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
    """Arrays (...) of an .npz by name, in any unit; nothing is unpickled.

    Args:
        path: the file.
        names: members to read, if present; None for all.

    Raises:
        InputError: it is no .npz of plain arrays, or would take more memory than it may.
    """
    with open_archive(path, names) as archive:
        members = None if names is None else set(names)
        return {
            name: read_member(archive, member)
            for member in archive.infolist()
            if (name := member.filename.removesuffix(".npy")) and (members is None or name in members)
        }


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """One array (...) of an .npz, in its unit.

    Args:
        archive: the .npz.
        member: the entry of the array in the archive.

    Raises:
        ValueError: it is not a plain array, or cut short; zipfile and numpy raise other errors as well.
    """
    with archive.open(member) as stream:
        read_layout(stream, member)
    with archive.open(member) as stream:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))


def read_layout(stream: Any, member: zipfile.ZipInfo) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether the first axis runs fastest, and data type of an .npy array, of which nothing is read yet.

    Args:
        stream: of bytes, at its beginning, then at the entries.
        member: its entry in the archive.

    Raises:
        ValueError: the header is damaged, or speaks of Python objects or of more entries than there are.
    """
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(stream)
    if dtype.hasobject:
        raise ValueError(f"member {member.filename[:60]} holds Python objects")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > member.file_size:
        raise ValueError(f"member {member.filename[:60]} of shape {shape} is cut short")
    return shape, fortran, dtype


@contextmanager
def open_archive(path: Path, names: Iterable[str] | None = None) -> Iterator[zipfile.ZipFile]:
    """A zip file of arrays. Errors while reading become one sentence.

    Args:
        path: the file.
        names: of the arrays that are read; None for all.

    Raises:
        InputError: there is no such file, it is damaged, or those arrays would take more memory than they may.
    """
    members = None if names is None else set(names)
    try:
        with zipfile.ZipFile(path) as archive:
            sizes = {member.filename.removesuffix(".npy"): member.file_size for member in archive.infolist()}
            require_room(path, sum(size for name, size in sizes.items() if members is None or name in members))
            yield archive
    except FileNotFoundError as error:
        raise InputError(f"There is no file {path}.") from error
    except InputError:
        raise
    except _UNREADABLE as error:
        raise InputError(f"{path}: not a readable .npz of plain arrays ({error}); save or fetch it again.") from error


def member_names(path: Path) -> tuple[str, ...]:
    """Names of the arrays of an .npz, without reading them.

    Args:
        path: the file.

    Raises:
        InputError: it is not a zip file.
    """
    with open_archive(path, ()) as archive:
        return tuple(name.removesuffix(".npy") for name in archive.namelist())
