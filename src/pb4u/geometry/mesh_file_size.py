"""How many triangles a mesh file holds, told without parsing it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

_BLOCK = 1 << 24


def least_triangles(path: Path, enough: int) -> int:
    """Triangles that the polygons of a mesh file come to, or fewer; 0 where only reading it whole tells.

    Exact up to `enough` for an OBJ written plainly, above that at least the number of its polygons. A PLY tells its
    number of polygons, of which each is a triangle or more. Takes the time of reading the file. Raises OSError.
    """
    suffix = path.suffix.lower()
    if suffix == ".obj":
        polygons = sum(lines.count(b"\nf ") for lines in _obj_lines(path))
        return polygons if polygons > enough else sum(_obj_triangles(lines) for lines in _obj_lines(path))
    with path.open("rb") as stream:
        head = stream.read(1 << 12)
    if suffix == ".ply" and (declared := re.search(rb"element face (\d+)", head)):
        return int(declared.group(1))
    if suffix == ".stl" and not head.lstrip().startswith(b"solid"):
        return max(0, path.stat().st_size - 84) // 50
    return 0


def _obj_lines(path: Path) -> Iterator[bytes]:
    """The file in blocks of whole lines, a line break before the first and after the last of each."""
    with path.open("rb") as stream:
        rest = b""
        while block := stream.read(_BLOCK):
            whole, _, rest = (rest + block).rpartition(b"\n")
            yield b"\n" + whole + b"\n"
        yield b"\n" + rest + b"\n"


def _obj_triangles(lines: bytes) -> int:
    """Corners of all face lines less two a line; a line with a comment counts as a triangle."""
    text = np.frombuffer(lines, dtype=np.uint8)
    ends = np.flatnonzero(text == ord("\n"))
    starts, stops = ends[:-1] + 1, ends[1:]
    blank = text <= ord(" ")
    face = (text[starts] == ord("f")) & blank[np.minimum(starts + 1, len(text) - 1)] & (stops > starts + 1)
    starts, stops = starts[face], stops[face]
    if not len(starts):
        return 0
    first, last = int(starts[0]), int(stops[-1]) + 1
    # A token begins where a blank ends; counted up to every place, their number in a line is a difference.
    tokens = np.cumsum(blank[first:last][:-1] & ~blank[first:last][1:], dtype=np.int32)
    comments = np.cumsum(text[first:last] == ord("#"), dtype=np.int32)
    corners = tokens[stops - first - 1] - tokens[starts - first]
    commented = comments[stops - first] > comments[starts - first]
    return int(np.maximum(np.where(commented, 3, corners) - 2, 1).sum())
