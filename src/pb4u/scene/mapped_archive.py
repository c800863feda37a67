"""An uncompressed .npz mapped into memory, which numpy itself cannot do, and read without pickle."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Literal

import numpy as np

from pb4u.io.array_archive import open_archive, read_layout, read_member
from pb4u.io.reading_limits import Allowance

_SMALLEST_MAPPED = 4096
"""Members of fewer bytes are read: a map costs a page and a file handle."""


def map_archive(path: Path) -> dict[str, np.ndarray]:
    """Arrays (...) of any unit of an .npz file by name, mapped from the file; small and compressed ones are read.

    Raises:
        InputError: the file cannot be read whole; OSError, ValueError or what else numpy's reader raises as well, or
            when what is compressed in it would take more memory than it may.
    """
    members: dict[str, np.ndarray] = {}
    with open_archive(path) as archive, path.open("rb") as raw:
        allowance = Allowance(path)
        for info in archive.infolist():
            name = info.filename.removesuffix(".npy")
            if info.compress_type != zipfile.ZIP_STORED or info.file_size == 0:
                members[name] = read_member(archive, info, allowance)
                continue
            raw.seek(info.header_offset + 26)
            name_length, extra_length = np.frombuffer(raw.read(4), dtype="<u2").tolist()
            start = info.header_offset + 30 + name_length + extra_length
            raw.seek(start)
            layout = read_layout(raw, name, info.file_size)
            data = raw.tell()
            if data + layout.size > start + info.file_size:
                raise ValueError(f"member {name} is cut short")
            order: Literal["F", "C"] = "F" if layout.fortran else "C"
            if layout.size < _SMALLEST_MAPPED:
                content = raw.read(layout.size)
                members[name] = np.frombuffer(content, dtype=layout.dtype).reshape(layout.shape, order=order)
            else:
                members[name] = np.memmap(path, layout.dtype, "r", data, layout.shape, order)
    return members
