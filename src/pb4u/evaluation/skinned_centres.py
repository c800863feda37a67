"""Where skinning alone would put a garment, to judge whether it fell off."""

from __future__ import annotations

import numpy as np

from pb4u.scene.scene import Scene
from pb4u.scene.trajectory import Trajectory

_CHUNK = 64


def skinned_centres(scene: Scene, trajectory: Trajectory) -> np.ndarray:
    """(frames, 3) centre of mass [m] of the garment where skinning alone would put it, at the trajectory's frames."""
    dressed = scene.garments[0]
    masses = dressed.garment.vertex_masses / dressed.garment.vertex_masses.sum()
    centres = []
    for start in range(scene.lead_in, scene.total_frames, _CHUNK):
        block = dressed.placement.positions(start, min(start + _CHUNK, scene.total_frames)).numpy()
        centres.append(np.einsum("v,tvd->td", masses, block))
    at_steps = np.concatenate(centres)
    at = np.arange(trajectory.frame_count) * (scene.fps / trajectory.fps)
    steps = np.arange(len(at_steps))
    return np.stack([np.interp(at, steps, column) for column in at_steps.T], axis=1)
