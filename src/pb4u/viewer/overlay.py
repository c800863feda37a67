"""What is painted on the cloth: nothing, its edges, strain, penetration, the paper's update scale; and its legend."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import OrderedDict
from dataclasses import dataclass
from functools import cache, cached_property
from html import escape

import numpy as np
import torch

from pb4u.collision.crossing_search import CrossingSearch
from pb4u.errors import InputError
from pb4u.geometry.principal_stretch import face_strains
from pb4u.measures.metrics import Ruler, visible_skin
from pb4u.network.graph.features import MaterialRange
from pb4u.network.graph.garment_graph import garment_graph
from pb4u.network.propagation_control import ConstantDistance
from pb4u.network.update_scaling import PerVertexScaling
from pb4u.viewer.clip import Clip
from pb4u.viewer.view_state import SHADED

_KEPT = 512
"""Painted frames that are kept for the next time round: more than most clips have, 40 MB at 20,000 vertices."""


@dataclass(frozen=True)
class ColourScale:
    """A fixed range of values and its colours: fixed, so that frames and trajectories compare.

    Args:
        title: the shown quantity, with its unit.
        low: value at the lower end; lower values get its colour.
        high: value at the upper end; higher values get its colour.
        low_label: how the lower end is written.
        high_label: how the upper end is written.
        colours: name of a matplotlib colour map.
    """

    title: str
    low: float
    high: float
    low_label: str
    high_label: str
    colours: str = "viridis"

    def vertex_colours(self, values: np.ndarray) -> np.ndarray:
        """Colours of values; values that are not finite get the colour of the low end.

        Args:
            values: (vertices,) in the unit that `title` names.

        Returns:
            (vertices, 4) uint8 linear RGBA [0 to 255].
        """
        share = (np.nan_to_num(values, nan=self.low) - self.low) / (self.high - self.low)
        return _linear_colours(self.colours)[np.clip(255 * share, 0, 255).astype(np.uint8)]

    def legend(self, notes: tuple[str, ...] = ()) -> str:
        """HTML: title, bar, both ends and any notes.

        Args:
            notes: lines below the bar.
        """
        from matplotlib.colors import to_hex

        stops = ", ".join(to_hex(colour) for colour in _colours(self.colours)[np.linspace(0, 255, 12).astype(int)])
        below = "".join(f"<div style='margin-top:4px'>{escape(note)}</div>" for note in notes)
        return (
            f"<div data-legend style='padding:4px 12px 8px;font-size:0.8em'><div>{escape(self.title)}</div>"
            f"<div style='height:12px;border-radius:3px;margin:4px 0;background:linear-gradient(to right, {stops})'>"
            "</div><div style='display:flex;justify-content:space-between'>"
            f"<span>{escape(self.low_label)}</span><span>{escape(self.high_label)}</span></div>{below}</div>"
        )


# Made once for all windows; `cache` may be asked from several threads.
@cache
def _colours(name: str) -> np.ndarray:
    """(256, 3) sRGB from 0 to 1."""
    from matplotlib import colormaps

    return np.asarray(colormaps[name](np.linspace(0.0, 1.0, 256)))[:, :3]


@cache
def _linear_colours(name: str) -> np.ndarray:
    """(256, 4) uint8 linear RGB and full alpha, as glTF wants vertex colours (transfer function of IEC 61966-2-1)."""
    srgb = _colours(name)
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return np.column_stack([np.round(255 * linear), np.full(256, 255)]).astype(np.uint8)


class Overlay:
    """One look of one clip; this class shows plain shaded cloth.

    Args:
        clip: the clip to draw.

    Attributes:
        wireframe: whether to draw edges instead of faces.
        scale: what the colours mean; None where nothing is painted.
    """

    wireframe = False
    scale: ColourScale | None = None

    def __init__(self, clip: Clip) -> None:
        self.clip = clip

    def colours(self, t: int) -> np.ndarray | None:
        """Colours (vertices, 4) uint8 linear RGBA [0 to 255] of frame t; None where nothing is painted.

        Args:
            t: number of the frame.
        """
        return None

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the legend."""
        return ()


class Wireframe(Overlay):
    """The edges of the triangles."""

    wireframe = True


class PaintedOverlay(Overlay, ABC):
    """A number at every vertex, shown as a colour.

    Args:
        clip: the clip to draw.

    Attributes:
        scale: range, unit and colours of the numbers.
    """

    scale: ColourScale

    def __init__(self, clip: Clip) -> None:
        super().__init__(clip)
        self._done: OrderedDict[int, np.ndarray] = OrderedDict()

    @abstractmethod
    def values(self, t: int) -> np.ndarray:
        """Value (vertices,) to paint at each vertex in frame t, in the unit of `scale`.

        Args:
            t: number of the frame.
        """

    def colours(self, t: int) -> np.ndarray:
        if t not in self._done:
            self._done[t] = self.scale.vertex_colours(self.values(t))
            while len(self._done) > _KEPT:
                self._done.popitem(last=False)
        return self._done[t]

    @cached_property
    def ruler(self) -> Ruler:
        """The instrument that measures this clip, made on first use."""
        return Ruler(self.clip.trajectory())

    def _garment(self, t: int) -> torch.Tensor:
        return torch.from_numpy(self.clip.garment(t).astype(np.float64))


class Strain(PaintedOverlay):
    """Largest |principal stretch - 1| of the faces around a vertex, weighted by their rest areas."""

    scale = ColourScale("Strain |stretch - 1|", 0.0, 0.25, "0 %", "25 % and more", "turbo")

    def values(self, t: int) -> np.ndarray:
        garments = self.ruler.garments
        strains = face_strains(self._garment(t), garments.faces, garments.inverse_rest_shape)
        corners, areas = garments.faces.numpy().T.ravel(), garments.face_areas.numpy()

        def gathered(values: np.ndarray) -> np.ndarray:
            return np.bincount(corners, np.tile(values, 3), garments.vertex_count)

        # The small floor is for vertices of no face.
        return gathered(areas * strains.numpy()) / np.maximum(gathered(areas), 1e-30)


class Penetration(PaintedOverlay):
    """Signed distance of each vertex to the body's surface, negative inside.

    Args:
        clip: the clip to draw.

    Raises:
        InputError: the body's surface is open, so that it has no inside.
    """

    scale = ColourScale("Distance to the body", -0.01, 0.01, "10 mm inside", "10 mm outside", "RdBu")

    def __init__(self, clip: Clip) -> None:
        super().__init__(clip)
        if self.ruler.surface is None:
            raise InputError(f"The body of {clip.label} is not a closed surface, so nothing can be inside it.")

    def values(self, t: int) -> np.ndarray:
        assert self.ruler.surface is not None
        body, garment = self.clip.body(t), self._garment(t)
        posed = self.ruler.surface.at(torch.from_numpy(body.astype(np.float64)))
        return posed.nearest(garment).signed_distance.numpy()


class SelfIntersections(PaintedOverlay):
    """Triangles of cloth that cross triangles without a shared vertex, within a garment or between two."""

    scale = ColourScale("Cloth through cloth", 0.0, 1.0, "free", "crosses", "coolwarm")

    @cached_property
    def _search(self) -> CrossingSearch:
        return CrossingSearch(self.ruler.garments.surface_tree)

    def values(self, t: int) -> np.ndarray:
        crossed = np.zeros(self.ruler.garments.vertex_count)
        faces = self.ruler.garments.faces.numpy()
        crossed[faces[np.unique(self._search.pairs(self.clip.garment(t)))]] = 1.0
        return crossed


class VisibleSkin(PaintedOverlay):
    """Triangles of cloth through which skin shows: the body is above cloth that should cover it."""

    scale = ColourScale("Skin through cloth", 0.0, 1.0, "covered", "skin shows", "coolwarm")

    def values(self, t: int) -> np.ndarray:
        cloth, faces = self.clip.garment(t).astype(np.float64), self.ruler.garments.faces.numpy()
        shown = np.zeros(len(cloth))
        if len(self.ruler.touched) and np.isfinite(cloth).all():
            _, _, under = visible_skin(self.clip.body(t).astype(np.float64), self.ruler.touched, cloth, faces)
            shown[faces[under].ravel()] = 1.0
        return shown


class UpdateScale(PaintedOverlay):
    """The paper's resolution-aware quantities: the factor s_i / L_ref at each vertex, and K of each garment."""

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
    def notes(self) -> tuple[str, ...]:
        """K, mean edge and range of the factor, of each garment."""
        garments, simulated = self.ruler.garments, self.clip.header.metadata.get("propagation_steps")
        if garments.garment_count > 1:
            simulated = None  # it is the most of all garments
        whence = "as simulated" if simulated else "by the paper's rule"
        lines = []
        for number, (garment, mean) in enumerate(zip(garments.garments, garments.mean_edge_lengths, strict=True)):
            factors = self._factors[garments.vertex_offsets[number] : garments.vertex_offsets[number + 1]]
            who = self.clip.label if garments.garment_count == 1 else f"{self.clip.label}, {garment.name}"
            lines.append(
                f"{who}: K = {simulated or ConstantDistance().steps(mean)} {whence}, mean edge {1000 * mean:.1f} mm, "
                f"s_i / L_ref {factors.min():.2f} to {factors.max():.2f}"
            )
        return tuple(lines)


OVERLAYS: dict[str, type[Overlay]] = {
    SHADED: Overlay,
    "wireframe": Wireframe,
    "strain": Strain,
    "penetration": Penetration,
    "self-intersections": SelfIntersections,
    "skin through cloth": VisibleSkin,
    "K and update scale": UpdateScale,
}
"""By the name that the page shows."""
