"""Whether a run diverged, without the energies that `measure` computes with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pb4u.scene.scene import Scene
    from pb4u.scene.trajectory import Trajectory


def diverged_at(scene: Scene, trajectory: Trajectory) -> int | None:
    """The first written frame in which the run had diverged, or None: what `measure` says, in milliseconds a frame."""
    import torch

    from pb4u.evaluation.divergence import first_diverged
    from pb4u.evaluation.metrics import garment_of
    from pb4u.evaluation.skinned_centres import skinned_centres
    from pb4u.geometry.principal_stretch import face_strains, weighted_percentile
    from pb4u.scene.packed import pack

    garment = garment_of(trajectory)
    packed = pack([garment])
    strains = []
    for positions in trajectory.positions:
        x = torch.from_numpy(np.array(positions, dtype=np.float64))
        strains.append(
            float(
                weighted_percentile(face_strains(x, packed.faces, packed.inverse_rest_shape), packed.face_areas, 95.0)
            )
        )
    return first_diverged(strains, trajectory.positions, garment.vertex_masses, skinned_centres(scene, trajectory))
