"""What the examples of cloth without a human body share: sheets, solids, pinned paths, and a report of contact."""

from __future__ import annotations

import numpy as np

import pb4u
from pb4u.body.vertex_sequence import VertexSequence
from pb4u.collision.crossings import crossings, self_crossings
from pb4u.garment.dressing import PrescribedPlacement
from pb4u.garment.material import load_material
from pb4u.scene.scene import DressedGarment
from pb4u.scene.trajectory import Trajectory
from pb4u.simulation.simulator import RunRecord


def sheet(width: float, depth: float, triangles: int, material: str = "cotton") -> pb4u.Garment:
    """A rectangle [m] in the x-y plane, its lower corner at the origin, of about so many triangles."""
    cell = (2.0 * width * depth / triangles) ** 0.5
    columns, rows = max(2, round(width / cell)), max(2, round(depth / cell))
    x, y = np.meshgrid(np.linspace(0.0, width, columns + 1), np.linspace(0.0, depth, rows + 1), indexing="ij")
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"))
    a, b = i * (rows + 1) + j, (i + 1) * (rows + 1) + j
    # Diagonals alternate, so that cloth folds as easily along one as along the other.
    even = ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.column_stack([a, b, b + 1]), np.column_stack([a, b, a + 1]))
    second = np.where(even, np.column_stack([a, b + 1, a + 1]), np.column_stack([b, b + 1, a + 1]))
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return pb4u.Garment("sheet", vertices, np.concatenate([first, second]), load_material(material))


def placed(garment: pb4u.Garment, frames: np.ndarray, pinned: np.ndarray | None = None) -> DressedGarment:
    """A sheet that starts at frame 0 of `frames` (frames, vertices, 3) [m], its `pinned` vertices following them."""
    worn = garment if pinned is None else garment.with_pins(pinned)
    return DressedGarment(worn, PrescribedPlacement(frames.reshape(-1, len(garment.vertices), 3)))


def solid(name: str, vertices: np.ndarray, faces: np.ndarray, felt: bool = True) -> VertexSequence:
    """A surface (frames, vertices, 3) [m] that the cloth meets, or that is only seen where it is not `felt`."""
    moving = np.asarray(vertices, dtype=np.float32).reshape(-1, np.shape(vertices)[-2], 3)
    return VertexSequence(name, moving, np.ascontiguousarray(faces, np.int64), contact=np.full(moving.shape[1], felt))


def simulate(scene: pb4u.Scene, out: str, self_contact: bool = True) -> Trajectory:
    """Simulate by the solver from where the cloth is placed, tell of contact, write a trajectory and a picture."""
    simulator = pb4u.load_simulator("solver", first_frame="placed", self_contact=self_contact)
    record = RunRecord()
    trajectory = Trajectory.collect(simulator.header(scene), simulator.written_frames(scene, record))
    crossing = [len(self_crossings(x, trajectory.faces, sharing=True)) for x in trajectory.positions]
    iterations = np.array(record.solver_iterations)
    print(
        f"{len(trajectory.faces)} triangles, {trajectory.frame_count} frames, {record.ms_per_step:.0f} ms a step, "
        f"{iterations.mean():.1f} iterations a step (most {iterations.max()}), {record.unsolved} steps unsolved"
    )
    print(f"pairs of triangles that cross: {sum(crossing)} in all frames, {max(crossing)} in the worst")
    felt = trajectory.header.body_faces[trajectory.header.body_contact[trajectory.header.body_faces].all(axis=1)]
    through = [
        len(crossings(x, trajectory.faces, body, felt))
        for x, body in zip(trajectory.positions, trajectory.body_positions, strict=True)
    ]
    print(
        f"pairs of triangles of cloth and solid that cross: {sum(through)} in all frames, {max(through)} in the worst"
    )
    print(f"fastest vertex at the end: {1000 * np.linalg.norm(trajectory.velocities[-1], axis=1).max():.1f} mm/s")
    print("written:", trajectory.save(f"{out}.npz"), pb4u.export_trajectory(trajectory, f"{out}.png"))
    return trajectory
