"""Small made-up garments and bodies for tests of graphs and networks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from pb4u.garment.garment import Garment
from pb4u.garment.material import Material
from pb4u.network.acceleration_model import AccelerationModel, PreparedGarments
from pb4u.scene.colliders import ColliderFrame, PackedColliders, pack_colliders
from pb4u.scene.packed import PackedGarments, pack
from pb4u.scene.state import State

COTTON = Material.isotropic(density=0.20022, lame_mu=23600.0, lame_lambda=44400.0, bending=3.962e-5)
DT = 1.0 / 30.0


def sheet(rows: int, columns: int, edge: float = 0.015, seed: int = 0, material: Material = COTTON) -> Garment:
    """A slightly uneven horizontal sheet of 2 (rows - 1) (columns - 1) triangles at 1 m height."""
    rng = np.random.default_rng(seed)
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    vertices = np.stack([i * edge, np.ones(i.shape), j * edge], axis=-1).reshape(-1, 3).astype(float)
    vertices[:, [0, 2]] += rng.uniform(-0.15, 0.15, (len(vertices), 2)) * edge
    corner = (i * columns + j)[:-1, :-1].reshape(-1)
    a, b, c, d = corner, corner + 1, corner + columns, corner + columns + 1
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]).astype(np.int64)
    return Garment("sheet", vertices, faces, material)


def sheet_of(triangles: int, area: float = 0.9) -> Garment:
    """A square sheet of about so many triangles and `area` [m^2] (a T-shirt has about 0.9)."""
    side = round((triangles / 2) ** 0.5) + 1
    return sheet(side, side, edge=area**0.5 / (side - 1))


@dataclass(frozen=True)
class Moment:
    """A packed state around its bodies."""

    garments: PackedGarments
    state: State
    collider: ColliderFrame

    def shifted(self, shift: Tensor) -> Moment:
        collider = placed(self.collider, lambda positions: positions + shift)
        return replace(self, state=replace(self.state, positions=self.state.positions + shift), collider=collider)

    def alone(self, garment: int) -> Moment:
        """The same moment of one garment only."""
        start, stop = self.garments.vertex_offsets[garment : garment + 2]
        state = replace(
            self.state, positions=self.state.positions[start:stop], velocities=self.state.velocities[start:stop]
        )
        bodies, rows = self.collider.colliders, self.collider.colliders.world_vertices[garment]
        faces = bodies.faces[bodies.world_faces[garment]] - rows.start
        own = pack_colliders([faces], [bodies.contact[rows]], [0])
        collider = placed(self.collider, lambda positions: positions[rows], own)
        packed = pack([self.garments.garments[garment]], dtype=self.garments.dtype)
        return Moment(packed, state, collider)


def placed(
    collider: ColliderFrame, change: Callable[[Tensor], Tensor] = torch.clone, bodies: PackedColliders | None = None
) -> ColliderFrame:
    """Positions of all three poses changed, and their bodies replaced where given."""
    made = bodies or collider.colliders
    return ColliderFrame(
        *(made.pose(change(at.positions)) for at in (collider.previous, collider.now, collider.following))
    )


def moment(garments: list[Garment], body: bool = True, seed: int = 0, dtype: torch.dtype = torch.float64) -> Moment:
    """Garments wobbling in the air, half of each 1.5 cm over a body of its own that moves."""
    generator = torch.Generator().manual_seed(seed)
    packed = pack(garments, dtype=dtype)

    def noise(like: Tensor, scale: float) -> Tensor:
        return scale * torch.randn(like.shape, generator=generator, dtype=torch.float64).to(like)

    positions = packed.rest_positions + noise(packed.rest_positions, 5e-4)
    velocities = noise(positions, 0.1)
    frames, faces = [], []
    for index, garment in enumerate(garments):
        extent = np.ptp(garment.vertices, axis=0)
        under = sheet(9, 9, edge=float(max(extent[0], extent[2])) / 12, seed=seed + index + 1)
        vertices = torch.as_tensor(under.vertices, dtype=dtype) - torch.tensor([0.0, 0.015, 0.0], dtype=dtype)
        frames.append(vertices if body else vertices[:0])
        faces.append(torch.as_tensor(under.faces)[: None if body else 0])
    now, contact = torch.cat(frames), [torch.ones(len(part), dtype=torch.bool) for part in frames]
    bodies = pack_colliders(faces, contact, range(len(garments)))
    previous, following = now + noise(now, 2e-3), now + noise(now, 2e-3)
    collider = ColliderFrame(bodies.pose(previous), bodies.pose(now), bodies.pose(following))
    return Moment(packed, State(positions, velocities, 0), collider)


def accelerations(
    model: AccelerationModel,
    at: Moment,
    steps: int | tuple[int, ...] | None = None,
    dtype: torch.dtype = torch.float64,
    origins: Tensor | None = None,
) -> Tensor:
    prepared = prepared_for(model, at, steps, dtype)
    extra = {
        feature.name: torch.zeros(at.garments.vertex_count, feature.width, dtype=dtype)
        for feature in model.network.configuration.layout.extra
    }
    return model(prepared.graph(at.state, at.collider, DT, origins, extra), prepared)


def prepared_for(
    model: AccelerationModel,
    at: Moment,
    steps: int | tuple[int, ...] | None = None,
    dtype: torch.dtype = torch.float64,
) -> PreparedGarments:
    prepared = model.prepare(at.garments, dtype=dtype)
    return prepared if steps is None else prepared.with_steps(steps)
