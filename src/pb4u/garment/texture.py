"""Garments that wear an image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pb4u.garment.garment import Garment
from pb4u.geometry.appearance import Appearance, Appearances


def textured(garment: Garment, image: bytes) -> Garment:
    """The garment wearing an image: by its UVs, or from front and back where it has none.

    Args:
        garment: to put it on; if it is remeshed, the image is put on its author's mesh.
        image: content of a PNG or JPEG file.
    """
    image_looks = (Appearance("texture", image=image),)
    result = replace(garment, appearances=Appearances(image_looks, np.zeros(len(garment.faces), dtype=np.int64)))
    if garment.source is not None:
        mesh = garment.source.source
        looks = Appearances(image_looks, np.zeros(len(mesh.polygons), dtype=np.int64))
        uvs = (mesh.uvs, mesh.polygon_uvs) if mesh.uvs is not None else (_from_front(mesh.vertices), mesh.polygons)
        mesh = replace(mesh, uvs=uvs[0], polygon_uvs=uvs[1], appearances=looks)
        result = replace(result, source=replace(garment.source, source=mesh))
        return result if garment.uvs is not None else replace(result, appearances=None)
    if garment.uvs is None:
        return replace(result, uvs=_from_front(garment.vertices), uv_faces=garment.faces)
    return result


def _from_front(vertices: np.ndarray) -> np.ndarray:
    """UVs (vertices, 2) that lay an image on from the front, as high as the garment and centred."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    flat = vertices[:, :2] - [0.5 * (low[0] + high[0]), low[1]]
    return flat / max(high[1] - low[1], 1e-9) + [0.5, 0.0]
