"""Values on garments without their short wavelengths: a screened Poisson equation on the rest mesh."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.scene.packed import PackedGarments
from pb4u.threads import to_device

_TOLERANCE = 1e-5
"""Error of the sweeps, relative to what they solve for; single precision of the accelerations leaves about that."""

_MOST_SWEEPS = 1000
"""Limit for meshes with slivers, where the bound of the spectrum is far too careful."""


class SurfaceLowPass:
    """The operator (M + l^2 C)^-1 M, M the vertices' areas and C the stiffness of the Laplacian by cotangents.

    On a plane it multiplies a wave of length w by 1 / (1 + (2 pi l / w)^2); values that are constant over a piece are
    unchanged. An edge with a negative sum of cotangents gets the stiffness 0, so that no value leaves the range of the
    input. At pinned vertices the smooth part is always 0: predictions there are overwritten, so that a correction near
    them ends at them and has no long wavelength.

    On a processor the matrix is factorised once; elsewhere a fixed number of Chebyshev sweeps solves for it, without
    waiting for the device.

    Args:
        garments: the pack, on the device of the values.
        length: l [m].
        sweeps: whether to solve by sweeps; by default where the garments are not on a processor.
    """

    def __init__(self, garments: PackedGarments, length: float, sweeps: bool | None = None) -> None:
        on_processor = garments.device.type == "cpu"
        areas, diagonal, weights = _system(garments, length)
        self._areas = to_device(torch.from_numpy(areas)[:, None], garments.device)
        makes = _by_sweeps if (not on_processor if sweeps is None else sweeps) else _by_factors
        self._solve = makes(diagonal, weights, garments.device)

    def __call__(self, values: Tensor) -> Tensor:
        """Smooth part (vertices, columns) of `values`, in their unit and precision; differentiable.

        Args:
            values: (vertices, columns) of any unit.
        """
        wide = values.to(torch.float64)
        smooth: Tensor = _Solution.apply(wide, self._areas, self._solve)  # type: ignore[no-untyped-call]
        return smooth.to(values)


class _Solution(torch.autograd.Function):
    """A^-1 M x with a symmetric A, so that M A^-1 g is its derivative."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, areas: Tensor, solve: Callable[[Tensor], Tensor]) -> Tensor:
        ctx.areas, ctx.solve = areas, solve
        return solve(areas * values)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        return ctx.areas * ctx.solve(gradient), None, None


def _system(garments: PackedGarments, length: float) -> tuple[np.ndarray, np.ndarray, Any]:
    """Areas (vertices,) [m^2] that values count with; of the matrix its diagonal and, negated, the sparse rest."""
    from scipy.sparse import coo_array

    second, third = garments.inverse_rest_shape.double().unbind(1)
    slopes = torch.stack([-second - third, second, third], dim=1)
    cotangents = -garments.face_areas.double()[:, None] * (slopes * slopes.roll(-1, 1)).sum(2)
    ends = torch.stack([garments.faces, garments.faces.roll(-1, 1)]).reshape(2, -1).cpu().numpy()
    count = garments.vertex_count
    halves = coo_array((cotangents.reshape(-1).cpu().numpy(), tuple(ends)), (count, count)).tocsr()
    joined = (halves + halves.T).tocoo()
    stiffness = length**2 * np.maximum(joined.data, 0.0)
    areas, pinned = garments.vertex_areas.double().cpu().numpy(), garments.pinned.cpu().numpy()
    areas = np.where(areas > 0.0, areas, 1.0)  # where no face is
    diagonal = areas + np.bincount(joined.row, stiffness, count)
    free = ~(pinned[joined.row] | pinned[joined.col])
    weights = coo_array((stiffness[free], (joined.row[free], joined.col[free])), (count, count)).tocsr()
    return np.where(pinned, 0.0, areas), diagonal, weights


def _by_factors(diagonal: np.ndarray, weights: Any, device: torch.device) -> Callable[[Tensor], Tensor]:
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    # Symmetric and positive definite: no pivots are looked for, and the order keeps the factors sparse.
    options = {"SymmetricMode": True}
    matrix = (diags_array(diagonal) - weights).tocsc()
    factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)

    def solve(values: Tensor) -> Tensor:
        return torch.from_numpy(factors.solve(values.detach().numpy()))

    return solve


def _by_sweeps(diagonal: np.ndarray, weights: Any, device: torch.device) -> Callable[[Tensor], Tensor]:
    """Chebyshev sweeps on D^-1 A, D the diagonal of A: by Gershgorin's circles its spectrum lies in [least, most]."""
    count = len(diagonal)
    rows = np.repeat(np.arange(count), np.diff(weights.indptr))
    width = max(int(np.diff(weights.indptr).max(initial=0)), 1)
    column = np.arange(len(rows)) - weights.indptr[rows]
    neighbours, shares = np.zeros((count, width), dtype=np.int64), np.zeros((count, width, 1))
    neighbours[rows, column], shares[rows, column, 0] = weights.indices, weights.data / diagonal[rows]
    least = float(1.0 - shares.sum(1).max())
    most = 2.0 - least
    sweeps = math.ceil(0.5 * math.sqrt(most / least) * math.log(2.0 / _TOLERANCE))
    middle, half = 0.5 * (most + least), 0.5 * (most - least)
    around, share, inverse = (
        to_device(torch.from_numpy(array), device) for array in (neighbours, shares, 1.0 / diagonal[:, None])
    )

    def solve(values: Tensor) -> Tensor:
        residual = inverse * values
        move, solution = residual / middle, torch.zeros_like(residual)
        if half <= 1e-12 * middle:
            return move
        ratio = half / middle
        for _ in range(min(sweeps, _MOST_SWEEPS)):
            solution = solution + move
            residual = residual - move + (share * move[around]).sum(1)
            following = 1.0 / (2.0 * middle / half - ratio)
            move = following * ratio * move + (2.0 * following / half) * residual
            ratio = following
        return solution

    return solve
