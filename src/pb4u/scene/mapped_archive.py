"""An uncompressed .npz mapped into memory, which numpy itself cannot do, and read without pickle."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Literal

import numpy as np

_SMALLEST_MAPPED = 4096
"""Members of fewer bytes are read: a map costs a page and a file handle."""


def map_archive(path: Path) -> dict[str, np.ndarray]:
    """Arrays (...) of any unit of an .npz file by name, mapped from the file; small and compressed ones are read.

    Raises OSError, BadZipFile, ValueError, or what else the readers of zipfile and numpy raise, when the file cannot be
    read whole.
    """
    members: dict[str, np.ndarray] = {}
    with zipfile.ZipFile(path) as archive, path.open("rb") as raw:
        for info in archive.infolist():
            name = info.filename.removesuffix(".npy")
            if info.compress_type != zipfile.ZIP_STORED or info.file_size == 0:
                with archive.open(info) as member:
                    members[name] = np.lib.format.read_array(member, allow_pickle=False)
                continue
            raw.seek(info.header_offset + 26)
            name_length, extra_length = np.frombuffer(raw.read(4), dtype="<u2").tolist()
            start = info.header_offset + 30 + name_length + extra_length
            raw.seek(start)
            version = np.lib.format.read_magic(raw)
            read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
            if version not in read_header:
                raise ValueError(f"member {name} has an array header of version {version[0]}.{version[1]}")
            shape, fortran, dtype = read_header[version](raw)
            if dtype.hasobject:
                raise ValueError(f"member {name} holds Python objects")
            if min(shape, default=0) < 0:
                raise ValueError(f"member {name} has the shape {shape}")
            data, size = raw.tell(), math.prod(shape) * dtype.itemsize
            if data + size > start + info.file_size:
                raise ValueError(f"member {name} is cut short")
            order: Literal["F", "C"] = "F" if fortran else "C"
            if size < _SMALLEST_MAPPED:
                members[name] = np.frombuffer(raw.read(size), dtype=dtype).reshape(shape, order=order)
            else:
                members[name] = np.memmap(path, dtype, "r", data, shape, order)
    return members
