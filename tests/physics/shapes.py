"""Synthetic garments and bodies for the physics tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
import trimesh

from pb4u.environment import Environment
from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.step_potential import StepPotential
from pb4u.physics.time_step import TimeStep
from pb4u.scene.colliders import ColliderFrame, pack_colliders
from pb4u.scene.packed import PackedGarments, pack
from pb4u.scene.state import State

DT = 1.0 / 30.0

EVALUATION = Material.isotropic(density=0.20022, lame_mu=23600.0, lame_lambda=44400.0, bending=3.962e-5)


def sheet(columns: int, rows: int, width: float = 1.0, height: float = 1.0, material: Material = EVALUATION) -> Garment:
    """A flat sheet in the x-y plane, lower corner at the origin, diagonals alternating."""
    x, y = np.meshgrid(np.linspace(0, width, columns + 1), np.linspace(0, height, rows + 1), indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return Garment("sheet", vertices, grid_faces(columns, rows, wrap=False), material)


def tube(around: int, along: int, radius: float, height: float, material: Material = EVALUATION) -> Garment:
    """An upright tube about the y axis, from y = 0 up, seen from outside."""
    angle = np.arange(around) * 2 * np.pi / around
    y = np.linspace(0, height, along + 1)
    ring = np.stack([radius * np.sin(angle), np.zeros(around), radius * np.cos(angle)], axis=1)
    vertices = (ring[:, None] + np.array([0, 1, 0]) * y[None, :, None]).reshape(-1, 3)
    return Garment("tube", vertices, grid_faces(around, along, wrap=True), material)


def grid_faces(columns: int, rows: int, wrap: bool) -> np.ndarray:
    faces = []
    count = columns if wrap else columns + 1
    for i in range(columns):
        for j in range(rows):
            a, b = i * (rows + 1) + j, ((i + 1) % count) * (rows + 1) + j
            c, d = b + 1, a + 1
            faces += [(a, b, c), (a, c, d)] if (i + j) % 2 == 0 else [(a, b, d), (b, c, d)]
    return np.asarray(faces, dtype=np.int64)


def capsule(height: float = 1.0, radius: float = 0.15, count: int = 24) -> trimesh.Trimesh:
    """An upright capsule about the y axis, centred at the origin."""
    mesh = trimesh.creation.capsule(height=height, radius=radius, count=[count, count])
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    return mesh


def collider(
    vertices: np.ndarray,
    faces: np.ndarray,
    motion: np.ndarray | float = 0.0,
    contact: np.ndarray | None = None,
) -> ColliderFrame:
    """A body that moves by `motion` [m] over the step."""
    return colliders([(vertices, faces)], [0], motion, contact)


def nobody() -> ColliderFrame:
    return collider(np.zeros((0, 3)), np.zeros((0, 3)))


def colliders(
    bodies: Sequence[tuple[np.ndarray, np.ndarray]],
    worlds: Sequence[int],
    motion: np.ndarray | float = 0.0,
    contact: np.ndarray | None = None,
) -> ColliderFrame:
    """Bodies (vertices, faces), each in its world, that move by `motion` [m] over the step."""
    now = torch.as_tensor(np.concatenate([np.asarray(vertices) for vertices, _ in bodies]), dtype=torch.float64)
    move = torch.as_tensor(np.asarray(motion), dtype=torch.float64)
    touched = np.ones(len(now), dtype=bool) if contact is None else np.asarray(contact)
    cuts = np.cumsum([len(vertices) for vertices, _ in bodies])[:-1]
    packed = pack_colliders(
        [torch.as_tensor(np.asarray(faces), dtype=torch.int64) for _, faces in bodies],
        [torch.as_tensor(part) for part in np.split(touched, cuts)],
        worlds,
    )
    return ColliderFrame(packed.pose(now - move), packed.pose(now), packed.pose(now + move))


def at_rest(garments: PackedGarments, positions: torch.Tensor | None = None, frame: int = 0) -> State:
    x = garments.rest_positions if positions is None else positions
    return State(positions=x, velocities=torch.zeros_like(x), frame=frame)


def time_step(
    garments: PackedGarments,
    state: State | None = None,
    collider: ColliderFrame | None = None,
    dt: float = DT,
    **around: Any,
) -> TimeStep:
    """A step under standard gravity and over no ground, from rest by default."""
    environment = Environment(**{"ground": None, **around})
    return TimeStep(garments, state or at_rest(garments), collider or nobody(), dt, environment)


def potential_of(
    garments: PackedGarments,
    state: State | None = None,
    collider: ColliderFrame | None = None,
    potential: IncrementalPotential | None = None,
    **around: Any,
) -> StepPotential:
    """The potential of a `time_step`, the usual one by default."""
    return (potential or IncrementalPotential()).of(time_step(garments, state, collider, **around))


def packed(
    *garments: Garment, dtype: torch.dtype = torch.float64, worlds: Sequence[int] | None = None
) -> PackedGarments:
    return pack(garments, dtype=dtype, worlds=worlds)
