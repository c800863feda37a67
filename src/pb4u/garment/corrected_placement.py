"""A garment skinned as the released code does it: by its own weights, with corrections for shape and pose."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pb4u.body.body_model import PosedBody
from pb4u.body.skinning import SkinnedSurface
from pb4u.garment.dressing import Placement
from pb4u.garment.garment import Garment


class CorrectedPlacement(Placement):
    """Linear blend skinning of a garment that brings its weights and its corrections, as its file has them.

    Source: the released code of the family (SMPL's formula on a garment's vertices).

    Args:
        garment: one that `is_skinned_for` the body.
        body: the posed body; its shape parameters beta0, beta1, .. shape the garment too.
    """

    def __init__(self, garment: Garment, body: PosedBody) -> None:
        assert garment.skinning is not None
        skinning, shaped = garment.skinning, body.body
        betas = np.array([shaped.shape.get(f"beta{k}", 0.0) for k in range(skinning.shape_directions.shape[2])])
        rest = skinning.vertices + skinning.shape_directions @ betas + np.array([0.0, shaped.lift, 0.0])
        self.body = body
        self._pose_directions = skinning.pose_directions.astype(np.float32)
        self._surface = SkinnedSurface(rest, skinning.weights, shaped.skeleton.bone_count)

    def positions(self, start: int, stop: int) -> Tensor:
        """Garment vertices (stop - start, vertices, 3) float32 [m]; see `Placement`.

        Args:
            start: first frame.
            stop: frame after the last.
        """
        if stop <= start:
            return torch.zeros(0, len(self._pose_directions), 3)
        return self.body.corrected(self._surface, self._pose_directions, start, stop)
