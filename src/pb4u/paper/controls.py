"""Controls: what a network does around its predictions, without the network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from pb4u.network.acceleration_model import GraphNetwork
from pb4u.network.graph.garment_graph import incident_lengths
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.time_step import TimeStep
from pb4u.scene.packed import PackedGarments
from pb4u.simulation.models import CONTROLS
from pb4u.simulation.network_pass import DescentFeature
from pb4u.simulation.pass_search import search_of
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import StepMethod
from pb4u.simulation.step_start import start_of
from pb4u.simulation.stepwise_simulator import StepwiseSimulator
from pb4u.simulation.timeline import Timeline

GRADIENT_DESCENT, WARM_START = "gradient-descent", "warm-start"


@dataclass(eq=False)
class ControlSimulator(StepwiseSimulator):
    """The default network's step, with gradient descent or nothing instead of the network.

    `--model gradient-descent` uses the network's own input feature, Jacobi descent of the potential, as its prediction;
    `--model warm-start` keeps the start of the step. The difference to these is the network's own contribution.

    Args:
        name: one of the two.
        like: network with the start, search and number of passes to use.
        passes: gradients in a step; None is the number of the network.
    """

    name: str
    like: GraphNetwork
    passes: int | None = None

    @property
    def _repeats(self) -> tuple[int, int]:
        """Gradients in a step, and the most beyond those."""
        if self.name != GRADIENT_DESCENT:
            return 0, 0
        like = self.like.configuration
        return (like.passes, like.further_passes) if self.passes is None else (self.passes, 0)

    def settings(self) -> dict[str, Any]:
        return {**super().settings(), "refine": self.refine, "device": "cpu", "passes": self._repeats[0]}

    def method(self, timeline: Timeline, record: RunRecord) -> StepMethod:
        return StepMethod(
            start_of(self.like, self.potential),
            GradientPass(timeline.garments, self.potential, *self._repeats) if self._repeats[0] else None,
            self.refinement(record),
            self.contact,
            self.potential,
            search_of(self.like, self.potential),
        )


CONTROLS.update(dict.fromkeys((GRADIENT_DESCENT, WARM_START), ControlSimulator))


class GradientPass:
    """The gradient feature itself as the pass, for comparison with a network.

    Args:
        garments: garments of the steps, float64 on the CPU.
        potential: the energies that are descended.
        passes: number of gradients in a step.
        further: largest number of additional passes, made while a pass lowers the energy enough.
    """

    def __init__(
        self, garments: PackedGarments, potential: IncrementalPotential, passes: int = 1, further: int = 0
    ) -> None:
        self.passes, self.further = passes, further
        self._feature = DescentFeature(potential)
        self._incident_length = incident_lengths(garments)

    @torch.no_grad()
    def correction(self, step: TimeStep, accelerations: Tensor) -> Tensor:
        """Accelerations (vertices, 3) [m per step^2] to add; see `NetworkPass.correction`.

        Args:
            step: the time step.
            accelerations: (vertices, 3) [m per step^2] from free flight.
        """
        length = self._incident_length
        return length[:, None] * self._feature.of(step, accelerations, length)
