"""Cloth that stands far beyond the stretch at which its threads stiffen."""

from __future__ import annotations

import numpy as np
import torch

from pb4u.geometry.principal_stretch import deformation_gradients
from pb4u.measures.limbs import has_physics
from pb4u.measures.metrics import garments_of
from pb4u.scene.packed import inverse_rest_shapes
from pb4u.scene.trajectory import Trajectory

_TOLD_FROM = 0.01
"""Share of a garment's area that is worth a sentence."""


def overstretched_sentences(trajectory: Trajectory) -> list[str]:
    """A sentence for each garment of which, in some frame, more than 1 % is stretched to twice the limit of its cloth.

    Stretch is that of the threads, along warp and weft. Cloth without a limit is ignored, and so is cloth moved by
    skinning.

    Args:
        trajectory: frames as written.
    """
    if not has_physics(trajectory.header):
        return []
    sentences, first_vertex = [], 0
    for garment in garments_of(trajectory):
        rows = slice(first_vertex, first_vertex + len(garment.vertices))
        first_vertex = rows.stop
        limit, growth = garment.of_faces("stiffening").T
        judged = (limit > 0.0) & (growth > 0.0)
        if not judged.any():
            continue
        faces, inverse = torch.from_numpy(garment.faces), torch.from_numpy(inverse_rest_shapes(garment.rest_shape))
        shares = []
        for positions in trajectory.positions[:, rows]:
            threads = deformation_gradients(torch.from_numpy(positions.astype(np.float64)), faces, inverse).norm(dim=1)
            beyond = judged & (threads.numpy().max(axis=1) - 1.0 > 2.0 * limit)
            shares.append(garment.face_areas[beyond].sum() / garment.face_areas.sum())
        worst = int(np.argmax(shares))
        if shares[worst] > _TOLD_FROM:
            strongest = 100.0 * 2.0 * limit[judged].min()
            sentences.append(
                f"{garment.name}: {100.0 * shares[worst]:.0f} % of it is stretched by more than {strongest:.3g} %, "
                f"twice the strain at which its cloth stiffens, most in frame {worst}; a larger cut or a softer "
                "--material would strain less."
            )
    return sentences
