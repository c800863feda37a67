"""When a run counts as diverged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

DIVERGED_STRAIN = 0.6
"""95th percentile of the strain beyond which a run counts as diverged."""

DIVERGED_DISTANCE = 0.5
"""Distance [m] between the garment's centre of mass and where skinning puts it beyond which it fell off."""


def first_diverged(
    strains: Sequence[float],
    positions: np.ndarray | Sequence[np.ndarray],
    masses: np.ndarray,
    skinned: np.ndarray | None,
) -> int | None:
    """The first frame in which a run had diverged, or None.

    Args:
        strains: (frames,) 95th percentiles; here as in positions, what is not a number has diverged too.
        positions: (frames, vertices, 3) [m]. masses: (vertices,) [kg].
        skinned: (frames, 3) centre of mass [m] where skinning alone would put the garment; without it falling off is
            not judged.
    """
    diverged = ~(np.asarray(strains) <= DIVERGED_STRAIN)
    if skinned is not None:
        share = masses / masses.sum()
        for t, (x, centre) in enumerate(zip(positions, skinned, strict=False)):
            distance = np.linalg.norm(share @ np.asarray(x, dtype=np.float64) - centre)
            diverged[t] |= not distance <= DIVERGED_DISTANCE
    return int(diverged.argmax()) if diverged.any() else None
