"""The point of a triangle that is closest to a point, by tensors: on any device, and with gradient."""

from __future__ import annotations

import torch
from torch import Tensor


def closest_barycentric(points: Tensor, a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    """Barycentric coordinates of the closest point of each triangle to a given point, one point for each triangle.

    By Voronoi regions of corners, edges and face (Ericson, Real-Time Collision Detection, 5.1.5); a degenerate
    triangle counts as its edges.

    Args:
        points: (..., 3) [m].
        a: (..., 3) first corner of each triangle [m].
        b: (..., 3) second corner [m].
        c: (..., 3) third corner [m].

    Returns:
        (..., 3) barycentric coordinates in the triangle.
    """
    ab, ac, ap = b - a, c - a, points - a
    d1, d2 = (ab * ap).sum(-1), (ac * ap).sum(-1)
    bp, cp = points - b, points - c
    d3, d4 = (ab * bp).sum(-1), (ac * bp).sum(-1)
    d5, d6 = (ab * cp).sum(-1), (ac * cp).sum(-1)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2

    def ratio(top: Tensor, bottom: Tensor) -> Tensor:
        return torch.where(bottom > 0, top / torch.where(bottom > 0, bottom, 1.0), 0.0).clamp(0.0, 1.0)

    zero, one = torch.zeros_like(d1), torch.ones_like(d1)
    total = va + vb + vc
    v, w = ratio(vb, total), ratio(vc, total)
    result = torch.stack([one - v - w, v, w], dim=-1)
    t = ratio(d4 - d3, (d4 - d3) + (d5 - d6))
    result = _choose((va <= 0) & (d4 - d3 >= 0) & (d5 - d6 >= 0), (zero, one - t, t), result)
    t = ratio(d2, d2 - d6)
    result = _choose((vb <= 0) & (d2 >= 0) & (d6 <= 0), (one - t, zero, t), result)
    t = ratio(d1, d1 - d3)
    result = _choose((vc <= 0) & (d1 >= 0) & (d3 <= 0), (one - t, t, zero), result)
    result = _choose((d6 >= 0) & (d5 <= d6), (zero, zero, one), result)
    result = _choose((d3 >= 0) & (d4 <= d3), (zero, one, zero), result)
    return _choose((d1 <= 0) & (d2 <= 0), (one, zero, zero), result)


def _choose(where: Tensor, coordinates: tuple[Tensor, Tensor, Tensor], otherwise: Tensor) -> Tensor:
    return torch.where(where[..., None], torch.stack(coordinates, dim=-1), otherwise)
