"""Training windows: drawn by number, so that any can be drawn again, and laid out as situations to step through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from pb4u.body.skeleton import PoseSequence
from pb4u.garment.material import Material
from pb4u.model.propagation_control import RandomSteps
from pb4u.physics.contact_planes import collider_surfaces
from pb4u.scene.packed import ColliderFrame, PackedGarments
from pb4u.scene.state import State
from pb4u.simulation.first_frame import SETTLING_DT
from pb4u.simulation.step import Situation
from pb4u.training.configuration import MaterialSampling, TrainingConfiguration
from pb4u.training.packed_data import TrainingData
from pb4u.training.wardrobe import Wardrobe

_LARGEST_PUSH = 0.02
_STANDARD_GRAVITY = (0.0, -9.81, 0.0)
_SAMPLE, _STEPS, _SETTLE, _SLOWING = range(4)


@dataclass(frozen=True)
class Sample:
    """One garment of a window.

    Args:
        outfit: index of the garment. clip: index of the motion. start: frame of the clip.
        material: of the garment. yaw: turn of body and garment about the vertical [rad].
        noise_seed: of the noise on the start.
    """

    outfit: int
    clip: int
    start: int
    material: Material
    yaw: float = 0.0
    noise_seed: tuple[int, ...] = ()


class Sampler:
    """Draws samples: sample i is the same whenever, wherever and in whatever order it is drawn.

    Args:
        data: what to draw from. configuration: how.
    """

    def __init__(self, data: TrainingData, configuration: TrainingConfiguration) -> None:
        self.data, self.configuration = data, configuration
        self._clips = [
            [i for i, clip in enumerate(data.clips) if clip.body == body and clip.split == "train"]
            for body in range(len(data.bodies))
        ]

    def sample(self, index: int, length: int) -> Sample:
        """Sample number `index`, with room for a window of `length` steps."""
        seed = (self.configuration.seed, _SAMPLE, index)
        rng = np.random.default_rng(seed)
        outfit = int(rng.integers(len(self.data.outfits)))
        clip = int(rng.choice(self._clips[self.data.outfits[outfit].body]))
        room = max(len(self.data.clips[clip].poses) - length - 1, 0)
        start = int(rng.integers(room + 1))
        material = drawn_material(self.configuration.material, rng)
        return Sample(outfit, clip, start, material, float(rng.uniform(-np.pi, np.pi)), (*seed, 1))

    def settles(self, window: int, length: int) -> bool:
        """Whether a window begins with the settling step; see `Curriculum.settling_share`."""
        if length > 1:
            return True
        draw = np.random.default_rng((self.configuration.seed, _SETTLE, window)).random()
        return bool(draw < self.configuration.curriculum.settling_share)

    def slowing(self, window: int) -> float:
        """Share of the body's speed that a window's garments set off with, 0.5 to 1."""
        return float(np.random.default_rng((self.configuration.seed, _SLOWING, window)).uniform(0.5, 1.0))

    def propagation_steps(self, index: int, step: int, ruled: int) -> int:
        """K of sample `index` at a step of its window; `ruled` is what the resolution asks for."""
        most = self.configuration.most_propagation_steps
        if most == 0:
            return ruled
        rng = np.random.default_rng((self.configuration.seed, _STEPS, index, step))
        return RandomSteps(most, rng).steps(0.0)


def drawn_material(ranges: MaterialSampling, rng: np.random.Generator) -> Material:
    """A material from the training ranges."""

    def logarithmic(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    return Material(
        density=float(rng.uniform(*ranges.density)),
        lame_mu=logarithmic(*ranges.lame_mu),
        lame_lambda=float(rng.uniform(*ranges.lame_lambda)),
        bending=logarithmic(*ranges.bending),
    )


@dataclass(frozen=True, eq=False)
class Window:
    """Some frames of bodies and skinned garments, packed; row r is frame start - 1 + r of each sample.

    Every body stands near the origin in row 1, so that float32 is fine wherever its motion leads.

    Args:
        samples: what is packed.
        garments: static quantities.
        body: (rows, body vertices, 3) [m]. skinned: (rows, vertices, 3) [m].
        faces: (body faces, 3). contact: (body vertices,). owner: (body vertices,) garment that touches each.
        dt: time step [s].
    """

    samples: tuple[Sample, ...]
    garments: PackedGarments
    body: Tensor
    skinned: Tensor
    faces: Tensor
    contact: Tensor
    owner: Tensor
    dt: float

    @property
    def length(self) -> int:
        """Steps of the window."""
        return len(self.skinned) - 2

    def skinned_velocity(self, row: int) -> Tensor:
        """(vertices, 3) [m/s] of the garments as the bodies alone would carry them."""
        return (self.skinned[row] - self.skinned[row - 1]) / self.dt

    def skinned_acceleration(self, row: int) -> Tensor:
        """(vertices, 3) [m per step^2] that would keep the garments where the bodies alone carry them."""
        return self.skinned[row + 1] - 2.0 * self.skinned[row] + self.skinned[row - 1]

    def settling(self, state: State) -> Situation:
        """The long first step from rest, with the bodies held."""
        row = state.frame
        resting = replace(state, velocities=torch.zeros_like(state.velocities))
        still = self._collider(row, row, row)
        pins = self.skinned[row]
        return Situation(self.garments, resting, still, pins, torch.zeros_like(pins), SETTLING_DT, self._gravity)

    def moving(self, state: State) -> Situation:
        """The ordinary step from the state's row to the next."""
        row = state.frame
        collider = self._collider(row - 1, row, row + 1)
        after = self.skinned[row + 1]
        return Situation(self.garments, state, collider, after, after - self.skinned[row], self.dt, self._gravity)

    @property
    def _gravity(self) -> Tensor:
        return self.body.new_tensor(_STANDARD_GRAVITY)

    def _collider(self, previous: int, now: int, following: int) -> ColliderFrame:
        return ColliderFrame(
            self.body[previous], self.body[now], self.body[following], self.faces, self.contact, self.owner, 0.0
        )

    def start(self, noise: float, clearance: float) -> State:
        """The skinned garments of row 1, with noise on where they are and were, pushed out of the bodies.

        Args:
            noise: standard deviation of the positions, pins left out, and of those one frame before, independently [m].
            clearance: distance to the bodies that vertices deeper than it are pushed out to [m].
        """
        now, before = self.skinned[1], self.skinned[0]
        if noise > 0:
            draws = [
                np.random.default_rng(sample.noise_seed).standard_normal((2, count, 3))
                for sample, count in zip(self.samples, np.diff(self.garments.vertex_offsets).tolist(), strict=True)
            ]
            shifts = noise * torch.as_tensor(np.concatenate(draws, axis=1)).to(now)
            now = now + torch.where(self.garments.pinned[:, None], 0.0, shifts[0])
            before = before + shifts[1]
        push = self._push(now, clearance)
        return State(now + push, (now - before) / self.dt, 1)

    def _push(self, x: Tensor, clearance: float) -> Tensor:
        """(vertices, 3) [m] out of the bodies of row 1, once."""
        planes = collider_surfaces(self.garments, self._collider(1, 1, 1)).at(self.body[1]).nearest(x)
        pushed = planes.touchable & ~self.garments.pinned
        depth = torch.where(pushed, (clearance - planes.distance).clamp(0.0, _LARGEST_PUSH), 0.0)
        return depth[:, None] * planes.normals


class WindowLoader:
    """Lays samples out as windows.

    Args:
        wardrobe: garments and bodies on the device.
    """

    def __init__(self, wardrobe: Wardrobe) -> None:
        self.wardrobe = wardrobe
        self.data = wardrobe.data

    def load(self, samples: Sequence[Sample], length: int) -> Window:
        """The samples with `length` + 2 frames from the one before their start; the ends of clips are held."""
        bodies, skins, faces, contacts, owners = [], [], [], [], []
        base = 0
        for index, sample in enumerate(samples):
            clip = self.data.clips[sample.clip]
            poses = _frames(clip.poses, sample.start - 1, length + 2)
            transforms = _turned(self.wardrobe.transforms(clip.body, poses), sample.yaw)
            ground = poses.root_positions[1] * np.array([1.0, 0.0, 1.0])
            shift = _turn(sample.yaw, transforms) @ torch.as_tensor(ground).to(transforms)
            bodies.append(self.wardrobe.body_positions(clip.body, transforms) - shift)
            skins.append(self.wardrobe.outfit_positions(sample.outfit, transforms) - shift)
            own_faces, contact = self.wardrobe.surface(clip.body)
            faces.append(own_faces + base)
            contacts.append(contact)
            owners.append(torch.full_like(contact, index, dtype=torch.int64))
            base += len(contact)
        garments = self.wardrobe.packed([s.outfit for s in samples], [s.material for s in samples])
        return Window(
            tuple(samples),
            garments,
            torch.cat(bodies, dim=1),
            torch.cat(skins, dim=1),
            torch.cat(faces),
            torch.cat(contacts),
            torch.cat(owners),
            1.0 / self.data.clips[samples[0].clip].poses.fps,
        )


def _frames(poses: PoseSequence, start: int, count: int) -> PoseSequence:
    rows = np.clip(np.arange(start, start + count), 0, len(poses) - 1)
    return PoseSequence(poses.rotations[rows], poses.root_positions[rows], poses.fps)


def _turn(yaw: float, like: Tensor) -> Tensor:
    c, s = float(np.cos(yaw)), float(np.sin(yaw))
    return like.new_tensor([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _turned(transforms: Tensor, yaw: float) -> Tensor:
    return _turn(yaw, transforms) @ transforms
