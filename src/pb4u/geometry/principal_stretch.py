"""How far a triangle mesh is stretched from its rest shape: principal stretches and strain."""

from __future__ import annotations

import torch
from torch import Tensor


def deformation_gradients(positions: Tensor, faces: Tensor, inverse_rest_shape: Tensor) -> Tensor:
    """Deformation gradients of the faces.

    Args:
        positions: (..., vertices, 3) deformed vertices [m].
        faces: (faces, 3) int64.
        inverse_rest_shape: (faces, 2, 2) inverse edge matrix of the rest triangle in its own plane [1/m].

    Returns:
        (..., faces, 3, 2) [1].
    """
    a, b, c = (positions.index_select(-2, faces[:, k]) for k in range(3))
    return torch.stack([b - a, c - a], dim=-1) @ inverse_rest_shape


def principal_stretches(positions: Tensor, faces: Tensor, inverse_rest_shape: Tensor) -> Tensor:
    """Singular values of the deformation gradients of the faces.

    Args:
        positions: (..., vertices, 3) deformed vertices [m].
        faces: (faces, 3) int64.
        inverse_rest_shape: (faces, 2, 2) as for `deformation_gradients` [1/m].

    Returns:
        (..., faces, 2) [1], largest first; 1 is unstretched.
    """
    gradient = deformation_gradients(positions, faces, inverse_rest_shape)
    f1, f2 = gradient[..., 0], gradient[..., 1]
    # The smaller from the area, their product: the characteristic polynomial would cancel on thin slivers.
    area = torch.linalg.cross(f1, f2).norm(dim=-1)
    squares = (f1 * f1).sum(-1) + (f2 * f2).sum(-1)
    half_gap = 0.5 * ((f1 * f1).sum(-1) - (f2 * f2).sum(-1))
    gap = torch.hypot(half_gap, (f1 * f2).sum(-1))
    largest = (0.5 * squares + gap).clamp_min(0.0).sqrt()
    smallest = area / largest.clamp_min(torch.finfo(largest.dtype).tiny)
    return torch.stack([largest, smallest], dim=-1)


def face_strains(positions: Tensor, faces: Tensor, inverse_rest_shape: Tensor) -> Tensor:
    """Largest |principal stretch - 1| of each face.

    Args:
        positions: (..., vertices, 3) deformed vertices [m].
        faces: (faces, 3) int64.
        inverse_rest_shape: (faces, 2, 2) as for `deformation_gradients` [1/m].

    Returns:
        (..., faces) [1].
    """
    return (principal_stretches(positions, faces, inverse_rest_shape) - 1.0).abs().amax(dim=-1)


def weighted_percentile(values: Tensor, weights: Tensor, percent: float) -> Tensor:
    """Smallest value that at least a share of the weight does not exceed.

    Args:
        values: (..., n), in any unit.
        weights: (n,) positive, in any unit.
        percent: the share, 0 to 100.

    Returns:
        (...,), in the unit of the values.
    """
    ordered, order = values.sort(dim=-1)
    share = weights[order].cumsum(dim=-1)
    reached = share >= (percent / 100.0) * share[..., -1:] * (1.0 - 1e-12)
    return ordered.gather(-1, reached.to(torch.int8).argmax(dim=-1, keepdim=True))[..., 0]
