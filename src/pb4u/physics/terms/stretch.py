"""In-plane stretch and shear: the Saint Venant-Kirchhoff membrane."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import compiled_with_fused_products
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.energy_term import CompiledTerm, EnergyTerm, columns, sum_by_garment, sum_by_vertex
from pb4u.physics.terms.stiffness_matrix import Stiffness
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

    def compiled(self, step: TimeStep, contacts: ContactSet) -> CompiledStretch:
        return CompiledStretch(step.garments)


class CompiledStretch(CompiledTerm, Stretch):
    """`Stretch` compiled, with its second derivative: exact where the stress is tensile.

    What the compressive part of the stress adds is negative, and multiples of the identity.

    Args:
        garments: in float64 on the CPU.
    """

    def __init__(self, garments: PackedGarments) -> None:
        weight = garments.face_areas * garments.thickness
        self._faces, self._garment = garments.faces.numpy(), garments.face_garment.numpy()
        self._law = (
            garments.inverse_rest_shape.numpy(),
            (weight * garments.lame_mu).numpy(),
            (weight * garments.lame_lambda).numpy(),
        )

    def add(self, contacts: ContactSet, x: np.ndarray, energies: np.ndarray, gradient: np.ndarray) -> None:
        _add_gradient(x, self._faces, *self._law, self._garment, energies, gradient)

    def add_stiffness(self, contacts: ContactSet, x: np.ndarray, slots: np.ndarray, stiffness: Stiffness) -> None:
        _add_stiffness(x, self._faces, *self._law, slots, stiffness.positive, stiffness.compressive)


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


@compiled_with_fused_products
def _deformation_at(
    vertices: np.ndarray, faces: np.ndarray, inverse: np.ndarray, face: int
) -> tuple[float, float, float, float, float, float]:
    """Both columns of the deformation gradient of one face, one after the other."""
    a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
    d00, d01, d10, d11 = inverse[face, 0, 0], inverse[face, 0, 1], inverse[face, 1, 0], inverse[face, 1, 1]
    b0, b1, b2 = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    c0, c1, c2 = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    return (
        b0 * d00 + c0 * d10,
        b1 * d00 + c1 * d10,
        b2 * d00 + c2 * d10,
        b0 * d01 + c0 * d11,
        b1 * d01 + c1 * d11,
        b2 * d01 + c2 * d11,
    )


@compiled_with_fused_products
def _add_gradient(
    vertices: np.ndarray,
    faces: np.ndarray,
    inverse: np.ndarray,
    mu: np.ndarray,
    lam: np.ndarray,
    garment: np.ndarray,
    energies: np.ndarray,
    gradient: np.ndarray,
) -> None:
    """Add to the `energies` (garments,) [J], and to their `gradient` (vertices, 3) [N] where it has rows.

    `mu` and `lam` (faces,) [J] are the Lame parameters times A h.
    """
    for face in range(len(faces)):
        u0, u1, u2, v0, v1, v2 = _deformation_at(vertices, faces, inverse, face)
        g11, g22 = 0.5 * (u0 * u0 + u1 * u1 + u2 * u2 - 1.0), 0.5 * (v0 * v0 + v1 * v1 + v2 * v2 - 1.0)
        g12 = 0.5 * (u0 * v0 + u1 * v1 + u2 * v2)
        squared, trace = g11 * g11 + g22 * g22 + 2.0 * g12 * g12, g11 + g22
        energies[garment[face]] += mu[face] * squared + 0.5 * lam[face] * trace * trace
        if not len(gradient):
            continue
        pressure = lam[face] * trace
        s11, s22, s12 = 2.0 * mu[face] * g11 + pressure, 2.0 * mu[face] * g22 + pressure, 2.0 * mu[face] * g12
        # How far the two columns move with corner b, and with corner c.
        b1 = inverse[face, 0, 0] * s11 + inverse[face, 0, 1] * s12
        b2 = inverse[face, 0, 0] * s12 + inverse[face, 0, 1] * s22
        c1 = inverse[face, 1, 0] * s11 + inverse[face, 1, 1] * s12
        c2 = inverse[face, 1, 0] * s12 + inverse[face, 1, 1] * s22
        for axis, u, v in ((0, u0, v0), (1, u1, v1), (2, u2, v2)):
            on_b, on_c = b1 * u + b2 * v, c1 * u + c2 * v
            gradient[faces[face, 0], axis] -= on_b + on_c
            gradient[faces[face, 1], axis] += on_b
            gradient[faces[face, 2], axis] += on_c


@compiled_with_fused_products
def _add_stiffness(
    vertices: np.ndarray,
    faces: np.ndarray,
    inverse: np.ndarray,
    mu: np.ndarray,
    lam: np.ndarray,
    slots: np.ndarray,
    positive: np.ndarray,
    compressive: np.ndarray,
) -> None:
    """Add to the `positive` blocks (pairs, 3, 3) and to the `compressive` factors (pairs,) [N/m] of a stiffness."""
    u, v = np.empty(3), np.empty(3)
    for face in range(len(faces)):
        u[0], u[1], u[2], v[0], v[1], v[2] = _deformation_at(vertices, faces, inverse, face)
        shear, bulk = mu[face], lam[face]
        g11 = 0.5 * (u[0] * u[0] + u[1] * u[1] + u[2] * u[2] - 1.0)
        g22 = 0.5 * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - 1.0)
        g12 = 0.5 * (u[0] * v[0] + u[1] * v[1] + u[2] * v[2])
        pressure = bulk * (g11 + g22)
        s11, s22, s12 = 2.0 * shear * g11 + pressure, 2.0 * shear * g22 + pressure, 2.0 * shear * g12
        # The tensile part: the stress with its negative eigenvalues set to zero.
        mean, half_gap = 0.5 * (s11 + s22), 0.5 * (s11 - s22)
        radius = np.sqrt(half_gap * half_gap + s12 * s12)
        high, low = max(mean + radius, 0.0), max(mean - radius, 0.0)
        spread = (high - low) / (2.0 * radius) if radius > 0.0 else 0.0
        middle = 0.5 * (high + low)
        t11, t22, t12 = middle + spread * half_gap, middle - spread * half_gap, spread * s12
        # Edges b-a and c-a move the columns through the inverse rest shape; corner a moves both edges back.
        b1, b2, c1, c2 = inverse[face, 0, 0], inverse[face, 0, 1], inverse[face, 1, 0], inverse[face, 1, 1]
        p11, p22, p12 = s11 - t11, s22 - t22, s12 - t12
        bb = b1 * b1 * p11 + 2.0 * b1 * b2 * p12 + b2 * b2 * p22
        bc = b1 * c1 * p11 + (b1 * c2 + b2 * c1) * p12 + b2 * c2 * p22
        cc = c1 * c1 * p11 + 2.0 * c1 * c2 * p12 + c2 * c2 * p22
        compressive[slots[face, 0]] += bb + 2.0 * bc + cc
        compressive[slots[face, 1]] -= bb + bc
        compressive[slots[face, 2]] -= bc + cc
        compressive[slots[face, 3]] += bb
        compressive[slots[face, 4]] += bc
        compressive[slots[face, 5]] += cc
        first, second, third = faces[face, 0], faces[face, 1], faces[face, 2]
        for i in range(3):
            for j in range(3):
                same = 1.0 if i == j else 0.0
                shared = shear * (u[i] * u[j] + v[i] * v[j])
                h11 = t11 * same + (shear + bulk) * u[i] * u[j] + shared
                h22 = t22 * same + (shear + bulk) * v[i] * v[j] + shared
                h12 = t12 * same + shear * v[i] * u[j] + bulk * u[i] * v[j]
                h21 = t12 * same + shear * u[i] * v[j] + bulk * v[i] * u[j]
                by_b1, by_b2 = b1 * h11 + b2 * h21, b1 * h12 + b2 * h22
                by_c1, by_c2 = c1 * h11 + c2 * h21, c1 * h12 + c2 * h22
                on_bb, on_bc = by_b1 * b1 + by_b2 * b2, by_b1 * c1 + by_b2 * c2
                on_cb, on_cc = by_c1 * b1 + by_c2 * b2, by_c1 * c1 + by_c2 * c2
                positive[slots[face, 0], i, j] += on_bb + on_bc + on_cb + on_cc
                positive[slots[face, 3], i, j] += on_bb
                positive[slots[face, 5], i, j] += on_cc
                # The matrix holds one block of two vertices, that of the lower one's row.
                k, n = (i, j) if first < second else (j, i)
                positive[slots[face, 1], k, n] -= on_bb + on_cb
                k, n = (i, j) if first < third else (j, i)
                positive[slots[face, 2], k, n] -= on_bc + on_cc
                k, n = (i, j) if second < third else (j, i)
                positive[slots[face, 4], k, n] += on_bc
