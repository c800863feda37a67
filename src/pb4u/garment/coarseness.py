"""Whether a garment's mesh is fine enough to go round the body that wears it.

An edge that lies on a limb spans a part of the way round it. Where edges span a fifth of it, the cloth is a tube of
five flat sides: a limb that bends comes out between them, and the garment is lost. What an edge spans is read off the
skin, as the angle between its normals beneath the two ends, so that it tells as much of somebody's own garment.
docs/design/garments.md says where garments are lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pb4u.garment.fit import RestBody
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import area_weighted_normals

_ON_SKIN = 0.05
"""Distance [m] from the body within which cloth follows its shape; a skirt's hem hangs farther off."""

_SHARE = 0.9
"""Share of the edges on the skin that span less: some bridge an armpit or a crease at any resolution."""

MOST_DEGREES = 72.0
"""Span [degrees] above which a garment is refused: fewer than five edges round a limb. A dress of 200 triangles, which
every model loses in a run, has 74; at 57 to 64 limbs come through a dress, trousers and a T-shirt, which stay worn."""

FEW_DEGREES = 35.0
"""Span [degrees] above which skin may show: ten edges round a limb. Of seven garments that walk and dance at a thousand
triangles, those of 24 and 34 degrees show 0 and 0.01 % of the skin beneath them, of those of 38 to 46 five show up to a
quarter of a percent, and limbs go through two."""

_ASKED_DEGREES = 28.0
"""Span [degrees] that a finer mesh should have: less than what is reported, since the widest spans grow more slowly
than edges, and no mesh is quite even."""


@dataclass(frozen=True)
class Coarseness:
    """How coarse a garment is for the body.

    Args:
        degrees: angle round the body that one edge in ten spans, or more.
        triangles: number of its triangles.
    """

    degrees: float
    triangles: int

    @classmethod
    def of(cls, vertices: np.ndarray, faces: np.ndarray, body: RestBody) -> Coarseness:
        """Coarseness of a garment worn at rest.

        Args:
            vertices: (vertices, 3) [m].
            faces: (faces, 3) int64.
            body: the body that wears it.
        """
        edges = Topology(faces, len(vertices)).edges
        if not len(edges):
            return cls(0.0, len(faces))
        skin = body.surface.nearest(vertices)
        normals = skin.normals.numpy()
        near = np.abs(skin.signed_distance.numpy()) < _ON_SKIN
        # A hand that hangs beside a hem is near the cloth too, but not under it.
        near &= (area_weighted_normals(vertices, faces) * normals).sum(axis=1) > 0.0
        a, b = normals[edges[near[edges].all(axis=1)]].swapaxes(0, 1)
        if not len(a):
            return cls(0.0, len(faces))
        spans = np.degrees(np.arccos(np.clip((a * b).sum(axis=1), -1.0, 1.0)))
        return cls(float(np.quantile(spans, _SHARE)), len(faces))

    @property
    def is_lost(self) -> bool:
        """Whether the garment would not stay around the body."""
        return self.degrees > MOST_DEGREES

    @property
    def is_few(self) -> bool:
        """Whether skin may show through it."""
        return self.degrees > FEW_DEGREES

    @property
    def enough(self) -> int:
        """Number of triangles to ask for: the angle is proportional to the edge length, the square root of a triangle's
        area."""
        return 100 * math.ceil(self.triangles * (self.degrees / _ASKED_DEGREES) ** 2 / 100.0)
