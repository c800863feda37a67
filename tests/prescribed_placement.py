"""A placement that the tests give frame by frame."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pb4u.garment.dressing import Placement


class PrescribedPlacement(Placement):
    """Where a cloth starts, and the paths of its pinned vertices.

    Args:
        frames: (frames, vertices, 3) [m]; the last one is held.
    """

    def __init__(self, frames: np.ndarray) -> None:
        self.frames = frames

    def positions(self, start: int, stop: int) -> Tensor:
        rows = np.clip(np.arange(start, stop), 0, len(self.frames) - 1)
        return torch.from_numpy(self.frames[rows].astype(np.float32))
