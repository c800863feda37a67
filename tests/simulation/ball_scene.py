"""A small scene without any asset: a sheet above a ball that moves sideways."""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from torch import Tensor

from pb4u.body.animated_body import AnimatedBody
from pb4u.garment.dressing import AttachedPlacement
from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.scene.scene import DressedGarment, Scene

MATERIAL = Material.isotropic(density=0.2, lame_mu=23600.0, lame_lambda=44400.0, bending=4e-5)


class Ball(AnimatedBody):
    """A ball of 0.2 m radius around (0, 0.5, 0) that moves along X."""

    def __init__(self, frames: int, fps: float = 30.0, speed: float = 0.3) -> None:
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
        self.rest_vertices = np.asarray(mesh.vertices) + np.array([0.0, 0.5, 0.0])
        self.faces = np.asarray(mesh.faces, dtype=np.int64)
        self.contact = np.ones(len(self.rest_vertices), dtype=bool)
        self.fps, self.name = fps, "ball"
        self._frames, self._speed = frames, speed

    @property
    def frame_count(self) -> int:
        return self._frames

    def positions(self, start: int, stop: int) -> Tensor:
        shift = np.zeros((stop - start, 1, 3))
        shift[:, 0, 0] = np.arange(start, stop) / self.fps * self._speed
        return torch.from_numpy((self.rest_vertices + shift).astype(np.float32))


def sheet(cells: int = 10, side: float = 0.5, height: float = 0.703) -> Garment:
    """A square sheet, facing up."""
    line = np.linspace(-side / 2, side / 2, cells + 1)
    x, z = np.meshgrid(line, line, indexing="ij")
    vertices = np.column_stack([x.ravel(), np.full(x.size, height), z.ravel()])
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    a, b, c, d = corner, corner + 1, corner + cells + 2, corner + cells + 1
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Garment("sheet", vertices, faces, MATERIAL)


def ball_scene(frames: int = 8, lead_in: int = 2, cells: int = 10, speed: float = 0.3) -> Scene:
    body = Ball(frames + lead_in, speed=speed)
    garment = sheet(cells)
    dressed = DressedGarment(garment, AttachedPlacement(garment, body))
    return Scene((dressed,), (body,), frames, lead_in, labels={"garment": "sheet", "body": "ball", "motion": "slide"})
