"""Frames that are not finite: found, reported, and replaced by the frame before them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pb4u.errors import InputError, warn
from pb4u.scene.trajectory import Trajectory

HELD_FRAMES = "held_frames"
"""Metadata entry that lists the frames which stand still because their own values are not finite."""


def hold_finite(trajectory: Trajectory) -> Trajectory:
    """The trajectory with each frame that has NaN or infinite values replaced by the last finite frame before it.

    No scene format has a place for NaN: tools drop the mesh or crash. The frames concerned are named in an
    InputWarning and under `held_frames` in the metadata, from which writers mark them. Frames before the first finite
    one repeat it.

    Args:
        trajectory: as simulated.

    Raises:
        InputError: no frame is whole.
    """
    finite = np.array([bool(np.isfinite(positions).all()) for positions in trajectory.positions])
    body_whole = np.array([bool(np.isfinite(positions).all()) for positions in trajectory.body_positions])
    if finite.all() and body_whole.all():
        return trajectory
    if not finite.any() or not body_whole.any():
        raise InputError("No frame of the trajectory is finite, so there is nothing to write; simulate it again.")
    gaps = np.flatnonzero(~(finite & body_whole)).tolist()
    warn(
        f"{len(gaps)} of {len(finite)} frames are not finite ({spans(gaps)}); each is replaced by the last finite "
        "frame before it, and marked where the format allows.",
    )
    return replace(
        trajectory,
        header=trajectory.header.with_metadata(**{HELD_FRAMES: gaps}),
        positions=_repeat(trajectory.positions, finite),
        body_positions=_repeat(trajectory.body_positions, body_whole),
    )


def held_frames(trajectory: Trajectory) -> list[int]:
    """Frames that `hold_finite` replaced.

    Args:
        trajectory: the trajectory.
    """
    return [int(t) for t in trajectory.metadata.get(HELD_FRAMES, [])]


def spans(frames: list[int]) -> str:
    """Frame numbers as text, runs joined: "3, 7-12".

    Args:
        frames: frame numbers, ascending.
    """
    runs: list[list[int]] = []
    for t in frames:
        if runs and t == runs[-1][1] + 1:
            runs[-1][1] = t
        else:
            runs.append([t, t])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in runs)


def _repeat(positions: np.ndarray, finite: np.ndarray) -> np.ndarray:
    last = np.maximum.accumulate(np.where(finite, np.arange(len(finite)), -1))
    return np.asarray(positions[np.where(last < 0, int(np.argmax(finite)), last)])
