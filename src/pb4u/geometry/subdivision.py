"""One round of Loop's subdivision: the smooth surface that a triangle mesh stands for, with four faces for each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix


@dataclass(frozen=True, eq=False)
class Split:
    """Faces split at the midpoints of their edges; the old vertices come first, then a new one for each edge.

    Args:
        faces: (fine faces, 3) int64; of a split face the three corner triangles, then the middle one.
        parent: (fine faces,) int64 the face that each is cut from.
        edges: (edges, 2) int64 that are cut.
        middles: (faces, 3) int64 new vertices on the edges 01, 12 and 20 of each face; -1 for faces that are not split.
    """

    faces: np.ndarray
    parent: np.ndarray
    edges: np.ndarray
    middles: np.ndarray

    def between(self, values: np.ndarray) -> np.ndarray:
        """Values (vertices + edges, ...) at all vertices; each new one has the mean of the edge's ends.

        Args:
            values: (vertices, ...) at the old vertices.
        """
        return np.concatenate([values, values[self.edges].mean(axis=1)])


def split_faces(faces: np.ndarray, vertices: int, chosen: np.ndarray) -> Split:
    """Cut some faces into four.

    Args:
        faces: (faces, 3) int64.
        vertices: how many there are.
        chosen: (faces,) bool the faces that are cut; no edge is shared with another.
    """
    cut = faces[chosen]
    edges, of_corner = np.unique(
        np.sort(cut[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0, return_inverse=True
    )
    middles = np.full(faces.shape, -1)
    middles[chosen] = vertices + of_corner.reshape(-1, 3)
    m01, m12, m20 = middles[chosen].T
    a, b, c = cut.T
    four = np.stack([a, m01, m20, b, m12, m01, c, m20, m12, m01, m12, m20], axis=1).reshape(-1, 3)
    parent = np.repeat(np.arange(len(faces)), np.where(chosen, 4, 1))
    fine = faces[parent]
    fine[chosen[parent]] = four
    return Split(fine, parent, edges, middles)


def loop_weights(split: Split, faces: np.ndarray, vertices: int) -> csr_matrix:
    """Weights (vertices + edges, vertices) of Loop's scheme; borders are cubic splines that follow nothing within.

    C. Loop, *Smooth subdivision surfaces based on triangles* (1987), with the weights beta = 3 / (8 n) and 3 / 16 at
    n = 3 of Warren (1995).

    Args:
        split: the split of these faces.
        faces: (faces, 3) int64.
        vertices: how many there are.
    """
    cut, middles, edges = faces[split.middles[:, 0] >= 0], split.middles[split.middles[:, 0] >= 0], split.edges
    border = np.bincount(middles.ravel() - vertices, minlength=len(edges)) != 2
    ends, new = edges.ravel(), np.repeat(vertices + np.arange(len(edges)), 2)
    entries = [(new, ends, np.repeat(np.where(border, 0.5, 0.375), 2))]
    # A new vertex follows the corners across its edge as well.
    within = ~border[middles.ravel() - vertices]
    entries.append((middles.ravel()[within], cut[:, [2, 0, 1]].ravel()[within], np.full(within.sum(), 0.125)))
    valence = np.bincount(ends, minlength=vertices)
    at_border = np.bincount(ends, np.repeat(border, 2), minlength=vertices)
    # Where other than two border edges meet, a corner stays.
    share = np.where(valence == 3, 0.1875, 0.375 / np.maximum(valence, 1))
    share = np.where(at_border == 0, share, np.where(at_border == 2, 0.125, 0.0))
    across = edges[:, ::-1].ravel()
    followed = (at_border[ends] == 0) | np.repeat(border, 2)
    entries.append((ends[followed], across[followed], share[ends[followed]]))
    rows, columns, weights = (np.concatenate(part) for part in zip(*entries, strict=True))
    own_weight = 1.0 - np.bincount(rows[rows < vertices], weights[rows < vertices], minlength=vertices)
    old = np.arange(vertices)
    places = np.concatenate([rows, old]), np.concatenate([columns, old])
    shape = vertices + len(edges), vertices
    return coo_matrix((np.concatenate([weights, own_weight]), places), shape=shape).tocsr()
