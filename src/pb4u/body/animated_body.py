"""What a simulation needs of a body: a surface that moves, whatever moves it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
from torch import Tensor

from pb4u.geometry.topology import Topology

FLOOR_PERCENTILE = 5.0
"""The ground is where the lowest point of a body is in all but so many percent of the frames, the lowest ones."""


class AnimatedBody(ABC):
    """A moving triangle surface with a constant topology.

    Attributes:
        faces: (faces, 3) int64, counter-clockwise seen from outside.
        contact: (vertices,) bool; False for hands or fingers and for skin inside other skin, which contact and
            penetration ignore.
        rest_vertices: (vertices, 3) float64 [m] the pose that garments are fitted to.
        fps: frames per second.
        name: as given by the user.
    """

    faces: np.ndarray
    contact: np.ndarray
    rest_vertices: np.ndarray
    fps: float
    name: str

    @property
    @abstractmethod
    def frame_count(self) -> int:
        """Number of frames."""

    @abstractmethod
    def positions(self, start: int, stop: int) -> Tensor:
        """Vertices of consecutive frames; two threads may call it at once.

        Args:
            start: first frame.
            stop: frame after the last.

        Returns:
            (stop - start, vertices, 3) float32 [m].
        """

    @cached_property
    def topology(self) -> Topology:
        return Topology(self.faces, len(self.rest_vertices))

    @property
    def is_closed(self) -> bool:
        """Whether the surface bounds a volume, without which penetration has no meaning."""
        return self.topology.is_closed
