"""The garments of an outfit one by one: other programs take each as an object of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, count

import numpy as np

from pb4u.export.shading import ClothPart
from pb4u.scene.author_mesh import Polygons
from pb4u.scene.trajectory import TrajectoryHeader


@dataclass(frozen=True, eq=False)
class Piece:
    """One garment of a trajectory.

    Args:
        name: of the garment; no two of a trajectory have the same.
        vertices: its vertices in the trajectory.
        faces: (faces,) int64 its faces in the trajectory.
        header: of a trajectory of this garment alone, without the author's other mesh.
    """

    name: str
    vertices: slice
    faces: np.ndarray
    header: TrajectoryHeader

    def looks(self, parts: Sequence[ClothPart]) -> list[ClothPart]:
        """The parts of this garment, with faces numbered within the garment.

        Args:
            parts: of the trajectory, each of one garment.
        """
        inside = [part for part in parts if np.isin(part.faces[:1], self.faces).all()]
        return [replace(part, faces=np.searchsorted(self.faces, part.faces)) for part in inside]


def part_of_polygon(header: TrajectoryHeader, parts: Sequence[ClothPart]) -> np.ndarray:
    """Which of the parts each polygon (polygons,) int64 of a trajectory belongs to, by its first triangle.

    Args:
        header: of the trajectory, or of a piece.
        parts: that all of its faces belong to.
    """
    of_face = np.empty(len(header.faces), dtype=np.int64)
    for k, part in enumerate(parts):
        of_face[part.faces] = k
    # The triangles of a polygon follow each other, two fewer than its corners.
    triangles = header.outlines.sizes - 2
    return of_face[np.cumsum(triangles) - triangles]


def pieces(header: TrajectoryHeader) -> list[Piece]:
    """The garments of a trajectory; one that is called "Garment" where there is no more than one.

    Args:
        header: of the trajectory.
    """
    owner = np.asarray(header.vertex_garment)
    firsts = np.flatnonzero(np.diff(owner, prepend=-1))
    described = header.garments
    if len(firsts) < 2 or len(firsts) != len(described) or len(np.unique(owner)) != len(firsts):
        return [Piece("Garment", slice(0, len(owner)), np.arange(len(header.faces)), header)]
    names = names_apart([str(garment["name"]) for garment in described], " ")
    ends = [*firsts[1:].tolist(), len(owner)]
    return [
        _piece(header, k, name, slice(first, end))
        for k, (name, first, end) in enumerate(zip(names, firsts.tolist(), ends, strict=True))
    ]


def names_apart(names: Sequence[str], between: str) -> list[str]:
    """The names made unique: a repeated one gets the first free number.

    Args:
        names: some may be equal.
        between: text before the number.
    """
    apart: list[str] = []
    for name in names:
        numbered = (f"{name}{between}{number}" for number in count(2))
        apart.append(next(candidate for candidate in chain((name,), numbered) if candidate not in apart))
    return apart


def _piece(header: TrajectoryHeader, k: int, name: str, vertices: slice) -> Piece:
    first, size = vertices.start, vertices.stop - vertices.start
    faces = np.flatnonzero((header.faces[:, 0] >= first) & (header.faces[:, 0] < vertices.stop))
    outlines = header.outlines
    starts = outlines.corners[np.cumsum(outlines.sizes) - outlines.sizes]
    polygons = (starts >= first) & (starts < vertices.stop)
    corners = np.repeat(polygons, outlines.sizes)
    uvs, uv_faces, uv_corners = header.uvs, None, None
    if uvs is not None and header.uv_faces is not None and outlines.uv_corners is not None:
        points = np.unique(np.r_[header.uv_faces[faces].ravel(), outlines.uv_corners[corners]])
        uvs, uv_faces = uvs[points], np.searchsorted(points, header.uv_faces[faces])
        uv_corners = np.searchsorted(points, outlines.uv_corners[corners])
    buttons = header.buttons
    if buttons is not None:
        buttons = buttons[(buttons >= first) & (buttons < vertices.stop)] - first
    outlines_of_piece = Polygons(outlines.sizes[polygons], outlines.corners[corners] - first, uv_corners)
    described = header.garments[k] | {"vertices": [0, size], "triangles": [0, len(faces)]}
    alone = replace(
        header,
        metadata={**header.metadata, "garments": [described]},
        faces=header.faces[faces] - first,
        rest_positions=header.rest_positions[vertices],
        pinned=header.pinned[vertices],
        vertex_garment=np.zeros(size, dtype=np.int32),
        uvs=uvs,
        uv_faces=uv_faces,
        source=None,
        rest_uv=None if header.rest_uv is None else header.rest_uv[faces],
        material_layers=None if header.material_layers is None else header.material_layers[faces],
        trims=None if header.trims is None else header.trims[faces],
        buttons=buttons,
        polygons=None if header.polygons is None else outlines_of_piece,
        appearances=None if header.appearances is None else header.appearances.at(faces),
    )
    return Piece(name, vertices, faces, alone)
