"""How good weights are: short clips rolled out by the network alone, and what it leaves of single steps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile

import numpy as np
import torch
from torch import Tensor

from pb4u.garment.material import MATERIALS
from pb4u.measures.excess import Reference
from pb4u.measures.metrics import strain_percentile
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.physics.solver.implicit_steps import implicit_steps
from pb4u.physics.solver.newton_solver import Solver
from pb4u.scene.packed import PackedGarments, pack
from pb4u.scene.state import State
from pb4u.simulation.network_pass import NetworkPass, StepFeatures
from pb4u.simulation.pass_search import search_of
from pb4u.simulation.step import StepMethod, predictions
from pb4u.simulation.step_start import start_of
from pb4u.training.configuration import TrainingConfiguration
from pb4u.training.lost_garment import GarmentWatch, drift_from
from pb4u.training.objective import LOSS_POTENTIAL, REFERENCE_WEIGHT, step_energies
from pb4u.training.packed_data import TrainingData
from pb4u.training.wardrobe import Wardrobe
from pb4u.training.windows import Sample, Window, WindowLoader

# An energy [J] that no clip has: cloth that lies still has thousands of times as much.
_NO_ENERGY = 1e-9

_LEAST_EXCESS = 1e-6
"""Height [m] that the geometric mean takes for less: the solver's tolerance."""

_REFERENCE_FRAMES, _REFERENCE_LEAD_IN, _SHARED_EVERY = 6, 2, 2
"""Frames of a clip that the solver rolls out, those before its first shared state, and from each to the next."""


@dataclass(frozen=True)
class Score:
    """The outcome of a validation.

    Args:
        survived: share of all frames before the garment was lost.
        excess_height: geometric mean [m], over states of the solver on those clips, of the height to which the energy
            above the minimum after one step would lift the garment; infinite if a step is not finite, or without
            compiled solver.
        strain: mean of the 95th percentile strains of the frames that survived.
        energy_without_gravity: geometric mean, over the clips, of their mean potential less gravity's [J]; reported in
            addition, since floating cloth has little of it.
    """

    survived: float
    excess_height: float
    strain: float
    energy_without_gravity: float

    def beats(self, other: Score | None, margin: float = 0.0) -> bool:
        """Whether this is better: more frames survived, or else a lower excess height, or lower strain.

        Args:
            other: score to beat; None is beaten by any.
            margin: share of its excess height by which the excess height has to be less.
        """
        if other is None:
            return True
        if self.survived != other.survived:
            return self.survived > other.survived
        if math.isinf(self.excess_height) and math.isinf(other.excess_height):
            return self.strain < (1.0 - margin) * other.strain
        return self.excess_height < (1.0 - margin) * other.excess_height


class Validation:
    """A fixed set of clips, spread over garments, levels and bodies.

    Args:
        data: its "validation" clips are used, or its training clips if it has none; clips of the requested number of
            frames, or the longest.
        configuration: how many clips and frames.
        loader: lays them out.
    """

    def __init__(self, data: TrainingData, configuration: TrainingConfiguration, loader: WindowLoader) -> None:
        rng = np.random.default_rng([configuration.seed, 7])
        self.samples, self.notes, self.data = [], [], data
        self.most_frames = configuration.validation_frames
        for outfit in _spread(data, configuration.validation_clips):
            body = data.outfits[outfit].body
            clips_of_body = [i for i, clip in enumerate(data.clips) if clip.body == body]
            held_out = [i for i in clips_of_body if data.clips[i].split == "validation"]
            clips = held_out or clips_of_body
            longest = min(max(len(data.clips[i].poses) for i in clips), self.most_frames)
            clips = [i for i in clips if len(data.clips[i].poses) >= longest]
            self.samples.append(Sample(outfit, int(rng.choice(clips)), 0, MATERIALS["default"]))
            if not held_out:
                self.notes.append("No clips are reserved for validation, so validation uses clips of the training.")
            if longest < self.most_frames:
                self.notes.append(
                    f"Validation is shorter than {self.most_frames} frames: its longest clip has {longest}."
                )
        self.loader, self.clearance = loader, configuration.clearance

    def frames(self, sample: Sample) -> int:
        """Frames of a clip that are simulated.

        Args:
            sample: the clip.
        """
        return min(self.most_frames, len(self.data.clips[sample.clip].poses))

    @torch.no_grad()
    def score(self, model: AccelerationModel) -> Score:
        """Roll every clip out with `model`; K follows the resolution.

        Args:
            model: the network with its normalisers.
        """
        survived, strain, logarithms = 0, 0.0, []
        for sample in self.samples:
            frames, energies, strains = self._rollout(model, sample)
            survived += frames
            strain += strains
            if frames:
                logarithms.append(math.log(max(energies / frames, _NO_ENERGY)))
        total = sum(map(self.frames, self.samples))
        energy = math.exp(sum(logarithms) / len(logarithms)) if logarithms else math.inf
        return Score(survived / total, self._excess_height(model), strain / max(survived, 1), energy)

    @cached_property
    def references(self) -> tuple[Reference, ...]:
        """Solver's first frames of every clip, with the states from which a score takes steps; computed once."""
        loader = WindowLoader(Wardrobe(self.loader.data, "cpu", torch.float64))
        return tuple(self._reference(loader, sample) for sample in self.samples)

    def _reference(self, loader: WindowLoader, sample: Sample) -> Reference:
        window = loader.load([sample], _REFERENCE_FRAMES)
        timeline, start = window.timeline, window.start(0.0, self.clearance)
        settled, _ = implicit_steps(LOSS_POTENTIAL, Solver(), timeline.settling_from(start))
        first = State(settled.positions, timeline.skinned_velocity(start.frame), start.frame)
        return Reference.of(LOSS_POTENTIAL, timeline, first, _REFERENCE_FRAMES, _REFERENCE_LEAD_IN, _SHARED_EVERY)

    def _excess_height(self, model: AccelerationModel) -> float:
        """Geometric mean of what `model` leaves of a step from each shared state [m]."""
        device, logarithms = next(model.parameters()).device, []
        for reference in self.references:
            packed = reference.timeline.garments
            garments = pack(packed.garments, torch.float32, device, packed.worlds)
            for height in reference.excess(_method(model, garments), settled=False):
                logarithms.append(math.log(max(height, _LEAST_EXCESS)) if math.isfinite(height) else math.inf)
        return math.exp(sum(logarithms) / len(logarithms)) if logarithms else math.inf

    def _rollout(self, model: AccelerationModel, sample: Sample) -> tuple[int, float, float]:
        """Frames before the garment is lost, and the sums of their energies without gravity [J] and strains."""
        window, capacities = self.loader.load([sample], self.frames(sample)), self.loader.wardrobe.capacities
        while True:
            rows = torch.stack(list(self._frames(model, window))).tolist()
            if capacities is None or not capacities.grow(*capacities.taken()):
                sound = list(takewhile(lambda row: row[0], rows))
                return len(sound), sum(row[1] for row in sound), sum(row[2] for row in sound)

    def _frames(self, model: AccelerationModel, window: Window) -> Iterator[Tensor]:
        """For each frame (3,) float64: 1 if its garment is not lost, its energy without gravity [J], and its strain.

        A processor ends where it is lost; an accelerator goes on, as it waits for no decision.
        """
        timeline, capacities, watch = window.timeline, self.loader.wardrobe.capacities, GarmentWatch()
        garments, state, last_move = timeline.garments, window.start(0.0, self.clearance), None
        method = _method(model, garments)
        for frame in range(window.length):
            step = timeline.step_from(state) if frame else timeline.settling_from(state)
            *_, prediction = predictions(step, method, last_move, capacities)
            after, last_move = prediction.state, prediction.last_move
            finite = torch.isfinite(after.positions)
            positions = torch.where(finite, after.positions, state.positions)
            velocities = after.velocities if frame else timeline.skinned_velocity(state.frame)
            state = State(positions, velocities, after.frame if frame else state.frame, after.history if frame else ())
            terms = step_energies(step, positions, REFERENCE_WEIGHT).terms
            energy = sum(term.sum().double() for name, term in terms.items() if name != "gravity")
            strain = strain_percentile(garments, positions)
            drift = drift_from(timeline.skinned(state.frame), garments, positions)
            lost = watch.is_lost(strain, drift, terms["collision"].sum().double() / REFERENCE_WEIGHT)
            fine = finite.all() & ~lost
            yield torch.stack([fine.double(), torch.as_tensor(energy), strain.double()])
            if capacities is None and not bool(fine):
                return


def _method(model: AccelerationModel, garments: PackedGarments) -> StepMethod:
    """A step by `model` alone; K follows the resolution."""
    network, c = model.network, model.network.configuration
    prepared = model.prepare(garments)
    passes = NetworkPass(model, prepared, StepFeatures(prepared, LOSS_POTENTIAL), c.passes, further=c.further_passes)
    return StepMethod(start_of(network, LOSS_POTENTIAL), passes, search=search_of(network, LOSS_POTENTIAL))


def _spread(data: TrainingData, count: int) -> list[int]:
    """Indices of outfits: every garment in its turn, and of each others of its resolutions and bodies."""
    by_name: dict[str, list[int]] = {}
    for index, outfit in enumerate(data.outfits):
        by_name.setdefault(outfit.garment.name, []).append(index)
    groups = list(by_name.values())
    # Multiples of the golden ratio are as far from each other, modulo 1, as any sequence can be.
    places = ((groups[i % len(groups)], (i * 0.618034) % 1.0) for i in range(count))
    return [group[int(place * len(group))] for group, place in places]
