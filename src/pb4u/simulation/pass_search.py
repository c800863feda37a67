"""Line search along the passes of a network: each is joined with the move of the pass before it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import torch
from torch import Tensor

from pb4u.network.acceleration_model import GraphNetwork
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.time_step import TimeStep, integrate

_FLATTEST = 1e-3
"""Smallest curvature along a joint of scaled directions: two that are nearly one must not be played off each other."""


PassSearch: TypeAlias = Callable[[TimeStep, Tensor, Tensor, Tensor | None], tuple[Tensor, Tensor]]
"""Called as `conjugate_move` of a potential is, and returns what it returns."""


def conjugate_move(
    potential: IncrementalPotential, step: TimeStep, accelerations: Tensor, correction: Tensor, last: Tensor | None
) -> tuple[Tensor, Tensor]:
    """A pass joined with the move of the pass before it, each at the length of least potential in every world.

    On its own a pass takes the same share of the energy that is left, again and again: steepest descent with the
    network as its preconditioner. Searching the plane of its direction and the last move makes it a conjugate gradient,
    for three gradients of the potential (locally optimal form: Knyazev 2001, SIAM J. Sci. Comput. 23). The last move of
    one time step serves the next, as what is still missing at its end changes slowly.

    In training the lengths carry no gradient: at their optimum they have none. A pass can still add energy, as standing
    still is not among what is compared.

    Args:
        potential: whose energies are lowered.
        step: that is taken.
        accelerations: (vertices, 3) reached so far, from free flight [m per step^2].
        correction: (vertices, 3) that the network predicts from there [m per step^2].
        last: (vertices, 3) move of the pass before [m per step^2]; None where there is none.

    Returns:
        Accelerations (vertices, 3) [m per step^2] to add, differentiable in `correction`, and by how much (worlds,) [J]
        they lower the energy.
    """
    directions = [torch.where(step.garments.pinned[:, None], 0.0, correction)]
    if last is not None:
        directions.append(last)
    lengths, decrease = _lengths(potential, step, accelerations, torch.stack(directions).detach())
    joined = torch.stack([_of_world(step, length) * d for length, d in zip(lengths, directions, strict=True)]).sum(0)
    return joined, decrease


def search_of(network: GraphNetwork, potential: IncrementalPotential) -> PassSearch | None:
    """Line search along the passes of `network`; None takes the passes whole, as the paper does.

    Args:
        network: the network.
        potential: the energies; those of cloth against cloth do not count, as passes may cross.
    """
    return partial(conjugate_move, potential.without_self_contact()) if network.configuration.conjugate else None


@torch.no_grad()
def _lengths(
    potential: IncrementalPotential, step: TimeStep, accelerations: Tensor, directions: Tensor
) -> tuple[Tensor, Tensor]:
    """Lengths (directions, worlds) of `directions` (directions, vertices, 3), the first the network's.

    And the decrease of the energy (worlds,) [J].
    """
    x = integrate(step, accelerations).positions
    # The body's tangent planes where the whole pass leads are exact enough to choose by, and queried once.
    frozen = potential.of(step).with_contact_at(x + directions[0])
    (before, at_whole, *_), (gradient, *others) = frozen.gradients(torch.stack([x, *(x + directions)]))
    changes = torch.stack(others) - gradient

    def by_world(products: Tensor) -> Tensor:
        sums = products.new_zeros(*products.shape[:-1], step.garments.world_count)
        return sums.index_add_(-1, step.garments.vertex_world, products).movedim(-1, 0)

    curvature = by_world(torch.einsum("ivc,jvc->ijv", directions, changes))
    slope = by_world(-torch.einsum("ivc,vc->iv", directions, gradient))
    best = _newton_lengths(0.5 * (curvature + curvature.mT), slope).T
    full = torch.zeros_like(best)
    full[0] = 1.0
    # Cloth buckles and skin is met on the way, so that the model can be wrong; half way is often still better.
    choices = torch.stack([full, best, 0.5 * (full + best)])
    shorter = torch.stack([_moved(step, x, directions, lengths) for lengths in choices[1:]])
    energies = torch.cat([at_whole[None], frozen.energies_of_worlds(shorter)])
    lowest, chosen = energies.nan_to_num(nan=torch.inf).min(0)
    return choices.gather(0, chosen.expand(1, *best.shape))[0], before - lowest


def _moved(step: TimeStep, x: Tensor, directions: Tensor, lengths: Tensor) -> Tensor:
    """Positions (vertices, 3) [m] after each world's `lengths` (directions, worlds) of `directions`."""
    return x + torch.stack([_of_world(step, n) * d for n, d in zip(lengths, directions, strict=True)]).sum(0)


def _of_world(step: TimeStep, lengths: Tensor) -> Tensor:
    """Lengths (vertices, 1) of the world of each vertex, from those of the worlds, (worlds,)."""
    return lengths[step.garments.vertex_world, None]


def _newton_lengths(curvature: Tensor, slope: Tensor) -> Tensor:
    """Lengths (worlds, directions) of a Newton step; none where its model is not finite.

    Args:
        curvature: (worlds, directions, directions), symmetric.
        slope: (worlds, directions) of descent.
    """
    finite = torch.isfinite(curvature).all((-1, -2)) & torch.isfinite(slope).all(-1)
    unit = torch.eye(slope.shape[1], dtype=curvature.dtype, device=curvature.device)
    curvature = torch.where(finite[:, None, None], curvature, unit)
    slope = torch.where(finite[:, None], slope, 0.0)
    scale = curvature.diagonal(dim1=-2, dim2=-1).abs().clamp_min(torch.finfo(curvature.dtype).tiny).sqrt()
    scaled = curvature / scale[:, :, None] / scale[:, None, :]
    # On a processor the library's solver: cloth that buckles amplifies other rounding to millimetres.
    values, vectors = torch.linalg.eigh(scaled) if scaled.device.type == "cpu" else eigenvectors(scaled)
    along = vectors.mT @ (slope / scale)[..., None] / values.abs().clamp_min(_FLATTEST)[..., None]
    return (vectors @ along)[..., 0] / scale


def eigenvectors(matrices: Tensor) -> tuple[Tensor, Tensor]:
    """Eigenvalues (worlds, n) and eigenvectors, the columns of (worlds, n, n), of symmetric 1x1 or 2x2 matrices.

    In closed form: the solvers of libraries synchronise a GPU.

    Args:
        matrices: (worlds, n, n) of any unit.
    """
    if matrices.shape[-1] == 1:
        return matrices[..., 0], torch.ones_like(matrices)
    a, b, c = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    mean, half = 0.5 * (a + c), 0.5 * (a - c)
    radius, angle = torch.hypot(half, b), 0.5 * torch.atan2(b, half)
    x, y = angle.cos(), angle.sin()
    vectors = torch.stack([torch.stack([x, -y], dim=1), torch.stack([y, x], dim=1)], dim=1)
    return torch.stack([mean + radius, mean - radius], dim=1), vectors
