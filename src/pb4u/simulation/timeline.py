"""The frames of a simulation: bodies, pins and skinned garments over time, and the time step that leaves a state."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

import torch
from torch import Tensor

from pb4u.collision.capacities import Capacities
from pb4u.environment import Environment
from pb4u.garment.garment import Garment
from pb4u.physics.integrator import IMPLICIT_EULER, Integrator
from pb4u.physics.time_step import TimeStep
from pb4u.scene.colliders import ColliderFrame, ColliderPose, PackedColliders, pack_colliders
from pb4u.scene.packed import PackedGarments, pack
from pb4u.scene.scene import Scene
from pb4u.scene.soft_folds import SoftFolds
from pb4u.scene.state import State
from pb4u.threads import begun, to_device

SETTLING_DT = 1.0 / 3.0
"""Length of a settling step [s]: inertia weighs a hundredth of what it does at 30 fps (reference 1.8)."""

_BLOCK = 32
"""Frames computed at a time: skinning many at once is several times faster than one by one."""

_POSES = 4
"""Poses kept with their search trees; a step needs three."""


class Frames(Protocol):
    """Vertices (vertices, 3) [m] frame by frame; a tensor (frames, vertices, 3) is one."""

    def __len__(self) -> int: ...

    def __getitem__(self, frame: int) -> Tensor: ...


class BlockedFrames:
    """Frames computed a block at a time and kept while they are near; the next block meanwhile, on another thread.

    Args:
        compute: gives frames (stop - start, vertices, 3) [m] from `start` to `stop`.
        length: number of frames.
    """

    def __init__(self, compute: Callable[[int, int], Tensor], length: int) -> None:
        self._compute, self._length = compute, length
        self._kept: dict[int, Tensor] = {}
        self._begun: dict[int, Callable[[], Tensor]] = {}

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, frame: int) -> Tensor:
        block = frame // _BLOCK
        if block not in self._kept:
            self._kept = {b: rows for b, rows in self._kept.items() if abs(b - block) <= 1}
            self._kept[block] = self._begun.get(block, partial(self._frames, block))()
            following = block + 1
            has_following = following * _BLOCK < self._length and following not in self._kept
            self._begun = {following: begun(partial(self._frames, following))} if has_following else {}
        return self._kept[block][frame - block * _BLOCK]

    def _frames(self, block: int) -> Tensor:
        start = block * _BLOCK
        return self._compute(start, min(start + _BLOCK, self._length))


def _padded(positions: Callable[[int, int], Tensor], length: int, start: int, stop: int) -> Tensor:
    """Frames (stop - start, vertices, 3) [m] of `positions`, which has `length`; the last stands for those beyond."""
    rows = positions(min(start, length - 1), min(stop, length))
    beyond = stop - start - len(rows)
    return torch.cat([rows, rows[-1:].expand(beyond, -1, -1)]) if beyond else rows


class Timeline:
    """Worlds of garments and bodies over frames; the first and last frame stand for those beyond.

    Args:
        garments: static quantities.
        colliders: static quantities of the bodies.
        body: (body vertices, 3) [m] of every frame.
        skinned: (vertices, 3) [m] of the garments at every frame where skinning alone puts them.
        dt: time between frames [s].
        environment: gravity, air and ground.
        integrator: of the steps.
    """

    def __init__(
        self,
        garments: PackedGarments,
        colliders: PackedColliders,
        body: Frames,
        skinned: Frames,
        dt: float,
        environment: Environment,
        integrator: Integrator = IMPLICIT_EULER,
    ) -> None:
        self.garments, self.colliders, self.dt = garments, colliders, dt
        self.environment, self.integrator = environment, integrator
        self._body, self._skinned = body, skinned
        self._poses: dict[int, ColliderPose] = {}

    @staticmethod
    def of(scene: Scene, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu") -> Timeline:
        """Timeline of a scene, all in one world.

        Args:
            scene: garments and bodies.
            dtype: data type of positions and static quantities.
            device: device of the arrays.
        """
        return Timeline.of_worlds([scene], dtype, device)

    @staticmethod
    def of_worlds(
        scenes: Sequence[Scene],
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
        *,
        opens_folds: bool = True,
        integrator: Integrator = IMPLICIT_EULER,
    ) -> Timeline:
        """Timeline of scenes, each in a world of its own; in a shorter one the last frame stands for those beyond.

        Args:
            scenes: garments and bodies, of one frame rate and environment.
            dtype: data type of positions and static quantities.
            device: device of the arrays.
            opens_folds: whether deep folds of the bodies are opened, as contact has them; else they are as posed.
            integrator: of the steps.
        """
        dressed = [(world, garment) for world, scene in enumerate(scenes) for garment in scene.garments]
        bodies = [(world, body) for world, scene in enumerate(scenes) for body in scene.colliders]
        garments = pack([garment.garment for _, garment in dressed], dtype, device, [world for world, _ in dressed])
        colliders = pack_colliders(
            [torch.as_tensor(body.faces, device=device) for _, body in bodies],
            [torch.as_tensor(body.contact, device=device) for _, body in bodies],
            [world for world, _ in bodies],
        )

        def frames(parts: Sequence[tuple[int, Callable[[int, int], Tensor]]]) -> BlockedFrames:
            def block(start: int, stop: int) -> Tensor:
                rows = [_padded(part, scenes[world].total_frames, start, stop) for world, part in parts]
                return torch.cat(rows or [torch.zeros(stop - start, 0, 3)], dim=1).to(device, dtype)

            return BlockedFrames(block, max(scene.total_frames for scene in scenes))

        body = frames([(world, (SoftFolds(body) if opens_folds else body).positions) for world, body in bodies])
        skinned = frames([(world, garment.placement.positions) for world, garment in dressed])
        return Timeline(garments, colliders, body, skinned, scenes[0].dt, scenes[0].environment, integrator)

    def with_garments(self, garments: Sequence[Garment]) -> Timeline:
        """This timeline with the same garments of other materials.

        Args:
            garments: one for each of its own, in their order.
        """
        before, other = self.garments, copy.copy(self)
        other.garments = pack(garments, before.dtype, before.device, before.worlds)
        return other

    def to(self, device: torch.device, capacities: Capacities) -> Timeline:
        """This timeline with all that a step reads on `device`.

        Args:
            device: of the copy.
            capacities: fixed numbers of what the searches of its steps find.
        """
        first = self.pose(0)
        self.colliders.surface_groups(self.garments.world_count, first.positions)
        self.colliders.vertex_groups(first.positions)

        def moved(frames: Frames) -> Frames:
            def block(start: int, stop: int) -> Tensor:
                return to_device(torch.stack([frames[frame] for frame in range(start, stop)]), device)

            return BlockedFrames(block, len(frames))

        garments, colliders = self.garments.to(device), self.colliders.to(device, capacities)
        around = self.dt, self.environment, self.integrator
        return Timeline(garments, colliders, moved(self._body), moved(self._skinned), *around)

    def skinned(self, frame: int) -> Tensor:
        """Garment vertices (vertices, 3) [m] at a frame where skinning alone puts them.

        Args:
            frame: number of the frame.
        """
        return self._skinned[min(max(frame, 0), len(self._skinned) - 1)]

    def skinned_velocity(self, frame: int) -> Tensor:
        """Velocities (vertices, 3) [m/s] of the garments under skinning alone; 0 at the first frame.

        Args:
            frame: number of the frame.
        """
        return (self.skinned(frame) - self.skinned(frame - 1)) / self.dt

    def skinned_acceleration(self, frame: int) -> Tensor:
        """Accelerations (vertices, 3) [m per step^2] of the garments under skinning alone.

        Args:
            frame: number of the frame.
        """
        return self.skinned(frame + 1) - 2.0 * self.skinned(frame) + self.skinned(frame - 1)

    def skinned_state(self, frame: int) -> State:
        """State of the garments under skinning alone: positions [m] and velocities [m/s] at a frame.

        Args:
            frame: number of the frame.
        """
        return State(self.skinned(frame), self.skinned_velocity(frame), frame)

    def body(self, frame: int) -> Tensor:
        """Body vertices (vertices, 3) [m] at a frame.

        Args:
            frame: number of the frame.
        """
        return self.pose(frame).positions

    def pose(self, frame: int) -> ColliderPose:
        """Pose of the bodies at a frame; the poses last asked for are kept, with their search trees.

        Args:
            frame: number of the frame.
        """
        frame = min(max(frame, 0), len(self._body) - 1)
        pose = self._poses.pop(frame, None) or self.colliders.pose(self._body[frame])
        while len(self._poses) >= _POSES:
            del self._poses[next(iter(self._poses))]
        self._poses[frame] = pose
        return pose

    def step_from(self, state: State) -> TimeStep:
        """Time step from the state's frame to the next.

        Args:
            state: state and its frame.
        """
        t = state.frame
        collider = ColliderFrame(self.pose(t - 1), self.pose(t), self.pose(t + 1))
        after = self.skinned(t + 1)
        motion = after - self.skinned(t)
        around = self.environment, after, motion, self.integrator
        return TimeStep(self.garments, state, collider, self.dt, *around, time=t * self.dt)

    def settling_from(self, state: State) -> TimeStep:
        """Long time step from rest, in still air, on the bodies standing still at the state's frame.

        Args:
            state: state and its frame.
        """
        still, pins = self.pose(state.frame), self.skinned(state.frame)
        return TimeStep(
            self.garments,
            State(state.positions, torch.zeros_like(state.velocities), state.frame, load=state.load),
            ColliderFrame(still, still, still),
            SETTLING_DT,
            self.environment.in_still_air,
            pins,
            torch.zeros_like(pins),
            self.integrator,
        )
