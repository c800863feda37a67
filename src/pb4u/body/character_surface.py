"""The skin of a character: welded, its pieces turned outward, its holes closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pb4u.geometry.topology import Topology, connected_labels

# Vertices nearer than this share of the height are one where the same bones move them, to this much of a weight.
_SAME_PLACE, _SAME_WEIGHT = 1e-5, 0.02


@dataclass(frozen=True, eq=False)
class CharacterSurface:
    """A skinned surface.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        bones: (vertices, influences) int64.
        weights: (vertices, influences) [1].
    """

    vertices: np.ndarray
    faces: np.ndarray
    bones: np.ndarray
    weights: np.ndarray

    def renumbered(self, rank: np.ndarray) -> CharacterSurface:
        """The same surface with other numbers of its bones.

        Args:
            rank: (bones,) int64 new number of each bone.
        """
        return CharacterSurface(self.vertices, self.faces, rank[self.bones], self.weights)

    def moved(self, transform: np.ndarray) -> CharacterSurface:
        """The same surface, transformed.

        Args:
            transform: (4, 4).
        """
        places = self.vertices @ transform[:3, :3].T + transform[:3, 3]
        return CharacterSurface(places, self.faces, self.bones, self.weights)

    def welded(self) -> tuple[CharacterSurface, np.ndarray]:
        """The surface with coincident vertices merged if the same bones move them, and the new index of each vertex.

        glTF splits a vertex wherever its normal or its texture has two values.
        """
        reach = _SAME_PLACE * max(float(np.ptp(self.vertices, axis=0).max()), 1e-9)
        pairs = cKDTree(self.vertices).query_pairs(reach, output_type="ndarray")
        apart = np.abs(self._dense(pairs[:, 0]) - self._dense(pairs[:, 1])).max(axis=1, initial=0.0)
        pairs = pairs[apart < _SAME_WEIGHT]
        number = connected_labels(len(self.vertices), pairs[:, 0], pairs[:, 1])
        _, first, number = np.unique(number, return_index=True, return_inverse=True)
        number = number.reshape(-1)
        faces = number[self.faces]
        faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
        # One triangle counts once, whichever way round.
        _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
        faces = faces[np.sort(once)]
        return CharacterSurface(self.vertices[first], faces, self.bones[first], self.weights[first]), number

    def _dense(self, rows: np.ndarray) -> np.ndarray:
        """Weights (rows, bones) of some vertices by bone."""
        result = np.zeros((len(rows), int(self.bones.max()) + 1), dtype=np.float32)
        np.add.at(result, (np.arange(len(rows))[:, None], self.bones[rows]), self.weights[rows])
        return result

    def turned_outward(self) -> CharacterSurface:
        """The surface with each of its pieces flipped if needed so that its volume is positive."""
        topology = Topology(self.faces, len(self.vertices))
        piece = topology.piece_of_vertex[self.faces[:, 0]]
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        volume = np.bincount(piece, np.einsum("fc,fc->f", a, np.cross(b, c)))
        faces = np.where((volume[piece] < 0.0)[:, None], self.faces[:, ::-1], self.faces)
        return CharacterSurface(self.vertices, np.ascontiguousarray(faces), self.bones, self.weights)

    def closed(self) -> tuple[CharacterSurface, list[float]]:
        """The surface with a fan over each hole, and the diameter of each hole [m]."""
        loops = _hole_cycles(self.faces)
        if not loops:
            return self, []
        vertices, faces, bones, weights = [self.vertices], [self.faces], [self.bones], [self.weights]
        width = self.bones.shape[1]
        sizes = []
        for k, loop in enumerate(loops):
            centre = len(self.vertices) + k
            faces.append(np.column_stack([loop, np.roll(loop, -1), np.full(len(loop), centre)]))
            vertices.append(self.vertices[loop].mean(axis=0)[None])
            mean = self._dense(loop).mean(axis=0)
            strongest = np.argsort(-mean, kind="stable")[:width]
            bones.append(np.pad(strongest, (0, width - len(strongest)))[None])
            shares = np.pad(mean[strongest], (0, width - len(strongest)))
            weights.append((shares / shares.sum())[None])
            sizes.append(float(np.linalg.norm(np.ptp(self.vertices[loop], axis=0))))
        return CharacterSurface(*(np.concatenate(rows) for rows in (vertices, faces, bones, weights))), sizes


def _hole_cycles(faces: np.ndarray) -> list[np.ndarray]:
    """The holes of triangles (faces, 3) as cycles of vertices, in the direction that triangles over them have."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = int(faces.max()) + 1
    missing = np.setdiff1d(directed[:, 1] * count + directed[:, 0], directed[:, 0] * count + directed[:, 1])
    following: dict[int, list[int]] = {}
    for start, end in zip((missing // count).tolist(), (missing % count).tolist(), strict=True):
        following.setdefault(start, []).append(end)
    cycles = []
    while following:
        way = [next(iter(following))]
        place = {way[0]: 0}
        while way and following.get(way[-1]):
            end = following[way[-1]].pop()
            if not following[way[-1]]:
                del following[way[-1]]
            if end not in place:
                place[end] = len(way)
                way.append(end)
                continue
            # Where holes touch in a vertex, each is a cycle of its own.
            cycle = way[place[end] :]
            cycles.append(np.array(cycle))
            for vertex in cycle[1:]:
                del place[vertex]
            way = way[: place[end] + 1]
        following.pop(way[-1], None)
    return [cycle for cycle in cycles if len(cycle) > 2]
