"""The training, on one page: draw some windows, start them, step through them in turn, learn from every step."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from enum import Enum, auto
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from pb4u.errors import InputError, Pb4uError
from pb4u.nn.acceleration_model import PreparedGarments
from pb4u.scene.state import State
from pb4u.simulation.checkpoint import TrainingRecord, save_checkpoint
from pb4u.simulation.first_frame import SETTLING_DT
from pb4u.simulation.situation_features import SituationFeatures
from pb4u.simulation.step import Situation, StepParts, step
from pb4u.simulation.step_start import Reached, start_of
from pb4u.training.budget import Budget, Counters
from pb4u.training.configuration import TrainingConfiguration
from pb4u.training.course import Course
from pb4u.training.distribution import Workers
from pb4u.training.explosion_guard import ExplosionGuard
from pb4u.training.learner import Learner
from pb4u.training.lost_garment import drift_from, is_lost, strain_percentile
from pb4u.training.objective import (
    LearningPredictor,
    comparable_total,
    further_losses,
    mean_energies,
    step_energies,
    strain_energy,
)
from pb4u.training.packed_data import TrainingData
from pb4u.training.progress import Reporter
from pb4u.training.run_folder import NotSavedError, RunFolder
from pb4u.training.validation import Score, Validation
from pb4u.training.wardrobe import Wardrobe
from pb4u.training.windows import Sampler, WindowLoader

MOST_ROLLBACKS = 8
IMPROVEMENT = 0.005


class TrainingFailedError(Pb4uError):
    """A training that cannot be saved by lowering its rate."""


class RoundEnd(Enum):
    """How a round of windows ended."""

    LEARNT = auto()
    CAME_APART = auto()
    STOPPED = auto()


@dataclass(frozen=True)
class Snapshot:
    """Where a training was: what `Learner.state` and `Counters.to_json` gave."""

    tensors: dict[str, Tensor]
    counters: dict[str, Any]

    @property
    def step(self) -> int:
        """Optimiser steps taken until then."""
        return int(self.counters["step"])


class Trainer:
    """Trains the network of a configuration on some data.

    Args:
        configuration: everything that decides it. budget: when it ends. data: what it is trained on.
        workers: this process and the others. folder: where it is kept, or None to keep nothing.
        reporter: told how it goes. stopping: asked every few steps whether to end early.
    """

    def __init__(
        self,
        configuration: TrainingConfiguration,
        budget: Budget,
        data: TrainingData,
        workers: Workers,
        folder: RunFolder | None,
        reporter: Reporter,
        stopping: Callable[[], bool] = lambda: False,
    ) -> None:
        self.configuration, self.budget, self.data = configuration, budget, data
        self.workers, self.folder, self.reporter, self.stopping = workers, folder, reporter, stopping
        self.learner = Learner(configuration, workers)
        self.model, self.network = self.learner.model, self.learner.network
        self.start = start_of(self.model.network)
        self.sampler = Sampler(data, configuration)
        self.loader = WindowLoader(Wardrobe(data, workers.device))
        self.validation = Validation(data, configuration, self.loader)
        self.share = workers.share(configuration.batch)
        self.counters = Counters()
        self.sums: dict[str, float] = {}
        self.totals: list[float] = []
        self.latest_collision = 0.0
        self.saved = Snapshot(self.learner.state(), self.counters.to_json())
        self._clock = time.monotonic()

    def run(self) -> str:
        """Train until the budget is spent, validation is flat or a stop is asked for; says which."""
        self._clock = time.monotonic() - self.counters.seconds
        if self.counters.window == 0:
            self._gather_statistics()
            self.saved = Snapshot(self.learner.state(), self.counters.to_json())
        ending = self._ending()
        while ending is None:
            begun = Snapshot(self.learner.state(), self.counters.to_json())
            end = self._train_round()
            if end is RoundEnd.STOPPED:
                self._return_to(begun)
                ending = "stopped"
                break
            self.counters.window += self.configuration.interleaved
            if end is RoundEnd.LEARNT:
                self._keep_house(begun.step)
            else:
                self._roll_back()
            ending = self._ending()
        if ending == "stopped" and not self.counters.guard.calm:
            self._return_to(self.saved)
        if ending != "stopped":
            self._validate()
            self._save_final()
        self._checkpoint(exact=True, insist=True)
        return ending

    def _return_to(self, then: Snapshot) -> None:
        self.learner.restore(then.tensors)
        self.counters = Counters.from_json(then.counters)
        self.sums, self.totals = {}, []

    def _ending(self) -> str | None:
        """Why to end now, the same in every process; None to go on."""
        elapsed = torch.tensor(time.monotonic() - self._clock, dtype=torch.float64, device=self.workers.device)
        self.counters.seconds = float(self.workers.mean(elapsed))
        if self.workers.agreed(self.stopping()):
            return "stopped"
        if self.progress >= 1.0:
            return "finished"
        patience = self.configuration.patience
        return "flat" if patience and self.counters.flat >= patience else None

    @property
    def progress(self) -> float:
        """Fraction of the budget spent."""
        return self.budget.spent(self.counters.step, self.counters.seconds)

    def _gather_statistics(self) -> None:
        """Normalise by what skinned garments look like; nothing is learnt yet."""
        for number in range(self.configuration.statistics_windows):
            course = self._begin(number, length=1, settle=bool(number % 2))
            predictor = LearningPredictor(self.network, course.prepared, self.start)
            self.model.gather_statistics(predictor.graph(course.situation()), course.window.skinned_acceleration(1))
            self.counters.window += 1
        self.workers.reduce_statistics(self.model)
        self.model.freeze_statistics()

    def _begin(self, number: int, length: int, settle: bool | None = None) -> Course:
        """This process's share of window `number`, at its noisy skinned start."""
        indices = self._indices(number)
        window = self.loader.load([self.sampler.sample(index, length) for index in indices], length)
        settles = self.sampler.settles(number, length) if settle is None else settle
        state = window.start(self.configuration.noise, self.configuration.clearance)
        prepared = self.model.prepare(window.garments)
        return Course(number, window, state, prepared, SituationFeatures(prepared), settles, length)

    def _indices(self, number: int) -> range:
        """This process's samples of window `number`."""
        batch = self.configuration.batch
        return range(number * batch, (number + 1) * batch)[self.share]

    def _train_round(self) -> RoundEnd:
        """Step through some windows in turn, an optimiser step after each step.

        A window whose garment is lost leaves the round: nothing that follows would be worth learning.
        """
        length = self.configuration.curriculum.window_length(self.progress)
        together, passes = self.configuration.interleaved, self.model.network.passes
        if self.budget.steps is not None:
            left = math.ceil((self.budget.steps - self.counters.step) / passes)
            together = min(together, left)
            length = min(length, math.ceil(left / together))
        first = self.counters.window
        courses = [self._begin(number, length) for number in range(first, first + together)]
        while courses:
            for course in courses:
                if not self._advance(course):
                    return RoundEnd.CAME_APART
            courses = [course for course in courses if course.left]
            ending = self._ending() if courses else None
            if ending == "stopped":
                return RoundEnd.STOPPED
            if ending == "finished":
                break
        return RoundEnd.LEARNT

    def _advance(self, course: Course) -> bool:
        """Learn from the next step of a window, and take it; whether all went well."""
        taken = course.window.length - course.left
        steps = [
            self.sampler.propagation_steps(index, taken, ruled)
            for index, ruled in zip(self._indices(course.number), course.prepared.steps, strict=True)
        ]
        prepared, situation = course.prepared.with_steps(steps), course.situation()
        start, after = self.start, course.state
        for _ in range(self.model.network.passes):
            predictor = LearningPredictor(self.network, prepared, start, features=course.features)
            after = step(situation, StepParts(predictor))
            if not self._learn(prepared, situation, after):
                return False
            start = Reached(predictor.reached)
        state = State(after.positions.detach(), after.velocities.detach(), after.frame)
        course.state = self._set_off(course, state) if course.settles else state
        course.settles, course.left = False, course.left - 1
        window, frame = course.window, course.state.frame
        strain = strain_percentile(window.garments, course.state.positions)
        drift = drift_from(window.skinned[frame], window.garments, course.state.positions)
        if self.workers.agreed(is_lost(strain, drift, self.latest_collision)):
            course.left = 0
        return True

    def _set_off(self, course: Course, settled: State) -> State:
        """A settled garment, still in the row where it settled, with the velocity that it sets off with."""
        window, row = course.window, settled.frame - 1
        skinned = window.skinned_velocity(row)
        velocities = {
            "skinned": skinned,
            "slowed": self.sampler.slowing(course.number) * skinned,
            "zero": torch.zeros_like(settled.velocities),
            # The released code counts the settling displacement as one of an ordinary step (reference 1.8).
            "carried": settled.velocities * (SETTLING_DT / window.dt),
        }
        return State(settled.positions, velocities[self.configuration.after_settling], row)

    def _learn(self, prepared: PreparedGarments, situation: Situation, after: State) -> bool:
        """One optimiser step on the energies of a step; False where they or their gradient are not finite."""
        weight = self.configuration.curriculum.collision(self.progress)
        rate = self.configuration.curriculum.rate(self.progress) * self.counters.rate_factor
        finite = torch.isfinite(after.positions)
        positions = torch.where(finite, after.positions, situation.state.positions)
        terms = mean_energies(step_energies(situation, positions, weight))
        further = further_losses(prepared, situation, positions, self.progress)
        gradient = self.learner.gradient(torch.stack([terms["total"], *further.values()]).sum())
        terms |= further
        watched = torch.stack([*(value.detach() for value in terms.values()), finite.all().to(positions)])
        *values, all_finite = self.workers.mean(watched).tolist()
        if all_finite < 1.0 or not all(math.isfinite(value) for value in (*values, gradient)):
            return False
        self.counters.step += 1
        self.learner.step(rate, self.counters.step)
        named = dict(zip(terms, values, strict=True))
        self.latest_collision = float(terms["collision"].detach()) / weight
        self.counters.guard = self.counters.guard.after(strain_energy(named, weight))
        extra = {"gradient": gradient, "rate": rate, "collision_weight": weight, "count": 1.0}
        self.totals.append(comparable_total(named, weight))
        for name, value in {**named, **extra}.items():
            self.sums[name] = self.sums.get(name, 0.0) + value
        if self.counters.step % self.configuration.log_every == 0:
            self._log()
        return not self.counters.guard.exploded

    def _keep_house(self, before: int) -> None:
        """Validate and save when a step since `before` was due for it."""
        c, now = self.configuration, self.counters.step

        def due(every: int) -> bool:
            return now // every > before // every

        if due(c.validate_every):
            self._validate()
        if due(c.checkpoint_every) and self.counters.guard.calm:
            self._checkpoint()

    def _log(self) -> None:
        """Report the mean of the steps since the last line."""
        count = self.sums.pop("count", 0.0)
        if not count:
            return
        means = {name: value / count for name, value in self.sums.items()}
        # Few deep penetrations outweigh everything else in a mean, and its weight of collisions rises.
        means["median"] = statistics.median(self.totals)
        self.sums, self.totals = {}, []
        length, seconds = self.configuration.curriculum.window_length(self.progress), time.monotonic() - self._clock
        self._note({"step": self.counters.step, "seconds": round(seconds, 2), "window": length, **means})
        self.reporter.progressed(self.counters.step, self.progress, seconds, means)

    def _note(self, record: dict[str, Any]) -> None:
        if self.workers.leads and self.folder:
            try:
                self.folder.append_metrics(record)
            except NotSavedError as error:
                self.reporter.said(f"{error} The training goes on.")

    def _validate(self) -> None:
        """Score the averaged weights, and keep them where they are the best so far."""
        if self.counters.validated == self.counters.step and self.counters.best is not None:
            return
        self.counters.validated = self.counters.step
        outcome = torch.zeros(3, dtype=torch.float64, device=self.workers.device)
        self.learner.average.swap(self.model)
        try:
            if self.workers.leads:
                score = self.validation.score(self.model.eval())
                outcome = outcome.new_tensor([score.survived, score.energy, score.strain])
            score = Score(*self.workers.sum(outcome).tolist())
            if score.beats(self.counters.best, IMPROVEMENT):
                self.counters.best, self.counters.flat = score, 0
                self._save_best(score)
            else:
                self.counters.flat += 1
        finally:
            self.learner.average.swap(self.model)
            self.model.train()
        finite = {name: value if math.isfinite(value) else None for name, value in asdict(score).items()}
        self._note({"step": self.counters.step, "validation": finite, "best": self.counters.flat == 0})
        self.reporter.validated(self.counters.step, score, self.counters.flat == 0)

    def _save_best(self, score: Score) -> None:
        if self.folder:
            self._save_weights(self.folder.best, asdict(score))

    def _save_final(self) -> None:
        """Keep the averaged weights of the end, which is what trainings of one budget are compared by."""
        if self.folder:
            self.learner.average.swap(self.model)
            self._save_weights(self.folder.final, {})
            self.learner.average.swap(self.model)

    def _save_weights(self, path: Path, score: dict[str, float]) -> None:
        if not self.workers.leads:
            return
        try:
            save_checkpoint(path, self.model, self.configuration.network, self.record(score), "Apache-2.0")
        except InputError as error:
            self.reporter.said(f"{error} The training goes on.")

    def record(self, score: dict[str, Any]) -> TrainingRecord:
        """How the weights of this moment came to be."""
        c, clip = self.configuration, self.data.clips[0]
        ruled = [self.model.network.propagation_steps(o.garment.mean_edge_length) for o in self.data.outfits]
        steps = (1, c.most_propagation_steps) if c.most_propagation_steps else (min(ruled), max(ruled))
        details = {
            "garments": sorted({outfit.garment.name for outfit in self.data.outfits}),
            "triangles": sorted({outfit.garment.triangle_count for outfit in self.data.outfits}),
            "bodies": sorted({body.name for body in self.data.bodies}),
            "clips": len(self.data.clips),
            "batch": c.batch,
            "seed": c.seed,
            "hours": round(self.counters.seconds / 3600.0, 3),
            "device": str(self.workers.device),
            "validation": {name: value if math.isfinite(value) else None for name, value in score.items()},
            "versions": {"pb4u": _version("pb4u"), "torch": torch.__version__},
        }
        return TrainingRecord(1.0 / clip.poses.fps, self.data.edge_lengths, steps, self.counters.step, details)

    def _roll_back(self) -> None:
        """Return to the last good weights at half the rate, and go on with other samples."""
        at, back = self.counters.step, self.saved.step
        self.counters.rollbacks += 1
        self.counters.rate_factor *= 0.5
        self.counters.guard, self.sums, self.totals = ExplosionGuard(), {}, []
        self.learner.restore(self.saved.tensors)
        sentence = (
            f"Step {at}: the training was coming apart; back to the weights of step {back} ({at - back} steps "
            f"lost), at {self.counters.rate_factor:g} times the learning rate."
        )
        self._note({"step": at, "rollback": back, "rate_factor": self.counters.rate_factor})
        self.reporter.said(sentence)
        if self.counters.rollbacks > MOST_ROLLBACKS:
            raise TrainingFailedError(
                f"The training came apart {self.counters.rollbacks} times by step {at}; start it with a lower "
                "curriculum.learning_rate."
            )

    def _checkpoint(self, exact: bool = False, insist: bool = False) -> None:
        """Save everything; without `insist`, a disk that is full only costs the checkpoint.

        The training itself goes on from what was saved, rounding included, so that it and one resumed stay the same.
        """
        self._log()
        tensors = self.learner.state(exact)
        if self.workers.leads and self.folder:
            try:
                self.folder.save_state(tensors, self.counters.to_json())
            except NotSavedError as error:
                if insist:
                    raise
                self.reporter.said(f"{error} The training goes on; the last whole checkpoint is of {self.saved.step}.")
        self.learner.restore(tensors)
        self.saved = Snapshot(tensors, self.counters.to_json())

    def resume(self, tensors: dict[str, Tensor], counters: dict[str, Any]) -> None:
        """Go on from a checkpoint. Raises InputError where it is not of this configuration."""
        self.counters = Counters.from_json(counters)
        self.learner.restore(tensors)
        self.saved = Snapshot(tensors, self.counters.to_json())


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
