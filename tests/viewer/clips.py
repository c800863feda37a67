"""A tube of cloth on a thinner tube of body, moving a little: a clip for pages and overlays."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from pb4u.garment.material import load_material
from pb4u.scene.trajectory import Frame, Trajectory, TrajectoryHeader

AROUND, UP = 12, 7


def tube(radius: float, low: float, high: float, lids: bool) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and outward faces of an upright tube, with a point in the middle of each lid where it has lids."""
    angle, height = np.meshgrid(2 * np.pi * np.arange(AROUND) / AROUND, np.linspace(low, high, UP))
    points = np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], axis=-1).reshape(-1, 3)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(UP - 1), np.arange(AROUND), indexing="ij"))
    a, b = i * AROUND + j, i * AROUND + (j + 1) % AROUND
    faces = [np.column_stack([a, b, b + AROUND]), np.column_stack([a, b + AROUND, a + AROUND])]
    if lids:
        ring = np.arange(AROUND)
        after, top = np.roll(ring, -1), (UP - 1) * AROUND
        bottom_point, top_point = np.full(AROUND, len(points)), np.full(AROUND, len(points) + 1)
        faces += [
            np.column_stack([after, ring, bottom_point]),
            np.column_stack([ring + top, after + top, top_point]),
        ]
        points = np.concatenate([points, [[0.0, low, 0.0], [0.0, high, 0.0]]])
    return points, np.concatenate(faces)


def header(fps: float = 30.0, lids: bool = True) -> TrajectoryHeader:
    cloth, faces = tube(0.20, 0.8, 1.3, lids=False)
    body, body_faces = tube(0.17, 0.0, 1.7, lids=lids)
    return TrajectoryHeader(
        faces=faces,
        rest_positions=cloth.astype(np.float32),
        pinned=np.zeros(len(cloth), dtype=bool),
        vertex_garment=np.zeros(len(cloth), dtype=np.int32),
        body_faces=body_faces,
        body_contact=np.ones(len(body), dtype=bool),
        fps=fps,
        metadata={"garment": "tube", "material": asdict(load_material("default")), "heading": 0.0},
    )


def frame(t: int, widen: float = 0.0) -> Frame:
    """The cloth `widen` [m] wider than at rest, both 1 cm further to the left with every frame."""
    cloth, _ = tube(0.20 + widen, 0.8, 1.3, lids=False)
    body, _ = tube(0.17, 0.0, 1.7, lids=True)
    away = np.array([0.01 * t, 0.0, 0.0])
    return Frame((cloth + away).astype(np.float32), np.zeros_like(cloth, dtype=np.float32), (body + away).astype("f4"))


def trajectory(frames: int = 8, fps: float = 30.0, lost: tuple[int, ...] = (), widen: float = 0.0) -> Trajectory:
    made = Trajectory.collect(header(fps), [frame(t, widen) for t in range(frames)])
    for t in lost:
        made.positions[t, 3] = np.nan
    return made
