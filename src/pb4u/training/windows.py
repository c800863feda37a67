"""Training windows: drawn by number, so that any can be drawn again, and packed as scenes to step through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pb4u.body.skeleton import PoseSequence
from pb4u.environment import USUAL
from pb4u.garment.material import Material
from pb4u.network.acceleration_model import PreparedGarments
from pb4u.physics.contact.contact_set import nearest_planes
from pb4u.physics.time_step import TimeStep
from pb4u.scene.state import State
from pb4u.simulation.network_pass import StepFeatures
from pb4u.simulation.timeline import Timeline
from pb4u.threads import to_device
from pb4u.training.configuration import MaterialSampling, TrainingConfiguration
from pb4u.training.lost_garment import GarmentWatch
from pb4u.training.packed_data import TrainingData
from pb4u.training.wardrobe import Wardrobe

_LARGEST_PUSH = 0.02
"""How far [m] a vertex is pushed out of a body before a window: farther it would cross a limb."""

_SAMPLE, _STEPS, _SETTLE, _SLOWING = range(4)


@dataclass(frozen=True)
class Sample:
    """One garment of a window.

    Args:
        outfit: index of the garment.
        clip: index of the motion.
        start: frame of the clip.
        material: of the garment.
        yaw: turn of body and garment about the vertical [rad].
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
        data: what to draw from.
        configuration: how.
    """

    def __init__(self, data: TrainingData, configuration: TrainingConfiguration) -> None:
        self.data, self.configuration = data, configuration
        self._clips = [
            [i for i, clip in enumerate(data.clips) if clip.body == body and clip.split == "train"]
            for body in range(len(data.bodies))
        ]

    def sample(self, index: int, length: int) -> Sample:
        """Sample of a number.

        Args:
            index: number of the sample.
            length: steps of the window that its clip has to have room for.
        """
        seed = (self.configuration.seed, _SAMPLE, index)
        rng = np.random.default_rng(seed)
        outfit = int(rng.integers(len(self.data.outfits)))
        clip = int(rng.choice(self._clips[self.data.outfits[outfit].body]))
        room = max(len(self.data.clips[clip].poses) - length - 1, 0)
        start = int(rng.integers(room + 1))
        material = drawn_material(self.configuration.material, rng)
        return Sample(outfit, clip, start, material, float(rng.uniform(-np.pi, np.pi)), (*seed, 1))

    def settles(self, window: int, length: int) -> bool:
        """Whether a window begins with the settling step: always if it has several steps, else by `settling_share`.

        Args:
            window: number of the window, from 0.
            length: steps of the window.
        """
        if length > 1:
            return True
        draw = np.random.default_rng((self.configuration.seed, _SETTLE, window)).random()
        return bool(draw < self.configuration.curriculum.settling_share)

    def slowing(self, window: int) -> float:
        """Share of the body's speed that a window's garments set off with, 0.5 to 1.

        Args:
            window: number of the window.
        """
        return float(np.random.default_rng((self.configuration.seed, _SLOWING, window)).uniform(0.5, 1.0))

    def propagation_steps(self, index: int, step: int, ruled: int) -> int:
        """Number of propagation steps K at a step of a sample's window, uniform from 1 to `most_propagation_steps`.

        Args:
            index: number of the sample.
            step: number of the step in its window, from 0.
            ruled: K by the network's own rule, used if `most_propagation_steps` is 0.
        """
        most = self.configuration.most_propagation_steps
        if most == 0:
            return ruled
        rng = np.random.default_rng((self.configuration.seed, _STEPS, index, step))
        return int(rng.integers(1, most + 1))


def drawn_material(ranges: MaterialSampling, rng: np.random.Generator) -> Material:
    """Material drawn from the training ranges.

    Args:
        ranges: lowest and highest of each constant.
        rng: source of the draws, which it advances.
    """

    def logarithmic(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    return Material.isotropic(
        density=float(rng.uniform(*ranges.density)),
        lame_mu=logarithmic(*ranges.lame_mu),
        lame_lambda=float(rng.uniform(*ranges.lame_lambda)),
        bending=logarithmic(*ranges.bending),
    )


@dataclass(frozen=True, eq=False)
class Window:
    """Some frames of samples, each in a world of its own; frame r of the timeline is start - 1 + r of each sample.

    Every body is near the origin in frame 1, so that float32 is precise enough for its motion.

    Args:
        samples: to pack.
        timeline: their garments and bodies.
        length: steps of the window.
    """

    samples: tuple[Sample, ...]
    timeline: Timeline
    length: int

    def start(self, noise: float, clearance: float) -> State:
        """Skinned garments of frame 1, with noise on their present and previous positions, pushed out of the bodies by
        at most 2 cm.

        Args:
            noise: standard deviation of the noise on the positions, except pins, and independently on those one frame
                before [m].
            clearance: distance to the bodies that vertices deeper than it are pushed out to [m].
        """
        garments, now, before = self.timeline.garments, self.timeline.skinned(1), self.timeline.skinned(0)
        if noise > 0:
            draws = [
                np.random.default_rng(sample.noise_seed).standard_normal((2, count, 3))
                for sample, count in zip(self.samples, np.diff(garments.vertex_offsets).tolist(), strict=True)
            ]
            shifts = noise * to_device(torch.as_tensor(np.concatenate(draws, axis=1)).to(now.dtype), now.device)
            now = now + torch.where(garments.pinned[:, None], 0.0, shifts[0])
            before = before + shifts[1]
        planes = nearest_planes(self.timeline.pose(1), garments, now)
        pushed = planes.touchable & ~garments.pinned
        depth = torch.where(pushed, (clearance - planes.distance).clamp(0.0, _LARGEST_PUSH), 0.0)
        return State(now + depth[:, None] * planes.normals, (now - before) / self.timeline.dt, 1)


@dataclass
class Rollout:
    """A training window in progress: its present state and its remaining steps.

    Args:
        number: of the window.
        window: its garments and bodies.
        state: of the garments.
        prepared: data that the network computes once from the garments.
        features: node features of the garments.
        watch: sees whether they are lost.
        settles: whether the next step is the settling step.
        steps_left: steps to go.
        last_move: last move of the search, as from `take`.
    """

    number: int
    window: Window
    state: State
    prepared: PreparedGarments
    features: StepFeatures
    watch: GarmentWatch
    settles: bool
    steps_left: int
    last_move: Tensor | None = None

    def next_step(self) -> TimeStep:
        """All that is known before the next step of the window."""
        timeline = self.window.timeline
        return timeline.settling_from(self.state) if self.settles else timeline.step_from(self.state)


class WindowLoader:
    """Lays samples out as windows.

    Args:
        wardrobe: garments and bodies on the device.
    """

    def __init__(self, wardrobe: Wardrobe) -> None:
        self.wardrobe = wardrobe
        self.data = wardrobe.data

    def load(self, samples: Sequence[Sample], length: int) -> Window:
        """Window of the samples, each in a world of its own, from the frame before its start.

        It holds `length` + 2 frames; beyond either end of a clip its first or last frame is repeated.

        Args:
            samples: to pack, from clips of one frame rate.
            length: steps of the window.
        """
        bodies, skins, wardrobe = [], [], self.wardrobe
        for sample in samples:
            clip = self.data.clips[sample.clip]
            poses = _frames(clip.poses, sample.start - 1, length + 2)
            transforms = _turned(wardrobe.transforms(clip.body, poses), sample.yaw)
            ground = poses.root_positions[1] * np.array([1.0, 0.0, 1.0])
            shift = to_device(_turn(sample.yaw, transforms) @ torch.as_tensor(ground).to(transforms), wardrobe.device)
            transforms = to_device(transforms, wardrobe.device)
            bodies.append(wardrobe.body_positions(clip.body, transforms) - shift)
            skins.append(wardrobe.outfit_positions(sample.outfit, transforms) - shift)
        clips = [self.data.clips[sample.clip] for sample in samples]
        timeline = Timeline(
            wardrobe.packed([s.outfit for s in samples], [s.material for s in samples]),
            wardrobe.colliders([clip.body for clip in clips]),
            torch.cat(bodies, dim=1),
            torch.cat(skins, dim=1),
            1.0 / clips[0].poses.fps,
            USUAL,
        )
        return Window(tuple(samples), timeline, length)


def _frames(poses: PoseSequence, start: int, count: int) -> PoseSequence:
    rows = np.clip(np.arange(start, start + count), 0, len(poses) - 1)
    return PoseSequence(poses.rotations[rows], poses.root_positions[rows], poses.fps)


def _turn(yaw: float, like: Tensor) -> Tensor:
    c, s = float(np.cos(yaw)), float(np.sin(yaw))
    return like.new_tensor([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _turned(transforms: Tensor, yaw: float) -> Tensor:
    return _turn(yaw, transforms) @ transforms
