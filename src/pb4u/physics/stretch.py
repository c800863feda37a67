"""In-plane stretch and shear: the Saint Venant-Kirchhoff membrane."""

from __future__ import annotations

import torch
from torch import Tensor

from pb4u.physics.energy_term import ElementBlocks, EnergyTerm, TimeStep, dot, outer, sum_by_garment
from pb4u.scene.packed import PackedGarments


class Stretch(EnergyTerm):
    """Sum over faces of A h [mu tr(G^2) + lambda/2 tr(G)^2] [J], G = (F^T F - 1) / 2 the Green strain.

    A is the rest area [m^2], h the thickness [m], mu and lambda the Lame parameters [Pa], F (3, 2) the deformation
    gradient against the rest triangle in its own plane. Source: SNUG (Santesteban et al. 2022), with 3D rest
    triangles as in HOOD (Grigorev et al. 2023).
    """

    name = "stretch"

    def energies(self, step: TimeStep, x: Tensor) -> Tensor:
        garments = step.garments
        f1, f2 = _columns(garments, x)
        g11, g22, g12 = 0.5 * (dot(f1, f1) - 1.0), 0.5 * (dot(f2, f2) - 1.0), 0.5 * dot(f1, f2)
        return _energies(garments, g11, g22, g12)

    def energies_and_gradient(self, step: TimeStep, x: Tensor) -> tuple[Tensor, Tensor]:
        garments = step.garments
        f1, f2 = _columns(garments, x)
        g11, g22, g12 = 0.5 * (dot(f1, f1) - 1.0), 0.5 * (dot(f2, f2) - 1.0), 0.5 * dot(f1, f2)
        s11, s22, s12 = _stress(garments, g11, g22, g12)
        p1 = f1 * s11[:, None] + f2 * s12[:, None]
        p2 = f1 * s12[:, None] + f2 * s22[:, None]
        inverse = garments.inverse_rest_shape
        on_b = p1 * inverse[:, 0, 0, None] + p2 * inverse[:, 0, 1, None]
        on_c = p1 * inverse[:, 1, 0, None] + p2 * inverse[:, 1, 1, None]
        gradient = torch.zeros_like(x)
        gradient.index_add_(0, garments.faces.T.reshape(-1), torch.cat([-on_b - on_c, on_b, on_c]))
        return _energies(garments, g11, g22, g12), gradient

    def curvature(self, step: TimeStep, x: Tensor) -> ElementBlocks:
        """Exact where the stress is tensile; compressive stress is left to `buckling`."""
        garments = step.garments
        f = _columns(garments, x)
        tension = _tensile_part(*self._stress_at(garments, f))
        weight = garments.face_areas * garments.thickness
        mu, lam = (weight * garments.lame_mu)[:, None, None], (weight * garments.lame_lambda)[:, None, None]
        identity = torch.eye(3, dtype=x.dtype, device=x.device)
        squares = [outer(f[0], f[0]), outer(f[1], f[1])]
        cross = outer(f[0], f[1])
        shared = mu * (squares[0] + squares[1])
        h00 = tension[0][:, None, None] * identity + (mu + lam) * squares[0] + shared
        h11 = tension[1][:, None, None] * identity + (mu + lam) * squares[1] + shared
        h01 = tension[2][:, None, None] * identity + mu * cross.transpose(1, 2) + lam * cross
        return _by_corners(garments, h00, h01, h11)

    def buckling(self, step: TimeStep, x: Tensor) -> ElementBlocks:
        """The curvature of compressive stress."""
        garments = step.garments
        stress = self._stress_at(garments, _columns(garments, x))
        identity = torch.eye(3, dtype=x.dtype, device=x.device)
        pressed = [s - t for s, t in zip(stress, _tensile_part(*stress), strict=True)]
        h00, h11, h01 = (p[:, None, None] * identity for p in pressed)
        return _by_corners(garments, h00, h01, h11)

    def _stress_at(self, garments: PackedGarments, f: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        g11, g22, g12 = 0.5 * (dot(f[0], f[0]) - 1.0), 0.5 * (dot(f[1], f[1]) - 1.0), 0.5 * dot(f[0], f[1])
        return _stress(garments, g11, g22, g12)


def _by_corners(garments: PackedGarments, h00: Tensor, h01: Tensor, h11: Tensor) -> ElementBlocks:
    """Second derivatives by the columns of F (faces, 3, 3) turned into those by the corners.

    Edges b-a and c-a move the columns through the inverse rest shape; corner a moves both edges back.
    """
    h = ((h00, h01), (h01.transpose(1, 2), h11))
    d = garments.inverse_rest_shape
    blocks = h00.new_empty((len(garments.faces), 3, 3, 3, 3))
    half = [[d[:, p, 0, None, None] * h[0][k] + d[:, p, 1, None, None] * h[1][k] for k in (0, 1)] for p in (0, 1)]
    for p in (0, 1):
        for q in (0, 1):
            blocks[:, p + 1, q + 1] = half[p][0] * d[:, q, 0, None, None] + half[p][1] * d[:, q, 1, None, None]
    blocks[:, 0, 1:] = -blocks[:, 1, 1:] - blocks[:, 2, 1:]
    blocks[:, :, 0] = -blocks[:, :, 1] - blocks[:, :, 2]
    return ElementBlocks(garments.faces, blocks)


def _columns(garments: PackedGarments, x: Tensor) -> tuple[Tensor, Tensor]:
    """The two columns (faces, 3) of the deformation gradient."""
    a, b, c = (x.index_select(0, garments.faces[:, k]) for k in range(3))
    e1, e2, inverse = b - a, c - a, garments.inverse_rest_shape
    return (
        e1 * inverse[:, 0, 0, None] + e2 * inverse[:, 1, 0, None],
        e1 * inverse[:, 0, 1, None] + e2 * inverse[:, 1, 1, None],
    )


def _energies(garments: PackedGarments, g11: Tensor, g22: Tensor, g12: Tensor) -> Tensor:
    squared = g11 * g11 + g22 * g22 + 2.0 * g12 * g12
    trace = g11 + g22
    density = garments.lame_mu * squared + 0.5 * garments.lame_lambda * trace * trace
    energy = garments.face_areas * garments.thickness * density
    return sum_by_garment(energy, garments.face_garment, garments.garment_count)


def _stress(garments: PackedGarments, g11: Tensor, g22: Tensor, g12: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Components 11, 22 and 12 (faces,) of A h times the second Piola-Kirchhoff stress [J]."""
    weight = garments.face_areas * garments.thickness
    double_mu, pressure = 2.0 * weight * garments.lame_mu, weight * garments.lame_lambda * (g11 + g22)
    return double_mu * g11 + pressure, double_mu * g22 + pressure, double_mu * g12


def _tensile_part(s11: Tensor, s22: Tensor, s12: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Symmetric 2x2 matrices with their negative eigenvalues set to zero."""
    mean, half_gap = 0.5 * (s11 + s22), 0.5 * (s11 - s22)
    radius = torch.hypot(half_gap, s12)
    high, low = (mean + radius).clamp_min(0.0), (mean - radius).clamp_min(0.0)
    spread = torch.where(radius > 0, (high - low) / torch.where(radius > 0, 2.0 * radius, 1.0), 0.0)
    middle = 0.5 * (high + low)
    return middle + spread * half_gap, middle - spread * half_gap, spread * s12
