"""Buttons as they are drawn: discs on the cloth, in the colour of its thread."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pb4u.export.sewing_lines import THREAD
from pb4u.export.shading import ClothPart, Colour
from pb4u.scene.trajectory import TrajectoryHeader

_RADIUS, _ABOVE, _CORNERS = 0.009, 0.003, 24
"""Radius [m] of a button, its height [m] above the cloth, and corners of its rim."""

_DOME = 0.5
"""How far normals lean outwards at the rim, for which light a disc looks round at its edge."""


class Buttons(NamedTuple):
    """Buttons of one colour.

    Args:
        vertices: (buttons,) int64 of the garments, on which they are.
        colour: sRGB [0 to 1].
    """

    vertices: np.ndarray
    colour: Colour

    @property
    def faces(self) -> np.ndarray:
        """Corners (faces, 3) int64 of their triangles, of the points that `at` gives."""
        rim = np.arange(_CORNERS)
        fan = np.column_stack([np.zeros_like(rim), 1 + rim, 1 + (rim + 1) % _CORNERS])
        first = (1 + _CORNERS) * np.arange(len(self.vertices))
        return (fan + first[:, None, None]).reshape(-1, 3)

    def at(self, cloth: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (points, 3) [m] and normals (points, 3) in a frame.

        Args:
            cloth: (vertices or more, 3) [m].
            normals: (vertices or more, 3) of length 1.
        """
        up = normals[self.vertices][:, None]
        # Any direction will do, of a disc.
        side = np.cross(up, np.where(np.abs(up[..., :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
        side /= np.maximum(np.linalg.norm(side, axis=2, keepdims=True), 1e-9)
        turn = 2.0 * np.pi * np.arange(_CORNERS)[:, None] / _CORNERS
        rim = np.cos(turn) * side + np.sin(turn) * np.cross(up, side)
        spokes = np.concatenate([np.zeros_like(up), rim], axis=1)
        points = cloth[self.vertices][:, None] + _ABOVE * up + _RADIUS * spokes
        leaning = up + _DOME * spokes
        leaning /= np.maximum(np.linalg.norm(leaning, axis=2, keepdims=True), 1e-9)
        return points.reshape(-1, 3), leaning.reshape(-1, 3)


def buttons_on(header: TrajectoryHeader, parts: Sequence[ClothPart]) -> list[Buttons]:
    """The buttons of a trajectory by the cloth that they are on.

    Args:
        header: of the trajectory.
        parts: of its garments.
    """
    if header.buttons is None:
        return []
    buttons, vertices = [], np.asarray(header.buttons)
    for part in parts:
        is_on = np.isin(vertices, header.faces[part.faces])
        red, green, blue = (THREAD * share for share in part.colour)
        buttons.append(Buttons(vertices[is_on], (red, green, blue)))
        vertices = vertices[~is_on]
    return [group for group in buttons if len(group.vertices)]
