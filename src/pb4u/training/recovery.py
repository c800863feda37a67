"""Recovery of a training after its energies explode, after a stop, and after its process is killed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from pb4u.errors import Pb4uError
from pb4u.training.budget import Counters, ExplosionGuard
from pb4u.training.distribution import Workers
from pb4u.training.journal import Journal
from pb4u.training.learner import Learner
from pb4u.training.run_folder import NotSavedError, RunFolder

MOST_ROLLBACKS = 8
"""Most rollbacks of a training: the learning rate is then 256 times lower, so the fault lies elsewhere."""


class TrainingFailedError(Pb4uError):
    """A training whose energies explode repeatedly in spite of lower learning rates."""


@dataclass(frozen=True)
class Snapshot:
    """State of a training at one step.

    Args:
        tensors: (...) each as in the model, by name, as `Learner.state` gives them.
        counters: progress, as `Counters.to_json` gives it.
    """

    tensors: dict[str, Tensor]
    counters: dict[str, Any]

    @property
    def step(self) -> int:
        """Optimiser steps taken until then."""
        return int(self.counters["step"])


class Recovery:
    """Stores the last good state of a training in memory, and in its folder.

    Args:
        learner: model in training.
        workers: this process and the others.
        folder: folder of the checkpoints, or None.
        journal: log of incidents.
    """

    def __init__(self, learner: Learner, workers: Workers, folder: RunFolder | None, journal: Journal) -> None:
        self.learner, self.workers, self.folder, self.journal = learner, workers, folder, journal
        self.saved = self.snapshot(Counters())

    def snapshot(self, counters: Counters) -> Snapshot:
        """Snapshot of the present state of the training, with `counters`.

        Args:
            counters: progress of the training.
        """
        return Snapshot(self.learner.state(), counters.to_json())

    def keep(self, counters: Counters) -> None:
        """Keep a snapshot of the training as the last good one.

        Args:
            counters: progress of the training.
        """
        self.saved = self.snapshot(counters)

    def return_to(self, then: Snapshot) -> Counters:
        """Restore weights and optimiser from `then`; returns its counters.

        Args:
            then: snapshot to return to.
        """
        self.learner.restore(then.tensors)
        self.journal.forget()
        return Counters.from_json(then.counters)

    def roll_back(self, counters: Counters) -> Counters:
        """Return to the last good weights at half the rate, and go on with other samples.

        Args:
            counters: progress of the training.

        Raises:
            TrainingFailedError: the training has gone back too often.
        """
        at, back = counters.step, self.saved.step
        lower = replace(
            counters,
            rollbacks=counters.rollbacks + 1,
            rate_factor=0.5 * counters.rate_factor,
            guard=ExplosionGuard(),
        )
        self.journal.forget()
        self.learner.restore(self.saved.tensors)
        self.journal.note({"step": at, "rollback": back, "rate_factor": lower.rate_factor})
        self.journal.say(
            f"Step {at}: the training was diverging; it returns to the weights of step {back} ({at - back} steps "
            f"lost), at {lower.rate_factor:g} times the learning rate."
        )
        if lower.rollbacks > MOST_ROLLBACKS:
            raise TrainingFailedError(
                f"The training diverged {lower.rollbacks} times by step {at}; start it with a lower "
                "curriculum.learning_rate."
            )
        return lower

    def checkpoint(self, counters: Counters, exact: bool = False, insist: bool = False) -> None:
        """Save everything that is needed to resume.

        The training itself continues from the saved, rounded values, so that it and a resumed training stay equal.

        Args:
            counters: progress of the training.
            exact: store moments unrounded.
            insist: raise NotSavedError on a full disk; without it, that only costs the checkpoint.
        """
        tensors = self.learner.state(exact)
        if self.workers.leads and self.folder:
            try:
                self.folder.save_state(tensors, counters.to_json())
            except NotSavedError as error:
                if insist:
                    raise
                self.journal.say(
                    f"{error} The training goes on; the last complete checkpoint is of step {self.saved.step}."
                )
        self.learner.restore(tensors)
        self.saved = Snapshot(tensors, counters.to_json())

    def resume(self, tensors: dict[str, Tensor], counters: dict[str, Any]) -> Counters:
        """Go on from a checkpoint; returns its counters.

        Args:
            tensors: (...) each as in the model, by name, in the units that `Learner.state` gave them.
            counters: progress, as `Counters.to_json` gave it.

        Raises:
            InputError: it is not of this configuration.
        """
        begun = Counters.from_json(counters)
        self.learner.restore(tensors)
        self.saved = Snapshot(tensors, begun.to_json())
        return begun
