"""Where the camera of a picture stands: from there the cloth is whole in every frame, and so is who wears it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pb4u.export.view import View
from pb4u.scene.trajectory import Trajectory

_MARGIN = 1.06
"""Of the distance at which the figure touches the picture's edge."""

_REACH, _TOP = 3.0, 6.0
"""What lies farther aside, or higher [m], may be cut off: a garment that flew away would make the figure a dot."""

_FILLED = 0.8
"""Share of the picture's height that one who stands fills at least: hands that reach aside are cut off before that."""

FIELD_OF_VIEW = 24.0
"""Of the picture's height [deg]: a long lens, which draws near limbs little larger."""

_NEAREST = 0.5
"""Distance of the camera [m] from a figure of no size."""


class Camera:
    """A camera that follows the figure of a trajectory.

    Args:
        trajectory: to draw.
        view: the angles that it is seen from, and the size of the picture.
        frames: numbers of the frames that will be drawn.

    Attributes:
        middle: height [m] at which it looks: halfway from the ground, or from the lowest point of cloth alone, to the
            highest point of all frames.
        distance: from what it looks at [m].
    """

    def __init__(self, trajectory: Trajectory, view: View, frames: Sequence[int]) -> None:
        self._trajectory, self._view = trajectory, view
        self._feet: dict[int, np.ndarray] = {}
        heights = [points[:, 1] for t in frames if len(points := self._visible(t)[0])]
        stands = view.show_body and trajectory.body_positions.shape[1] > 0
        low = 0.0 if stands else min((float(height.min()) for height in heights), default=0.0)
        self._half_height = 0.5 * (max((float(height.max()) for height in heights), default=0.0) - low)
        self.middle = low + self._half_height
        self.distance = max((self._needed_distance(t) for t in frames), default=0.0) * _MARGIN

    def _visible(self, t: int) -> tuple[np.ndarray, np.ndarray]:
        """Points (vertices, 3) [m] that the picture of frame t should hold, seen from its `foot`; which are cloth."""
        cloth, body = self._trajectory.positions[t], self._trajectory.body_positions[t]
        points = np.concatenate([cloth, body]) if self._view.show_body else cloth
        finite = np.isfinite(points).all(axis=1)
        points = np.where(finite[:, None], points, 0.0) - self.foot(t)
        near = (np.linalg.norm(points[:, [0, 2]], axis=1) < _REACH) & (points[:, 1] < _TOP) & finite
        return points[near], near.nonzero()[0] < len(cloth)

    def wearer(self, t: int) -> np.ndarray:
        """Points (vertices, 3) [m] of the body, or of the cloth where there is none.

        Args:
            t: number of the frame.
        """
        body = self._trajectory.body_positions[t]
        points = body if len(body) else self._trajectory.positions[t]
        points = points[np.isfinite(points).all(axis=1)]
        return np.asarray(points) if len(points) else np.zeros((1, 3))

    def foot(self, t: int) -> np.ndarray:
        """(3,) point of the ground [m] below the middle of the figure.

        Args:
            t: number of the frame.
        """
        if t not in self._feet:
            x, _, z = np.median(self.wearer(t), axis=0)
            self._feet[t] = np.array([x, 0.0, z])
        return self._feet[t]

    def target(self, t: int) -> np.ndarray:
        """(3,) point [m] that it looks at: halfway between the leftmost and the rightmost point.

        Args:
            t: number of the frame.
        """
        right = self.axes(t)[0]
        aside = self._visible(t)[0] @ right
        reach = (aside.min() + aside.max()) / 2 if len(aside) else 0.0
        return np.asarray(self.foot(t) + np.array([0.0, self.middle, 0.0]) + reach * right)

    def _needed_distance(self, t: int) -> float:
        """Distance of the camera [m] from which frame t lies within the picture."""
        points, cloth = self._visible(t)
        seen = points + self.foot(t) - self.target(t)
        aside, upward, towards = (seen @ axis for axis in self.axes(t))
        sides, heights = np.abs(aside) * self._view.height / self._view.width, np.abs(upward)

        def needed(spread: np.ndarray) -> float:
            return float((towards + spread / np.tan(np.deg2rad(FIELD_OF_VIEW / 2))).max(initial=_NEAREST))

        low, high = np.quantile(points, (0.25, 0.75), axis=0) if len(points) else np.zeros((2, 3))
        distance = needed(np.maximum(heights, sides))
        if self._half_height < (high - low)[[0, 2]].max():
            return distance
        return min(distance, max(needed(heights) / _FILLED, needed(np.where(cloth, sides, 0.0))))

    def axes(self, t: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Unit vectors (3,) of the picture of frame t: to its right, to its top, and towards the camera.

        Args:
            t: number of the frame.
        """
        turn = self._view.turntable * t / max(self._trajectory.frame_count - 1, 1)
        azimuth = self.heading() + np.deg2rad(self._view.azimuth + turn)
        elevation = np.deg2rad(self._view.elevation)
        level = np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
        up = np.array([0.0, 1.0, 0.0])
        return (
            np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)]),
            np.cos(elevation) * up - np.sin(elevation) * level,
            np.cos(elevation) * level + np.sin(elevation) * up,
        )

    def heading(self) -> float:
        """Angle about the vertical [rad] of the direction the body faces at the start; 0 is +Z."""
        return float(self._trajectory.metadata.get("heading", 0.0))
