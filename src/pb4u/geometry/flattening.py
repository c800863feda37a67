"""Lays a curved piece of surface flat with as little stretch as may be: what a tailor cuts out."""

from __future__ import annotations

import numpy as np

from pb4u.geometry.topology import Topology
from pb4u.geometry.triangle_mesh import laid_flat

_LARGEST_STRAIN = 0.2
"""Mean strain of what can be laid flat; a closed tube is far beyond."""

_ROUNDS = 30
"""Rounds of fitting: further ones change no quantile of the strain of a garment's panels by a tenth."""


def flattened(vertices: np.ndarray, faces: np.ndarray, ease: float = 0.0) -> np.ndarray | None:
    """A piece of surface flattened so that each triangle keeps its shape as nearly as its neighbours allow.

    Least squares conformal maps (Levy et al. 2002) are the start; fits of each triangle and of all follow in turn (as
    rigid as possible, Liu et al. 2008). With ease, triangles that come out larger than on the surface partly stay so:
    there worn cloth folds, and the rest is stretched less.

    Args:
        vertices: (vertices, 3) of the surface [m], all of them used.
        faces: (faces, 3) int64, one piece with a border.
        ease: share of the excess size that stays, from 0 to below 1.

    Returns:
        (vertices, 2) [m], turned anyhow; None where triangles fold over, or are strained by a fifth in the mean.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import splu

    corners = laid_flat(vertices[faces]) @ [1.0, 1.0j]
    # The edge opposite to each corner; points of the plane are complex numbers.
    sides = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)
    areas = _areas(corners)
    energies = (sides[:, :, None] * sides[:, None].conj()).real / (8.0 * areas[:, None, None])
    rows, columns = np.broadcast_arrays(faces[:, :, None], faces[:, None])
    stiffness = coo_matrix((energies.ravel(), (rows.ravel(), columns.ravel())), shape=[len(vertices)] * 2)
    # One point stays where it is.
    fit = splu(stiffness.tocsc()[1:, 1:])
    flat = _conformal(vertices, faces)
    for _ in range(_ROUNDS):
        # The map of a triangle is a turn and a mirrored turn: their sizes' sum and difference are its stretches.
        turn = -0.25j / areas * (flat[faces] * sides.conj()).sum(axis=1)
        mirror = 0.25j / areas * (flat[faces] * sides).sum(axis=1)
        sizes = np.maximum(np.abs([turn, mirror]), 1e-12)
        larger, smaller = (1.0 + ease * np.maximum(s - 1.0, 0.0) for s in (sizes[0] + sizes[1], sizes[0] - sizes[1]))
        turn, mirror = 0.5 * (larger + smaller) * turn / sizes[0], 0.5 * (larger - smaller) * mirror / sizes[1]
        pulls = 0.25j * (sides * turn[:, None] - sides.conj() * mirror[:, None])
        x, y = (fit.solve(np.bincount(faces.ravel(), part.ravel())[1:]) for part in (pulls.real, pulls.imag))
        flat = np.concatenate([[0.0], x + 1j * y])
    strains = np.abs([sizes[0] + sizes[1] - 1.0, sizes[0] - sizes[1] - 1.0]).max(axis=0)
    is_sound = (_areas(flat[faces]) > 0.0).all() and np.average(strains, weights=areas) < _LARGEST_STRAIN
    return np.column_stack([flat.real, flat.imag]) if is_sound else None


def _conformal(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Points (vertices,) of the plane that keep angles as nearly as may be; two far ones keep their distance [m]."""
    import igl

    border = np.flatnonzero(Topology(faces, len(vertices)).border_vertices)
    first = border[np.argmin(vertices[border, 1])]
    distances = np.linalg.norm(vertices[border] - vertices[first], axis=1)
    ends, places = np.array([first, border[np.argmax(distances)]]), np.array([[0.0, 0.0], [0.0, distances.max()]])
    return np.asarray(igl.lscm(vertices, faces, ends, places)[0]).reshape(-1, 2) @ [1.0, 1.0j]


def _areas(corners: np.ndarray) -> np.ndarray:
    """Areas (faces,) of triangles with their corners (faces, 3) in the plane, below 0 where they are turned over."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * (one.conj() * two).imag
