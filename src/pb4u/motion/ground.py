"""How low a posed body reaches."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence
from pb4u.body.skinning import SkinnedSurface, SkinningWeights, bone_transforms


def lowest_heights(body: ShapedBody, poses: PoseSequence) -> np.ndarray:
    """Height y (frames,) [m] of the lowest point of the body, over the outermost vertices of each bone."""
    transforms = bone_transforms(body.skeleton, poses)
    return _outermost_surface(body).positions(transforms)[..., 1].min(dim=1).values.double().numpy()


@lru_cache(maxsize=16)
def _outermost_surface(body: ShapedBody) -> SkinnedSurface:
    """The vertices that lie farthest out in some direction among those that one bone moves most."""
    directions = np.stack(np.meshgrid(*[[-1.0, -0.4, 0.0, 0.4, 1.0]] * 3), -1).reshape(-1, 3)
    directions = directions[np.abs(directions).max(1) == 1.0]
    bones, weights = body.weights.bones, body.weights.weights
    owner = bones[np.arange(len(bones)), weights.argmax(1)]
    chosen: set[int] = set()
    for bone in np.unique(owner):
        rows = np.flatnonzero(owner == bone)
        chosen.update(rows[np.argmax(body.vertices[rows] @ directions.T, axis=0)].tolist())
    kept = np.array(sorted(chosen), dtype=np.int64)
    return SkinnedSurface(body.vertices[kept], SkinningWeights(bones[kept], weights[kept]), body.skeleton.bone_count)
