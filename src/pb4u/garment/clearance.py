"""Keeps a resting garment a little way off the skin."""

from __future__ import annotations

import numpy as np

from pb4u.body.body_model import ShapedBody
from pb4u.collision.nearest_surface import PosedSurface, TriangleSurface

#: Smallest distance [m] that a built-in garment keeps from the skin at rest.
SMALLEST_CLEARANCE = 0.004

# Most rounds of pushing, which end when all is clear; what a crease has no room for is left after them.
_ROUNDS = 12
#: Where each face is probed: corners, edge middles, centre, and the centres of the four quarters.
_PROBES = np.array(
    [
        (1, 0, 0), (0, 1, 0), (0, 0, 1), (1 / 2, 1 / 2, 0), (0, 1 / 2, 1 / 2), (1 / 2, 0, 1 / 2), (1 / 3, 1 / 3, 1 / 3),
        (2 / 3, 1 / 6, 1 / 6), (1 / 6, 2 / 3, 1 / 6), (1 / 6, 1 / 6, 2 / 3),
    ]
)  # fmt: skip


def clear_of_body(vertices: np.ndarray, faces: np.ndarray, body: ShapedBody) -> np.ndarray:
    """A garment moved out until corners, edges and insides of all faces are `SMALLEST_CLEARANCE` off the skin.

    Args:
        vertices: (vertices, 3) [m].
        faces: (faces, 3) int64.
        body: the resting body.

    Returns:
        (vertices, 3) [m].
    """
    surface = TriangleSurface(body.faces, len(body.vertices)).at(body.vertices)
    vertices = vertices.copy()
    suspects = np.arange(len(faces))
    for _ in range(_ROUNDS):
        short, normals = _shortfall(vertices, faces[suspects], surface)
        worst = short.max(axis=1)
        suspects = suspects[worst > -0.02]
        if not (worst > 0.0).any():
            break
        short, normals = short[worst > -0.02], normals[worst > -0.02]
        push = np.zeros((len(vertices), 4))
        for k, weights in enumerate(_PROBES):
            needed = np.flatnonzero(short[:, k] > 0.0)
            for corner in range(3):
                if weights[corner] == 0.0:
                    continue
                # A probe moves with its corners: all of them go as far as it must.
                index = faces[suspects[needed], corner]
                amount = short[needed, k] * weights[corner]
                np.add.at(push, index, np.column_stack([normals[needed, k] * amount[:, None], amount]))
        is_pushed = push[:, 3] > 0.0
        direction = push[is_pushed, :3] / push[is_pushed, 3:]
        longest = np.zeros(len(vertices))
        for corner in range(3):
            np.maximum.at(longest, faces[suspects, corner], np.maximum(short.max(axis=1), 0.0))
        vertices[is_pushed] += direction * (longest[is_pushed, None] + 2e-4)
    return vertices


def _shortfall(vertices: np.ndarray, faces: np.ndarray, surface: PosedSurface) -> tuple[np.ndarray, np.ndarray]:
    """How much each probe (faces, probes) lacks of the clearance [m], and the way out (faces, probes, 3)."""
    probes = np.einsum("pk,fkd->fpd", _PROBES, vertices[faces])
    near = surface.nearest(probes.reshape(-1, 3))
    distance = near.signed_distance.numpy().reshape(probes.shape[:2])
    return SMALLEST_CLEARANCE - distance, near.normals.numpy().reshape(probes.shape)


def rest_distances(vertices: np.ndarray, body: ShapedBody) -> np.ndarray:
    """Signed distances of points to the resting skin.

    Args:
        vertices: (n, 3) [m].
        body: the resting body.

    Returns:
        (n,) [m], negative inside.
    """
    surface = TriangleSurface(body.faces, len(body.vertices)).at(body.vertices)
    return surface.nearest(vertices).signed_distance.numpy()
