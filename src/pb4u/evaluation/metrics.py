"""What is measured of a trajectory, frame by frame: the six energies, strain, penetration, divergence."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pb4u.evaluation.divergence import first_diverged
from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.geometry.nearest_surface import TriangleSurface
from pb4u.geometry.principal_stretch import face_strains, weighted_percentile
from pb4u.geometry.topology import Topology
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import ColliderFrame, ColliderPose, PackedGarments, pack, pack_colliders
from pb4u.scene.state import State
from pb4u.scene.trajectory import Trajectory

ENERGIES = ("stretch", "bending", "collision", "gravity", "friction", "inertia", "total")
GEOMETRY = ("strain_p95", "strain_max", "penetration_percent", "penetration_depth_max")

PENETRATION_TOLERANCE = 1e-3
"""Depth [m] beyond which a vertex counts as inside the body."""

Progress = Callable[[int, int], None]


def measure(
    trajectory: Trajectory, skinned: np.ndarray | None = None, progress: Progress | None = None
) -> dict[str, Any]:
    """`metrics`, `metrics_paper`, `diverged` and the frame `diverged_at` (or None) of the command line's JSON.

    Args:
        trajectory: frames as written; the energies of a frame are those of the step that led to it. The first frame
            has none and is judged standing still: its inertia and friction are 0.
        skinned: (frames, 3) centre of mass [m] where skinning alone would put the garment; without it falling off
            is not judged.
        progress: called with (frames done, frames in all).
    """
    ruler = Ruler(trajectory)
    rows, paper_rows = [], []
    for t in range(trajectory.frame_count):
        row, paper_row = ruler.frame(t)
        rows.append(row)
        paper_rows.append(paper_row)
        if progress:
            progress(t + 1, trajectory.frame_count)
    masses = garment_of(trajectory).vertex_masses
    diverged_at = first_diverged([row["strain_p95"] for row in rows], trajectory.positions, masses, skinned)
    return {
        "metrics": _summary(rows, (*ENERGIES, *GEOMETRY)),
        "metrics_paper": _summary(paper_rows, ENERGIES),
        "diverged": diverged_at is not None,
        "diverged_at": diverged_at,
    }


def _summary(rows: list[dict[str, float]], names: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    columns = {name: [row.get(name, float("nan")) for row in rows] for name in names}
    return {
        name: {"per_frame": values, "mean": float(np.mean(values)), "max": float(np.max(values))}
        for name, values in columns.items()
        if not np.isnan(values).all() or name in ENERGIES
    }


def garment_of(trajectory: Trajectory) -> Garment:
    """The garment of a trajectory, from its own record."""
    header = trajectory.header
    material = Material(**{key: float(value) for key, value in header.metadata["material"].items()})
    rest = np.asarray(header.rest_positions, dtype=np.float64)
    return Garment(str(header.metadata.get("garment", "garment")), rest, header.faces, material, header.pinned)


class Ruler:
    """Measures single frames; holds everything about a trajectory that measuring needs once.

    Attributes:
        garments: the garment, packed in float64.
        surface: the body's surface, or None where it is open or nothing may touch it.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        header = trajectory.header
        self.trajectory = trajectory
        self.garments: PackedGarments = pack([garment_of(trajectory)])
        self.potentials = IncrementalPotential(), IncrementalPotential.paper_release()
        self.dt = 1.0 / trajectory.fps
        self.gravity = torch.tensor(header.metadata.get("gravity", [0.0, -9.81, 0.0]), dtype=torch.float64)
        self.ground = header.metadata.get("ground_height", 0.0)
        faces, contact = (torch.from_numpy(np.array(part)) for part in (header.body_faces, header.body_contact))
        self.colliders = pack_colliders([faces], [contact], [0], self.ground)
        self._pose = lru_cache(maxsize=3)(self._posed)
        closed = Topology(np.array(header.body_faces), len(header.body_contact)).is_closed
        touchable = closed and bool(header.body_contact[header.body_faces].all(axis=1).any())
        self.surface = (
            TriangleSurface(header.body_faces, len(header.body_contact), np.array(header.body_contact))
            if touchable
            else None
        )

    def frame(self, t: int) -> tuple[dict[str, float], dict[str, float]]:
        """Metrics of frame t, and the energies by the released convention."""
        x = self._garment(t)
        if not bool(torch.isfinite(x).all()):
            lost = dict.fromkeys((*ENERGIES, *GEOMETRY), float("nan"))
            return lost, dict.fromkeys(ENERGIES, float("nan"))
        state, collider = self._before(t, x)
        ours, paper = (
            potential.of(TimeStep(self.garments, state, collider, self.dt, self.gravity)).energies(x).floats()
            for potential in self.potentials
        )
        strains = face_strains(x, self.garments.faces, self.garments.inverse_rest_shape)
        ours["strain_p95"] = float(weighted_percentile(strains, self.garments.face_areas, 95.0))
        ours["strain_max"] = float(strains.max())
        if self.surface is not None:
            distance = self.surface.at(self._body(t)).nearest(x).signed_distance
            ours["penetration_percent"] = 100.0 * float((distance < -PENETRATION_TOLERANCE).double().mean())
            ours["penetration_depth_max"] = max(0.0, -float(distance.min()))
        return ours, paper

    def _before(self, t: int, x: Tensor) -> tuple[State, ColliderFrame]:
        """The state and bodies that the step to frame t started from; frame 0 is judged standing still."""
        before, velocity = (x, torch.zeros_like(x)) if t == 0 else (self._garment(t - 1), self._velocity(t - 1))
        collider = ColliderFrame(*(self._pose(max(s, 0)) for s in (t - 2, t - 1, t)))
        return State(torch.nan_to_num(before), velocity, t - 1), collider

    def _posed(self, t: int) -> ColliderPose:
        return self.colliders.pose(self._body(t))

    def _garment(self, t: int) -> Tensor:
        return torch.from_numpy(np.array(self.trajectory.positions[t], dtype=np.float64))

    def _velocity(self, t: int) -> Tensor:
        return torch.nan_to_num(torch.from_numpy(np.array(self.trajectory.velocities[t], dtype=np.float64)))

    def _body(self, t: int) -> Tensor:
        return torch.from_numpy(np.array(self.trajectory.body_positions[t], dtype=np.float64))
