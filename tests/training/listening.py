"""A reporter that remembers what it was told, and a trainer on the ball that reports to it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import torch
from tests.training.ball_data import TINY, ball_data

from pb4u.measures.excess import Reference
from pb4u.training.budget import Budget
from pb4u.training.configuration import TrainingConfiguration, training_to_json
from pb4u.training.distribution import Workers
from pb4u.training.journal import Reporter
from pb4u.training.run_folder import RunFolder
from pb4u.training.trainer import Trainer
from pb4u.training.validation import Score

ALONE = Workers(0, 1, torch.device("cpu"))


class Listener(Reporter):
    """Keeps the means, scores and sentences."""

    def __init__(self) -> None:
        self.sentences: list[str] = []
        self.means: list[Mapping[str, float]] = []
        self.scores: list[Score] = []

    def progressed(self, step: int, progress: float, seconds: float, means: Mapping[str, float]) -> None:
        self.means.append(dict(means))

    def validated(self, step: int, score: Score, best: bool) -> None:
        self.scores.append(score)

    def said(self, sentence: str) -> None:
        self.sentences.append(sentence)


def made(
    configuration: TrainingConfiguration, steps: int, folder: Path | None = None, listener: Listener | None = None
) -> Trainer:
    """A trainer of `steps` on this one process, kept in `folder` where one is given."""
    kept = None if folder is None else RunFolder.create(folder, training_to_json(configuration))
    trainer = Trainer(configuration, Budget(steps), ball_data(), ALONE, kept, listener or Listener())
    if all(getattr(configuration, name) == getattr(TINY, name) for name in ("seed", "validation_clips", "clearance")):
        vars(trainer.validation)["references"] = references()
    return trainer


@lru_cache
def references() -> tuple[Reference, ...]:
    """What the validations of all these trainers compare with: the solver's, which takes longer than a training."""
    return Trainer(TINY, Budget(1), ball_data(), ALONE, None, Listener()).validation.references
