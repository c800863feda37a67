"""In-plane stretch and shear: the Saint Venant-Kirchhoff membrane."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.jit import as_float64
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.terms.element_loops import GRADIENT, VALUE, Record, element_loops, rows
from pb4u.physics.terms.energy_term import EnergyTerm, sum_by_garment
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments


def _face(
    x: np.ndarray,
    corners: np.ndarray,
    numbers: np.ndarray,
    face: int,
    wanted: int,
    forces: np.ndarray,
    blocks: np.ndarray,
    factors: np.ndarray,
) -> float:
    """One face; its numbers are the inverse rest shape [1/m] by rows, its four moduli times the rest area [J], the
    stretch beyond which threads stiffen, by how much for each unit of stretch, times the rest area [J], and the Green
    strain at which the moduli pull at nothing: 0 of its stretch.

    The second derivative is exact where the stress is tensile; what compression adds is multiples of the identity.
    """
    a, b, c = corners[face, 0], corners[face, 1], corners[face, 2]
    d00, d01, d10, d11 = numbers[face, 0], numbers[face, 1], numbers[face, 2], numbers[face, 3]
    b0, b1, b2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    c0, c1, c2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    u = (b0 * d00 + c0 * d10, b1 * d00 + c1 * d10, b2 * d00 + c2 * d10)
    v = (b0 * d01 + c0 * d11, b1 * d01 + c1 * d11, b2 * d01 + c2 * d11)
    g11 = 0.5 * (u[0] * u[0] + u[1] * u[1] + u[2] * u[2] - 1.0)
    g22 = 0.5 * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - 1.0)
    g12 = 0.5 * (u[0] * v[0] + u[1] * v[1] + u[2] * v[2])
    c11, c22, c12, c33 = numbers[face, 4], numbers[face, 5], numbers[face, 6], numbers[face, 7]
    e11, e22, e12 = g11 - numbers[face, 10], g22 - numbers[face, 11], g12 - numbers[face, 12]
    s11, s22, s12 = c11 * e11 + c12 * e22, c12 * e11 + c22 * e22, 2.0 * c33 * e12
    energy = 0.5 * (s11 * e11 + s22 * e22) + s12 * e12
    stiffening = numbers[face, 9]
    if stiffening > 0.0:
        # The energy of a thread depends on its own stretch alone, so it adds to one stress and to one modulus.
        u_length, v_length = np.sqrt(2.0 * g11 + 1.0), np.sqrt(2.0 * g22 + 1.0)
        beyond = u_length - 1.0 - numbers[face, 8]
        if beyond > 0.0:
            energy += stiffening * beyond**3 / 6.0
            s11 += 0.5 * stiffening * beyond**2 / u_length
            c11 += stiffening * beyond / u_length**2 * (1.0 - 0.5 * beyond / u_length)
        beyond = v_length - 1.0 - numbers[face, 8]
        if beyond > 0.0:
            energy += stiffening * beyond**3 / 6.0
            s22 += 0.5 * stiffening * beyond**2 / v_length
            c22 += stiffening * beyond / v_length**2 * (1.0 - 0.5 * beyond / v_length)
    if wanted == VALUE:
        return energy
    if wanted == GRADIENT:
        for axis in range(3):
            by_u, by_v = s11 * u[axis] + s12 * v[axis], s12 * u[axis] + s22 * v[axis]
            on_b, on_c = d00 * by_u + d01 * by_v, d10 * by_u + d11 * by_v
            forces[0, axis], forces[1, axis], forces[2, axis] = -(on_b + on_c), on_b, on_c
        return energy
    # The tensile part: the stress with its negative eigenvalues set to zero.
    mean, half_gap = 0.5 * (s11 + s22), 0.5 * (s11 - s22)
    radius = np.sqrt(half_gap * half_gap + s12 * s12)
    high, low = max(mean + radius, 0.0), max(mean - radius, 0.0)
    spread = (high - low) / (2.0 * radius) if radius > 0.0 else 0.0
    middle = 0.5 * (high + low)
    t11, t22, t12 = middle + spread * half_gap, middle - spread * half_gap, spread * s12
    # Edges b-a and c-a move the columns through the inverse rest shape; corner a moves both edges back.
    p11, p22, p12 = s11 - t11, s22 - t22, s12 - t12
    bb = d00 * d00 * p11 + 2.0 * d00 * d01 * p12 + d01 * d01 * p22
    bc = d00 * d10 * p11 + (d00 * d11 + d01 * d10) * p12 + d01 * d11 * p22
    cc = d10 * d10 * p11 + 2.0 * d10 * d11 * p12 + d11 * d11 * p22
    factors[0], factors[1], factors[2] = bb + 2.0 * bc + cc, -bb - bc, -bc - cc
    factors[3], factors[4], factors[5] = bb, bc, cc
    for i in range(3):
        for j in range(3):
            same = 1.0 if i == j else 0.0
            h11 = t11 * same + c11 * u[i] * u[j] + c33 * v[i] * v[j]
            h22 = t22 * same + c22 * v[i] * v[j] + c33 * u[i] * u[j]
            h12 = t12 * same + c33 * v[i] * u[j] + c12 * u[i] * v[j]
            h21 = t12 * same + c33 * u[i] * v[j] + c12 * v[i] * u[j]
            by_b1, by_b2 = d00 * h11 + d01 * h21, d00 * h12 + d01 * h22
            by_c1, by_c2 = d10 * h11 + d11 * h21, d10 * h12 + d11 * h22
            on_bb, on_bc = by_b1 * d00 + by_b2 * d01, by_b1 * d10 + by_b2 * d11
            on_cb, on_cc = by_c1 * d00 + by_c2 * d01, by_c1 * d10 + by_c2 * d11
            blocks[0, i, j] = on_bb + on_bc + on_cb + on_cc
            blocks[1, i, j], blocks[2, i, j] = -on_bb - on_cb, -on_bc - on_cc
            blocks[3, i, j], blocks[4, i, j], blocks[5, i, j] = on_bb, on_bc, on_cc
    return energy


class Stretch(EnergyTerm):
    """Sum over faces of A (c11 g11^2 / 2 + c22 g22^2 / 2 + c12 g11 g22 + 2 c33 g12^2) [J], G = (F^T F - 1) / 2.

    A is the rest area [m^2], c the four moduli of the face's membrane [N/m] along its grain, F (3, 2) the deformation
    gradient against the rest triangle in its own plane. Of an isotropic cloth of thickness h this is A h [mu tr(G^2) +
    lambda/2 tr(G)^2]. Source: SNUG (Santesteban et al. 2022), with 3D rest triangles as in HOOD (Grigorev et al. 2023);
    four moduli as in Volino et al. 2009.

    A thread of a cloth that stiffens adds A k max(s - 1 - limit, 0)^3 / 6, s = sqrt(2 g11 + 1) its stretch: its modulus
    grows by k [N/m] for each unit of stretch beyond the limit, without a jump.
    """

    name = "stretch"
    loops = element_loops(_face, 3)
    reads_contacts = False

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments = step.garments
        strains, threads = _strains(garments, x)
        share, unstrained = self.resisted(step)
        density = share * elastic_density(garments, strains - unstrained)
        if garments.stiffens:
            limit, stiffening = garments.stiffening.unbind(1)
            for thread in threads:
                beyond = ((thread * thread).sum(0).clamp_min(1e-30).sqrt() - 1.0 - limit).clamp_min(0.0)
                density = density + stiffening * beyond**3 / 6.0
        return sum_by_garment(garments.face_areas * density, garments.face_garment, garments.garment_count)

    def resisted(self, step: TimeStep) -> tuple[Tensor | float, Tensor | float]:
        """By which factor the moduli resist, (faces,) or one for all, and the Green strains at which they do not.

        These are (3, faces) g11, g22 and g12, or one for all.

        Args:
            step: the time step.
        """
        return 1.0, 0.0

    def elements(self, step: TimeStep, contacts: ContactSet) -> Tensor:
        return step.garments.faces

    def records(self, step: TimeStep, contacts: ContactSet) -> Callable[[ContactSet], Sequence[Record]]:
        garments = step.garments
        areas, inverse = as_float64(garments.face_areas), as_float64(garments.inverse_rest_shape)
        limit, stiffening = as_float64(garments.stiffening).T
        share, unstrained = (np.asarray(part) for part in self.resisted(step))
        moduli = (share * areas)[:, None] * as_float64(garments.membrane)
        strains = np.broadcast_to(unstrained, (3, len(areas))).T
        numbers = rows(len(areas), inverse.reshape(-1, 4), moduli, limit, areas * stiffening, strains)
        records = (Record(garments.faces.numpy(), garments.face_garment.numpy(), numbers),)
        return lambda _: records


def green_strains(garments: PackedGarments, x: Tensor) -> Tensor:
    """Green strains g11, g22 and g12 (3, faces) along the axes of the rest shape, at x (vertices, 3) [m].

    Args:
        garments: the garments with these faces.
        x: (vertices, 3) [m].
    """
    return _strains(garments, x)[0]


def _strains(garments: PackedGarments, x: Tensor) -> tuple[Tensor, tuple[Tensor, Tensor]]:
    """Green strains (3, faces), and where both axes of the rest shape lead, (3, faces) each."""
    corners = garments.faces.T.reshape(-1).expand(3, -1)
    a, b, c = x.T.contiguous().gather(1, corners).reshape(3, 3, -1).unbind(1)
    e1, e2, d = b - a, c - a, garments.inverse_rest_shape
    u, v = e1 * d[:, 0, 0] + e2 * d[:, 1, 0], e1 * d[:, 0, 1] + e2 * d[:, 1, 1]
    along = 0.5 * ((u * u).sum(0) - 1.0), 0.5 * ((v * v).sum(0) - 1.0), 0.5 * (u * v).sum(0)
    return torch.stack(along), (u, v)


def elastic_density(garments: PackedGarments, strains: Tensor) -> Tensor:
    """Energy by rest area (faces,) [J/m^2] of the four moduli.

    Args:
        garments: the garments with these moduli.
        strains: (3, faces) g11, g22 and g12.
    """
    g11, g22, g12 = strains.unbind(0)
    c11, c22, c12, c33 = garments.membrane.unbind(1)
    return 0.5 * (c11 * g11 * g11 + c22 * g22 * g22) + c12 * g11 * g22 + 2.0 * c33 * g12 * g12
