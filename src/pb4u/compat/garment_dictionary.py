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
from pb4u.garment.library import DICTIONARIES
from pb4u.garment.material import Material
from pb4u.geometry.topology import Topology
from pb4u.io.restricted_pickle import load_pickle
from pb4u.io.stored_numbers import Layout, read_members, require_places

PINNED = 3
"""Type of a pinned vertex in the released code."""
_LAYOUT: Layout = {
    "faces": ("iu", ("faces", 3)),
    "node_type": ("iu", ("vertices", 1)),
    "verts_uv": ("fiu", ("uv points", 2)),
    "faces_uv": ("iu", ("faces", 3)),
}
_POINTS_AT = {"faces": "vertices", "faces_uv": "uv points"}
_SKINNING: Layout = {
    "v": ("fiu", ("vertices", 3)),
    "lbs_weights": ("fiu", ("vertices", "bones")),
    "posedirs": ("fiu", ("pose features", "coordinates")),
    "shapedirs": ("fiu", ("vertices", 3, None)),
}
_RESOLUTIONS = ("level1", "level2", "level3")


def read_dictionary_garment(entry: DictionaryEntry, material: Material) -> Garment:
    """A garment of a dictionary or template, in the axes and at the height of its file.

    Args:
        entry: file and name.
        material: its cloth.

    Raises:
        InputError: the file is not a dictionary of garments, lacks the garment, or its parts do not fit each other.
    """
    if not entry.path.is_file():
        raise InputError(f"There is no garment file {entry.path}.")
    where, fields = f"{entry.path}, garment {entry.title}", _chosen(entry, load_pickle(entry.path))
    positions = "rest_pos" if "rest_pos" in fields else "vertices"
    arrays, counts = _read(
        where, fields, {positions: ("fiu", ("vertices", 3)), **_LAYOUT}, _POINTS_AT, tuple(_LAYOUT)[1:]
    )
    faces, count = arrays["faces"].astype(np.int64), counts["vertices"]
    if len(Topology(faces, count).non_manifold_edges):
        raise InputError(
            f"{where}: some edges are shared by three or more faces; repair the mesh in the program it comes from."
        )
    types, corners = arrays.get("node_type", np.zeros(count)), arrays.get("faces_uv")
    return Garment(
        entry.title,
        arrays[positions].astype(np.float64),
        faces,
        material,
        types.reshape(-1) == PINNED,
        uvs=None if corners is None else arrays["verts_uv"].astype(np.float64),
        uv_faces=None if corners is None else corners.astype(np.int64),
        coarse_edges=_coarse_edges(where, fields.get("coarse_edges"), entry.centre, count),
        skinning=None if fields.get("lbs") is None else _skinning(where, fields["lbs"], count),
    )


DICTIONARIES[".pkl"] = read_dictionary_garment


def _read(
    where: str, content: object, layout: Layout, points_at: Mapping[str, str], optional: tuple[str, ...] = ()
) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    def refuse(what: str) -> InputError:
        return InputError(f"{where}: {what}.")

    arrays, counts = read_members(content, layout, refuse, optional)
    require_places(arrays, points_at, counts, refuse)
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            raise refuse(f'"{name}" holds something other than finite numbers')
    return arrays, counts


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
    garment = next(iter(garments)) if name is None else name.partition("/")[0]
    if garment not in garments:
        raise InputError(f"{path} holds no garment {garment}. {_listed(garments)}")
    return _of_resolution(entry, garments[garment])


def _of_resolution(entry: DictionaryEntry, fields: Mapping[str, Any]) -> Mapping[str, Any]:
    """The fields of one resolution, named NAME/level2, where a dictionary holds several; else as they are."""
    if "faces" in fields:
        return fields
    levels = [level for level in _RESOLUTIONS if isinstance(fields.get(level), Mapping)]
    level = (entry.name or "").rpartition("/")[2]
    chosen = level if level in levels else next(iter(levels), None)
    if chosen is None:
        raise InputError(
            f'{entry.path}, garment {entry.title} lacks "faces"; it is not a garment of the released code.'
        )
    return {**fields, **fields[chosen]}


def _listed(garments: Mapping[str, Any]) -> str:
    return f"There are: {', '.join(sorted(garments)[:20])}."


def _coarse_edges(where: str, levels: Any, centre: int | None, count: int) -> tuple[np.ndarray, ...]:
    """Edges (edges, 2) int64 of the coarse levels around one centre, from fine to coarse; none where there are none."""
    if not isinstance(levels, Mapping) or not levels:
        return ()
    by_centre = {int(vertex): edges for vertex, edges in levels.items()}
    centre = next(iter(by_centre)) if centre is None else centre
    if centre not in by_centre:
        centres = ", ".join(map(str, sorted(by_centre)[:20]))
        raise InputError(f"{where} has no coarse levels around {centre}; it has them around {centres}.")
    edges_of = {int(level): np.asarray(edges) for level, edges in by_centre[centre].items()}
    if sorted(edges_of) != list(range(len(edges_of))):
        raise InputError(f"{where} has coarse levels {sorted(edges_of)}, where they count from 0 without a gap.")
    # A level without edges is written as floating-point numbers of no shape.
    by_level = {str(k): edges if edges.size else np.zeros((0, 2), dtype=np.int64) for k, edges in edges_of.items()}
    layout: Layout = {level: ("iu", (None, 2)) for level in by_level}
    arrays, _ = _read(where, by_level, layout, {})
    for edges in arrays.values():
        if edges.size and not 0 <= edges.min() <= edges.max() < count:
            raise InputError(f"{where}: a coarse edge points outside of its {count} vertices.")
    return tuple(arrays[str(level)].astype(np.int64) for level in range(len(edges_of)))


def _skinning(where: str, content: object, count: int) -> GarmentSkinning:
    arrays, counts = _read(where, content, _SKINNING, {})
    weights, bones = arrays["lbs_weights"], counts["bones"]
    if counts != {**counts, "vertices": count, "pose features": 9 * (bones - 1), "coordinates": 3 * count}:
        raise InputError(f"{where}: its skinning does not fit its {count} vertices: {counts}.")
    if (weights < 0).any() or (weights.sum(axis=1) < 1e-6).any():
        raise InputError(f'{where}: "lbs_weights" has negative or empty rows.')
    return GarmentSkinning(
        arrays["v"].astype(np.float64),
        arrays["shapedirs"].astype(np.float64),
        np.ascontiguousarray(arrays["posedirs"].T.astype(np.float64)).reshape(count, 3, 9 * (bones - 1)),
        strongest_influences(np.broadcast_to(np.arange(bones), weights.shape), weights.astype(np.float64), bones),
        bones,
    )
