"""Every shape of Anny, through the optional `anny` package (code Apache-2.0, data CC0)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from pb4u.body.baked_body import BakedBody
from pb4u.body.body_model import BodyModel
from pb4u.body.skinning import strongest_influences
from pb4u.errors import extra, warn

# Closed and free of eyes and tongue. The "smpl" and "smplx" topologies carry non-commercial data and are never used.
_TOPOLOGY = "anny-noeyes-notongue"
# Bones that move one vertex at most, which bounds the cost of skinning; the others' small shares go to these.
_MAX_INFLUENCES = 8
# Lowest, default and highest value of each parameter; an age of 0.67 is Anny's adult.
_RANGES = {
    "gender": (0.0, 1.0, 1.0),
    "age": (0.0, 0.67, 1.0),
    "muscle": (0.0, 0.5, 1.0),
    "weight": (0.0, 0.5, 1.0),
    "height": (0.0, 0.5, 1.0),
    "proportions": (0.0, 0.5, 1.0),
}


def to_world_axes(points: np.ndarray) -> np.ndarray:
    """Points (..., 3) [m] turned from Anny's axes (Z up, facing -Y) to the world's (Y up, facing +Z): (x, z, -y).

    Args:
        points: (..., 3) [m] in Anny's axes.
    """
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


class AnnyBody(BodyModel):
    """The full Anny model; the first use on a machine builds its rig, which takes minutes.

    Raises:
        MissingExtraError: the package `anny` is not installed.
    """

    name = family = "anny"

    def __init__(self) -> None:
        #: The `anny.Anny` module, posed by world orientations.
        self.model = _anny_model()
        self.faces = self.model.get_triangular_faces().numpy().astype(np.int64)
        self.bone_names = tuple(self.model.bone_labels)
        parents = [-1 if parent is None else parent for parent in self.model.bone_parents]
        self.bone_parents = np.asarray([-1, *parents[1:]], dtype=np.int64)
        self.weights = strongest_influences(
            self.model.vertex_bone_indices.numpy(), self.model.vertex_bone_weights.numpy(), _MAX_INFLUENCES
        )
        # Worked out when the built-in bodies were baked, which have the same vertices.
        self.contact = BakedBody.built_in("woman").contact & BakedBody.built_in("man").contact

    @property
    def shape_parameters(self) -> Mapping[str, tuple[float, float, float]]:
        return _RANGES

    def rest(self, parameters: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        import torch

        with torch.no_grad():
            model = self.model
            rest = model.get_rest_model(model.get_phenotype_blendshape_coefficients(**parameters))
        return to_world_axes(rest["rest_vertices"][0].numpy()), to_world_axes(rest["rest_bone_heads"][0].numpy())


def _anny_model() -> Any:
    with extra("anny", "A body shape beyond the built-in ones"):
        import anny
    cache = anny.paths.get_anny_cache_path()
    if not any(cache.rglob("build_compact_model_data_*")):
        warn(f"Anny builds its rig once on each machine, which takes 3 to 5 minutes and 0.8 GB in {cache}.")
    return anny.Anny(topology=_TOPOLOGY, pose_parameterization="world-orient", skinning_method="lbs")
