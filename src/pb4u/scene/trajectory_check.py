"""Checks of the members of a trajectory file against each other, before anything is made of them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from pb4u.errors import InputError
from pb4u.geometry.appearance import Appearances
from pb4u.io.reading_limits import parse_json
from pb4u.io.stored_numbers import Layout, require_layout, require_places

_LAYOUT: Layout = {
    "positions": ("f", ("frames", "vertices", 3)),
    "velocities": ("f", ("frames", "vertices", 3)),
    "body_positions": ("f", ("frames", "body vertices", 3)),
    "position_origins": ("f", ("frames", 3)),
    "body_position_origins": ("f", ("frames", 3)),
    "rest_positions": ("f", ("vertices", 3)),
    "pinned": ("b", ("vertices",)),
    "vertex_garment": ("iu", ("vertices",)),
    "body_contact": ("b", ("body vertices",)),
    "faces": ("iu", ("faces", 3)),
    "body_faces": ("iu", ("body faces", 3)),
    "fps": ("f", ()),
    "metadata": ("U", ()),
    "uvs": ("f", ("uv points", 2)),
    "uv_faces": ("iu", ("faces", 3)),
    "rest_uv": ("f", ("faces", 3, 2)),
    "material_layers": ("f", ("faces", "materials")),
    "trims": ("f", ("faces", 2)),
    "buttons": ("iu", ("buttons",)),
    "appearances": ("u", ("appearance bytes",)),
    "appearance_images": ("u", ("image bytes",)),
    "appearance_of_face": ("iu", ("faces",)),
    "polygon_sizes": ("iu", ("polygons",)),
    "polygon_corners": ("iu", ("corners",)),
    "polygon_uv_corners": ("iu", ("corners",)),
    "source_triangle": ("iu", ("source vertices",)),
    "source_barycentric": ("f", ("source vertices", 3)),
    "source_faces": ("iu", ("source faces", 3)),
    "source_uvs": ("f", ("source uv points", 2)),
    "source_uv_faces": ("iu", ("source faces", 3)),
    "source_appearances": ("u", ("source appearance bytes",)),
    "source_appearance_images": ("u", ("source image bytes",)),
    "source_appearance_of_face": ("iu", ("source faces",)),
    "source_polygon_sizes": ("iu", ("source polygons",)),
    "source_polygon_corners": ("iu", ("source corners",)),
    "source_polygon_uv_corners": ("iu", ("source corners",)),
}
_POINTS_AT = {
    "faces": "vertices", "body_faces": "body vertices", "uv_faces": "uv points", "polygon_corners": "vertices",
    "polygon_uv_corners": "uv points", "source_triangle": "faces", "source_faces": "source vertices",
    "source_uv_faces": "source uv points", "source_polygon_corners": "source vertices", "buttons": "vertices",
    "source_polygon_uv_corners": "source uv points",
}  # fmt: skip
"""Member of indices -> the count that they stay below."""

_TOGETHER = (
    ("uvs", "uv_faces"), ("source_uvs", "source_uv_faces"), ("source_triangle", "source_barycentric", "source_faces"),
    ("appearances", "appearance_images", "appearance_of_face"),
    ("source_appearances", "source_appearance_images", "source_appearance_of_face"),
    ("polygon_sizes", "polygon_corners"), ("source_polygon_sizes", "source_polygon_corners"),
)  # fmt: skip


def require_consistent(members: dict[str, np.ndarray], path: Path) -> dict[str, Any]:
    """Metadata of a trajectory file, if its members fit together; frames may hold NaN, nothing else may.

    Args:
        members: arrays (...) of the file by name; `_LAYOUT` has the shape of each, lengths are in [m].
        path: path of the file, for the refusal.

    Raises:
        InputError: a member does not fit; the first is named.
    """

    def refuse(what: str) -> InputError:
        return InputError(f"{path} is inconsistent: {what}; simulate it again.")

    counts = require_layout(members, _LAYOUT, refuse)
    for count in ("frames", "vertices", "faces"):
        if not counts[count]:
            raise refuse(f"it has no {count}")
    for together in _TOGETHER:
        if 0 < sum(name in members for name in together) < len(together):
            raise refuse(f"it has only some of {', '.join(together)}")
    require_places(members, _POINTS_AT, counts, refuse)
    for prefix in ("", "source_"):
        sizes = members.get(f"{prefix}polygon_sizes")
        if sizes is not None and (
            sizes.min(initial=3) < 3 or sizes.sum() != counts[f"{prefix.replace('_', ' ')}corners"]
        ):
            raise refuse(f"{prefix}polygon_sizes and {prefix}polygon_corners do not agree")
        try:
            Appearances.from_members(members, prefix)
        except (ValueError, LookupError, TypeError, AttributeError):
            raise refuse(f"its {prefix}appearances cannot be read") from None
    for name in ("fps", "rest_positions", "uvs", "source_barycentric", "source_uvs", "material_layers", "trims"):
        if name in members and not np.isfinite(members[name]).all():
            raise refuse(f"{name} is not finite")
    if not 1e-3 <= members["fps"] <= 1e5:
        raise refuse(f"{float(members['fps']):g} frames per second")
    metadata = _metadata(str(members["metadata"]), path, refuse)
    materials = metadata.get("materials")
    if "material_layers" in members and not (isinstance(materials, list) and len(materials) == counts["materials"]):
        raise refuse("material_layers and the materials in its metadata do not agree")
    if "trims" in members and not (members["trims"][:, 1] > 0.0).all():
        raise refuse("the elastic in its trims is not positive")
    return metadata


def _metadata(text: str, path: Path, refuse: Any) -> dict[str, Any]:
    try:
        metadata = parse_json(text)
    except ValueError:
        raise refuse("its metadata is not JSON") from None
    if not isinstance(metadata, dict):
        raise refuse("its metadata is not a JSON object")
    heading, held_frames = metadata.get("heading", 0.0), metadata.get("held_frames", [])
    if not isinstance(heading, int | float) or not math.isfinite(heading):
        raise refuse("the heading in its metadata is not a number")
    if not isinstance(held_frames, list) or not all(isinstance(frame, int) for frame in held_frames):
        raise refuse("the held_frames in its metadata are not frame numbers")
    return metadata
