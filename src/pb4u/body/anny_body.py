"""Every shape of Anny, through the optional `anny` package (code Apache-2.0, data CC0)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pb4u.body.baked_body import BakedBody
from pb4u.body.body_model import BodyModel, ShapedBody, complete_parameters
from pb4u.body.skeleton import Skeleton
from pb4u.body.skinning import SkinningWeights, strongest_influences
from pb4u.errors import InputWarning, MissingExtraError

# Closed and free of eyes and tongue. The "smpl" and "smplx" topologies carry non-commercial data and are never used.
TOPOLOGY = "anny-noeyes-notongue"
MAX_INFLUENCES = 8

_RANGES = {
    "gender": (0.0, 1.0, 1.0),
    "age": (0.0, 0.67, 1.0),
    "muscle": (0.0, 0.5, 1.0),
    "weight": (0.0, 0.5, 1.0),
    "height": (0.0, 0.5, 1.0),
    "proportions": (0.0, 0.5, 1.0),
}


@dataclass(frozen=True, eq=False)
class AnnyRest:
    """Anny at rest in the world axes of this package, at the height that Anny gives it.

    Args:
        vertices: (vertices, 3) float64 [m].
        joints: (bones, 3) float64 [m].
        orientations: (bones, 3, 3) float64 world rotations that Anny itself gives to the bones at rest.
    """

    vertices: np.ndarray
    joints: np.ndarray
    orientations: np.ndarray


def to_world_axes(points: np.ndarray) -> np.ndarray:
    """Points (..., 3) from Anny's axes (Z up, facing -Y) to the world's (Y up, facing +Z): (x, z, -y)."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


class AnnyBody(BodyModel):
    """The full Anny model; the first use on a machine builds its rig, which takes minutes.

    Raises MissingExtraError when the package `anny` is not installed.
    """

    def __init__(self, name: str = "anny", defaults: Mapping[str, float] | None = None) -> None:
        self.name = name
        self._defaults = dict(defaults or {})

    @property
    def shape_parameters(self) -> Mapping[str, tuple[float, float, float]]:
        return {key: (low, self._defaults.get(key, mid), high) for key, (low, mid, high) in _RANGES.items()}

    @cached_property
    def model(self) -> Any:
        """The `anny.Anny` module, posed by world orientations."""
        try:
            import anny
        except ImportError as error:
            raise MissingExtraError("anny", "A body shape beyond the built-in ones") from error
        cache = anny.paths.get_anny_cache_path()
        if not any(cache.rglob("build_compact_model_data_*")):
            warnings.warn(
                f"Anny builds its rig once on each machine, which takes 3 to 5 minutes and 0.8 GB in {cache}.",
                InputWarning,
                stacklevel=2,
            )
        return anny.Anny(topology=TOPOLOGY, pose_parameterization="world-orient", skinning_method="lbs")

    @cached_property
    def faces(self) -> np.ndarray:
        """(faces, 3) int64, counter-clockwise seen from outside."""
        return self.model.get_triangular_faces().numpy().astype(np.int64)

    @cached_property
    def bone_names(self) -> tuple[str, ...]:
        return tuple(self.model.bone_labels)

    @cached_property
    def bone_parents(self) -> np.ndarray:
        """(bones,) int64, -1 for the root."""
        parents = np.asarray([-1 if parent is None else parent for parent in self.model.bone_parents], dtype=np.int64)
        parents[0] = -1
        return parents

    @cached_property
    def weights(self) -> SkinningWeights:
        """The strongest influences of each vertex."""
        return strongest_influences(
            self.model.vertex_bone_indices.numpy(), self.model.vertex_bone_weights.numpy(), MAX_INFLUENCES
        )

    def rest(self, parameters: Mapping[str, float]) -> AnnyRest:
        """Rest surface, joints and bone orientations for these shape parameters."""
        import torch

        with torch.no_grad():
            model = self.model
            rest = model.get_rest_model(model.get_phenotype_blendshape_coefficients(**parameters))
        vertices = to_world_axes(rest["rest_vertices"][0].numpy())
        joints = to_world_axes(rest["rest_bone_heads"][0].numpy())
        # The change of axes acts on the columns, which are each bone's own axes written in world axes.
        orientations = np.swapaxes(
            to_world_axes(np.swapaxes(rest["rest_bone_poses"][0, :, :3, :3].numpy(), -1, -2)), -1, -2
        )
        return AnnyRest(vertices, joints, orientations)

    def shaped(self, **parameters: float) -> ShapedBody:
        """The body with these shape parameters; its contact mask is that of the built-in bodies.

        Raises InputError on an unknown name or a value out of range.
        """
        complete = complete_parameters(self.name, self.shape_parameters, parameters)
        rest = self.rest(complete)
        lift = np.array([0.0, -rest.vertices[:, 1].min(), 0.0])
        return ShapedBody(
            name=self.name,
            family="anny",
            vertices=rest.vertices + lift,
            faces=self.faces,
            skeleton=Skeleton(self.bone_names, self.bone_parents, rest.joints + lift),
            weights=self.weights,
            contact=BakedBody.built_in("woman").contact & BakedBody.built_in("man").contact,
            shape=complete,
            lift=float(lift[1]),
        )
