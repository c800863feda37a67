"""Garments for tests of the baselines: in two pieces, one of which pokes through the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from tests.network_scenes import COTTON, Moment, moment, sheet

from pb4u.collision.surface_tree import SurfaceTree
from pb4u.garment.garment import Garment
from pb4u.geometry.topology import Topology


def tree_of(vertices: np.ndarray, faces: np.ndarray) -> SurfaceTree:
    """Search tree of one surface."""
    count = len(vertices)
    return SurfaceTree(vertices, faces, Topology(faces, count).edges, np.zeros(count, dtype=np.int64), [0])


def two_sheets(rows: int = 11, columns: int = 12, gap: float = 0.008, edge: float = 0.015) -> Garment:
    """One garment of two sheets, the second `gap` [m] above the first."""
    lower, upper = sheet(rows, columns, edge, seed=1), sheet(rows, columns, edge, seed=2)
    vertices = np.concatenate([lower.vertices, upper.vertices + [0.0, gap, 0.0]])
    faces = np.concatenate([lower.faces, upper.faces + len(lower.vertices)])
    return Garment("two sheets", vertices, faces, COTTON)


def dented(garment: Garment, depth: float = 0.016, width: float = 0.04) -> np.ndarray:
    """Vertices (vertices, 3) [m] of `two_sheets` with a round dent in the upper one, through the lower."""
    vertices = garment.vertices.copy()
    upper = vertices[len(vertices) // 2 :]
    away = np.linalg.norm((upper - upper.mean(axis=0))[:, [0, 2]], axis=1)
    upper[:, 1] -= depth * np.exp(-((away / width) ** 2))
    return vertices


def dented_moment(garment: Garment) -> Moment:
    """`two_sheets` dented and wobbling, over a body."""
    at = moment([garment])
    wobble = at.state.positions - torch.as_tensor(garment.vertices)
    return replace(at, state=replace(at.state, positions=torch.as_tensor(dented(garment)) + 0.2 * wobble))
