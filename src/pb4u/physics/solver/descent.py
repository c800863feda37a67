"""One step of Jacobi descent of the incremental potential."""

from __future__ import annotations

import torch
from torch import Tensor

from pb4u.physics.step_potential import StepPotential
from pb4u.scene.packed import PackedGarments


class JacobiDescent:
    """Moves every vertex separately against the gradient divided by its inertia and its membrane stiffness at rest.

    Args:
        garments: static quantities.
        dt: time [s] of inertia, one or (vertices,), that of an implicit Euler step.
    """

    def __init__(self, garments: PackedGarments, dt: float | Tensor) -> None:
        stiffness = membrane_stiffness(garments) + garments.vertex_masses / dt**2
        moves = ~garments.pinned & (garments.vertex_masses > 0)
        self._compliance = torch.where(moves, 1.0 / stiffness.clamp_min(1e-30), 0.0)[:, None]

    def at(self, potential: StepPotential, x: Tensor) -> Tensor:
        """Displacements (vertices, 3) [m] of one descent step; zero for vertices that do not move.

        Args:
            potential: the potential that is descended.
            x: (vertices, 3) [m] positions at which to take the gradient.
        """
        _, gradient = potential.energies_and_gradient(x)
        return -gradient * self._compliance


def membrane_stiffness(garments: PackedGarments) -> Tensor:
    """Mean in-plane stiffness (vertices,) [N/m] against moving a single vertex of the garments at rest.

    Half the trace of the second derivative of the stretch energy at F = 1, in the mean over directions: a face adds
    A ((c11 + c22) / 4 + c33 / 2) times the squared gradient of the corner's shape function.

    Args:
        garments: the packed garments.
    """
    of_b, of_c = garments.inverse_rest_shape[:, 0], garments.inverse_rest_shape[:, 1]
    squared = torch.stack([g.square().sum(-1) for g in (of_b + of_c, of_b, of_c)], dim=1)
    c11, c22, _, c33 = garments.membrane.unbind(1)
    weight = garments.face_areas * (0.25 * (c11 + c22) + 0.5 * c33)
    total = torch.zeros_like(garments.vertex_masses)
    return total.index_add_(0, garments.faces.reshape(-1), (weight[:, None] * squared).reshape(-1))
