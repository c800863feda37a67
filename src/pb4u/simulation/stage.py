"""A scene packed for stepping: the garments' static quantities, and bodies and pins at any frame."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from pb4u.scene.packed import ColliderFrame, PackedGarments, pack
from pb4u.scene.scene import Scene

_BLOCK = 32


class _Blocks:
    """Rows of a long track, computed a block at a time and kept while they are near."""

    def __init__(self, compute: Callable[[int, int], Tensor], length: int) -> None:
        self._compute, self._length = compute, length
        self._kept: dict[int, Tensor] = {}

    def __getitem__(self, frame: int) -> Tensor:
        frame = min(max(frame, 0), self._length - 1)
        block = frame // _BLOCK
        if block not in self._kept:
            start = block * _BLOCK
            self._kept = {b: rows for b, rows in self._kept.items() if abs(b - block) <= 1}
            self._kept[block] = self._compute(start, min(start + _BLOCK, self._length))
        return self._kept[block][frame - block * _BLOCK]


class Stage:
    """One scene, ready to be stepped.

    Args:
        scene: garments and bodies.
        dtype: of positions and static quantities.
        device: where they live.
    """

    def __init__(self, scene: Scene, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu") -> None:
        self.scene = scene
        self.garments: PackedGarments = pack([worn.garment for worn in scene.garments], dtype, device)
        self.dt = scene.dt
        self.gravity = torch.as_tensor(scene.gravity, dtype=dtype, device=device)
        collider = scene.colliders[0]
        self._body = _Blocks(lambda a, b: collider.positions(a, b).to(device, dtype), scene.total_frames)
        placement = scene.garments[0].placement
        self._skinned = _Blocks(lambda a, b: placement.positions(a, b).to(device, dtype), scene.total_frames)
        self._faces = torch.as_tensor(collider.faces, device=device)
        self._contact = torch.as_tensor(collider.contact, device=device)
        self._owner = torch.zeros(len(collider.contact), dtype=torch.int64, device=device)

    def body(self, frame: int) -> Tensor:
        """Body vertices [m] at a frame; the first and last frame stand for those beyond."""
        return self._body[frame]

    def skinned(self, frame: int) -> Tensor:
        """Garment vertices [m] where the body alone would carry them."""
        return self._skinned[frame]

    def skinned_velocity(self, frame: int) -> Tensor:
        """Velocity [m/s] of the garment as the body alone would carry it; 0 at the first frame."""
        return (self.skinned(frame) - self.skinned(frame - 1)) / self.dt

    def collider(self, frame: int) -> ColliderFrame:
        """The bodies around the step from `frame` to `frame` + 1."""
        return ColliderFrame(
            previous=self.body(frame - 1),
            now=self.body(frame),
            following=self.body(frame + 1),
            faces=self._faces,
            contact=self._contact,
            vertex_garment=self._owner,
            ground_height=self.scene.ground_height,
        )

    def held_collider(self, frame: int) -> ColliderFrame:
        """The bodies standing still at `frame`, for settling."""
        still = self.body(frame)
        return ColliderFrame(still, still, still, self._faces, self._contact, self._owner, self.scene.ground_height)
