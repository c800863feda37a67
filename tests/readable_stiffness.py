"""The readable twin of the second derivatives that the solver compiles: whole matrices, from formulas and autograd.

Slow on purpose; the tests hold the kernels in `src` to it. Last come these kernels themselves, for matrices and vectors
as the tests have them.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pb4u.collision.lanes import padded
from pb4u.environment import STANDARD_GRAVITY, UP
from pb4u.physics.solver.preconditioner import TwoLevelPreconditioner, precondition
from pb4u.physics.step_potential import StepPotential
from pb4u.physics.terms.collision import REFERENCE_AREA, Collision
from pb4u.physics.terms.energy_term import CompiledTerm, EnergyTerm
from pb4u.physics.terms.friction import Friction
from pb4u.physics.terms.pair_stiffness import PairStiffness, add_product
from pb4u.physics.terms.stiffness_matrix import SymmetricBlocks, multiply


def readable_stiffness(name: str, frozen: StepPotential, x: Tensor) -> tuple[Tensor, Tensor]:
    """Positive and compressive part (3 vertices, 3 vertices) [N/m] of the second derivative of a term of its own."""
    if name == "stretch":
        return stretch(frozen, x)
    of_vertices = {"inertia": inertia, "collision": collision, "friction": friction}
    matrix = bending(frozen, x) if name == "bending" else on_diagonal(of_vertices[name](frozen, x))
    return matrix, torch.zeros_like(matrix)


def made_of(frozen: StepPotential, name: str) -> EnergyTerm:
    """The term of a name, as it was before it was compiled for the step."""
    term = frozen.potential.term(name)
    return term.term if isinstance(term, CompiledTerm) else term


def stretch(frozen: StepPotential, x: Tensor) -> tuple[Tensor, Tensor]:
    garments = frozen.step.garments
    of_bc = garments.inverse_rest_shape
    shape = torch.cat([-of_bc.sum(1, keepdim=True), of_bc], dim=1)
    f = torch.einsum("fck,fca->fka", shape, x[garments.faces])
    green = 0.5 * (torch.einsum("fka,fla->fkl", f, f) - torch.eye(2, dtype=x.dtype))
    moduli = x.new_zeros((len(green), 2, 2, 2, 2))
    for which, places in (
        (0, ["0000"]),
        (1, ["1111"]),
        (2, ["0011", "1100"]),
        (3, ["0101", "0110", "1001", "1010"]),
    ):
        for place in places:
            moduli[(slice(None), *map(int, place))] = garments.face_areas * garments.membrane[:, which]
    stress = torch.einsum("fkplq,flq->fkp", moduli, green)
    for axis in (0, 1):
        # By autograd, twice: what a thread beyond its limit adds to its stress and to its modulus.
        strain = green[:, axis, axis].clone().requires_grad_(True)
        beyond = ((2.0 * strain + 1.0).sqrt() - 1.0 - garments.stiffening[:, 0]).clamp_min(0.0)
        energy = garments.face_areas * garments.stiffening[:, 1] * beyond**3 / 6.0
        (first,) = torch.autograd.grad(energy.sum(), strain, create_graph=True)
        (second,) = torch.autograd.grad(first.sum(), strain)
        stress[:, axis, axis] += first.detach()
        moduli[:, axis, axis, axis, axis] += second
    values, vectors = torch.linalg.eigh(stress)
    tensile = torch.einsum("fkp,fp,flp->fkl", vectors, values.clamp_min(0.0), vectors)
    axes = torch.eye(3, dtype=x.dtype)
    of_columns = torch.einsum("fkl,ab->fklab", tensile, axes) + torch.einsum("fkplq,fpa,fqb->fklab", moduli, f, f)
    compressive = torch.einsum("fkl,ab->fklab", stress - tensile, axes)
    parts = (torch.einsum("fik,fjl,fklab->fiajb", shape, shape, part) for part in (of_columns, compressive))
    positive, negative = (assembled(part, garments.faces, len(x)) for part in parts)
    return positive, negative


def dihedral_angles(x: Tensor, hinges: Tensor) -> Tensor:
    """Angles (hinges,) [rad] between the two faces at each hinge; 0 where flat."""
    x0, x1, x2, x3 = (x[hinges[:, k]] for k in range(4))
    edge = x1 - x0
    n0, n1 = torch.linalg.cross(edge, x2 - x0), torch.linalg.cross(x3 - x0, edge)
    sine = (edge * torch.linalg.cross(n0, n1)).sum(1) / edge.norm(dim=1)
    return torch.atan2(sine, (n0 * n1).sum(1))


def bending(frozen: StepPotential, x: Tensor) -> Tensor:
    garments = frozen.step.garments
    hinges = garments.hinges

    def bend(positions: Tensor) -> Tensor:
        length = (positions[hinges[:, 1]] - positions[hinges[:, 0]]).norm(dim=1)
        return length * dihedral_angles(positions, hinges)

    derivative = torch.autograd.functional.jacobian(bend, x).reshape(len(hinges), -1)
    stiffness = garments.bending / (4.0 * garments.hinge_areas)
    return derivative.T @ (stiffness[:, None] * derivative)


def inertia(frozen: StepPotential, x: Tensor) -> Tensor:
    mass = frozen.step.garments.vertex_masses / frozen.step.dt**2
    return mass[:, None, None] * torch.eye(3, dtype=x.dtype)


def collision(frozen: StepPotential, x: Tensor) -> Tensor:
    """Exact to a depth of half a millimetre, softer beyond it."""
    term, step, contacts = made_of(frozen, "collision"), frozen.step, frozen.contacts
    assert isinstance(term, Collision)
    weight = term.weight / REFERENCE_AREA * step.garments.vertex_areas
    blocks = x.new_zeros((len(x), 3, 3))
    surfaces = [
        (torch.where(planes.touchable, planes.signed_distance(x), torch.inf), planes.normals)
        for planes in (contacts.next, contacts.opposite)
        if planes is not None
    ]
    if step.environment.ground is not None:
        surfaces.append((x[:, 1] - step.environment.ground, x.new_tensor(UP).expand_as(x)))
    for height, normal in surfaces:
        depth = (term.clearance - height).clamp_min(0.0)
        stiffness = 3.0 * weight * (depth + depth.clamp_max(5e-4))
        blocks += stiffness[:, None, None] * normal[:, :, None] * normal[:, None, :]
    return blocks


def friction(frozen: StepPotential, x: Tensor, softening: float = 0.8) -> Tensor:
    """With a share of the softening along the slip."""
    term, step, contacts = made_of(frozen, "friction"), frozen.step, frozen.contacts
    assert isinstance(term, Friction)
    assert contacts.now is not None
    assert contacts.transported is not None
    assert contacts.transported_normals is not None
    distance = torch.where(contacts.now.touchable, contacts.now.distance, torch.inf)
    anchor, normal = contacts.transported, contacts.transported_normals
    if step.environment.ground is not None:
        before = step.state.positions
        lower = before[:, 1] - step.environment.ground < distance
        on_ground = lower & (before[:, 1] - step.environment.ground < term.radius)
        anchor = torch.where(on_ground[:, None], before, anchor)
        normal = torch.where(on_ground[:, None], x.new_tensor(UP), normal)
        touching = on_ground | (distance < term.radius)
        distance = torch.where(on_ground, before[:, 1] - step.environment.ground, distance)
    else:
        touching = distance < term.radius
    force = STANDARD_GRAVITY * step.garments.vertex_masses
    weights = torch.diag(x.new_tensor([1.0 + 1e-4, 1e-4, 1.0 + 1e-4]))
    if term.law == "coulomb":
        force, weights = torch.zeros_like(force), torch.eye(3, dtype=x.dtype)
    if term.load is not None:
        depth = (term.load.clearance - distance).clamp(0.0, 2.0 * term.load.clearance)
        force = force.maximum(3.0 * term.load.weight / REFERENCE_AREA * step.garments.vertex_areas * depth**2)
    limit = torch.where(touching, step.garments.friction * force, 0.0)
    across = torch.eye(3, dtype=x.dtype) - normal[:, :, None] * normal[:, None, :]
    slip = torch.einsum("vab,vb->va", across, x - anchor)
    magnitude = (torch.einsum("va,ab,vb->v", slip, weights, slip) + (term.smoothing * step.dt) ** 2).sqrt()
    along = torch.einsum("vab,bc,vc->va", across, weights, slip) / magnitude[:, None]
    stiff = across @ weights @ across - softening * along[:, :, None] * along[:, None, :]
    return (limit / magnitude)[:, None, None] * stiff


def on_diagonal(blocks: Tensor) -> Tensor:
    """(3 vertices, 3 vertices) of `blocks` (vertices, 3, 3)."""
    return torch.block_diag(*blocks)


def assembled(parts: Tensor, elements: Tensor, count: int) -> Tensor:
    """(3 vertices, 3 vertices) sum of the matrices (elements, corners, 3, corners, 3) of the `elements`."""
    whole = parts.new_zeros((count, count, 3, 3))
    for i in range(elements.shape[1]):
        for j in range(elements.shape[1]):
            whole.index_put_((elements[:, i], elements[:, j]), parts[:, i, :, j], accumulate=True)
    return whole.permute(0, 2, 1, 3).reshape(3 * count, 3 * count)


def dense(matrix: SymmetricBlocks) -> np.ndarray:
    """The whole matrix (3 vertices, 3 vertices) [N/m]."""
    count = len(matrix.starts) - 1
    rows = np.repeat(np.arange(count), np.diff(matrix.starts))
    whole = np.zeros((count, 3, count, 3))
    whole[matrix.columns, :, rows] = matrix.blocks.transpose(0, 2, 1)
    whole[rows, :, matrix.columns] = matrix.blocks
    return whole.reshape(3 * count, 3 * count)


def times(matrix: SymmetricBlocks | PairStiffness, vector: np.ndarray) -> np.ndarray:
    """Product (vertices, 3) [N] with a `vector` (vertices, 3) [m], by the kernels."""
    result, at = np.zeros((len(vector), 4)), padded(vector, np.float64)
    if isinstance(matrix, PairStiffness):
        add_product(matrix.corners, padded(matrix.rows.reshape(-1, 3), np.float64), at, result)
    else:
        multiply(matrix.starts, matrix.columns, matrix.blocks, at, result)
    return result[:, :3]


def preconditioned(preconditioner: TwoLevelPreconditioner, residual: np.ndarray) -> np.ndarray:
    """Approximate solution (vertices, 3) [m] for `residual` (vertices, 3) [N], by the kernel."""
    precision = preconditioner.parts[0].dtype
    result = np.empty((len(residual), 4), precision)
    precondition(preconditioner.parts, padded(residual, precision), result)
    return result[:, :3]
