"""What is painted on the cloth: nothing, its edges, strain, penetration, or the paper's factor of the update."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import OrderedDict
from functools import cached_property

import numpy as np
import torch

from pb4u.errors import InputError
from pb4u.evaluation.metrics import Ruler
from pb4u.geometry.principal_stretch import face_strains
from pb4u.graph.features import MaterialRange
from pb4u.graph.garment_graph import garment_graph
from pb4u.model.propagation_control import ConstantDistance
from pb4u.model.update_scaling import PerVertexScaling
from pb4u.viewer.clip import Clip
from pb4u.viewer.colour_scale import ColourScale

_KEPT = 512
"""Painted frames that are kept for the next time round."""


class Overlay:
    """One way to look at one clip."""

    wireframe = False
    painted = False
    scale: ColourScale | None = None

    def __init__(self, clip: Clip) -> None:
        self.clip = clip

    def colours(self, t: int) -> np.ndarray:
        """(vertices, 4) uint8 linear RGBA of frame t. Only where `painted`."""
        raise NotImplementedError

    @property
    def note(self) -> str:
        """A sentence for the legend, or nothing."""
        return ""


class Shaded(Overlay):
    """Plain cloth in the light."""


class Wireframe(Overlay):
    """The edges of the triangles."""

    wireframe = True


class PaintedOverlay(Overlay, ABC):
    """A number at every vertex, as a colour."""

    painted = True
    scale: ColourScale

    def __init__(self, clip: Clip) -> None:
        super().__init__(clip)
        self._done: OrderedDict[int, np.ndarray] = OrderedDict()

    @abstractmethod
    def values(self, t: int) -> np.ndarray:
        """(vertices,) of frame t."""

    def colours(self, t: int) -> np.ndarray:
        if t not in self._done:
            self._done[t] = self.scale.vertex_colours(self.values(t))
            while len(self._done) > _KEPT:
                self._done.popitem(last=False)
        return self._done[t]

    @cached_property
    def ruler(self) -> Ruler:
        """What measures this clip."""
        return Ruler(self.clip.trajectory())

    def _garment(self, t: int) -> torch.Tensor:
        return torch.from_numpy(self.clip.garment(t).astype(np.float64))


class Strain(PaintedOverlay):
    """Largest |principal stretch - 1| of the faces around a vertex, weighted by their rest areas."""

    scale = ColourScale("Strain |stretch - 1|", 0.0, 0.25, "0 %", "25 % and more", "turbo")

    def values(self, t: int) -> np.ndarray:
        garments = self.ruler.garments
        strains = face_strains(self._garment(t), garments.faces, garments.inverse_rest_shape)
        faces, areas = garments.faces.numpy(), garments.face_areas.numpy()
        weight, total = np.zeros(garments.vertex_count), np.zeros(garments.vertex_count)
        for corner in range(3):
            np.add.at(weight, faces[:, corner], areas)
            np.add.at(total, faces[:, corner], areas * strains.numpy())
        return total / np.maximum(weight, 1e-30)


class Penetration(PaintedOverlay):
    """Signed distance of each vertex to the body's surface, negative inside.

    Raises InputError when the body's surface is open, so that it has no inside.
    """

    scale = ColourScale("Distance to the body", -0.01, 0.01, "10 mm inside", "10 mm outside", "RdBu")

    def __init__(self, clip: Clip) -> None:
        super().__init__(clip)
        if self.ruler.surface is None:
            raise InputError(f"The body of {clip.label} is not a closed surface, so nothing can be inside it.")

    def values(self, t: int) -> np.ndarray:
        assert self.ruler.surface is not None
        body = torch.from_numpy(self.clip.body(t).astype(np.float64))
        return self.ruler.surface.at(body).nearest(self._garment(t)).signed_distance.numpy()


class UpdateScale(PaintedOverlay):
    """The paper's resolution-aware quantities: the factor s_i / L_ref at each vertex, and K of the garment."""

    scale = ColourScale("Update scaling s_i / L_ref", 0.0, 2.0, "0", "2 and more", "viridis")

    @cached_property
    def _factors(self) -> np.ndarray:
        graph = garment_graph(self.ruler.garments, MaterialRange())
        factors = PerVertexScaling().factors(graph)
        assert factors is not None
        return factors[:, 0].numpy()

    def values(self, t: int) -> np.ndarray:
        return self._factors

    @property
    def note(self) -> str:
        mean = self.ruler.garments.mean_edge_lengths[0]
        simulated = self.clip.header.metadata.get("propagation_steps")
        steps = simulated or ConstantDistance().steps(mean)
        least, most = self._factors.min(), self._factors.max()
        whence = "as simulated" if simulated else "by the paper's rule"
        return (
            f"{self.clip.label}: K = {steps} {whence}, mean edge {1000 * mean:.1f} mm, "
            f"s_i / L_ref {least:.2f} to {most:.2f}"
        )


OVERLAYS: dict[str, type[Overlay]] = {
    "shaded": Shaded,
    "wireframe": Wireframe,
    "strain": Strain,
    "penetration": Penetration,
    "K and update scale": UpdateScale,
}
"""By the name that the page shows."""
