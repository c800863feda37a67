"""The faces of a mesh as its author made them: triangles, quads and n-gons."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Polygons:
    """Faces of any number of corners, laid end to end.

    Args:
        sizes: (polygons,) int64 corners of each, 3 or more.
        corners: (sum of sizes,) int64 vertex at each corner.
        uv_corners: (sum of sizes,) int64 UV point at each corner, or None.
    """

    sizes: np.ndarray
    corners: np.ndarray
    uv_corners: np.ndarray | None = None

    @classmethod
    def of(cls, polygons: Sequence[np.ndarray], polygon_uvs: Sequence[np.ndarray] | None = None) -> Polygons | None:
        """Those of a mesh; None where all are triangles, which need no other account than the faces."""
        sizes = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
        if not (sizes > 3).any():
            return None
        return cls(sizes, np.concatenate(polygons), None if polygon_uvs is None else np.concatenate(polygon_uvs))

    @classmethod
    def of_triangles(cls, faces: np.ndarray, uv_faces: np.ndarray | None) -> Polygons:
        """Triangles (faces, 3), and their UV corners, as polygons."""
        uv_corners = None if uv_faces is None else uv_faces.reshape(-1)
        return cls(np.full(len(faces), 3, dtype=np.int64), faces.reshape(-1), uv_corners)

    def each(self, of_corners: np.ndarray) -> Iterator[list[int]]:
        """Rows of one integer per corner, polygon by polygon."""
        values, start = of_corners.tolist(), 0
        for size in self.sizes.tolist():
            yield values[start : start + size]
            start += size

    def members(self, prefix: str = "") -> dict[str, np.ndarray]:
        """As arrays of a trajectory file."""
        members = {f"{prefix}polygon_sizes": self.sizes, f"{prefix}polygon_corners": self.corners}
        if self.uv_corners is not None:
            members[f"{prefix}polygon_uv_corners"] = self.uv_corners
        return {name: values.astype(np.int64) for name, values in members.items()}

    @classmethod
    def from_members(cls, members: dict[str, np.ndarray], prefix: str = "") -> Polygons | None:
        """From the arrays of a trajectory file; None where it has no such arrays."""
        sizes, corners = members.get(f"{prefix}polygon_sizes"), members.get(f"{prefix}polygon_corners")
        if sizes is None or corners is None:
            return None
        return cls(sizes, corners, members.get(f"{prefix}polygon_uv_corners"))
