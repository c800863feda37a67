"""Training data without any asset: sheets above a ball with one bone that slides sideways."""

from __future__ import annotations

import dataclasses

import numpy as np
import trimesh

from pb4u.body.body_model import ShapedBody
from pb4u.body.skeleton import PoseSequence, Skeleton
from pb4u.body.skinning import SkinningWeights
from pb4u.garment.garment import Garment
from pb4u.garment.material import MATERIALS
from pb4u.paper.network_presets import pb4u_small
from pb4u.training.configuration import TrainingConfiguration
from pb4u.training.curriculum import Curriculum
from pb4u.training.packed_data import Outfit, PosedClip, TrainingData, rounded_poses


def ball() -> ShapedBody:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    vertices = np.asarray(mesh.vertices) + np.array([0.0, 0.5, 0.0])
    skeleton = Skeleton(("root",), np.array([-1]), np.array([[0.0, 0.5, 0.0]]))
    faces, contact = np.asarray(mesh.faces, dtype=np.int64), np.ones(len(vertices), dtype=bool)
    return ShapedBody("ball", "ball", vertices, faces, skeleton, rigid(len(vertices)), contact)


def rigid(count: int) -> SkinningWeights:
    return SkinningWeights(np.zeros((count, 1), dtype=np.int64), np.ones((count, 1), dtype=np.float32))


def sheet(cells: int, side: float = 0.5, height: float = 0.703) -> Garment:
    line = np.linspace(-side / 2, side / 2, cells + 1)
    x, z = np.meshgrid(line, line, indexing="ij")
    vertices = np.column_stack([x.ravel(), np.full(x.size, height), z.ravel()])
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    a, b, c, d = corner, corner + 1, corner + cells + 2, corner + cells + 1
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Garment("sheet", vertices, faces, MATERIALS["default"])


def slide(split: str, speed: float, frames: int = 20) -> PosedClip:
    rotations = np.zeros((frames, 1, 4))
    rotations[..., 0] = 1.0
    roots = np.zeros((frames, 3))
    roots[:, 0], roots[:, 1] = np.arange(frames) / 30.0 * speed, 0.5
    return PosedClip(f"slide-{speed}", split, 0, rounded_poses(PoseSequence(rotations, roots, 30.0)))


def ball_data(cells: tuple[int, ...] = (8, 12)) -> TrainingData:
    garments = [sheet(count) for count in cells]
    outfits = tuple(Outfit(garment, rigid(len(garment.vertices)), 0) for garment in garments)
    return TrainingData((ball(),), outfits, (slide("train", 0.3), slide("train", 0.6), slide("validation", 0.4)))


TINY = TrainingConfiguration(
    network=dataclasses.replace(pb4u_small, width=8, blocks=1),
    curriculum=Curriculum(
        window_steps=((0.0, 1), (0.3, 2), (0.6, 3)), collision_weight=((0.0, 5e3),), learning_rate=2e-3, halvings=2
    ),
    most_propagation_steps=3,
    statistics_windows=6,
    log_every=10,
    checkpoint_every=10,
    validate_every=25,
    validation_clips=2,
    validation_frames=5,
)
