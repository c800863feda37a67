"""Which vertices of a garment follow the body."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.io.reading_limits import parse_json

NAMES = ("none", "waist", "collar", "hem")
# How far [m] below its highest point the edge of a garment is a collar: from the sides of the neck to the nape, which
# lies up to 30 mm lower on the broadest bodies.
_COLLAR_DEPTH = 0.04


def resolve_pins(spec: str | Path | Sequence[int] | np.ndarray, garment: Garment) -> np.ndarray:
    """Mask of the pinned vertices of the simulated mesh.

    Args:
        spec: "none"; "waist" or "hem", the highest or lowest border; "collar", the uppermost part of the border that
            reaches highest; "loop:K", the border with the K-th most vertices from 0; a file with vertex indices (JSON
            list, or separated by blanks, commas or lines); or indices (n,). Indices count from 0 in the author's mesh
            where there is one.
        garment: garment to pin.

    Returns:
        (vertices,) bool.

    Raises:
        InputError: the name, the border or a vertex does not exist, or the file cannot be read.
    """
    if not isinstance(spec, str | Path):
        return _from_indices(np.asarray(spec), garment, "The list of pins")
    text = str(spec)
    if text in NAMES or text.startswith("loop:"):
        return _from_name(text, garment)
    path = Path(text)
    if path.is_file():
        indices = _read_indices(path)
        if not indices.size:
            raise InputError(f'{path} names no vertex; give "none" to pin none.')
        return _from_indices(indices, garment, str(path))
    raise InputError(
        f'There are no pins "{text}" and no file of that name; choose {_choices(garment)}, or give a file of indices.'
    )


def highest_reaching(vertices: np.ndarray, loops: Sequence[np.ndarray]) -> np.ndarray:
    """Vertices (n,), in order, of the border with the highest vertex.

    Args:
        vertices: (vertices, 3) [m].
        loops: borders, at least one.
    """
    return max(loops, key=lambda loop: float(vertices[loop, 1].max()))


def collar_of(vertices: np.ndarray, border: np.ndarray) -> np.ndarray:
    """The vertices (k,) of a border that are a collar: its uppermost part.

    Args:
        vertices: (vertices, 3) [m].
        border: (n,) vertices of the border.
    """
    height = vertices[border, 1]
    return border[height > height.max() - _COLLAR_DEPTH]


def _from_name(name: str, garment: Garment) -> np.ndarray:
    pinned = np.zeros(len(garment.vertices), dtype=bool)
    if name == "none":
        return pinned
    loops = garment.topology.boundary_loops
    if not loops:
        raise InputError(f'{garment.name} has no border, so "{name}" cannot be pinned; give a file of vertex indices.')
    heights = [float(garment.vertices[loop, 1].mean()) for loop in loops]
    if name == "collar":
        pinned[collar_of(garment.vertices, highest_reaching(garment.vertices, loops))] = True
        return pinned
    if name == "waist":
        loop = int(np.argmax(heights))
    elif name == "hem":
        loop = int(np.argmin(heights))
    else:
        number = name.removeprefix("loop:")
        if not number.isdecimal() or int(number) >= len(loops):
            raise InputError(f'{garment.name} has no border "{name}"; choose {_choices(garment)}.')
        loop = int(number)
    pinned[loops[loop]] = True
    return pinned


def _choices(garment: Garment) -> str:
    heights = [f"loop:{k} (at {garment.vertices[loop, 1].mean():.2f} m)" for k, loop in enumerate(_loops(garment))]
    return ", ".join([*NAMES, *heights])


def _loops(garment: Garment) -> tuple[np.ndarray, ...]:
    return garment.topology.boundary_loops[:8]


def _read_indices(path: Path) -> np.ndarray:
    try:
        text = path.read_text(encoding="utf-8")
        is_json = text.lstrip().startswith("[")
        values = parse_json(text) if is_json else [int(word) for word in text.replace(",", " ").split()]
        indices = np.array(values)
    except (OSError, ValueError):
        raise InputError(
            f"{path} is not a list of vertex indices; write one index a line, or a JSON list of whole numbers."
        ) from None
    return indices


def _from_indices(indices: np.ndarray, garment: Garment, where: str) -> np.ndarray:
    count = len(garment.vertices) if garment.source is None else len(garment.source.source.vertices)
    if indices.ndim != 1 or (indices.size and indices.dtype.kind not in "iu"):
        raise InputError(f"{where} must list vertex indices, whole numbers from 0 to {count - 1}.")
    indices = indices.astype(np.int64)
    bad = indices[(indices < 0) | (indices >= count)]
    if len(bad):
        raise InputError(
            f"{where} names vertices out of range, the first of them {bad[:5].tolist()}; {garment.name} "
            f"has {count} vertices."
        )
    is_pinned = np.zeros(count, dtype=bool)
    is_pinned[indices] = True
    if garment.source is None or not len(indices):
        return is_pinned if garment.source is None else np.zeros(len(garment.vertices), dtype=bool)
    corners = garment.source.barycentric.argmax(axis=1)
    used = np.unique(np.concatenate(garment.source.source.polygons))
    if np.isclose(garment.source.barycentric[used].max(axis=1), 1.0).all():
        # Every vertex of the author's is one that is simulated, be it sewn to another, which moved it.
        same = np.zeros(len(garment.vertices), dtype=bool)
        same[garment.faces[garment.source.triangle, corners][indices]] = True
        return same
    # A simulated vertex is pinned when the author's vertex nearest to it is; and every listed vertex pins at least the
    # simulated vertex nearest to it, however coarse the mesh.
    source = garment.source.source.vertices
    pinned: np.ndarray = is_pinned[cKDTree(source).query(garment.vertices)[1]]
    pinned[cKDTree(garment.vertices).query(source[is_pinned])[1]] = True
    return pinned
