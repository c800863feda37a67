"""The averaged weights of a training: scored on its validation clips, and kept in its folder."""

from __future__ import annotations

import time
from dataclasses import asdict, astuple, fields
from pathlib import Path

import torch

from pb4u.errors import InputError
from pb4u.simulation.checkpoint import TrainingRecord, save_checkpoint
from pb4u.training.budget import Counters
from pb4u.training.configuration import TrainingConfiguration
from pb4u.training.distribution import Workers
from pb4u.training.journal import Journal
from pb4u.training.learner import Learner
from pb4u.training.packed_data import TrainingData
from pb4u.training.run_folder import RunFolder
from pb4u.training.training_record import training_record
from pb4u.training.validation import Score, Validation

IMPROVEMENT = 0.005
"""Share of the energy by which a score must be better to count: less is the noise of a validation."""
FREE_LICENCE = "Apache-2.0"
"""Licence of weights that are made from assets of this package alone."""


class AveragedWeights:
    """Scores the averaged weights of a training, and saves the best and the last ones.

    Args:
        configuration: everything that decides the training.
        data: the training data.
        learner: the model in training.
        validation: scores a model.
        workers: this process and the others.
        folder: for the weights, or None to save nothing.
        journal: log of scores and incidents.

    Attributes:
        origin: record of the weights that the training started from, or None.
        licence: of the saved weights.
    """

    def __init__(
        self,
        configuration: TrainingConfiguration,
        data: TrainingData,
        learner: Learner,
        validation: Validation,
        workers: Workers,
        folder: RunFolder | None,
        journal: Journal,
    ) -> None:
        self.configuration, self.data, self.learner, self.validation = configuration, data, learner, validation
        self.workers, self.folder, self.journal = workers, folder, journal
        self.origin: TrainingRecord | None = None
        self.licence = FREE_LICENCE

    def seconds_to_validate(self) -> float:
        """Time [s] of a validation at the end; its references are computed first."""
        self.journal.say("Simulating the reference runs for validation; the training time counts from after them.")
        _ = self.validation.references
        began = time.monotonic()
        score = self._score()
        # What is lost early is rolled out no further; later weights keep it to the end.
        return (time.monotonic() - began) / max(score.survived, 0.25)

    def validate(self, counters: Counters) -> None:
        """Score the weights, and save them if they are the best so far.

        Args:
            counters: progress of the training; the best score is recorded there.
        """
        if counters.validated == counters.step and counters.best is not None:
            return
        counters.validated = counters.step
        outcome = torch.zeros(len(fields(Score)), dtype=torch.float64, device=self.workers.device)
        if self.workers.leads:
            outcome = outcome.new_tensor(astuple(self._score()))
        score = Score(*self.workers.sum(outcome).tolist())
        best = score.beats(counters.best, IMPROVEMENT)
        if best:
            counters.best, counters.flat = score, 0
            self.save("best", asdict(score), counters)
        else:
            counters.flat += 1
        self.journal.note_score(counters.step, score, best)

    def save(self, which: str, score: dict[str, float], counters: Counters) -> None:
        """Save the weights: the best, or the last ones, by which trainings of equal budget are compared.

        Args:
            which: "best" or "final".
            score: of these weights, as JSON data.
            counters: progress of the training.
        """
        if self.folder is None or not self.workers.leads:
            return
        path: Path = getattr(self.folder, which)
        network, device = self.learner.model.network, self.workers.device
        record = training_record(self.configuration, self.data, network, counters, score, device)
        record = record if self.origin is None else record.after(self.origin)
        with self.learner.averaged():
            try:
                save_checkpoint(path, self.learner.model, self.configuration.network, record, self.licence)
            except InputError as error:
                self.journal.say(f"{error} The training goes on.")

    def _score(self) -> Score:
        with self.learner.averaged():
            score = self.validation.score(self.learner.model.eval())
        self.learner.model.train()
        return score
