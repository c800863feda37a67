"""Borrowed skinning weights kept on disk, so that a garment is dressed once."""

from __future__ import annotations

import contextlib
import hashlib
import io
from pathlib import Path

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.skinning import SkinningWeights
from pb4u.errors import InputError
from pb4u.garment.garment import Garment
from pb4u.io.array_archive import read_arrays
from pb4u.io.atomic_file import replace_file
from pb4u.io.cache_folder import cache_folder

ALGORITHM = 1
"""To be raised whenever `borrow_weights` gives different numbers."""


def garment_weights(garment: Garment, body: ShapedBody) -> SkinningWeights:
    """`borrow_weights`, read from the cache when this garment was dressed on this body before.

    A cache that cannot be read or written costs time, never the result.

    Args:
        garment: worn by the body in its rest pose.
        body: its skinning weights are used.
    """
    path = cache_folder() / "skinning" / f"{_key(garment, body)}.npz"
    weights = _read(path, len(garment.vertices), body.skeleton.bone_count)
    if weights is None:
        from pb4u.garment.weight_transfer import borrow_weights

        weights = borrow_weights(garment, body)
        _write(path, weights)
    return weights


def _key(garment: Garment, body: ShapedBody) -> str:
    digest = hashlib.sha256(f"{ALGORITHM} {garment.loose}".encode())
    skin = (body.vertices, body.faces, body.contact, body.weights.bones, body.weights.weights)
    for array in (garment.vertices, garment.faces, *skin):
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def _read(path: Path, vertices: int, bones: int) -> SkinningWeights | None:
    try:
        stored = read_arrays(path, ("bones", "weights"))
        weights = SkinningWeights(stored["bones"].astype(np.int64), stored["weights"].astype(np.float32))
    except (InputError, KeyError, ValueError, TypeError):
        return None
    fits = (
        weights.bones.shape == weights.weights.shape
        and weights.bones.ndim == 2
        and len(weights.bones) == vertices
        and bool(((weights.bones >= 0) & (weights.bones < bones)).all())
        and bool(np.allclose(weights.weights.sum(axis=1), 1.0, atol=1e-4))
    )
    return weights if fits else None


def _write(path: Path, weights: SkinningWeights) -> None:
    """Written in one step, so that two processes never see half a file."""
    content = io.BytesIO()
    np.savez(content, bones=weights.bones.astype(np.int16), weights=weights.weights)
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, content.getvalue())
