"""The training, on one page: draw some windows, start them, step through them in turn, learn from every step."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from enum import Enum, auto
from typing import Any

import torch
from torch import Tensor

from pb4u.errors import warn
from pb4u.measures.metrics import strain_percentile
from pb4u.network.acceleration_model import PreparedGarments
from pb4u.physics.time_step import TimeStep
from pb4u.progress import format_duration
from pb4u.scene.state import State
from pb4u.simulation.checkpoint import Checkpoint
from pb4u.simulation.device_steps import bytes_a_vertex, require_memory
from pb4u.simulation.network_pass import NetworkPass, StepFeatures
from pb4u.simulation.pass_search import search_of
from pb4u.simulation.step import Prediction, StepMethod, predictions
from pb4u.simulation.step_start import start_accelerations, start_of
from pb4u.simulation.timeline import SETTLING_DT
from pb4u.training.averaged_weights import AveragedWeights
from pb4u.training.budget import Budget, Counters
from pb4u.training.configuration import TrainingConfiguration
from pb4u.training.distribution import Workers
from pb4u.training.journal import Journal, Reporter
from pb4u.training.learner import Learner
from pb4u.training.lost_garment import GarmentWatch, drift_from
from pb4u.training.objective import (
    LOSS_POTENTIAL,
    PROGRESS,
    further_losses,
    mean_energies,
    progress_weights,
    step_energies,
)
from pb4u.training.outcome import Outcome, note_outcomes
from pb4u.training.packed_data import TrainingData
from pb4u.training.recovery import Recovery
from pb4u.training.run_folder import RunFolder
from pb4u.training.validation import Validation
from pb4u.training.wardrobe import Wardrobe
from pb4u.training.windows import Rollout, Sampler, WindowLoader

_WORTH_SAYING = 300.0
"""Seconds of a whole training above which its time is said beforehand."""


class RoundEnd(Enum):
    """How a round of windows ended."""

    LEARNT = auto()
    CAME_APART = auto()
    STOPPED = auto()


class Trainer:
    """Trains the network of a configuration on some data.

    Args:
        configuration: everything that decides it.
        budget: when it ends.
        data: the training data.
        workers: this process and the others.
        folder: for the training, or None to save nothing.
        reporter: shows progress.
        stopping: called every few steps; true ends the training early.
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
        self.workers, self.folder, self.stopping = workers, folder, stopping
        self.learner = Learner(configuration, workers)
        self.model, self.network = self.learner.model, self.learner.network
        self.start = start_of(self.model.network, LOSS_POTENTIAL)
        self.search = search_of(self.model.network, LOSS_POTENTIAL)
        self.sampler = Sampler(data, configuration)
        self.loader = WindowLoader(Wardrobe(data, workers.device))
        self.validation = Validation(data, configuration, self.loader)
        for note in dict.fromkeys(self.validation.notes) if workers.leads else ():
            warn(note)
        self.share = workers.share(configuration.batch)
        self.counters = Counters()
        self.journal = Journal(reporter, folder, workers.leads)
        self.averages = AveragedWeights(
            configuration, data, self.learner, self.validation, workers, folder, self.journal
        )
        self.recovery = Recovery(self.learner, workers, folder, self.journal)
        self.capacities = self.loader.wardrobe.capacities
        self.outcomes: list[Outcome] = []
        self.latest_collision = torch.zeros(())
        self.began = time.monotonic()

    def run(self) -> str:
        """Train until the budget is spent, the validation no longer improves, or a stop is requested; returns which.

        Raises:
            InputError: a card has no room for a step.
        """
        if self.capacities is not None:
            self._require_memory()
        if self.counters.window == 0:
            self.gather_statistics()
            self.recovery.keep(self.counters)
        if self.budget.minutes is not None:
            self._keep_time_to_validate()
        # Neither the data nor their statistics are training, and on a busy machine they take minutes.
        self.began = time.monotonic() - self.counters.seconds
        first, since, rounds = self.counters.step, self.began, 0
        while (ending := self._ending()) is None:
            begun = self.recovery.snapshot(self.counters)
            end = self.train_round()
            if end is RoundEnd.STOPPED:
                self.counters = self.recovery.return_to(begun)
                ending = "stopped"
                break
            self.counters.window += self.configuration.interleaved
            rounds += 1
            if rounds == 1:  # the first one compiles
                first, since = self.counters.step, time.monotonic()
            elif rounds == 2 and self.budget.steps is not None and self.counters.step > first:
                pace = (time.monotonic() - since) / (self.counters.step - first)
                rest = self.budget.steps - self.counters.step
                if rest * pace > _WORTH_SAYING:
                    time_left = format_duration(rest * pace)
                    self.journal.say(f"A step takes {pace:.2g} s; the remaining {rest:,} take about {time_left}.")
            if end is RoundEnd.CAME_APART:
                self.counters = self.recovery.roll_back(self.counters)
                continue
            if self._due(self.configuration.validate_every, begun.step):
                self.averages.validate(self.counters)
            if self._due(self.configuration.checkpoint_every, begun.step) and self.counters.guard.calm:
                self._checkpoint()
        if ending == "stopped" and not self.counters.guard.calm:
            self.counters = self.recovery.return_to(self.recovery.saved)
        if ending != "stopped":
            self.averages.validate(self.counters)
            self.averages.save("final", {}, self.counters)
        self._checkpoint(exact=True, insist=True)
        return ending

    def _require_memory(self) -> None:
        """Refuse data of which the largest window has no room on the card."""
        garments, network = [outfit.garment for outfit in self.data.outfits], self.model.network
        depths = [network.propagation_steps(garment.mean_edge_length) for garment in garments]
        faces = max(len(body.faces) for body in self.data.bodies)
        bytes_each = bytes_a_vertex(network, faces, max(self.configuration.most_propagation_steps, *depths))
        most = len(self._indices(0)) * max(len(garment.vertices) for garment in garments)
        require_memory("a step of training", most, bytes_each, self.workers.device)

    def _ending(self) -> str | None:
        """Why to end now, the same in every process; None to go on."""
        self.counters.seconds = self.workers.total(time.monotonic() - self.began) / self.workers.count
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

    def _keep_time_to_validate(self) -> None:
        """Take the validation at the end off the minutes, so that they hold it too."""
        seconds = self.averages.seconds_to_validate() if self.workers.leads else 0.0
        self.budget = self.budget.without(self.workers.total(seconds))

    def _due(self, every: int, before: int) -> bool:
        """Whether a step since `before` was one of every so many."""
        return self.counters.step // every > before // every

    def begin_with(self, checkpoint: Checkpoint) -> None:
        """Start from weights of an earlier training and their statistics; the optimiser starts from scratch.

        Args:
            checkpoint: weights of a network of this configuration.
        """
        self.learner.begin_with(checkpoint.model.state_dict())
        # As if the windows of the statistics had been drawn.
        self.counters.window = self.configuration.statistics_windows
        self.recovery.keep(self.counters)

    def gather_statistics(self) -> None:
        """Normalise by what skinned garments look like; nothing is learnt yet."""
        for number in range(self.configuration.statistics_windows):
            rollout = self.begin(number, length=1, settle=bool(number % 2))
            step, network = rollout.next_step(), NetworkPass(self.network, rollout.prepared, rollout.features)
            graph = network.graph(step, start_accelerations(self.start, step))
            while self.capacities is not None and self.capacities.grow(*self.capacities.taken()):
                graph = network.graph(step, start_accelerations(self.start, step))
            self.model.gather_statistics(graph, rollout.window.timeline.skinned_acceleration(1))
            self.counters.window += 1
        self.workers.reduce_statistics(self.model)
        self.model.freeze_statistics()

    def begin(self, number: int, length: int, settle: bool | None = None) -> Rollout:
        """This process's share of a window, at its noisy skinned start.

        Args:
            number: of the window.
            length: steps.
            settle: whether it begins with a settling step; random by default.
        """
        indices = self._indices(number)
        window = self.loader.load([self.sampler.sample(index, length) for index in indices], length)
        settles = self.sampler.settles(number, length) if settle is None else settle
        state = window.start(self.configuration.noise, self.configuration.clearance)
        prepared = self.model.prepare(window.timeline.garments)
        features = StepFeatures(prepared, LOSS_POTENTIAL)
        return Rollout(number, window, state, prepared, features, GarmentWatch(), settles, length)

    def _indices(self, number: int) -> range:
        """This process's samples of window `number`."""
        batch = self.configuration.batch
        return range(number * batch, (number + 1) * batch)[self.share]

    def train_round(self) -> RoundEnd:
        """Step through some windows in turn, an optimiser step after each pass of each step.

        A window whose garment is lost leaves the round, since its later steps are useless for training.
        """
        length = self.configuration.curriculum.window_length(self.progress)
        together, network = self.configuration.interleaved, self.configuration.network
        if self.budget.steps is not None:
            remaining = math.ceil((self.budget.steps - self.counters.step) / (network.passes + network.further_passes))
            together = min(together, remaining)
            length = min(length, math.ceil(remaining / together))
        first = self.counters.window
        rollouts = [self.begin(number, length) for number in range(first, first + together)]
        while rollouts:
            for rollout in rollouts:
                if not self.advance(rollout):
                    return RoundEnd.CAME_APART
            rollouts = [rollout for rollout in rollouts if rollout.steps_left and not rollout.watch.seen_lost]
            ending = self._ending() if rollouts else None
            if ending == "stopped":
                return RoundEnd.STOPPED
            if ending == "finished":
                break
        return RoundEnd.LEARNT if self.look_at_outcomes() else RoundEnd.CAME_APART

    def advance(self, rollout: Rollout) -> bool:
        """Learn from the next step of a window, and take the step; returns whether its values were finite.

        Args:
            rollout: the window and its present step; changed.
        """
        taken = rollout.window.length - rollout.steps_left
        steps = [
            self.sampler.propagation_steps(index, taken, ruled)
            for index, ruled in zip(self._indices(rollout.number), rollout.prepared.steps, strict=True)
        ]
        step, prepared = rollout.next_step(), rollout.prepared.with_steps(steps)
        passes, further = self.configuration.network.passes, self.configuration.network.further_passes
        network = NetworkPass(self.network, prepared, rollout.features, passes, nullcontext, further)
        method = StepMethod(self.start, network, search=self.search)
        passes_made = predictions(step, method, rollout.last_move, self.capacities)
        # The network has no part in the first, which the start alone leads to.
        latest = next(passes_made)
        for latest in passes_made:
            if not self.learn(prepared, step, latest, rollout.watch):
                return False
        after, rollout.last_move = latest.state, latest.last_move
        state = replace(after, positions=after.positions.detach(), velocities=after.velocities.detach())
        rollout.state = self.with_initial_velocity(rollout, state) if rollout.settles else state
        rollout.settles, rollout.steps_left = False, rollout.steps_left - 1
        timeline, positions = rollout.window.timeline, rollout.state.positions
        strain = strain_percentile(timeline.garments, positions)
        drift = drift_from(timeline.skinned(rollout.state.frame), timeline.garments, positions)
        lost = rollout.watch.is_lost(strain, drift, self.latest_collision)
        # On an accelerator nothing more is learnt from them; the processor hears of it with the next line of the log.
        if self.capacities is None and self.workers.agreed(bool(lost)):
            rollout.steps_left = 0
        return True

    def with_initial_velocity(self, rollout: Rollout, settled: State) -> State:
        """State of settled garments, still in the frame where they settled, with the velocity that they set off with.

        Args:
            rollout: window that they are of.
            settled: after the settling step.
        """
        timeline, frame = rollout.window.timeline, settled.frame - 1
        skinned = timeline.skinned_velocity(frame)
        velocities = {
            "skinned": skinned,
            "slowed": self.sampler.slowing(rollout.number) * skinned,
            "zero": torch.zeros_like(settled.velocities),
            # The released code counts the settling displacement as one of an ordinary step (reference 1.8).
            "carried": settled.velocities * (SETTLING_DT / timeline.dt),
        }
        return State(settled.positions, velocities[self.configuration.after_settling], frame)

    def learn(
        self,
        prepared: PreparedGarments,
        step: TimeStep,
        prediction: Prediction,
        watch: GarmentWatch | None = None,
    ) -> bool:
        """One optimiser step on the energies of `step`; False where they or their gradient are not finite.

        On an accelerator results of steps are read with each line of the log; the weights do not change in a step that
        is not finite, of a lost garment, of a pass with too little gain or of a search with too small an array.

        Args:
            prepared: data that the network computes once from the garments.
            step: the time step.
            prediction: where it led, differentiable, and what its last pass was worth.
            watch: sees whether the garments are lost.
        """
        weight = self.configuration.curriculum.collision(self.progress)
        rate = self.configuration.curriculum.rate(self.progress) * self.counters.rate_factor
        finite = torch.isfinite(prediction.state.positions)
        positions = torch.where(finite, prediction.state.positions, step.state.positions)
        energies = step_energies(step, positions, weight, self.configuration.inside_weight)
        further = further_losses(prepared, step, positions, self.progress)
        energy = torch.stack([energies.per_garment, *further.values()]).sum(0)
        if self.configuration.loss_weight == PROGRESS:
            energy = progress_weights(step.garments, prediction.decrease).to(energy) * energy
        gradient = self.learner.gradient(energy.mean())
        terms = mean_energies(energies) | {name: value.mean() for name, value in further.items()}
        self.latest_collision = terms["collision"].detach().double() / weight
        none = finite.new_zeros(())
        idle = none if prediction.worth is None else ~prediction.worth.any()
        lost = none if self.capacities is None else self.capacities.too_little()
        if self.capacities is not None and watch is not None:
            # What a search short of room gave is not worth going on from.
            watch.lost = lost = lost if watch.lost is None else lost | watch.lost
        flags = torch.stack([idle, lost, ~finite.all()]).to(positions)
        values = self.workers.mean(torch.cat([torch.stack([*(v.detach() for v in terms.values()), gradient]), flags]))
        outcome = Outcome((*terms, "gradient"), values, {"rate": rate, "collision_weight": weight}, watch)
        if self.capacities is None and not outcome.finite(values.tolist()):
            return False
        self.outcomes.append(outcome)
        self.counters.step += 1
        self.learner.step(rate, self.counters.step, None if self.capacities is None else outcome.changes_nothing())
        if self.capacities is not None and len(self.outcomes) < self.configuration.log_every:
            return True
        return self.look_at_outcomes()

    def look_at_outcomes(self) -> bool:
        """Record the outcomes of the steps since the last call; False if one is not finite."""
        outcomes, self.outcomes, before = self.outcomes, [], self.counters.step - len(self.outcomes)
        if not outcomes:
            return True
        if not note_outcomes(outcomes, self.capacities, self.counters, self.journal):
            return False
        if self._due(self.configuration.log_every, before):
            self._log()
        return not self.counters.guard.exploded

    def _log(self) -> None:
        length, seconds = self.configuration.curriculum.window_length(self.progress), time.monotonic() - self.began
        self.journal.note_means(self.counters.step, self.progress, seconds, length)

    def _checkpoint(self, exact: bool = False, insist: bool = False) -> None:
        self._log()
        self.recovery.checkpoint(self.counters, exact, insist)

    def resume(self, tensors: dict[str, Tensor], counters: dict[str, Any]) -> None:
        """Go on from a checkpoint.

        Args:
            tensors: what `Learner.state` gave, by name.
            counters: what `Counters.to_json` gave.

        Raises:
            InputError: it is not of this configuration.
        """
        self.counters = self.recovery.resume(tensors, counters)
