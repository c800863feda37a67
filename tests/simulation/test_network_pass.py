"""Features made from the physics of a step, and networks that take several passes."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from ball_scene import ball_scene
from torch import Tensor

from pb4u.errors import InputError
from pb4u.network.acceleration_model import AccelerationModel, PreparedGarments
from pb4u.network.graph.features import ADVANCE, DESCENT, Feature, FeatureLayout
from pb4u.network.pb4u_gnet import Pb4uConfiguration
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.physics.time_step import TimeStep, integrate
from pb4u.scene.packed import pack
from pb4u.scene.state import State
from pb4u.simulation.checkpoint import TrainingRecord, load_checkpoint, save_checkpoint
from pb4u.simulation.models import load_simulator
from pb4u.simulation.network_pass import NetworkPass, StepFeatures, local_origins
from pb4u.simulation.step import StepMethod, predictions, take
from pb4u.simulation.step_start import BodyMotionWarmStart
from pb4u.simulation.stepwise_simulator import NetworkSimulator
from pb4u.simulation.timeline import Timeline

SIX = IncrementalPotential()
TINY = Pb4uConfiguration(width=8, blocks=1, layout=FeatureLayout(extra=(DESCENT, ADVANCE)), passes=3)


def a_step(cells: int = 10) -> TimeStep:
    timeline = Timeline.of(ball_scene(cells=cells))
    rest = timeline.skinned(0)
    generator = torch.Generator().manual_seed(1)
    noise = torch.randn(rest.shape, generator=generator, dtype=rest.dtype)
    return timeline.step_from(State(rest + 1e-3 * noise, 0.1 * noise, 0))


def model(configuration: Pb4uConfiguration = TINY) -> AccelerationModel:
    torch.manual_seed(0)
    return AccelerationModel(configuration.network())


def prepared_for(network: AccelerationModel, at: TimeStep):
    return network.prepare(pack(at.garments.garments, torch.float32))


def pass_of(network: AccelerationModel, prepared: PreparedGarments, passes: int = 1, **common: Any) -> NetworkPass:
    return NetworkPass(network, prepared, StepFeatures(prepared, SIX), passes, **common)


def test_descent_sees_where_earlier_passes_would_end() -> None:
    at = a_step()
    features = StepFeatures(prepared_for(model(), at), SIX)
    nothing = torch.zeros_like(at.state.positions)
    free = features.of(at, nothing)
    moved = features.of(at, nothing + torch.tensor([0.0, 0.0, 2e-3], dtype=nothing.dtype))
    assert not torch.allclose(free["descent"], moved["descent"])
    assert torch.equal(free["advance"], nothing)
    assert float(moved["advance"][0, 2]) == pytest.approx(0.2)


def test_descent_is_bounded_however_bad_the_state() -> None:
    at = a_step()
    features = StepFeatures(prepared_for(model(), at), SIX)
    wild = 0.3 * torch.randn(at.state.positions.shape, generator=torch.Generator().manual_seed(2)).double()
    assert float(features.of(at, wild)["descent"].norm(dim=1).max()) < 1.0


def test_a_descent_is_shown_at_one_size_and_predictions_scaled_back() -> None:
    at = a_step()
    sized = replace(TINY, descent_size=0.03)
    features, plain = StepFeatures(prepared_for(model(sized), at), SIX), StepFeatures(prepared_for(model(), at), SIX)
    nothing = torch.zeros_like(at.state.positions)
    shown, factors = features.scaled(at, nothing)
    assert float(shown["descent"].square().sum(1).mean().sqrt()) == pytest.approx(0.03, rel=1e-5)
    torch.testing.assert_close(factors * shown["descent"], plain.of(at, nothing)["descent"])
    as_it_is, ones = plain.scaled(at, nothing)
    assert torch.equal(as_it_is["descent"], plain.of(at, nothing)["descent"])
    assert torch.equal(ones, torch.ones_like(ones))


def test_a_pass_near_the_minimum_is_as_one_far_from_it() -> None:
    # Descent alone is seen, and seen at one size: a tenth of it is answered by a tenth of the correction.
    sized = replace(
        TINY, descent_size=0.03, layout=FeatureLayout(node=(), mesh_edge=("rest_direction",), extra=(DESCENT,))
    )
    at, network = a_step(), model(sized)
    moves = []
    for share in (1.0, 0.1):
        asked = pass_of(network, prepared_for(network, at), 1)
        asked.features.of = lambda step, reached, share=share: {"descent": share * 1e-2 * step.state.velocities}
        moves.append(asked.correction(at, torch.zeros_like(at.state.positions)))
    assert float(moves[0].norm()) > 0.0
    torch.testing.assert_close(moves[1], 0.1 * moves[0], rtol=1e-4, atol=1e-9)


def test_cloth_at_rest_is_not_shown_larger_than_it_is() -> None:
    at = a_step()
    features = StepFeatures(prepared_for(model(replace(TINY, descent_size=0.03)), at), SIX)
    features.of = lambda step, reached: {"descent": torch.zeros_like(reached), "advance": reached}
    shown, factors = features.scaled(at, torch.zeros_like(at.state.positions))
    assert not shown["descent"].any()
    assert bool(torch.isfinite(factors).all())


@pytest.mark.parametrize("size", [-0.1, 1.5])
def test_a_size_that_no_descent_has_is_refused(size: float) -> None:
    with pytest.raises(InputError, match="descent_size must be"):
        replace(TINY, descent_size=size)


def test_every_pass_starts_where_the_last_left_off() -> None:
    at = a_step()
    network = model()
    prepared = prepared_for(network, at)
    features = StepFeatures(prepared, SIX)
    found = torch.zeros_like(at.state.positions)
    with torch.no_grad():
        for _ in range(3):
            graph = prepared.graph(at.state, at.collider, at.dt, local_origins(at.collider, 1), features.of(at, found))
            found = found + network(graph, prepared).to(found)
    taken = take(at, StepMethod(network=pass_of(network, prepared, 3))).state
    assert torch.allclose(taken.positions, integrate(at, found).positions, atol=1e-7)


class Reached(BodyMotionWarmStart):
    """Starts from accelerations already reached."""

    def __init__(self, accelerations: Tensor) -> None:
        self.reached = accelerations

    def accelerations(self, step: TimeStep) -> Tensor:
        return self.reached


def states(step: TimeStep, method: StepMethod) -> list[State]:
    return [made.state for made in predictions(step, method)]


def test_training_takes_a_pass_at_a_time() -> None:
    at = a_step()
    network = model()
    prepared = prepared_for(network, at)
    start: BodyMotionWarmStart | None = None
    free = integrate(at, torch.zeros_like(at.state.positions)).positions
    for _ in range(3):
        before, reached = states(at, StepMethod(start, pass_of(network, prepared, mode=nullcontext)))
        assert not before.positions.requires_grad
        start = Reached((reached.positions - free).detach())
    assert reached.positions.requires_grad
    all_passes = StepMethod(None, pass_of(network, prepared, 3, mode=nullcontext))
    *earlier, last = states(at, all_passes)
    assert len(earlier) == 3
    assert torch.allclose(last.positions, reached.positions, atol=1e-9)
    (of_all,) = torch.autograd.grad(last.positions.sum(), network.network.decoder.last.bias)
    (of_last,) = torch.autograd.grad(reached.positions.sum(), network.network.decoder.last.bias)
    assert torch.allclose(of_all, of_last, rtol=1e-5), "only the latest pass is differentiable"


def test_a_feature_that_nothing_makes_is_refused() -> None:
    unknown = Feature("colour", 3, "1", False, 1.0, "a test")
    at = a_step()
    network = model(replace(TINY, layout=FeatureLayout(extra=(unknown,)), passes=1))
    with pytest.raises(InputError, match="colour"):
        StepFeatures(prepared_for(network, at), SIX)


def test_less_than_one_pass_is_refused() -> None:
    with pytest.raises(InputError, match="at least 1 pass"):
        replace(TINY, passes=0)


def test_passes_can_be_chosen_and_are_one_where_the_solver_refines(tmp_path: Path) -> None:
    path = tmp_path / "tiny.safetensors"
    save_checkpoint(path, model(), TINY, TrainingRecord(1 / 30, (0.01, 0.06), (1, 30)))
    assert NetworkSimulator(load_checkpoint(path)).passes == 3
    assert NetworkSimulator(load_checkpoint(path), refine=5).passes == 3
    assert load_simulator(path).passes == 1
    assert load_simulator(path, refine=0).passes == 3
    assert load_simulator(path, refine=5, passes=2).simulate(ball_scene(frames=2)).metadata["passes"] == 2
    with pytest.raises(InputError, match=r"^passes "):
        load_simulator(path, passes=0)


def test_a_network_of_one_pass_cannot_take_more(tmp_path: Path) -> None:
    path = tmp_path / "plain.safetensors"
    plain = Pb4uConfiguration(width=8, blocks=1)
    save_checkpoint(path, model(plain), plain, TrainingRecord(1 / 30, (0.01, 0.06), (1, 30)))
    with pytest.raises(InputError, match="one pass"):
        load_simulator(path, passes=2)
