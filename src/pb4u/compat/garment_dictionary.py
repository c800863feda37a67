"""Garments of the released research code: dictionaries and templates (.pkl), with pins, coarse levels and skinning.

Nothing in a file is run.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pb4u.body.skinning import strongest_influences
from pb4u.errors import InputError
from pb4u.garment.dictionary_entry import DictionaryEntry
from pb4u.garment.garment import Garment, GarmentSkinning
from pb4u.garment.material import Material
from pb4u.geometry.topology import Topology
from pb4u.io.restricted_pickle import load_pickle
from pb4u.io.stored_numbers import stored_numbers

PINNED = 3
"""Type of a pinned vertex in the released code."""
_RESOLUTIONS = ("level1", "level2", "level3")


def read_dictionary_garment(entry: DictionaryEntry, material: Material) -> Garment:
    """A garment of a dictionary or template, in the axes and at the height of its file.

    Args:
        entry: file and name.
        material: its cloth.

    Raises:
        InputError: the file is none, lacks the garment, or its parts do not fit each other.
    """
    if not entry.path.is_file():
        raise InputError(f"There is no garment file {entry.path}.")
    fields = _Fields(entry, _chosen(entry, load_pickle(entry.path)))
    vertices = fields.numbers("rest_pos" if "rest_pos" in fields.content else "vertices", (None, 3))
    count = len(vertices)
    faces = fields.indices("faces", (None, 3), count)
    if len(Topology(faces, count).non_manifold_edges):
        raise InputError(f"{fields.where}: some edges are shared by three or more faces; mend it where it comes from.")
    types = fields.indices("node_type", (count, 1), PINNED + 1) if "node_type" in fields.content else np.zeros(count)
    corners = fields.indices("faces_uv", (len(faces), 3), None) if "faces_uv" in fields.content else None
    return Garment(
        entry.title,
        vertices,
        faces,
        material,
        types.reshape(-1) == PINNED,
        uvs=None if corners is None else fields.numbers("verts_uv", (None, 2)),
        uv_faces=corners,
        coarse_edges=_coarse_edges(fields, count),
        skinning=_skinning(fields, count),
    )


class _Fields:
    """The fields of one garment, checked as they are read."""

    def __init__(self, entry: DictionaryEntry, content: Mapping[str, Any]) -> None:
        self.entry, self.content = entry, content
        self.where = f"{entry.path}, garment {entry.title}"

    def within(self, name: str) -> _Fields:
        part = self.content[name]
        if not isinstance(part, Mapping):
            raise InputError(f'{self.where}: "{name}" is no dictionary.')
        return _Fields(self.entry, part)

    def numbers(self, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
        values = self._array(name, shape)
        if values.dtype.kind not in "fiu" or not np.isfinite(values).all():
            raise InputError(f'{self.where}: "{name}" holds something other than finite numbers.')
        return values.astype(np.float64)

    def indices(self, name: str, shape: tuple[int | None, ...], limit: int | None) -> np.ndarray:
        values = self._array(name, shape)
        if values.dtype.kind not in "iu" or (values.size and values.min() < 0):
            raise InputError(f'{self.where}: "{name}" should hold whole numbers from 0.')
        if limit is not None and values.size and values.max() >= limit:
            raise InputError(f'{self.where}: "{name}" holds {values.max()}, where numbers below {limit} belong.')
        return values.astype(np.int64)

    def _array(self, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
        if name not in self.content:
            raise InputError(f'{self.where} lacks "{name}"; it holds {", ".join(sorted(map(str, self.content))[:10])}.')
        values = stored_numbers(self.content[name], self.where, name)
        fits = values.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, values.shape, strict=True))
        if not fits:
            told = ", ".join("any" if n is None else str(n) for n in shape)
            raise InputError(f'{self.where}: "{name}" has the shape {values.shape}, where ({told}) belongs.')
        return values


def _chosen(entry: DictionaryEntry, content: Any) -> Mapping[str, Any]:
    """The fields of the garment that the entry names."""
    path, name = entry.path, entry.name
    if not isinstance(content, Mapping) or not content:
        raise InputError(f"{path} holds no garments.")
    if "faces" in content or any(level in content for level in _RESOLUTIONS):
        return _of_resolution(entry, content)
    garments = {str(key): value for key, value in content.items() if isinstance(value, Mapping)}
    if not garments:
        raise InputError(f"{path} holds no garments; it holds {', '.join(sorted(map(str, content))[:10])}.")
    if name is None and len(garments) > 1:
        raise InputError(f"{path} holds several garments; name one as {path}:{min(garments)}. {_listed(garments)}")
    wanted = next(iter(garments)) if name is None else name.partition("/")[0]
    if wanted not in garments:
        raise InputError(f"{path} holds no garment {wanted}. {_listed(garments)}")
    return _of_resolution(entry, garments[wanted])


def _of_resolution(entry: DictionaryEntry, fields: Mapping[str, Any]) -> Mapping[str, Any]:
    """The fields of one resolution, named NAME/level2, where a dictionary holds several; else as they are."""
    if "faces" in fields:
        return fields
    levels = [level for level in _RESOLUTIONS if isinstance(fields.get(level), Mapping)]
    wanted = (entry.name or "").rpartition("/")[2]
    chosen = wanted if wanted in levels else next(iter(levels), None)
    if chosen is None:
        raise InputError(f'{entry.path}, garment {entry.title} lacks "faces"; it is no garment of the released code.')
    return {**fields, **fields[chosen]}


def _listed(garments: Mapping[str, Any]) -> str:
    return f"There are: {', '.join(sorted(garments)[:20])}."


def _coarse_edges(fields: _Fields, count: int) -> tuple[np.ndarray, ...]:
    """Edges (edges, 2) int64 of the coarse levels around one centre, from fine to coarse; none where there are none."""
    levels = fields.content.get("coarse_edges")
    if not isinstance(levels, Mapping) or not levels:
        return ()
    by_centre = {int(centre): edges for centre, edges in levels.items()}
    centre = next(iter(by_centre)) if fields.entry.centre is None else fields.entry.centre
    if centre not in by_centre:
        known = ", ".join(map(str, sorted(by_centre)[:20]))
        raise InputError(f"{fields.where} has no coarse levels around {centre}; it has them around {known}.")
    named = by_centre[centre]
    if not isinstance(named, Mapping):
        raise InputError(f'{fields.where}: "coarse_edges" should hold levels by number.')
    found = {int(level): np.asarray(edges) for level, edges in named.items()}
    # A level without edges is written as floating-point numbers of no shape.
    by_level = {
        str(level): edges.reshape(-1, 2).astype(np.int64) if not edges.size else edges for level, edges in found.items()
    }
    if sorted(found) != list(range(len(found))):
        raise InputError(f"{fields.where} has coarse levels {sorted(found)}, where they count from 0 without a gap.")
    part = _Fields(fields.entry, by_level)
    return tuple(part.indices(str(level), (None, 2), count) for level in range(len(found)))


def _skinning(fields: _Fields, count: int) -> GarmentSkinning | None:
    if fields.content.get("lbs") is None:
        return None
    part = fields.within("lbs")
    vertices, weights = part.numbers("v", (None, 3)), part.numbers("lbs_weights", (None, None))
    if len(vertices) != count or len(weights) != count:
        raise InputError(
            f"{fields.where}: its skinning is of {len(vertices)} vertices and {len(weights)} rows of weights, the mesh "
            f"has {count}."
        )
    if (weights < 0).any() or (weights.sum(axis=1) < 1e-6).any():
        raise InputError(f'{fields.where}: "lbs_weights" has negative or empty rows.')
    bones = weights.shape[1]
    offsets = part.numbers("posedirs", (9 * (bones - 1), 3 * count))
    return GarmentSkinning(
        vertices,
        part.numbers("shapedirs", (count, 3, None)),
        np.ascontiguousarray(offsets.T).reshape(count, 3, 9 * (bones - 1)),
        strongest_influences(np.broadcast_to(np.arange(bones), weights.shape), weights, bones),
        bones,
    )
