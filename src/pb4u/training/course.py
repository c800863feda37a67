"""A training window on its way through a round."""

from __future__ import annotations

from dataclasses import dataclass

from pb4u.nn.acceleration_model import PreparedGarments
from pb4u.scene.state import State
from pb4u.simulation.situation_features import SituationFeatures
from pb4u.simulation.step import Situation
from pb4u.training.windows import Window


@dataclass
class Course:
    """A window on its way.

    Args:
        number: of the window. window: its garments and bodies. state: of the garments.
        prepared: what the network derived once from the garments. features: of them.
        settles: whether the next step is the settling one. left: steps to go.
    """

    number: int
    window: Window
    state: State
    prepared: PreparedGarments
    features: SituationFeatures
    settles: bool
    left: int

    def situation(self) -> Situation:
        """What the next step starts from."""
        return self.window.settling(self.state) if self.settles else self.window.moving(self.state)
