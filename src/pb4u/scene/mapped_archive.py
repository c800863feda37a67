"""An uncompressed .npz mapped into memory, which numpy itself cannot do, and read without pickle."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from pb4u.io.array_archive import open_archive, read_layout, read_member

_SMALLEST_MAPPED = 4096
"""Members of fewer bytes are read: a map costs a page and a file handle."""


def map_archive(path: Path) -> dict[str, np.ndarray]:
    """Arrays (...) of any unit of an .npz file by name, mapped from the file; small and compressed ones are read.

    Args:
        path: path of the .npz.

    Raises:
        InputError: the file is incomplete, or its compressed arrays would take more memory than allowed.
    """
    members: dict[str, np.ndarray] = {}
    with open_archive(path) as archive, path.open("rb") as raw:
        for info in archive.infolist():
            name = info.filename.removesuffix(".npy")
            if info.compress_type != zipfile.ZIP_STORED or info.file_size < _SMALLEST_MAPPED:
                members[name] = read_member(archive, info)
                continue
            raw.seek(info.header_offset + 26)
            name_length, extra_length = np.frombuffer(raw.read(4), dtype="<u2").tolist()
            raw.seek(info.header_offset + 30 + name_length + extra_length)
            shape, fortran, dtype = read_layout(raw, info)
            members[name] = np.memmap(path, dtype, "r", raw.tell(), shape, "F" if fortran else "C")
    return members
