"""A trained network rolled out, with the solver and contact response in the loop where asked for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from pb4u.errors import InputError
from pb4u.graph.features import ADVANCE
from pb4u.nn.acceleration_model import AccelerationModel, PreparedGarments
from pb4u.physics.divergence import require_finite
from pb4u.physics.integrator import integrate
from pb4u.scene.packed import ColliderFrame, PackedGarments, pack
from pb4u.scene.scene import Scene
from pb4u.scene.state import State
from pb4u.simulation.checkpoint import Checkpoint
from pb4u.simulation.first_frame import FirstFrame, OneLongStep, Relaxed
from pb4u.simulation.refinement import SolverRefinement
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.situation_features import SituationFeatures
from pb4u.simulation.stage import Stage
from pb4u.simulation.step import Contact, NoContact, NoRefinement, Predictor, Situation, StepParts
from pb4u.simulation.step_start import start_of
from pb4u.simulation.stepwise_simulator import StepwiseSimulator

_ORIGIN_GRID = 1.0 / 16.0


class NetworkPredictor(Predictor):
    """Accelerations from the network, integrated in the state's own precision; DivergedError where one is not finite.

    Args:
        model: the network between its normalisers, on the device to compute on.
        prepared: what it derived once from the garments.
        passes: how often the network is asked, each time from where it left off; None is its own number.
    """

    def __init__(self, model: AccelerationModel, prepared: PreparedGarments, passes: int | None = None) -> None:
        self.model, self.prepared = model, prepared
        self.passes = model.network.passes if passes is None else passes
        self.device = next(model.parameters()).device
        self._features = SituationFeatures(prepared)
        self._start = start_of(model.network)
        self._static: tuple[ColliderFrame, ColliderFrame] | None = None

    @torch.inference_mode()
    def _accelerations(self, situation: Situation) -> Tensor:
        found = self._start.accelerations(situation)
        for _ in range(self.passes):
            found = found + self._pass(situation, found).to(found)
            if not bool(torch.isfinite(found).all()):
                break
        return found

    def _pass(self, situation: Situation, found: Tensor) -> Tensor:
        """What the network adds to the accelerations `found` by earlier passes."""
        state = replace(
            situation.state,
            positions=situation.state.positions.to(self.device),
            velocities=situation.state.velocities.to(self.device),
        )
        collider = self._on_device(situation.collider)
        origin = local_origin(situation.collider).to(self.device)
        extra = {name: values.to(self.device) for name, values in self._features.of(situation, found).items()}
        graph = self.prepared.graph(state, collider, situation.dt, origin, extra)
        return self.model(graph, self.prepared)

    def _on_device(self, collider: ColliderFrame) -> ColliderFrame:
        """The bodies where the network computes; what never changes is moved once."""
        if collider.now.device == self.device:
            return collider
        fixed = ("faces", "contact", "vertex_garment")
        if self._static is None or any(getattr(self._static[0], n) is not getattr(collider, n) for n in fixed):
            self._static = collider, replace(collider, **{n: getattr(collider, n).to(self.device) for n in fixed})
        moving = {n: getattr(collider, n).to(self.device) for n in ("previous", "now", "following")}
        return replace(self._static[1], **moving)

    def predict(self, situation: Situation) -> State:
        acceleration = self._accelerations(situation).clone()
        # Here, because neither the next pass nor what follows a prediction can look up a body at no position.
        return require_finite(
            integrate(situation.state, acceleration, situation.dt, situation.garments.pinned, situation.pin_positions)
        )


def local_origin(collider: ColliderFrame) -> Tensor:
    """(3,) [m] middle of the bodies, rounded so that float32 differences of positions stay exact."""
    middle = collider.now.mean(0)
    return (middle / _ORIGIN_GRID).round() * _ORIGIN_GRID


class NetworkSimulator(StepwiseSimulator):
    """Rolls a checkpoint out.

    Args:
        checkpoint: the trained model.
        propagation_steps: override of K; None follows the paper's rule.
        refine: solver iterations after each step; 0 for none.
        contact: what answers vertices left inside the body.
        device: where the network computes.
        passes: how often the network is asked in a step; None is its own number, or 1 where the solver refines: what a
            further pass improves, the solver improves more cheaply.

    Raises InputError for less than 1 pass, or more than 1 of a network that cannot tell one pass from the next.
    """

    def __init__(
        self,
        checkpoint: Checkpoint,
        propagation_steps: int | None = None,
        refine: int = 0,
        contact: Contact | None = None,
        device: torch.device | str = "cpu",
        passes: int | None = None,
    ) -> None:
        self.name = checkpoint.name
        self.fps = 1.0 / checkpoint.record.dt
        self.checkpoint = checkpoint
        self.override = propagation_steps
        self.refine = refine
        self.contact = contact or NoContact()
        self.device = torch.device(device)
        self.passes = (1 if refine else checkpoint.model.network.passes) if passes is None else passes
        if self.passes < 1:
            raise InputError(f"A network takes at least 1 pass a step, not {self.passes}.")
        if self.passes > 1 and ADVANCE not in checkpoint.model.network.layout.extra:
            raise InputError(
                f"The network {checkpoint.name} was made for one pass a step; leave --passes out, or give 1."
            )
        checkpoint.model.to(self.device)

    def settings(self) -> dict[str, Any]:
        return {
            "refine": self.refine,
            "passes": self.passes,
            "device": str(self.device),
            "weights_licence": self.checkpoint.licence,
        }

    def propagation_steps(self, scene: Scene) -> int | None:
        ruled = self.checkpoint.model.network.propagation_steps(scene.garments[0].garment.mean_edge_length)
        if not ruled:
            return None
        return ruled if self.override is None else self.override

    def parts(self, stage: Stage, record: RunRecord) -> StepParts:
        garments: PackedGarments = pack(stage.garments.garments, torch.float32, self.device)
        # What the warnings of the checkpoint tell to expect, the solver mends where it refines.
        careful = self.checkpoint.model if self.refine else self.checkpoint
        prepared = careful.prepare(garments, self.override)
        predictor = NetworkPredictor(self.checkpoint.model, prepared, self.passes)
        refinement = SolverRefinement(self.refine) if self.refine else NoRefinement()
        return StepParts(predictor, refinement, self.contact)

    def first_frame(self, parts: StepParts) -> FirstFrame:
        return Relaxed(contact=self.contact) if self.refine else OneLongStep(parts, self.contact)
