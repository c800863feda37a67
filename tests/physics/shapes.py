"""Synthetic garments and bodies for the physics tests."""

from __future__ import annotations

import numpy as np
import torch
import trimesh

from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.scene.packed import ColliderFrame, PackedGarments, pack
from pb4u.scene.state import State

EVALUATION = Material(density=0.20022, lame_mu=23600.0, lame_lambda=44400.0, bending=3.962e-5)


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
    ground_height: float | None = None,
    contact: np.ndarray | None = None,
    owner: np.ndarray | None = None,
) -> ColliderFrame:
    """A body that moves by `motion` [m] over the step."""
    now = torch.as_tensor(np.asarray(vertices), dtype=torch.float64)
    move = torch.as_tensor(np.asarray(motion), dtype=torch.float64)
    return ColliderFrame(
        previous=now - move,
        now=now,
        following=now + move,
        faces=torch.as_tensor(np.asarray(faces), dtype=torch.int64),
        contact=torch.ones(len(now), dtype=torch.bool) if contact is None else torch.as_tensor(contact),
        vertex_garment=torch.zeros(len(now), dtype=torch.int64) if owner is None else torch.as_tensor(owner),
        ground_height=ground_height,
    )


def at_rest(garments: PackedGarments, positions: torch.Tensor | None = None, frame: int = 0) -> State:
    x = garments.rest_positions if positions is None else positions
    return State(positions=x, velocities=torch.zeros_like(x), frame=frame)


def packed(*garments: Garment, dtype: torch.dtype = torch.float64) -> PackedGarments:
    return pack(garments, dtype=dtype)
