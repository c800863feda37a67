"""Features made from the physics of a step, and networks that take several passes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from ball_scene import ball_scene
from pb4u.physics.integrator import integrate
from pb4u.simulation.network_simulator import NetworkPredictor, NetworkSimulator, local_origin
from pb4u.simulation.situation_features import SituationFeatures
from pb4u.simulation.stage import Stage

from pb4u.errors import InputError
from pb4u.graph.features import ADVANCE, DESCENT, Feature, FeatureLayout
from pb4u.model.pb4u_gnet import Pb4uConfiguration
from pb4u.nn.acceleration_model import AccelerationModel
from pb4u.scene.packed import pack
from pb4u.scene.state import State
from pb4u.simulation.checkpoint import TrainingRecord, load_checkpoint, save_checkpoint
from pb4u.simulation.models import load_simulator
from pb4u.simulation.step import Situation
from pb4u.simulation.step_start import FreeFlight, Reached, StepStart
from pb4u.simulation.stepwise_simulator import situation_at
from pb4u.training.objective import LearningPredictor

TINY = Pb4uConfiguration(width=8, blocks=1, layout=FeatureLayout(extra=(DESCENT, ADVANCE)), passes=3)


def situation(cells: int = 10) -> Situation:
    stage = Stage(ball_scene(cells=cells))
    rest = stage.skinned(0)
    generator = torch.Generator().manual_seed(1)
    noise = torch.randn(rest.shape, generator=generator, dtype=rest.dtype)
    state = State(rest + 1e-3 * noise, 0.1 * noise, 0)
    return situation_at(stage, state, 0)


def model(configuration: Pb4uConfiguration = TINY) -> AccelerationModel:
    torch.manual_seed(0)
    return AccelerationModel(configuration.network())


def prepared_for(network: AccelerationModel, at: Situation):
    return network.prepare(pack(at.garments.garments, torch.float32))


def test_descent_sees_where_earlier_passes_would_end() -> None:
    at = situation()
    features = SituationFeatures(prepared_for(model(), at))
    nothing = torch.zeros_like(at.state.positions)
    free = features.of(at, nothing)
    moved = features.of(at, nothing + torch.tensor([0.0, 0.0, 2e-3], dtype=nothing.dtype))
    assert not torch.allclose(free["descent"], moved["descent"])
    assert torch.equal(free["advance"], nothing)
    assert float(moved["advance"][0, 2]) == pytest.approx(0.2)


def test_descent_is_bounded_however_bad_the_state() -> None:
    at = situation()
    features = SituationFeatures(prepared_for(model(), at))
    wild = 0.3 * torch.randn(at.state.positions.shape, generator=torch.Generator().manual_seed(2)).double()
    assert float(features.of(at, wild)["descent"].norm(dim=1).max()) < 1.0


def test_every_pass_starts_where_the_last_left_off() -> None:
    at = situation()
    network = model()
    prepared = prepared_for(network, at)
    features = SituationFeatures(prepared)
    found = torch.zeros_like(at.state.positions)
    with torch.no_grad():
        for _ in range(3):
            graph = prepared.graph(at.state, at.collider, at.dt, local_origin(at.collider), features.of(at, found))
            found = found + network(graph, prepared).to(found)
    by_hand = integrate(at.state, found, at.dt, at.garments.pinned, at.pin_positions)
    assert torch.allclose(NetworkPredictor(network, prepared).predict(at).positions, by_hand.positions, atol=1e-7)


def test_training_takes_a_pass_at_a_time() -> None:
    at = situation()
    network = model()
    prepared = prepared_for(network, at)
    start: StepStart = FreeFlight()
    for _ in range(3):
        single = LearningPredictor(network, prepared, start)
        ended = single.predict(at)
        start = Reached(single.reached)
    assert ended.positions.requires_grad
    assert not single.reached.requires_grad
    whole = LearningPredictor(network, prepared, FreeFlight(), passes=3).predict(at)
    assert torch.allclose(whole.positions, ended.positions, atol=1e-9)


def test_a_feature_that_nothing_makes_is_refused() -> None:
    unknown = Feature("colour", 3, "1", False, 1.0, "a test")
    at = situation()
    network = model(replace(TINY, layout=FeatureLayout(extra=(unknown,)), passes=1))
    with pytest.raises(InputError, match="colour"):
        SituationFeatures(prepared_for(network, at))


def test_less_than_one_pass_is_refused() -> None:
    with pytest.raises(InputError, match="at least 1 pass"):
        replace(TINY, passes=0)


def test_passes_can_be_chosen_and_are_one_where_the_solver_refines(tmp_path: Path) -> None:
    path = tmp_path / "tiny.safetensors"
    save_checkpoint(path, model(), TINY, TrainingRecord(1 / 30, (0.01, 0.06), (1, 30)))
    assert NetworkSimulator(load_checkpoint(path)).passes == 3
    assert NetworkSimulator(load_checkpoint(path), refine=5).passes == 1
    assert load_simulator(path, refine=5, passes=2).simulate(ball_scene(frames=2)).metadata["passes"] == 2
    with pytest.raises(InputError, match="at least 1 pass"):
        load_simulator(path, passes=0)


def test_a_network_of_one_pass_cannot_take_more(tmp_path: Path) -> None:
    path = tmp_path / "plain.safetensors"
    plain = Pb4uConfiguration(width=8, blocks=1)
    save_checkpoint(path, model(plain), plain, TrainingRecord(1 / 30, (0.01, 0.06), (1, 30)))
    with pytest.raises(InputError, match="one pass"):
        load_simulator(path, passes=2)
