"""When a garment is lost: strained too far, fallen off, or slid from what holds it up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pb4u.scene.packed import PackedGarments
from pb4u.scene.scene import DressedGarment, Scene
from pb4u.scene.trajectory import Trajectory

DIVERGED_STRAIN = 0.6
"""95th percentile of the strain beyond which a run counts as diverged: cloth tears long before."""

DIVERGED_DISTANCE = 0.5
"""Distance [m] between a garment's centre of mass and where skinning puts it beyond which it fell off: what is still
worn swings less."""

HOLD_DEPTH = 0.04
"""Depth [m] below a garment's highest points of what holds it up: the width of a strap or a waistband."""

SLID = 0.08
"""Distance [m] from where skinning puts it beyond which what holds a garment up has slid: two widths of a strap, which
by then lies on the arm, or two waistbands. Cloth that swings or that a raised arm lifts stays below."""

SLID_FRAMES = 10
"""Frames on end for which it has to stay so: a third of a second; a leap lifts straps for less."""

_SKINNED_AT_ONCE = 64
"""Frames of a garment that are skinned in one call; bounds the memory of long clips."""


def first_lost(
    trajectory: Trajectory,
    garments: PackedGarments,
    frames: Sequence[list[dict[str, float]]],
    skinned: np.ndarray | None,
) -> list[int | None]:
    """The first frame in which each garment had diverged, or None.

    Args:
        trajectory: frames as written.
        garments: its garments.
        frames: metrics of each garment in each frame, "strain_p95" among them.
        skinned: as `skinned_centres`, or (frames, 3) of one garment [m]; without it falling off is not detected.
    """
    # What is not a number has diverged too.
    diverged = ~(np.array([[strains["strain_p95"] for strains in row] for row in frames]) <= DIVERGED_STRAIN)
    if skinned is not None:
        for g, garment in enumerate(garments.garments):
            vertices = slice(*garments.vertex_offsets[g : g + 2])
            share = garment.vertex_masses / garment.vertex_masses.sum()
            centres = np.reshape(skinned, (len(skinned), -1, 3))[:, g]
            for t, (x, centre) in enumerate(zip(trajectory.positions, centres, strict=False)):
                distance = np.linalg.norm(share @ np.asarray(x[vertices], dtype=np.float64) - centre)
                diverged[t, g] |= not distance <= DIVERGED_DISTANCE
    return [int(entry.argmax()) if entry.any() else None for entry in diverged.T]


def skinned_centres(scene: Scene, trajectory: Trajectory) -> np.ndarray:
    """Centres of mass of the garments where skinning alone would put them.

    Args:
        scene: the simulated one.
        trajectory: the result; the centres are computed at its (frames,) frames.

    Returns:
        (frames, garments, 3) [m].
    """
    masses = (dressed.garment.vertex_masses for dressed in scene.garments)
    centres = zip(scene.garments, (mass / mass.sum() for mass in masses), strict=True)
    return np.stack([_skinned_means(scene, trajectory, cloth, share[None])[:, 0] for cloth, share in centres], axis=1)


def _skinned_means(scene: Scene, trajectory: Trajectory, garment: DressedGarment, shares: np.ndarray) -> np.ndarray:
    """Means (frames, groups, 3) [m] of a garment's skinned vertices, by their `shares` (groups, vertices)."""
    at = np.arange(trajectory.frame_count) * (scene.fps / trajectory.fps)
    means = []
    for start in range(scene.lead_in, scene.total_frames, _SKINNED_AT_ONCE):
        block = garment.placement.positions(start, min(start + _SKINNED_AT_ONCE, scene.total_frames)).numpy()
        means.append(np.einsum("gv,tvd->tgd", shares, block))
    at_steps = np.concatenate(means)
    columns = [np.interp(at, np.arange(len(at_steps)), column) for column in at_steps.reshape(len(at_steps), -1).T]
    return np.stack(columns, axis=1).reshape(len(at), *at_steps.shape[1:])


def hold_shifts(scene: Scene, trajectory: Trajectory) -> np.ndarray:
    """Distance of the vertices that hold each garment up from where skinning puts them.

    A garment is held by the uppermost `HOLD_DEPTH` of its left half and of its right half: straps, shoulders or the two
    sides of a waist. The shift is that of the mean of those vertices, in the half that moved farther.

    Args:
        scene: the simulated one.
        trajectory: the result.

    Returns:
        (frames, garments) [m].
    """
    shifts, first = [], 0
    for dressed in scene.garments:
        rest = dressed.garment.vertices
        is_left = rest[:, 0] > np.median(rest[:, 0])
        holds = np.stack([side & (rest[:, 1] > rest[side, 1].max() - HOLD_DEPTH) for side in (is_left, ~is_left)])
        shares = holds / holds.sum(axis=1, keepdims=True)
        positions = np.asarray(trajectory.positions[:, first : first + len(rest)], dtype=np.float64)
        moves = np.einsum("gv,tvd->tgd", shares, positions) - _skinned_means(scene, trajectory, dressed, shares)
        shifts.append(np.linalg.norm(moves, axis=2).max(axis=1))
        first += len(rest)
    return np.stack(shifts, axis=1)


def slid_from(shifts: np.ndarray) -> int | None:
    """The first frame from which a garment's hold stays beyond `SLID` for `SLID_FRAMES` frames, or None.

    Args:
        shifts: (frames, garments) as `hold_shifts` [m].
    """
    # What is not a number is not where it was.
    beyond = ~(np.asarray(shifts) <= SLID)
    span = min(SLID_FRAMES, len(beyond))
    starts = [at for at in range(len(beyond) - span + 1) if beyond[at : at + span].all(axis=0).any()]
    return starts[0] if starts else None
