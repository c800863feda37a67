"""In-plane stretch and shear: the Saint Venant-Kirchhoff membrane."""

from __future__ import annotations

import torch
from torch import Tensor

from pb4u.physics.contact.planes import ContactSet
from pb4u.physics.energy_term import EnergyTerm, columns, outer, sum_by_garment, sum_by_vertex
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments


class Stretch(EnergyTerm):
    """Sum over faces of A h [mu tr(G^2) + lambda/2 tr(G)^2] [J], G = (F^T F - 1) / 2 the Green strain.

    A is the rest area [m^2], h the thickness [m], mu and lambda the Lame parameters [Pa], F (3, 2) the deformation
    gradient against the rest triangle in its own plane. Source: SNUG (Santesteban et al. 2022), with 3D rest
    triangles as in HOOD (Grigorev et al. 2023).
    """

    name = "stretch"

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        return _energies(step.garments, *_green_strain(*_deformation(step.garments, x)))

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        garments = step.garments
        f1, f2 = _deformation(garments, x)
        g11, g22, g12 = _green_strain(f1, f2)
        s11, s22, s12 = _stress(garments, g11, g22, g12)
        p1, p2 = f1 * s11 + f2 * s12, f1 * s12 + f2 * s22
        d = garments.inverse_rest_shape
        on_b = p1 * d[:, 0, 0] + p2 * d[:, 0, 1]
        on_c = p1 * d[:, 1, 0] + p2 * d[:, 1, 1]
        forces = torch.cat([-on_b - on_c, on_b, on_c], dim=1)
        return _energies(garments, g11, g22, g12), sum_by_vertex(forces, garments.faces.T.reshape(-1), len(x))

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return step.garments.faces

    def curvature(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        """Second derivatives (3, 3, pairs, faces) [J/m^2]; exact where the stress is tensile.

        Compressive stress is left to `buckling`.

        Args:
            step: the time step.
            contacts: not read.
            x: (vertices, 3) [m] next positions.
        """
        garments = step.garments
        f1, f2 = _deformation(garments, x)
        t11, t22, t12 = _tensile_part(*_stress(garments, *_green_strain(f1, f2)))
        weight = garments.face_areas * garments.thickness
        mu, lam = weight * garments.lame_mu, weight * garments.lame_lambda
        identity = _identity(x)
        square1, square2, cross = outer(f1, f1), outer(f2, f2), outer(f1, f2)
        shared = mu * (square1 + square2)
        h11 = t11 * identity + (mu + lam) * square1 + shared
        h22 = t22 * identity + (mu + lam) * square2 + shared
        h12 = t12 * identity + mu * cross.transpose(0, 1) + lam * cross
        return _by_corners(garments, h11, h12, h22)

    def buckling(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        """Second derivatives (3, 3, pairs, faces) [J/m^2] of the compressive stress, which are negative.

        Args:
            step: the time step.
            contacts: not read.
            x: (vertices, 3) [m] next positions.
        """
        garments = step.garments
        stress = _stress(garments, *_green_strain(*_deformation(garments, x)))
        identity = _identity(x)
        h11, h22, h12 = ((s - t) * identity for s, t in zip(stress, _tensile_part(*stress), strict=True))
        return _by_corners(garments, h11, h12, h22)


def _identity(x: Tensor) -> Tensor:
    return torch.eye(3, dtype=x.dtype, device=x.device)[:, :, None]


def _by_corners(garments: PackedGarments, h11: Tensor, h12: Tensor, h22: Tensor) -> Tensor:
    """Second derivatives by the columns of F (3, 3, faces) turned into those by the corners.

    Edges b-a and c-a move the columns through the inverse rest shape; corner a moves both edges back.
    """
    (b1, b2), (c1, c2) = garments.inverse_rest_shape.permute(1, 2, 0).contiguous()
    b_by_1, b_by_2 = b1 * h11 + b2 * h12.transpose(0, 1), b1 * h12 + b2 * h22
    c_by_1, c_by_2 = c1 * h11 + c2 * h12.transpose(0, 1), c1 * h12 + c2 * h22
    bb, bc = b_by_1 * b1 + b_by_2 * b2, b_by_1 * c1 + b_by_2 * c2
    cc = c_by_1 * c1 + c_by_2 * c2
    ab, ac = -bb - bc.transpose(0, 1), -bc - cc
    aa = -ab - ac
    return torch.stack([aa, ab, ac, bb, bc, cc], dim=2)


def _deformation(garments: PackedGarments, x: Tensor) -> tuple[Tensor, Tensor]:
    """The two columns (3, faces) of the deformation gradient."""
    a, b, c = columns(x, garments.faces.T.reshape(-1)).reshape(3, 3, -1).unbind(1)
    e1, e2, d = b - a, c - a, garments.inverse_rest_shape
    return e1 * d[:, 0, 0] + e2 * d[:, 1, 0], e1 * d[:, 0, 1] + e2 * d[:, 1, 1]


def _green_strain(f1: Tensor, f2: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Components 11, 22 and 12 (faces,) of (F^T F - 1) / 2."""
    return 0.5 * ((f1 * f1).sum(0) - 1.0), 0.5 * ((f2 * f2).sum(0) - 1.0), 0.5 * (f1 * f2).sum(0)


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
