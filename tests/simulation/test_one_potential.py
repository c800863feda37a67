"""A simulator's potential is the one that its first frame, start, gradient feature, search and solver descend."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from ball_scene import ball_scene
from torch import Tensor

from pb4u.measures.excess import StepMinima
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.graph.features import ADVANCE, DESCENT, FeatureLayout
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.paper.controls import GRADIENT_DESCENT, ControlSimulator
from pb4u.physics.contact.contact_set import ContactSet
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.terms.energy_term import EnergyTerm, sum_by_garment
from pb4u.physics.time_step import TimeStep
from pb4u.simulation.checkpoint import TrainingRecord, load_checkpoint, save_checkpoint
from pb4u.simulation.simulator import RunRecord
from pb4u.simulation.step import StepMethod, take
from pb4u.simulation.stepwise_simulator import NetworkSimulator, QuickSolver, SolverSimulator, StepwiseSimulator
from pb4u.simulation.timeline import Timeline

SIX = IncrementalPotential()
PULL = 60.0
"""Acceleration [m/s^2] along Z."""
CONFIGURATION = Pb4uConfiguration(
    width=8,
    blocks=1,
    layout=FeatureLayout(extra=(DESCENT, ADVANCE)),
    passes=2,
    conjugate=True,
    warm_start_shares=(0.5, 1.0),
)


class Pull(EnergyTerm):
    """Minus the sum over vertices of m a z' [J]: what draws cloth along Z, in the place of `name` or besides all."""

    def __init__(self, name: str) -> None:
        self.name = name

    def energies(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> Tensor:
        garments = step.garments
        energy = -PULL * garments.vertex_masses * x[:, 2]
        return sum_by_garment(energy, garments.vertex_garment, garments.garment_count)

    def energies_and_gradient(self, step: TimeStep, contacts: ContactSet, x: Tensor) -> tuple[Tensor, Tensor]:
        along = x.new_tensor((0.0, 0.0, -PULL))
        return self.energies(step, contacts, x), step.garments.vertex_masses[:, None] * along


def step_of(timeline: Timeline) -> TimeStep:
    """A step from rest, over which skinning carries all cloth along Z."""
    at = timeline.settling_from(timeline.skinned_state(0))
    motion = torch.zeros_like(at.state.positions) + torch.tensor([0.0, 0.0, 0.02], dtype=torch.float64)
    return replace(at, dt=timeline.dt, pin_positions=at.state.positions + motion, skinned_motion=motion)


def network(folder: Path, potential: IncrementalPotential) -> NetworkSimulator:
    torch.manual_seed(0)
    file = folder / "a.safetensors"
    record = TrainingRecord(1 / 30, (0.02, 0.03), (1, 9), 5)
    save_checkpoint(file, AccelerationModel(CONFIGURATION.network()), CONFIGURATION, record)
    return NetworkSimulator(load_checkpoint(file), potential=potential)


def control(_: Path, potential: IncrementalPotential) -> ControlSimulator:
    return ControlSimulator(GRADIENT_DESCENT, CONFIGURATION.network(), potential=potential)


def along(method: StepMethod, step: TimeStep) -> dict[str, float]:
    """How far along Z [m] each part of a method leads, on the mean."""
    nothing = torch.zeros_like(step.state.positions)
    way = nothing + torch.tensor([0.0, 0.0, 1e-3], dtype=torch.float64)
    moves = {
        "start": method.start.accelerations(step),
        "search": method.search(step, nothing, way, None)[0],
        "prediction": method.network.correction(step, nothing),
    }
    if hasattr(method.network, "features"):
        moves["prediction"] = method.network.features.of(step, nothing)["descent"]
    return {name: float(move[:, 2].mean()) for name, move in moves.items()}


@pytest.mark.parametrize("name", ["gravity", "pull"])
@pytest.mark.parametrize("made", [network, control])
def test_start_search_and_feature_follow_another_potential(made, name: str, tmp_path: Path) -> None:
    pulled = SIX.with_term(Pull(name))
    assert pulled.names == (*SIX.names, *(() if name in SIX.names else (name,)))
    timeline = Timeline.of(ball_scene(speed=0.0))
    step = step_of(timeline)
    usual, led = (along(made(tmp_path, each).method(timeline, RunRecord()), step) for each in (SIX, pulled))
    assert abs(usual["prediction"]) < 0.05 * led["prediction"]
    # All of the body's motion is taken along the pull, which lowers the energy by more than inertia raises it.
    assert usual["start"] == 0.0
    assert led["start"] > 0.01
    assert abs(usual["search"]) < 0.2 * led["search"]


@pytest.mark.parametrize("simulator", [SolverSimulator, lambda **its: QuickSolver(refine=3, **its)])
def test_the_solver_and_its_first_frame_follow_another_potential(simulator) -> None:
    timeline, ways = Timeline.of(ball_scene(speed=0.0)), []
    for potential in (SIX, SIX.with_term(Pull("pull"))):
        made: StepwiseSimulator = simulator(potential=potential)
        method = made.method(timeline, RunRecord())
        first = made.first_frame.start(timeline, method).state
        after = take(timeline.step_from(first), method).state
        ways.append([float((x - timeline.skinned(0))[:, 2].mean()) for x in (first.positions, after.positions)])
    (settled, taken), (drawn, further) = ways
    assert drawn > settled + 0.02
    assert further > taken + 0.04


def test_the_excess_of_a_step_is_of_its_potential() -> None:
    step = step_of(Timeline.of(ball_scene(speed=0.0)))
    minima = StepMinima(SIX.with_term(Pull("pull")))
    x = step.state.positions
    least = minima.lowest(step, minima.usual_starts(step)).energy
    # Standing still leaves at least what the pull frees in a step: a dt^2 of way at half its force.
    assert minima.excess(step, x, least) > 0.4 * PULL**2 / 9.81 / 30**2
