"""A garment at rest: everything about it that never changes during a simulation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from pb4u.garment.material import Material
from pb4u.geometry.mesh_file import PolygonMesh
from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import edge_lengths, face_areas


@dataclass(frozen=True, eq=False)
class SourceMap:
    """Places of the author's vertices on the simulated mesh, by triangle and barycentric coordinates.

    Args:
        source: the author's mesh.
        triangle: (source vertices,) int64 simulated face.
        barycentric: (source vertices, 3) float64, rows sum to 1.
    """

    source: PolygonMesh
    triangle: np.ndarray
    barycentric: np.ndarray


@dataclass(frozen=True, eq=False)
class Garment:
    """A single-layer triangle mesh in its rest shape, worn by a body in its rest pose.

    Args:
        name: what the user called it.
        vertices: (vertices, 3) float64 rest positions [m], where they sit on the resting body.
        faces: (faces, 3) int64, counter-clockwise from outside.
        material: cloth material.
        pinned: (vertices,) bool, vertices that follow the body; left out, none does.
        uvs: (uv points, 2) float64 of the simulated mesh, or None.
        uv_faces: (faces, 3) int64 into `uvs`, or None.
        source: map to the author's mesh, or None where that is the simulated mesh itself.
        loose: whether it hangs free of the nearest limb (dresses, skirts): skinning weights are then averaged widely.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    material: Material
    pinned: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    uvs: np.ndarray | None = None
    uv_faces: np.ndarray | None = None
    source: SourceMap | None = None
    loose: bool = False

    def __post_init__(self) -> None:
        if not len(self.pinned):
            object.__setattr__(self, "pinned", np.zeros(len(self.vertices), dtype=bool))

    @cached_property
    def topology(self) -> Topology:
        return Topology(self.faces, len(self.vertices))

    @cached_property
    def face_areas(self) -> np.ndarray:
        """Rest areas (faces,) [m^2] of the faces."""
        return face_areas(self.vertices, self.faces)

    @cached_property
    def vertex_areas(self) -> np.ndarray:
        """Rest areas (vertices,) [m^2] that belong to the vertices: a third of each incident face."""
        weights = np.repeat(self.face_areas / 3.0, 3)
        return np.bincount(self.faces.reshape(-1), weights=weights, minlength=len(self.vertices))

    @cached_property
    def vertex_masses(self) -> np.ndarray:
        """Masses (vertices,) [kg] of the vertices."""
        return self.material.density * self.vertex_areas

    @cached_property
    def edge_lengths(self) -> np.ndarray:
        """Rest lengths (edges,) [m] of `topology.edges`."""
        return edge_lengths(self.vertices, self.topology.edges)

    @cached_property
    def mean_edge_length(self) -> float:
        """Mean rest edge length [m]: the garment's resolution."""
        return float(self.edge_lengths.mean())

    @property
    def triangle_count(self) -> int:
        return len(self.faces)

    def with_material(self, material: Material) -> Garment:
        return replace(self, material=material)

    def with_pins(self, pinned: np.ndarray) -> Garment:
        return replace(self, pinned=pinned)
